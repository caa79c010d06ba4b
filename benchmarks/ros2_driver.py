"""Cost of the ROS 2 driver compared with controllers without ROS, and the delay of its setpoints, with a 500 Hz arm.

Both are processes of their own before an emulated UR5e, with the same controllers active: the scaled trajectory
controller and all that move nothing. The subscriber is a third process, whose cost does not count.

For the setpoints a further process commands a joint angle a little off, to an arm at rest, and takes the time until
the first RTDE state whose target has left the place has come.

Under load, processes that compute without a pause compete for the cores, and what the driver logs is counted: control
programs that ended because nothing came from it, and arms that were stopped because a setpoint came too late.
"""

import asyncio
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Sequence
from contextlib import ExitStack, asynccontextmanager, contextmanager
from pathlib import Path
from typing import IO, Final

from processes import family_cpu_s
from table import Table

from client import RTDEClient
from client.controllers.remote import RemoteManager
from client.errors import NoManagerError

SECONDS: Final = 10.0
HOST: Final = "127.0.0.79"
_DOMAIN: Final = "79"
_SETTLED_S: Final = 5.0  # after the start
SAMPLES: Final = 300
LOADED_S: Final = 60.0
_BUSY: Final = 6  # processes
_LOST: Final = "the control program has ended"
_LATE: Final = "the arm was stopped"
_READY: Final = "ready: "
_START_S: Final = 60.0
_ROUNDS: Final = 2  # of each, by turns: what else the machine does meets both
_FORWARD: Final = "forward_position_controller"
_TOPIC: Final = f"/{_FORWARD}/commands"
_OFFSET_RAD: Final = 0.002  # of the last joint: too little to matter, far above rounding
_MOVED_RAD: Final = 1e-6
_REST_S: Final = 0.35  # servoj has come to rest by then, to 1e-7 rad
_GIVE_UP_S: Final = 2.0
_BAR_MS: Final = 1.0
_WAYS: Final = {"socket": ["controllers", "serve"], "topic": ["ros2"]}


def measure(seconds: float = SECONDS) -> Table:
    """One row for the controllers alone, the driver, and the driver with a subscriber."""
    alone = _share(["controllers", "serve"], seconds, subscribed=False)
    nodes = _share(["ros2"], seconds, subscribed=False)
    heard = _share(["ros2"], seconds, subscribed=True)
    rows = [
        ["`ur-client controllers serve`", f"{alone:.1%}", ""],
        ["`ur-client ros2`", f"{nodes:.1%}", f"{nodes - alone:+.1%}"],
        ["`ur-client ros2`, with a subscriber of `/joint_states`", f"{heard:.1%}", f"{heard - alone:+.1%}"],
    ]
    about = (
        f"Controllers of an emulated UR5e at 500 Hz, at rest, for {seconds:g} s. Requirement: ROS adds less than 10 % "
        "of a core."
    )
    return Table("ROS 2 driver", about, ["process", "cost", "added by ROS"], rows)


