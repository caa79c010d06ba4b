"""The nodes of this process, each with a thread of its own, and the event loop in which controllers run.

A callback of ROS runs in its node's thread; what touches controllers is done in the loop, between two cycles, by
`NodeHost.do` and `NodeHost.wait`. Messages are published from the loop. A node that waits, as in a service that waits
for the robot, holds up nobody but itself.

Why not one executor for all nodes: rclpy's builds its wait set anew for each message, over all entities of all its
nodes, 300 of them here, which takes milliseconds.
"""

import asyncio
import concurrent.futures
import logging
import threading
from collections import defaultdict
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from importlib import import_module
from types import TracebackType
from typing import Any, TypeVar

from rclpy.context import Context
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy, qos_profile_system_default
from rclpy.task import Future
from rclpy.validate_namespace import validate_namespace

from client.errors import Ros2Error

Result = TypeVar("Result")

_logger = logging.getLogger(__name__)

SYSTEM_DEFAULT = qos_profile_system_default
LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""Who subscribes late gets the last message."""


def interface(name: str) -> Any:
    """The class of an interface, such as ``sensor_msgs/msg/JointState``. Raises ImportError, AttributeError."""
    package, kind, type_name = name.split("/")
    return getattr(import_module(f"{package}.{kind}"), type_name)


def interface_if_any(name: str) -> Any:
    """The same; None where the distribution does not have it."""
    try:
        return interface(name)
    except (ImportError, AttributeError):
        return None


class NodeHost:
    """Nodes of one ROS context; use it with ``async with``.

    domain: number of the domain, None for ROS_DOMAIN_ID. namespace: of all nodes, without slashes at the ends.
    ros_arguments: as behind ``--ros-args``.
    """

    def __init__(self, *, domain: int | None = None, namespace: str = "", ros_arguments: Sequence[str] = ()) -> None:
        self.loop = asyncio.get_running_loop()
        self.namespace = namespace
        self._domain = domain
        self._arguments = ["--ros-args", *ros_arguments] if ros_arguments else []
        self._context = Context()
        self._spinning: dict[Node, tuple[SingleThreadedExecutor, threading.Thread]] = {}
        self._tasks: dict[Node, set[concurrent.futures.Future[Any]]] = defaultdict(set)

    async def __aenter__(self) -> "NodeHost":
        """Raises Ros2Error for a namespace or arguments that ROS does not accept."""
        try:
            validate_namespace(f"/{self.namespace}")
            self._context.init(self._arguments, domain_id=self._domain)
        except (InvalidNamespaceException, ValueError, RuntimeError) as error:
            raise Ros2Error(f"ROS 2 does not accept this: {' '.join(str(error).split())}") from None
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for node in list(self._spinning):
            await asyncio.to_thread(self.close, node)  # which may be waiting for the event loop
        self._context.try_shutdown()

    def node(self, name: str, overrides: Sequence[Parameter] = (), **options: Any) -> Node:
        """A node that does not spin yet. options: of rclpy's Node."""
        return Node(
            name, context=self._context, namespace=self.namespace, parameter_overrides=list(overrides), **options
        )

    def spin(self, node: Node) -> None:
        """Let its callbacks be called from now on, in a thread of their own."""
        executor = SingleThreadedExecutor(context=self._context)
        executor.add_node(node)
        thread = threading.Thread(target=self._spin, args=(executor,), name=f"ros {node.get_name()}", daemon=True)
        self._spinning[node] = executor, thread
        thread.start()

    def _spin(self, executor: SingleThreadedExecutor) -> None:
        while True:
            try:
                executor.spin()
                return
            except ExternalShutdownException:  # the context was shut down: nothing else is to be done
                return
            except Exception:  # of a callback: its client goes without an answer, the others do not
                _logger.exception("%s: a callback failed", threading.current_thread().name)

    def close(self, node: Node) -> None:
        """End a node and its thread; neither from that thread nor in the event loop, for which it may wait."""
        for task in list(self._tasks.pop(node, ())):
            task.cancel()
        executor, thread = self._spinning.pop(node)
        executor.shutdown(timeout_sec=0.0)
        thread.join()
        node.destroy_node()

    # from the threads of nodes

    def do(self, work: Callable[[], Result]) -> Result:
        """Call it in the event loop, between two control cycles, and give what it gives or raises."""
        done: concurrent.futures.Future[Result] = concurrent.futures.Future()

        def inside() -> None:  # no coroutine: a setpoint would wait for one more turn of the loop
            try:
                done.set_result(work())
            except BaseException as error:
                done.set_exception(error)
                if not isinstance(error, Exception):
                    raise

        self.loop.call_soon_threadsafe(inside)
        return done.result()

    def wait(self, work: Awaitable[Result]) -> Result:
        """Wait for a coroutine that runs in the event loop."""
        return asyncio.run_coroutine_threadsafe(_awaited(work), self.loop).result()

    def ending(self, node: Node) -> Any:
        """What a coroutine of this node can await, and any thread may set the result of."""
        executor, _ = self._spinning[node]
        future = Future(executor=executor)
        future.add_done_callback(_nothing)  # whose call wakes the executor: setting the result alone does not
        return future

    def task(self, node: Node, work: Coroutine[Any, Any, Any]) -> Any:
        """Run a coroutine in the event loop; a coroutine of this node can await what it gives or raises.

        The node goes on meanwhile. When the node is closed the coroutine is cancelled.
        """
        ended = self.ending(node)
        tasks = self._tasks[node]

        def pass_on(task: concurrent.futures.Future[Any]) -> None:
            tasks.discard(task)
            if task.cancelled():  # with the node
                return
            if (error := task.exception()) is not None:
                ended.set_exception(error)
            else:
                ended.set_result(task.result())

        task = asyncio.run_coroutine_threadsafe(work, self.loop)
        tasks.add(task)
        task.add_done_callback(pass_on)
        return ended


async def _awaited(work: Awaitable[Result]) -> Result:
    return await work


def _nothing(_: object) -> None: ...


def stamp(message: Any, time_ns: int) -> None:
    """Set a message's builtin_interfaces/Time."""
    message.sec, message.nanosec = divmod(time_ns, 1_000_000_000)
