"""Diagnoses the setup of this machine and a robot: kernel, network and ports, versions and calibration.

Each check yields findings, which ``ur-client doctor`` prints.
"""

import errno
import math
import os
import platform
import socket
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Final

from client import dashboard, primary, realtime, robotapi, rtde
from client.calibration import calibration_of, is_nominal, read_calibration
from client.connection import DEFAULT_TIMEOUT_S
from client.driver.results import COMMAND_PORT, TRAJECTORY_PORT
from client.driver.reverse import REVERSE_PORT
from client.driver.script_sender import SENDER_PORT
from client.errors import FileError
from urproto.compat import StrEnum
from urproto.dashboard import GREETING, LineDecoder, encode_line, is_not_understood
from urproto.errors import RemoteProtocolError, RobotRefused, URError
from urproto.robots import Calibration, CalibrationError
from urproto.rtde.fields import IN_USE, MAX_TIMESTAMP_S
from urproto.text import quoted

_PACKAGES = ("ur-emulator", "ur-rtde", "pin", "numpy")
_MIN_PRIORITY = 1  # any real-time priority is above everything else
_PRIORITY = (
    "sudo groupadd -f realtime && sudo usermod -aG realtime $USER && "
    "echo '@realtime - rtprio 99' | sudo tee /etc/security/limits.d/99-realtime.conf, then log in again"
)
_CONTAINER = (
    "in a container: docker run --cap-add SYS_NICE --ulimit rtprio=99; on a host: sysctl kernel.sched_rt_runtime_us"
)
_PORTS: Final = {"primary": primary.PORT, "RTDE": rtde.PORT, "dashboard": dashboard.PORT, "realtime": realtime.PORT}
_ALTERNATIVES: Final = {"dashboard": ("Robot API", robotapi.PORT)}  # what PolyScope X has instead of a port
_REQUIRED: Final = ("primary", "RTDE")
_CONNECT_S: Final = 2.0
_REPLIES: Final = 20
_STREAM_S: Final = 4.0  # guess: a robot that falls silent now and then does so within this time
_SILENCE_S: Final = 0.5  # guess: longer than any network and any controller under load
_DRIVER_INPUT: Final = "speed_slider_mask"  # every driver writes it
_READ_BYTES: Final = 4096
_MODE: Final = "robotmode"
_MODE_ANSWER: Final = "Robotmode: "
_QUERIES: Final = (_MODE, "programState", "running", "get loaded program")  # every version has them
_SLOW_CONNECT_S: Final = 0.005  # guess: a cable through a switch takes less than 1 ms
_LATE: Final = 1.0  # periods; a servo setpoint for this state comes one period late
_PROXY: Final = "check the address; connect to the controller directly, without a proxy that changes its text"
_WIFI: Final = "use a direct cable to this machine's network card, without other traffic"


class Grade(StrEnum):
    """Severity of a finding."""

    GOOD = "good"
    UNKNOWN = "cannot be seen"
    WEAK = "weak"  # works, but less well than it could
    BROKEN = "broken"  # something will not work


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of a check. ``mend``: the command or action that fixes the problem, empty if there is none."""

    grade: Grade
    subject: str
    text: str
    mend: str = ""


def exit_status(findings: list[Finding]) -> int:
    """1 if something will not work, otherwise 0."""
    return int(any(finding.grade is Grade.BROKEN for finding in findings))


def examine_versions() -> Iterator[Finding]:
    """Report the versions of Python and of the installed packages."""
    versions = [f"Python {platform.python_version()}"]
    for package in _PACKAGES:
        try:
            versions.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            continue
    yield Finding(Grade.GOOD, "versions", ", ".join(versions))


def examine_calibration(host: str, file: Path | None = None, port_offset: int = 0) -> Iterator[Finding]:
    """Report the robot's calibration, and whether the file belongs to it."""
    subject = "calibration"
    again = f"ur-client calibration --robot-ip {host} -o {file or 'my_robot_calibration.yaml'}"
    try:
        with primary.BlockingPrimaryClient(host, primary.PORT + port_offset) as robot:
            found = calibration_of(robot.run(robot.core.kinematics_info()))
            nominal = is_nominal(found, robot.run(robot.core.configuration_data()))
    except CalibrationError as error:
        yield Finding(Grade.BROKEN, subject, str(error), "restore the calibration on the robot's pendant")
        return
    except URError as error:
        yield Finding(Grade.UNKNOWN, subject, str(error))
        return
    yield _compare(found, file, again, nominal=nominal)


