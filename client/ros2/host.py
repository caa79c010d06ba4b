"""The nodes of this process, each in a separate thread, and their calls to the control loop.

ROS callbacks run in their node's thread. Controllers and the robot belong to the process of the control loop, which
`NodeHost.do` and `NodeHost.call` call; what it publishes is passed on in the thread that receives it. Coroutines of
nodes run in this process's event loop. A node that waits, for example in a service that waits for the robot, blocks
only itself.

There is no common executor for all nodes, because rclpy's executor rebuilds its wait set for each message, over all
entities of all its nodes. Here that would be 300 entities, which takes milliseconds.
"""

import asyncio
import concurrent.futures
import logging
import socket
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Coroutine, Hashable, Sequence
from importlib import import_module
from typing import Any, Final, TypeVar

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.context import Context
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy, qos_profile_system_default
from rclpy.task import Future
from rclpy.validate_namespace import validate_namespace

from client.controllers.controller import Controller
from client.errors import ControllerError, Ros2Error
from client.ros2.control_side import CLOCK, SIDE, ControllerFacts, ControlSide
from client.ros2.remote_calls import Caller, Reference
from urproto.log_throttle import LogThrottle

Result = TypeVar("Result")

_logger = logging.getLogger(__name__)

SYSTEM_DEFAULT = qos_profile_system_default
LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""Late subscribers get the last message."""
_QUIET_S: Final = 1.0  # before the same reason is logged again; guess


def interface(name: str) -> Any:
    """The class of an interface, such as ``sensor_msgs/msg/JointState``. Raises ImportError, AttributeError."""
    package, kind, type_name = name.split("/")
    return getattr(import_module(f"{package}.{kind}"), type_name)


def interface_if_any(name: str) -> Any:
    """The same; None if the distribution does not have it."""
    try:
        return interface(name)
    except (ImportError, AttributeError):
        return None


async def in_thread(function: Callable[..., Result], *arguments: Any) -> Result:
    """Call a function in another thread. A caller that is cancelled still waits for its end.

    Nodes are made and closed this way, so that none is closed while it is being made.
    """
    call = asyncio.ensure_future(asyncio.to_thread(function, *arguments))
    try:
        return await asyncio.shield(call)
    except asyncio.CancelledError:
        if not call.cancelled():
            await asyncio.wait([call])
            call.exception()  # it is of no interest any more
        raise


class NodeHost:
    """Nodes of one ROS context; use it with ``async with``.

    link: connection to the process of the control loop; None for nodes that make no calls. domain: ROS domain, None for
    ROS_DOMAIN_ID. namespace: of all nodes, without leading and trailing slashes. ros_arguments: as after
    ``--ros-args``. use_sim_time: ROS' time is the robot's. received_ns: that of the messages that are passed on now.
    """

    def __init__(
        self,
        link: socket.socket | None = None,
        *,
        domain: int | None = None,
        namespace: str = "",
        ros_arguments: Sequence[str] = (),
        use_sim_time: bool = False,
    ) -> None:
        self.loop = asyncio.get_running_loop()
        self.namespace = namespace
        self.received_ns = 0
        self._use_sim_time = use_sim_time
        self._link = link
        self._caller: Caller | None = None
        self._ending = False
        self._ended = asyncio.Event()  # the control loop
        self._domain = domain
        self._arguments = ["--ros-args", *ros_arguments] if ros_arguments else []
        self._context = Context()
        self._spinning: dict[Node, tuple[SingleThreadedExecutor, threading.Thread]] = {}
        self._tasks: dict[Node, set[concurrent.futures.Future[Any]]] = defaultdict(set)
        self._listeners: dict[Hashable, Callable[[Any], object]] = {}
        self._passing_on = threading.Lock()

    async def __aenter__(self) -> "NodeHost":
        """Raises Ros2Error for a namespace or arguments that ROS does not accept."""
        try:
            validate_namespace(f"/{self.namespace}")
            self._context.init(self._arguments, domain_id=self._domain)
        except (InvalidNamespaceException, ValueError, RuntimeError) as error:
            raise Ros2Error(f"ROS 2 rejects the namespace or arguments: {' '.join(str(error).split())}") from None
        if self._link is not None:
            self._caller = Caller(self._link, self._pass_on, self._on_end)
        return self

    async def __aexit__(self, *_: object) -> None:
        self.end()
        for node in list(self._spinning):
            await in_thread(self.close, node)  # the node may be waiting for the event loop
        self._context.try_shutdown()
        if self._caller is not None:
            await in_thread(self._caller.close)

    def end(self) -> None:
        """Let the control loop end, which brings the arm to rest, while the nodes are closed."""
        self._ending = True
        if self._caller is not None:
            self._caller.end()

    def _on_end(self) -> None:
        self._ending = True
        self.loop.call_soon_threadsafe(self._ended.set)

    async def ended(self) -> None:
        """Wait until the process of the control loop has ended."""
        await self._ended.wait()

    def node(self, name: str, overrides: Sequence[Parameter] = (), **options: Any) -> Node:
        """Create a node that does not spin yet. options: arguments of rclpy's Node."""
        return Node(
            name, context=self._context, namespace=self.namespace, parameter_overrides=list(overrides), **options
        )

    def spin(self, node: Node) -> None:
        """Start calling the node's callbacks in a separate thread."""
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
            except ExternalShutdownException:  # the context was shut down
                return
            except Ros2Error:  # without the control loop, which the driver reports, nodes can only be closed
                if not self._ending:
                    _logger.exception("%s: a callback failed", threading.current_thread().name)
            except Exception:  # in a callback: only its own client gets no answer
                _logger.exception("%s: a callback failed", threading.current_thread().name)

    def close(self, node: Node) -> None:
        """End a node and its thread. Must not be called from that thread or the event loop, for which it may wait."""
        for task in list(self._tasks.pop(node, ())):
            task.cancel()
        executor, thread = self._spinning.pop(node)
        executor.shutdown(timeout_sec=0.0)
        thread.join()
        node.destroy_node()

    # messages of the control loop

    def listen(self, key: Hashable, listener: Callable[[Any], object]) -> None:
        """Pass messages with this key on, in the thread that receives them, until `unlisten`."""
        self._listeners[key] = listener

    def unlisten(self, key: Hashable) -> None:
        """Pass no more messages on, also none that has arrived; not from a listener."""
        with self._passing_on:
            self._listeners.pop(key, None)

    def _pass_on(self, messages: dict[Hashable, Any]) -> None:
        if not self._use_sim_time:
            self.received_ns = time.time_ns()
        elif CLOCK in messages:
            self.received_ns = round(messages[CLOCK] * 1e9)
        for key, message in messages.items():
            with self._passing_on:
                if (listener := self._listeners.get(key)) is None:
                    continue
                try:
                    listener(message)
                except Exception:  # the others, and the answers to calls, must go on
                    _logger.exception("a message of the control loop was not published: %s", key)

    # from the threads of nodes

    def do(self, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Call a function in the control loop, between two cycles; return its result or raise its error."""
        return self._begin(function, args, kwargs).result()

    def wait(self, work: Coroutine[Any, Any, Result]) -> Result:
        """Wait for a coroutine that runs in the event loop of this process."""
        return asyncio.run_coroutine_threadsafe(work, self.loop).result()

    # in the event loop

    async def call(self, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Like `do`. If it is cancelled, so is a coroutine in the control loop."""
        return await asyncio.wrap_future(self._begin(function, args, kwargs))

    def _begin(
        self, function: Callable[..., Any], args: Sequence[Any], kwargs: dict[str, Any]
    ) -> "concurrent.futures.Future[Any]":
        if self._caller is None:
            raise RuntimeError("these nodes have no control loop")
        return self._caller.call(function, *args, **kwargs)

    # anywhere

    def now_ns(self) -> int:
        """The current time of ROS: this machine's since 1970, or that of the robot's newest state [ns]."""
        return self.received_ns if self._use_sim_time else time.time_ns()

    def ending(self, node: Node) -> Any:
        """A future that a coroutine of this node can await, and whose result any thread may set."""
        executor, _ = self._spinning[node]
        future = Future(executor=executor)
        future.add_done_callback(
            lambda _: None
        )  # calling it wakes the executor, which setting the result alone does not
        return future

    def task(self, node: Node, work: Coroutine[Any, Any, Any]) -> Any:
        """Run a coroutine in the event loop; a coroutine of this node can await its result or error.

        Meanwhile, the node keeps handling callbacks. Closing the node cancels the coroutine.
        """
        ended = self.ending(node)
        tasks = self._tasks[node]

        def on_done(task: concurrent.futures.Future[Any]) -> None:
            tasks.discard(task)
            if task.cancelled():  # with the node
                return
            if (error := task.exception()) is not None:
                ended.set_exception(error)
            else:
                ended.set_result(task.result())

        task = asyncio.run_coroutine_threadsafe(work, self.loop)
        tasks.add(task)
        task.add_done_callback(on_done)
        return ended


class HostedNode:
    """A node of a host, which a subclass lets spin at the end of its construction, until `close`."""

    def __init__(self, host: NodeHost, name: str) -> None:
        self._host = host
        self.node: Node = host.node(name)

    def close(self) -> None:
        """End the node, and what it has begun; not from its own thread."""
        self._host.close(self.node)

    def _fixed(self, name: str, value: Any) -> Any:
        """The value of a parameter that can only be given at the start."""
        return self.node.declare_parameter(name, value, ParameterDescriptor(read_only=True)).value


class RemoteController:
    """A loaded controller, which belongs to the control loop; see `ControllerFacts`."""

    def __init__(self, host: NodeHost, facts: ControllerFacts) -> None:
        self._host = host
        self.name = facts.name
        self.kind: type[Controller[Any]] = facts.kind
        self.parameters = facts.parameters
        self.joints = facts.joints
        self.reference = Reference((facts.name,))

    def do(self, method: Callable[..., Any], *args: Any) -> Any:
        return self._host.do(method, self.reference, *args)

    def request(self, method: Callable[..., Any], *args: Any, **kwargs: Any) -> None:
        """Call a method that sends a request to the robot, and wait for the answer. Raises ControllerError."""
        self._host.do(ControlSide.answer, SIDE, method, self.reference, *args, **kwargs)

    def error(self, reason: str) -> ControllerError:
        return ControllerError(self.name, reason)


class RefusalLog:
    """The refusals of one topic. node: whose log it is. topic: its name."""

    def __init__(self, node: Node, topic: str) -> None:
        self._node = node
        self._topic = topic.removeprefix("~/")
        self._reason = ""
        self._throttle = LogThrottle(time.monotonic, _QUIET_S)

    def add(self, reason: str) -> None:
        """Log the reason of a refusal, unless that has just been done."""
        if reason != self._reason:
            self._reason, self._throttle = reason, LogThrottle(time.monotonic, _QUIET_S)
        if (more := self._throttle.due()) is not None:
            self._node.get_logger().error(f"{self._topic}: message refused: {reason}{more}")


def stamp(message: Any, time_ns: int) -> None:
    """Set a message's builtin_interfaces/Time."""
    message.sec, message.nanosec = divmod(time_ns, 1_000_000_000)
