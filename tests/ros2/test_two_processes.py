"""The process of the control loop and that of the nodes: calls, messages, and the death of either."""

import asyncio
import os
import signal
import socket
import threading
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack, asynccontextmanager
from typing import Any

import pytest
from driver_rig import driver_options, emulator
from ros2_rig import HOST, PATIENCE_S, SCALED, free_domain

from client.controllers.forward import ForwardCommandController
from client.controllers.remote import RemoteManager
from client.controllers.running import ManagerOptions
from client.errors import GoalRejectedError, NoManagerError, Ros2Error
from client.ros2 import message_packages
from client.ros2.control_process import control_process
from client.ros2.control_side import SIDE, ControlSide
from client.ros2.driver import DriverOptions, Ros2Driver
from client.ros2.remote_calls import Callee, Caller, Reference
from urproto.compat_asyncio import timeout
from urproto.modes import RuntimeState
from urproto.testing.process import EmulatorProcess

pytestmark = [pytest.mark.xdist_group("ros2")]

THING: Any = Reference("thing")
BIG = b"x" * 300_000  # more than both sockets take


class Thing:
    """What is called in the other process."""

    def __init__(self) -> None:
        self.calls = Callee(lambda key: {"thing": self}[key])
        self.cancelled = asyncio.Event()

    def length(self, data: bytes) -> int:
        return len(data)

    def refuse(self) -> None:
        raise GoalRejectedError(SCALED, -1, "it is inactive")

    def secret(self) -> Any:
        return lambda: None

    async def wait(self) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            self.cancelled.set()


@asynccontextmanager
async def connected(thing: Thing) -> AsyncIterator[tuple[Caller, list[dict[Any, Any]], threading.Event]]:
    """A caller of it, the messages, and whether it is allowed to go on taking them."""
    ours, theirs = socket.socketpair()
    taken: list[dict[Any, Any]] = []
    go_on = threading.Event()
    go_on.set()

    def take(messages: dict[Any, Any]) -> None:
        assert go_on.wait(PATIENCE_S)
        taken.append(messages)

    serving = asyncio.ensure_future(thing.calls.serve(theirs))
    caller = Caller(ours, take, lambda: None)
    try:
        yield caller, taken, go_on
    finally:
        go_on.set()
        caller.end()
        await serving
        await asyncio.to_thread(caller.close)


async def test_calls_return_results_and_errors() -> None:
    thing = Thing()
    async with connected(thing) as (caller, _, _), timeout(PATIENCE_S):
        assert await asyncio.to_thread(lambda: caller.call(Thing.length, THING, BIG).result()) == len(BIG)
        with pytest.raises(GoalRejectedError, match="it is inactive") as refused:
            await asyncio.wrap_future(caller.call(Thing.refuse, THING))
        assert (refused.value.controller, refused.value.code) == (SCALED, -1)
        with pytest.raises(KeyError):
            await asyncio.wrap_future(caller.call(Thing.refuse, Reference("nothing")))
        with pytest.raises(TypeError, match="cannot be sent"):
            await asyncio.wrap_future(caller.call(Thing.secret, THING))
        waiting = asyncio.wrap_future(caller.call(Thing.wait, THING))
        await asyncio.sleep(0)
        waiting.cancel()
        await thing.cancelled.wait()
        lost = caller.call(Thing.wait, THING)
    with pytest.raises(Ros2Error, match="has ended"):
        lost.result()
    with pytest.raises(Ros2Error, match="has ended"):
        caller.call(Thing.length, THING, b"")


async def test_nodes_that_do_not_read_get_the_newest_messages() -> None:
    """And the control loop neither waits for them nor keeps what they do not read."""
    thing = Thing()
    async with connected(thing) as (_, taken, go_on), timeout(PATIENCE_S):
        go_on.clear()
        for number in range(50):
            thing.calls.publish("states", lambda number=number: (number, BIG))  # type: ignore[misc]
            thing.calls.publish("mode", lambda number=number: number)  # type: ignore[misc]
            await asyncio.sleep(0)
            await asyncio.sleep(0)
        go_on.set()
        while not taken or "mode" not in taken[-1] or taken[-1]["mode"] < 49:
            await asyncio.sleep(0.01)
    assert len(taken) < 10
    assert taken[-1]["states"][0] == 49
    modes = [batch["mode"] for batch in taken]
    assert modes == sorted(set(modes))


def hold_interpreter() -> None:
    """Compute without letting any other thread of this process run, for a second or so."""
    began_s = time.monotonic()
    while time.monotonic() - began_s < 1.0:
        sum(range(30_000_000))


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A domain."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    message_packages.ensure()  # `make test` has made them
    with free_domain() as domain:
        yield domain


@pytest.mark.long
async def test_a_node_that_computes_does_not_delay_the_control_loop(ros: int) -> None:
    with EmulatorProcess(["--model", "ur3"]) as robot, control_process() as link:
        ports = dict.fromkeys(("reverse_port", "sender_port", "trajectory_port", "command_port"), 0)
        options = DriverOptions(robot.host, ports, domain=ros, make_ready=True)
        async with timeout(PATIENCE_S), Ros2Driver(options, link) as driver:
            call = driver.host.call
            assert await call(eval, "[name for name in __import__('sys').modules if name.startswith('rcl')]") == []
            for _ in range(5):  # others of a busy machine may delay the loop, too
                await call(ControlSide.take_cycle_times, SIDE)
                await asyncio.to_thread(hold_interpreter)
                times_s = await call(ControlSide.take_cycle_times, SIDE)
                if len(times_s) > 10:
                    break
            states, _ = await call(ControlSide.states, SIDE)
    assert len(times_s) > 10, "no cycles while the nodes' process did something else"
    assert dict(states)[SCALED] == "active"


@asynccontextmanager
async def in_process() -> AsyncIterator[socket.socket]:
    """The process, whose end does not block the robot in this one."""
    with ExitStack() as stack:
        yield stack.enter_context(control_process())
        await asyncio.to_thread(stack.close)


async def test_the_driver_ends_with_the_process_of_the_control_loop(ros: int) -> None:
    async with (
        emulator("ur3") as robot,
        timeout(PATIENCE_S),
        in_process() as link,
        Ros2Driver(DriverOptions(HOST, driver_options(robot), domain=ros), link) as driver,
    ):
        os.kill(await driver.host.call(os.getpid), signal.SIGKILL)
        with pytest.raises(Ros2Error, match="has ended"):
            await driver.ended()


async def test_the_arm_comes_to_rest_when_the_nodes_die() -> None:
    async with emulator("ur3") as robot, timeout(PATIENCE_S), in_process() as link:
        options = ManagerOptions(HOST, driver_options(robot), controller="forward_velocity_controller")
        caller = Caller(link, print, lambda: None)
        await asyncio.wrap_future(caller.call(ControlSide.start, SIDE, options))
        command = Reference((options.controller,)), ForwardCommandController.command, (0.0,) * 5 + (0.3,)
        await asyncio.wrap_future(caller.call(ControlSide.deliver, SIDE, *command))
        while abs(robot.controller.snapshot.actual_qd[5]) < 0.1:
            await asyncio.sleep(0.01)
        link.shutdown(socket.SHUT_RDWR)  # as when a process dies
        await asyncio.to_thread(caller.close)
        while robot.controller.programs.state is not RuntimeState.STOPPED:
            await asyncio.sleep(0.01)
        assert not any(robot.controller.snapshot.target_qd)
        while True:
            try:
                async with RemoteManager(HOST, robot.ports["rtde"]):
                    await asyncio.sleep(0.01)
            except NoManagerError:
                break