def _compare(found: Calibration, file: Path | None, again: str, *, nominal: bool) -> Finding:
    if file is None:
        kind = "nominal (a simulated arm)" if nominal else "individual"
        mend = "" if nominal else f"poses are correct only with it: {again}"
        return Finding(Grade.GOOD, "calibration", f"{kind}, {found.hash}", mend)
    try:
        given = read_calibration(file)
    except FileError as error:
        return Finding(Grade.BROKEN, "calibration", str(error), again)
    if given.hash != found.hash:
        text = f"the robot has {found.hash}, {file} has {given.hash}: another arm, or it was calibrated again"
        return Finding(Grade.BROKEN, "calibration", text, again)
    if not given.is_whole:
        return Finding(Grade.BROKEN, "calibration", f"the numbers in {file} do not match its hash", again)
    return Finding(Grade.GOOD, "calibration", f"{file} matches this robot, {found.hash}")


def examine_machine() -> Iterator[Finding]:
    """Check kernel, real-time priority and processor speed, as far as this machine reports them."""
    if sys.platform != "linux":
        for subject in ("kernel", "real-time priority", "processor speed"):
            yield Finding(Grade.UNKNOWN, subject, f"only on Linux; this is {platform.system() or sys.platform}")
        return
    import resource

    yield preemption(platform.version(), Path("/"))
    yield priority(resource.getrlimit(resource.RLIMIT_RTPRIO)[0], _gets_priority())
    yield governor(Path("/"))


def preemption(version: str, root: Path) -> Finding:
    """Check the preemption of a Linux kernel by its version text (``uname -v``)."""
    subject = "kernel"
    try:
        real_time = (root / "sys/kernel/realtime").read_text().strip() == "1"
    except OSError:
        real_time = False
    if real_time or "PREEMPT_RT" in version:
        return Finding(Grade.GOOD, subject, "fully preemptible (PREEMPT_RT)")
    kind = "PREEMPT_DYNAMIC" if "PREEMPT_DYNAMIC" in version else "PREEMPT" if "PREEMPT" in version else "none"
    text = f"not a real-time kernel (preemption: {kind}): under load it may be some milliseconds late"
    mend = "sudo apt install linux-image-rt-amd64 (Debian), or sudo pro enable realtime-kernel (Ubuntu), then reboot"
    return Finding(Grade.WEAK, subject, text, mend)


def _gets_priority() -> bool:
    """Whether this thread gets real-time priority if it tries, for a moment."""
    if sys.platform != "linux":
        return False
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_MIN_PRIORITY))
    except OSError:
        return False
    os.sched_setscheduler(0, policy, parameters)
    return True


def priority(limit: int, granted: bool) -> Finding:
    """Judge the real-time priority. limit: of this user, -1 for unlimited; granted: whether a thread got it."""
    subject = "real-time priority"
    if granted:
        return Finding(Grade.GOOD, subject, "granted")
    if limit == -1 or limit >= _MIN_PRIORITY:
        return Finding(Grade.WEAK, subject, "allowed to this user, but the system does not grant it", _CONTAINER)
    return Finding(Grade.WEAK, subject, "not allowed to this user: other programs may delay a control loop", _PRIORITY)


def governor(root: Path) -> Finding:
    """Check the frequency scaling of the processors."""
    subject = "processor speed"
    files = sorted(root.glob("sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor"))
    try:
        found = Counter(file.read_text().strip() for file in files)
    except OSError as error:
        return Finding(Grade.UNKNOWN, subject, f"{error.strerror}")
    if not found:
        return Finding(Grade.UNKNOWN, subject, "not controlled by the kernel (a virtual machine, or a fixed speed)")
    if set(found) == {"performance"}:
        return Finding(Grade.GOOD, subject, "always at maximum")
    kinds = ", ".join(f"{count} x {kind}" for kind, count in found.items())
    return Finding(Grade.WEAK, subject, f"varies: {kinds}", "sudo cpupower frequency-set -g performance")