def _share(words: list[str], seconds: float, *, subscribed: bool) -> float:
    environment = {**os.environ, "ROS_DOMAIN_ID": _DOMAIN, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with ExitStack() as running:
        running.enter_context(_process([sys.executable, __file__, "serve"], environment))
        time.sleep(_SETTLED_S)
        command = [sys.executable, "-m", "client", *words, "--robot-ip", HOST]
        process = running.enter_context(_process(command, environment))
        time.sleep(2 * _SETTLED_S)
        if subscribed:
            from client.ros2 import message_packages

            message_packages.ensure()
            running.enter_context(_process([sys.executable, __file__, "subscribe"], {**environment, **os.environ}))
            time.sleep(_SETTLED_S)
        before_s, began_s = family_cpu_s(process.pid), time.monotonic()
        time.sleep(seconds)
        used = family_cpu_s(process.pid) - before_s
        if process.poll() is not None:
            raise RuntimeError(f"{' '.join(words)} has ended by itself")
        return used / (time.monotonic() - began_s)


def under_load(seconds: float = LOADED_S) -> Table:
    """One row for the controllers alone and one for the driver with a subscriber."""
    found = [_loaded(words, seconds) for words in (["controllers", "serve"], ["ros2"])]
    names = ["`ur-client controllers serve`", "`ur-client ros2`, with a subscriber of `/joint_states`"]
    rows = [
        [name, str(log.count(_LOST)), str(log.count(_LATE)), f"{share:.1%}", f"{ready_s:.1f} s"]
        for name, (log, share, ready_s) in zip(names, found, strict=True)
    ]
    about = (
        f"Controllers of an emulated UR5e at 500 Hz, for {seconds:g} s next to {_BUSY} processes that compute without "
        "a pause. Requirement: no control program is lost."
    )
    columns = ["process", "lost control programs", "late setpoints", "cost", "start to ready"]
    return Table("ROS 2 driver under load", about, columns, rows)


def _loaded(words: list[str], seconds: float) -> tuple[str, float, float]:
    """What a process logs under load, its cost, and the time until it was ready [s]."""
    environment = {**os.environ, "ROS_DOMAIN_ID": _DOMAIN, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with ExitStack() as running:
        log = Path(running.enter_context(tempfile.TemporaryDirectory())) / "log"
        errors = running.enter_context(log.open("wb"))
        running.enter_context(_process([sys.executable, __file__, "serve"], environment))
        time.sleep(_SETTLED_S)
        command, began_s = [sys.executable, "-m", "client", *words, "--robot-ip", HOST], time.monotonic()
        process = running.enter_context(_process(command, environment, errors))
        while _READY not in log.read_text():
            if process.poll() is not None or time.monotonic() - began_s > _START_S:
                raise RuntimeError(f"{' '.join(words)} does not get ready: {log.read_text()}")
            time.sleep(0.01)
        ready_s = time.monotonic() - began_s
        if words == ["ros2"]:
            from client.ros2 import message_packages

            message_packages.ensure()
            running.enter_context(_process([sys.executable, __file__, "subscribe"], {**environment, **os.environ}))
        time.sleep(_SETTLED_S)
        with ExitStack() as load:
            for _ in range(_BUSY):
                load.enter_context(_process([sys.executable, "-c", "while True: pass"], environment))
            before_s, began_s = family_cpu_s(process.pid), time.monotonic()
            time.sleep(seconds)
            share = (family_cpu_s(process.pid) - before_s) / (time.monotonic() - began_s)
        return log.read_text(), share, ready_s


def latency(samples: int = SAMPLES) -> Table:
    """One row for each way of a setpoint to the arm; the second says whether it is within the bar."""
    found_s: dict[str, list[float]] = {way: [] for way in _WAYS}
    for _ in range(_ROUNDS):
        for way in _WAYS:
            found_s[way] += _latencies_of(way, samples // _ROUNDS)
    (socket_50, socket_99), (topic_50, topic_99) = (_percentiles_ms(times_s) for times_s in found_s.values())
    more = topic_99 - socket_99
    rows = [
        ["`ur-client controllers serve`, its socket", f"{socket_50:.2f} ms", f"{socket_99:.2f} ms", ""],
        [
            f"`ur-client ros2`, `{_TOPIC}`",
            f"{topic_50:.2f} ms",
            f"{topic_99:.2f} ms",
            f"{more:+.2f} ms: {'met' if more <= _BAR_MS else 'not met'}",
        ],
    ]
    about = (
        f"Time from a command to the first RTDE state of an emulated UR5e that shows it: {samples} commands each, in "
        f"{_ROUNDS} alternating rounds. Requirement: a topic adds at most {_BAR_MS:g} ms to the 99th percentile."
    )
    return Table("ROS 2 setpoints", about, ["sent through", "p50", "p99", "added to p99"], rows)


def _percentiles_ms(times_s: Sequence[float]) -> tuple[float, float]:
    times = sorted(times_s)
    return 1e3 * times[len(times) // 2], 1e3 * times[min(len(times) - 1, int(0.99 * len(times)))]


def _latencies_of(way: str, samples: int) -> list[float]:
    environment = {**os.environ, "ROS_DOMAIN_ID": _DOMAIN, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with ExitStack() as running:
        running.enter_context(_process([sys.executable, __file__, "serve"], environment))
        time.sleep(_SETTLED_S)
        command = [sys.executable, "-m", "client", *_WAYS[way], "--controller", _FORWARD, "--robot-ip", HOST]
        running.enter_context(_process(command, environment))
        measured = [sys.executable, __file__, "measure", way, str(samples)]
        times_s: list[float] = json.loads(subprocess.check_output(measured, env=environment))
    return times_s


async def _measure(way: str, samples: int) -> list[float]:
    """In a process of its own: the time of each command [s]."""
    async with (
        _manager() as manager,
        _COMMANDERS[way](manager) as command,
        RTDEClient(HOST, ["timestamp", "target_q"]) as states,
    ):
        home = (await states.receive())["target_q"]
        return [await _once(states, command, home) for _ in range(samples)]


async def _once(
    states: RTDEClient, command: Callable[[Sequence[float]], Awaitable[object]], home: Sequence[float]
) -> float:
    state = await states.receive()
    until_s = state["timestamp"] + _REST_S
    while state["timestamp"] < until_s:
        state = await states.latest()
    await asyncio.sleep(random.uniform(0.0, 0.01))  # no rhythm of ours meets that of the control periods
    at = state["target_q"][5]
    target = [*home[:5], home[5] + (_OFFSET_RAD if at <= home[5] else -_OFFSET_RAD)]
    began_s = time.perf_counter()
    answered = asyncio.ensure_future(command(target))
    while abs(state["target_q"][5] - at) < _MOVED_RAD:
        state = await states.receive()
        if time.perf_counter() - began_s > _GIVE_UP_S:
            raise RuntimeError(f"no target was executed within {_GIVE_UP_S} s")
    taken_s = time.perf_counter() - began_s
    await answered
    return taken_s


@asynccontextmanager
async def _manager() -> AsyncIterator[RemoteManager]:
    """The running one, when the forward controller is active."""
    while True:
        try:
            async with RemoteManager(HOST) as manager:
                while _FORWARD not in await _active(manager):
                    await asyncio.sleep(0.1)
                yield manager
                return
        except NoManagerError:
            await asyncio.sleep(0.1)


async def _active(manager: RemoteManager) -> list[str]:
    return [one["name"] for one in await manager.request("list_controllers") if one["state"] == "active"]


@asynccontextmanager
async def _by_socket(manager: RemoteManager) -> AsyncIterator[Callable[[Sequence[float]], Awaitable[object]]]:
    yield lambda q: manager.request("forward_command", controller=_FORWARD, values=list(q))


@asynccontextmanager
async def _by_topic(manager: RemoteManager) -> AsyncIterator[Callable[[Sequence[float]], Awaitable[object]]]:
    import rclpy
    from rclpy.node import Node
    from std_msgs.msg import Float64MultiArray

    rclpy.init()
    publisher = Node("commander").create_publisher(Float64MultiArray, _TOPIC, 1)
    while not publisher.get_subscription_count():
        await asyncio.sleep(0.1)

    async def command(q: Sequence[float]) -> None:
        publisher.publish(Float64MultiArray(data=list(q)))

    try:
        yield command
    finally:
        rclpy.shutdown()


_COMMANDERS: Final = {"socket": _by_socket, "topic": _by_topic}


@contextmanager
def _process(
    command: list[str], environment: dict[str, str], errors: IO[bytes] | int = subprocess.DEVNULL
) -> Iterator[subprocess.Popen[bytes]]:
    quiet = subprocess.DEVNULL
    process = subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=quiet, stderr=errors)
    try:
        yield process
    finally:
        process.terminate()
        process.communicate()


def _subscribe() -> None:
    import rclpy
    from rclpy.node import Node
    from sensor_msgs.msg import JointState

    rclpy.init()
    node = Node("listener")
    node.create_subscription(JointState, "/joint_states", lambda message: None, 10)
    rclpy.spin(node)


if __name__ == "__main__":
    if sys.argv[1:] == ["serve"]:
        from jitter import serve_at

        serve_at("ur5e", HOST)
    elif sys.argv[1:] == ["subscribe"]:
        _subscribe()
    elif sys.argv[1:2] == ["measure"]:
        sys.stdout.write(json.dumps(asyncio.run(_measure(sys.argv[2], int(sys.argv[3])))))
    elif sys.argv[1:] == ["cost"]:
        sys.stdout.write(measure().markdown())
    elif sys.argv[1:] == ["latency"]:
        sys.stdout.write(latency().markdown())
    elif sys.argv[1:] == ["load"]:
        sys.stdout.write(under_load().markdown())
    else:
        sys.stdout.write(measure().markdown())
        sys.stdout.write(latency().markdown())
        sys.stdout.write(under_load().markdown())
