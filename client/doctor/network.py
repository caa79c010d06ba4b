"""The robot's ports and the way to them: what is open, how long it takes, how regularly states come."""

import math
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from itertools import pairwise
from statistics import median
from typing import Final

from client import dashboard, primary, realtime, rtde
from client.connection import DEFAULT_TIMEOUT_S
from client.doctor.robot import Finding, Grade
from client.driver.endpoint import REVERSE_PORT, SENDER_PORT
from client.driver.results import COMMAND_PORT, TRAJECTORY_PORT
from urproto.errors import URError

_PORTS: Final = {"primary": primary.PORT, "RTDE": rtde.PORT, "dashboard": dashboard.PORT, "realtime": realtime.PORT}
_NEEDED: Final = ("primary", "RTDE")  # PolyScope X has no dashboard of this kind
_CONNECT_S: Final = 2.0
_REPLIES: Final = 20
_STREAM_S: Final = 2.0
_SLOW_CONNECT_S: Final = 0.005  # guess: a cable through a switch takes less than 1 ms
_LONGEST_S: Final = 1e9  # guess: no robot has been on for 30 years
_LATE: Final = 1.0  # periods; a servo setpoint for this state comes one period late
_WIFI: Final = "use a cable, without other traffic on it, to this machine's own network card"


def examine_ports(host: str, port_offset: int = 0) -> Iterator[Finding]:
    """Connect to each port once."""
    times = []
    for name, port in _PORTS.items():
        port += port_offset
        began = time.perf_counter()
        try:
            socket.create_connection((host, port), _CONNECT_S).close()
        except OSError as error:
            grade = Grade.BROKEN if name in _NEEDED else Grade.WEAK
            mend = f"ping {host}; e-Series: enable it in Settings, Security, Services; nc -vz {host} {port}"
            yield Finding(grade, f"port {port}", f"{name} is closed: {error.strerror or error}", mend)
            continue
        times.append(time.perf_counter() - began)
        yield Finding(Grade.GOOD, f"port {port}", f"{name} is open")
    if times:
        typical = median(times)
        text = f"a connection takes {_ms(typical)}"
        slow = typical > _SLOW_CONNECT_S
        yield Finding(Grade.WEAK if slow else Grade.GOOD, "network latency", text, _WIFI if slow else "")


def examine_own_ports() -> Iterator[Finding]:
    """Whether a driver could open its four ports here."""
    for port in (REVERSE_PORT, SENDER_PORT, TRAJECTORY_PORT, COMMAND_PORT):
        with closing(socket.socket()) as own:
            own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                own.bind(("", port))
            except OSError as error:
                text = f"of this machine, for the driver, is taken: {error.strerror}"
                yield Finding(Grade.WEAK, f"port {port}", text, f"ss -ltnp 'sport = :{port}' tells by whom")


def examine_replies(host: str, port_offset: int = 0) -> Iterator[Finding]:
    """How long the dashboard takes to answer a question that moves nothing."""
    subject = "round trip"
    try:
        with dashboard.BlockingDashboardClient(host, dashboard.PORT + port_offset) as board:
            times = [_timed(board) for _ in range(_REPLIES)]
    except URError as error:
        yield Finding(Grade.UNKNOWN, subject, f"the dashboard does not answer: {error}")
        return
    yield Finding(Grade.GOOD, subject, f"the dashboard answers within {_ms(median(times))}, at most {_ms(max(times))}")


def _timed(board: dashboard.BlockingDashboardClient) -> float:
    began = time.perf_counter()
    board.ask(dashboard.ROBOT_MODE)
    return time.perf_counter() - began


def examine_stream(host: str, port_offset: int = 0, seconds: float = _STREAM_S) -> Iterator[Finding]:
    """How regularly RTDE states come at the robot's full rate."""
    try:
        with rtde.BlockingRTDEClient(host, ["timestamp"], port=rtde.PORT + port_offset) as robot:
            yield Finding(Grade.GOOD, "PolyScope", str(robot.core.version))
            arrivals: list[float] = []
            stamps: list[float] = []
            end = time.perf_counter() + min(seconds, DEFAULT_TIMEOUT_S)
            while not arrivals or arrivals[-1] < end:
                stamps.append(float(robot.receive()["timestamp"]))
                arrivals.append(time.perf_counter())
    except URError as error:
        yield Finding(Grade.BROKEN, "RTDE stream", str(error), f"nc -vz {host} {rtde.PORT + port_offset}")
        return
    yield from judge_stream(arrivals, stamps)


def judge_stream(arrivals: Sequence[float], stamps: Sequence[float]) -> Iterator[Finding]:
    """Of states by when they came here and when the robot made them [s], each on its own clock."""
    if timeless := sum(not (math.isfinite(stamp) and abs(stamp) < _LONGEST_S) for stamp in stamps):
        text = f"{timeless} of {len(stamps)} states have no time (timestamp)"
        yield Finding(Grade.BROKEN, "RTDE stream", text, "restart the controller")
        return
    steps = [b - a for a, b in pairwise(stamps)]
    if not steps or min(steps) <= 0.0:
        yield Finding(Grade.BROKEN, "RTDE stream", "the robot's clock stands still", "restart the controller")
        return
    period = median(steps)
    lost = sum(round(step / period) - 1 for step in steps)
    # the earliest arrival, relative to the robot's clock, is the one that was not late
    delays = [arrival - stamp for arrival, stamp in zip(arrivals, stamps, strict=True)]
    late = sorted(delay - min(delays) for delay in delays)
    often, worst = late[int(0.99 * (len(late) - 1))], late[-1]
    rate = f"{len(stamps)} states at {1.0 / period:.0f} Hz"
    if lost:
        mend = "read states faster than they come, or ask for a lower rate; look at the network with ping -i 0.2"
        yield Finding(Grade.WEAK, "RTDE stream", f"{rate}, and {lost} were left out", mend)
    else:
        yield Finding(Grade.GOOD, "RTDE stream", f"{rate}, none left out")
    jitter = f"99 of 100 states are less than {_ms(often)} late, the worst {_ms(worst)} (period {_ms(period)})"
    weak = often > _LATE * period
    yield Finding(Grade.WEAK if weak else Grade.GOOD, "jitter", jitter, _WIFI if weak else "")


def _ms(seconds: float) -> str:
    return f"{seconds * 1e3:.2f} ms"