def examine_ports(host: str, port_offset: int = 0) -> Iterator[Finding]:
    """Connect to each port of the robot once."""
    times = []
    for name, port in _PORTS.items():
        port += port_offset
        began = time.perf_counter()
        try:
            socket.create_connection((host, port), _CONNECT_S).close()
        except OSError as error:
            other, instead = _ALTERNATIVES.get(name, ("", 0))
            if other and _accepts_connections(host, instead + port_offset):
                text = f"{other} is open: this is PolyScope X, which has it instead of the {name} (port {port})"
                yield Finding(Grade.GOOD, f"port {instead + port_offset}", text)
                continue
            grade = Grade.BROKEN if name in _REQUIRED else Grade.WEAK
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


def _accepts_connections(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), _CONNECT_S).close()
    except OSError:
        return False
    return True


def examine_own_ports() -> Iterator[Finding]:
    """Check whether a driver could open its four ports on this machine."""
    for port in (REVERSE_PORT, SENDER_PORT, TRAJECTORY_PORT, COMMAND_PORT):
        with closing(socket.socket()) as own:
            own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                own.bind(("", port))
            except OSError as error:
                text = f"of this machine, for the driver, is in use: {error.strerror}"
                yield Finding(Grade.WEAK, f"port {port}", text, f"ss -ltnp 'sport = :{port}' shows the process")


def examine_replies(host: str, port_offset: int = 0) -> Iterator[Finding]:
    """Check that the dashboard understands what clients send, and measure how long it takes to answer."""
    subject = "dashboard"
    try:
        with closing(socket.create_connection((host, dashboard.PORT + port_offset), DEFAULT_TIMEOUT_S)) as line:
            board = _Lines(line)
            greeting = board.next()
            answers = {query: board.ask(query) for query in _QUERIES}
            times = [_measure_reply(board) for _ in range(_REPLIES)]
    except (OSError, RemoteProtocolError) as error:
        reason = getattr(error, "strerror", None) or error
        yield Finding(Grade.UNKNOWN, "round trip", f"the dashboard does not answer: {reason}")
        return
    if greeting != GREETING:
        text = f"its greeting is {quoted(greeting)}, not {GREETING!r}: clients refuse it"
        yield Finding(Grade.BROKEN, subject, text, _PROXY)
    if unknown := [query for query, answer in answers.items() if is_not_understood(answer)]:
        text = f"it does not understand {', '.join(unknown)}"
        yield Finding(Grade.BROKEN, subject, text, "clients need these commands: update the controller's software")
    elif not answers[_MODE].startswith(_MODE_ANSWER):
        text = f"it answers {quoted(answers[_MODE])} to {_MODE}: clients expect {_MODE_ANSWER!r}"
        yield Finding(Grade.BROKEN, subject, text, _PROXY)
    if board.pieces > 1:
        text = f"a line arrives in up to {board.pieces} pieces: a client that reads once sees a part of it"
        yield Finding(Grade.WEAK, subject, text, _WIFI)
    text = f"the dashboard answers within {_ms(median(times))}, at most {_ms(max(times))}"
    yield Finding(Grade.GOOD, "round trip", text)


class _Lines:
    """Lines of a dashboard. ``pieces``: the most parts in which a line has arrived."""

    def __init__(self, line: socket.socket) -> None:
        self._line = line
        self._decoder = LineDecoder()
        self.pieces = 0

    def ask(self, query: str) -> str:
        self._line.sendall(encode_line(query))
        return self.next()

    def next(self) -> str:
        """The next line. Raises OSError, RemoteProtocolError."""
        pieces, lines = 0, list[str]()
        while not lines:
            if not (data := self._line.recv(_READ_BYTES)):
                raise ConnectionResetError(errno.ECONNRESET, "it closed the connection")
            pieces, lines = pieces + 1, self._decoder.feed(data)
        self.pieces = max(self.pieces, pieces)
        return lines[0]


def _measure_reply(board: _Lines) -> float:
    began = time.perf_counter()
    board.ask(_MODE)
    return time.perf_counter() - began


def examine_stream(host: str, port_offset: int = 0, seconds: float = _STREAM_S) -> Iterator[Finding]:
    """Check how regularly RTDE states arrive at the robot's full rate."""
    port = rtde.PORT + port_offset
    try:
        yield from _examine_inputs(host, port)
        with rtde.BlockingRTDEClient(host, ["timestamp"], port=port) as robot:
            yield Finding(Grade.GOOD, "PolyScope", str(robot.core.version))
            arrivals: list[float] = []
            stamps: list[float] = []
            end = time.perf_counter() + min(seconds, DEFAULT_TIMEOUT_S)
            while not arrivals or arrivals[-1] < end:
                stamps.append(float(robot.receive()["timestamp"]))
                arrivals.append(time.perf_counter())
    except URError as error:
        yield Finding(Grade.BROKEN, "RTDE stream", str(error), f"nc -vz {host} {port}")
        return
    yield from check_stream(arrivals, stamps)


def _examine_inputs(host: str, port: int) -> Iterator[Finding]:
    """Check that a driver could write its inputs. They are not written."""
    try:
        with rtde.BlockingRTDEClient(host, [], [[_DRIVER_INPUT]], port=port):
            pass
    except RobotRefused as refusal:
        if IN_USE in refusal.answer:
            text = f"another client holds the inputs of drivers ({_DRIVER_INPUT}): a second driver is refused"
            yield Finding(Grade.WEAK, "RTDE inputs", text, "end the other driver, or use the robot from that one only")


def check_stream(arrivals: Sequence[float], stamps: Sequence[float]) -> Iterator[Finding]:
    """Judge states by their arrival times and the robot's timestamps [s], each by its own clock."""
    if invalid := sum(not (math.isfinite(stamp) and abs(stamp) < MAX_TIMESTAMP_S) for stamp in stamps):
        text = f"{invalid} of {len(stamps)} states have no time (timestamp)"
        yield Finding(Grade.BROKEN, "RTDE stream", text, "restart the controller")
        return
    steps = [b - a for a, b in pairwise(stamps)]
    if not steps or min(steps) <= 0.0:
        yield Finding(Grade.BROKEN, "RTDE stream", "the robot's clock does not advance", "restart the controller")
        return
    period = median(steps)
    lost = sum(round(step / period) - 1 for step in steps)
    # the state that arrived earliest, relative to the robot's clock, counts as not late
    delays = [arrival - stamp for arrival, stamp in zip(arrivals, stamps, strict=True)]
    late = sorted(delay - min(delays) for delay in delays)
    often, worst = late[int(0.99 * (len(late) - 1))], late[-1]
    rate = f"{len(stamps)} states at {1.0 / period:.0f} Hz"
    if lost:
        mend = "read states faster than they arrive, or request a lower rate; check the network with ping -i 0.2"
        yield Finding(Grade.WEAK, "RTDE stream", f"{rate}, {lost} missing", mend)
    else:
        yield Finding(Grade.GOOD, "RTDE stream", f"{rate}, none missing")
    silence = max(b - a for a, b in pairwise(arrivals))
    if silence > _SILENCE_S:
        text = f"nothing arrived for {silence:.1f} s: drivers stop the arm, or lose their connection"
        yield Finding(Grade.BROKEN, "RTDE stream", text, _WIFI)
    jitter = f"99 of 100 states are less than {_ms(often)} late, the worst {_ms(worst)} (period {_ms(period)})"
    weak = often > _LATE * period
    yield Finding(Grade.WEAK if weak else Grade.GOOD, "jitter", jitter, _WIFI if weak else "")


def _ms(seconds: float) -> str:
    return f"{seconds * 1e3:.2f} ms"
