"""What an enemy does and what an accident does, to emulators and clients of this machine: ``make chaos``.

``chaos.py [--quick] [--json FILE] [SCENARIO ...]``. Every scenario is bounded in count and time, talks to loopback
addresses of its own, and ends the processes that it started, no others. The exit status is 1 when a bar is missed:

- no client that behaves loses a package, whatever else happens;
- no traceback in what any process prints;
- every arm whose driver was killed or stopped stands within 1.2 s of robot time;
- memory is flat: no process that has warmed up grows by more than 8 MiB over a scenario, be it emulator, pendant or
  client.
"""

import argparse
import json
import os
import platform
import random
import resource
import select
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

from jitter import connect
from processes import cpu_s, memory_mib

from urproto import modbus
from urproto.errors import URError
from urproto.ports import PENDANT_PORT
from urproto.rtde import codec
from urproto.rtde.codec import RTDEDecoder
from urproto.rtde.fields import OUTPUT_FIELDS
from urproto.rtde.recipes import Recipe
from urproto.testing.process import EmulatorProcess

ROOT = Path(__file__).resolve().parents[1]
STOPPED_WITHIN_S = 1.2  # of robot time
STANDS_RAD_S = 1e-3
FLAT_MIB = 8.0
WARM_SHARE = 0.2  # of a scenario, before memory counts
HOME = (0.0, -1.4, 1.5, -1.7, -1.5, 0.0)
PERIOD_S = {"ur3": 0.008, "ur5e": 0.002}
OPTIONS = ("--running", "--remote-control", "--log-level", "error")
PAGE = resource.getpagesize()
SAID = ("Traceback (most recent call last)", "MemoryError")


@dataclass
class Result:
    """Of one scenario. ``missed``: the bars that it missed, in words."""

    name: str
    figures: dict[str, object] = field(default_factory=dict)
    missed: list[str] = field(default_factory=list)

    def bar(self, met: bool, otherwise: str) -> None:
        """Hold the scenario to something."""
        if not met:
            self.missed.append(otherwise)


# what is watched


@contextmanager
def emulator(*options: str, model: str = "ur5e") -> Iterator[EmulatorProcess]:
    """A robot of its own, that stands with its brakes released."""
    with EmulatorProcess(["--model", model, *OPTIONS, *options]) as robot:
        yield robot


class Witness:
    """A client that behaves, in a process of its own: an RTDE client at the full rate."""

    def __init__(self, robot: EmulatorProcess, clients: int = 1, rate_hz: float = 500.0) -> None:
        command = [sys.executable, __file__, "--work", "witness", robot.host, str(robot.ports["rtde"])]
        self._process = subprocess.Popen(
            [*command, str(clients), str(rate_hz)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        self._process.stdout.readline()  # it streams
        self.pid = self._process.pid

    def report(self) -> dict[str, float]:
        """End it: packages, lost, silence_s (the longest time without one), pace (robot time a second)."""
        out, _ = self._process.communicate(timeout=60)
        report: dict[str, float] = json.loads(out)
        return report


def witness(host: str, port: int, clients: int, rate_hz: float) -> None:
    """The process of a Witness: until its standard input ends."""
    received = {connect(port, rate_hz, host): (RTDEDecoder(), [0, 0.0, 0.0]) for _ in range(clients)}
    print("streams", flush=True)
    step = 1 / rate_hz
    lost, silence, last = 0, 0.0, time.monotonic()
    began: list[float] = []
    while True:
        ready = select.select([*received, sys.stdin], [], [], 1.0)[0]
        now = time.monotonic()
        silence, last = max(silence, now - last), now
        for source in ready:
            if source is sys.stdin:
                robot_s = max(seen[2] for _, seen in received.values()) - began[1]
                packages = sum(seen[0] for _, seen in received.values())
                report = {"packages": packages, "lost": lost, "silence_s": silence, "pace": robot_s / (now - began[0])}
                print(json.dumps(report))
                return
            decoder, seen = received[source]  # type: ignore[index]
            data = source.recv(1 << 18)  # type: ignore[union-attr]
            if not data:
                raise ConnectionError("the emulator ended the connection of a client that behaves")
            for package in decoder.feed(data):
                (stamp,) = struct.unpack_from(">d", package.payload, 1)
                if seen[0]:
                    lost += round((stamp - seen[2]) / step) - 1
                elif not began:
                    began = [now, stamp]
                seen[0], seen[2] = seen[0] + 1, stamp


def slope(values: Sequence[float]) -> float:
    """Least squares: how much values at equal distances grow from the first to the last."""
    count = len(values)
    if count < 2:
        return 0.0
    middle = (count - 1) / 2
    spread = sum((index - middle) ** 2 for index in range(count))
    return sum((index - middle) * value for index, value in enumerate(values)) / spread * (count - 1)


class Memory:
    """Growth of the memory of processes over a scenario, after a share of it for warming up."""

    def __init__(self, robot: EmulatorProcess) -> None:
        self._pids = {"emulator": robot.pid}
        self._samples: dict[str, list[float]] = {}
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def __enter__(self) -> "Memory":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def watch(self, name: str, pid: int) -> None:
        """Watch another process, too."""
        self._pids[name] = pid

    @property
    def growth_mib(self) -> dict[str, float]:
        return {name: slope(seen[int(len(seen) * WARM_SHARE) :]) for name, seen in self._samples.items()}

    def _look(self) -> None:
        while not self._ended.wait(0.2):
            for name, pid in tuple(self._pids.items()):
                with suppress(OSError, IndexError, ValueError):  # it has ended
                    self._samples.setdefault(name, []).append(memory_mib(pid))


def said(result: Result, *texts: str) -> None:
    """Hold what processes printed to having no traceback in it."""
    found = sum(text.count(word) for text in texts for word in SAID)
    result.figures["tracebacks"] = found
    result.bar(not found, f"{found} tracebacks: {'…'.join(texts)[-2000:]}")


def unharmed(result: Result, report: dict[str, float]) -> None:
    """Hold a witness to having lost nothing."""
    result.figures |= {name: round(value, 3) for name, value in report.items()}
    result.bar(report["lost"] == 0, f"a client that behaves lost {report['lost']:.0f} packages")


def flat(result: Result, memory: Memory) -> None:
    """Hold every process to its memory."""
    for name, growth in memory.growth_mib.items():
        result.figures[f"memory_of_{name}_mib"] = round(growth, 2)
        result.bar(growth < FLAT_MIB, f"the memory of the {name} grew by {growth:.1f} MiB")


# floods


def _frame(data: bytes) -> bytes:
    return modbus.encode_frame(modbus.Frame(1, 255, data))


_TEXTS = (b"robotmode", b"running", b"load \xc3(.urp", b"popup a", b"addToLog x", b"safetystatus", b"play", b"x" * 300)
_SCRIPTS = (
    b"x = 1",
    b"def f():\n  y = [1, 2]\nend",
    b'textmsg("\xe4")',
    b"movej([0, 0",
    b"sec s():\n  set_digital_out(0, True)\nend",
    b"end",
    b"#\t# comment",
    b"x = 1e999",
)
_PACKAGES = (
    codec.RequestProtocol(2).encode(1),
    codec.GetVersion().encode(2),
    codec.SetupOutputs(("actual_q", "no_such"), 125.0).encode(2),
    codec.SetupInputs(("input_int_register_1",)).encode(2),
    codec.Pause().encode(2),
    b"\0\x0bU\1\xff\xff\xff\xff\xff\xff\xff",
)
_FRAMES = tuple(_frame(modbus.encode_request(modbus.ModbusRequest(3, address, 20))) for address in (0, 256, 400))
_HTTP = b"POST /verbs/robot_mode HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
_CALL = _HTTP + b"Content-Length: 2\r\n\r\n{}"
MESSAGES: dict[str, tuple[tuple[bytes, ...], bytes]] = {
    "dashboard": (_TEXTS, b"\n"),
    "primary": (_SCRIPTS, b"\n"),
    "secondary": (_SCRIPTS, b"\n"),
    "realtime": (_SCRIPTS, b"\n"),
    "interpreter": (_SCRIPTS, b"\n"),
    "primary read-only": (_SCRIPTS, b"\n"),
    "realtime read-only": (_SCRIPTS, b"\n"),
    "rtde": (_PACKAGES, b""),
    "modbus": (_FRAMES, b""),
    "gripper": ((b"GET POS", b"SET ACT 1", b"SET POS 1e300", b"GET \xff"), b"\n"),
    "control": ((_CALL, b"GET /verbs HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"), b""),
}
"""What a port is sent, whole or damaged, and how a message ends there. No word of it shuts a controller down."""

_DAMAGED = 0.3  # of the messages
_AT_ONCE = 20  # messages
_PATIENCE_S = 20.0
_PACE = 0.7  # of the wall's, whatever happens; more leaves no room for what else a machine does


class Flooder:
    """Sends garbage to one port over one connection at a time; who is turned out comes back."""

    def __init__(self, host: str, port: int, kind: str, seed: int) -> None:
        self.sent = self.turned_out = 0
        self._where = host, port
        self._messages, self._end = MESSAGES[kind]
        self._random = random.Random(seed)
        self._connection: socket.socket | None = None
        self._waiting = b""
        self._count = 0  # messages in what waits

    def send(self) -> None:
        """As much as the port takes now."""
        try:
            connection = self._open()
            with suppress(BlockingIOError):
                while connection.recv(1 << 16):
                    pass
                raise ConnectionError("turned out")
            if not self._waiting:
                self._waiting = b"".join(self._message() for _ in range(_AT_ONCE))
                self._count = _AT_ONCE
            with suppress(BlockingIOError):
                self._waiting = self._waiting[connection.send(self._waiting) :]
            if not self._waiting:
                self.sent += self._count
        except OSError:
            self.turned_out += 1
            self.close()

    def finish(self) -> None:
        """Wait until all that was sent has been read: the port answers the end with the end."""
        if self._connection is not None:
            with suppress(OSError):
                self._connection.settimeout(_PATIENCE_S)
                self._connection.shutdown(socket.SHUT_WR)
                while self._connection.recv(1 << 16):
                    pass
        self.close()

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
        self._connection, self._waiting = None, b""

    def _open(self) -> socket.socket:
        if self._connection is None:
            self._connection = socket.create_connection(self._where, timeout=5.0)
            self._connection.setblocking(False)
        return self._connection

    def _message(self) -> bytes:
        message = bytearray(self._random.choice(self._messages))
        if self._random.random() < _DAMAGED:
            for _ in range(self._random.randint(1, 4)):
                message[self._random.randrange(len(message))] = self._random.randrange(256)
        return bytes(message) + self._end


def flood(messages: int) -> Result:
    """Garbage on all ports, as fast as they accept it, alongside a client at 500 Hz."""
    result = Result("flood of all ports")
    with emulator("--gripper", "robotiq-2f-85") as robot, Memory(robot) as memory:
        client = Witness(robot)
        ports = {name: port for name, port in robot.ports.items() if name in MESSAGES}
        flooders = [Flooder(robot.host, port, name, seed) for seed, (name, port) in enumerate(ports.items())]
        until = time.monotonic() + max(30.0, messages / 500)
        while sum(one.sent for one in flooders) < messages and time.monotonic() < until:
            for one in flooders:
                one.send()
        for one in flooders:
            one.finish()
        unharmed(result, client.report())
        sent = sum(one.sent for one in flooders)
        result.figures |= {"messages": sent, "ports": len(ports), "reconnects": sum(one.turned_out for one in flooders)}
        result.bar(sent >= messages, f"the ports took {sent} messages of {messages}")
        result.bar(robot.running, "the emulator is gone")
        said(result, robot.output)
    flat(result, memory)
    return result


def slow_readers(seconds: float) -> Result:
    """Clients of every state port that never read, alongside one that does."""
    result = Result("slow readers")
    with emulator() as robot, ExitStack() as opened, Memory(robot) as memory:
        client = Witness(robot)
        for name in ("primary", "secondary", "realtime", "rtde", "dashboard"):
            for _ in range(6):
                if name == "rtde":
                    deaf = connect(robot.ports[name], 500.0, robot.host)
                else:
                    deaf = socket.create_connection((robot.host, robot.ports[name]))
                deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                opened.enter_context(deaf)
                with suppress(OSError):
                    deaf.setblocking(False)
                    deaf.sendall(b"robotmode\n" * 50 if name == "dashboard" else b"")
        time.sleep(seconds)
        unharmed(result, client.report())
        said(result, robot.output)
    flat(result, memory)
    return result


def many_clients(clients: int, seconds: float) -> Result:
    """Many clients at 125 Hz at the same time."""
    result = Result(f"{clients} clients at 125 Hz")
    with emulator() as robot, Memory(robot) as memory:
        client = Witness(robot, clients, 125.0)
        used = cpu_s(robot.pid)
        time.sleep(seconds)
        result.figures["processor"] = f"{(cpu_s(robot.pid) - used) / seconds:.0%}"
        unharmed(result, client.report())
        said(result, robot.output)
    flat(result, memory)
    return result


# drivers


def drivers(count: int) -> Result:
    """Drivers that are killed, or stopped, while they move an arm."""
    result = Result("drivers killed and stopped")
    workers = max(1, min(os.cpu_count() or 1, count // 2))
    share = [count // workers + (index < count % workers) for index in range(workers)]
    command = [sys.executable, __file__, "--work", "drivers"]
    processes = [
        subprocess.Popen([*command, str(part), str(seed)], stdout=subprocess.PIPE, text=True)
        for seed, part in enumerate(share)
    ]
    reports = [json.loads(process.communicate()[0].splitlines()[-1]) for process in processes]
    times = [time_s for report in reports for time_s in report["times"]]
    stopped = [time_s for time_s in times if time_s is not None]
    in_time = sum(time_s <= STOPPED_WITHIN_S for time_s in stopped)
    result.figures |= {
        "drivers": len(times),
        "stopped_in_time": in_time,
        "worst_stop_s": round(max(stopped, default=0.0), 3),
        "ended_before": sum(report["early"] for report in reports),
        "robot_time": "from the last package before the signal to the first of an arm that stands",
    }
    result.bar(len(times) == count, f"{len(times)} drivers of {count} moved their arm")
    result.bar(in_time == len(times), f"{len(times) - in_time} of {len(times)} arms did not stop in time")
    said(result, *(report["output"] for report in reports))
    return result


class Observer:
    """When an arm moves and when it stands, by the robot's own time."""

    def __init__(self, host: str, port: int) -> None:
        self._connection = socket.create_connection((host, port))
        names = ("timestamp", "actual_qd")
        self._recipe = Recipe.of(names, OUTPUT_FIELDS)
        for request in (codec.RequestProtocol(2), codec.SetupOutputs(names, 500.0), codec.Start()):
            self._connection.sendall(request.encode(2))
            self._connection.recv(4 if isinstance(request, codec.Start) else 4096)
        self._decoder = RTDEDecoder()

    def states(self, seconds: float) -> Iterator[tuple[float, float]]:
        """Time stamps and highest joint speeds, for so long by the wall clock."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            if select.select([self._connection], [], [], left)[0]:
                for package in self._decoder.feed(self._connection.recv(1 << 16)):
                    stamp, *speeds = struct.unpack_from(">7d", package.payload, 1)
                    yield stamp, max(map(abs, speeds))

    def wait(self, moving: bool, seconds: float) -> float | None:
        """The time stamp of the first state of an arm that moves, or stands; None if there was none."""
        for stamp, speed in self.states(seconds):
            if (speed > STANDS_RAD_S) is moving:
                return stamp
        return None

    def now(self) -> float:
        """The last state that has come."""
        stamp = 0.0
        while select.select([self._connection], [], [], 0)[0] or not stamp:
            for package in self._decoder.feed(self._connection.recv(1 << 16)):
                (stamp,) = struct.unpack_from(">d", package.payload, 1)
        return stamp

    def close(self) -> None:
        self._connection.close()


WAYS = ("servo_j", "speed_j", "speed_l", "move_j")


def kill_drivers(count: int, seed: int) -> None:
    """The process of one robot: its drivers come and go."""
    import client  # noqa: F401 - once, for all the children

    generator = random.Random(seed)
    times: list[float | None] = []
    early = 0
    with emulator() as robot, tempfile.TemporaryFile("w+") as output:
        observer = Observer(robot.host, robot.ports["rtde"])
        for tried in range(3 * count):
            number = len(times)
            if number == count:
                break
            child = os.fork()
            if not child:
                _drive(robot.host, WAYS[number // 2 % len(WAYS)], output.fileno())
            try:
                moving = observer.wait(True, 30.0) is not None
                speed = [speed for _, speed in observer.states(generator.uniform(0.1, 0.5))][-1]
                if not moving or speed <= STANDS_RAD_S:
                    early = tried + 1 - number  # it ended before it was struck
                    continue
                struck_s = observer.now()
                os.kill(child, signal.SIGKILL if number % 2 else signal.SIGSTOP)
                stood_s = observer.wait(False, 20.0)
                times.append(None if stood_s is None else max(0.0, stood_s - struck_s))
            finally:
                with suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
        observer.close()
        output.seek(0)
        print(json.dumps({"times": times, "early": early, "output": robot.output + output.read()}))


def _drive(host: str, way: str, output: int) -> None:
    """A driver in a process of its own, until it is killed; it does not return."""
    from client import ClientError, Robot

    os.dup2(output, 1)
    os.dup2(output, 2)
    try:
        with Robot(host) as robot:
            robot.make_ready()
            begin, side = list(robot.q), 1.0 if robot.q[0] < 0.0 else -1.0
            if way == "servo_j":
                with robot.servo_j() as follow:
                    for number in range(5000):
                        follow((begin[0] + side * 0.0006 * number, *begin[1:]))
            elif way == "speed_j":
                robot.speed_j([side * 0.4, 0.0, 0.0, 0.0, 0.0, 0.0], duration_s=10.0)
            elif way == "speed_l":
                robot.speed_l([0.0, side * 0.05, 0.0, 0.0, 0.0, 0.0], duration_s=10.0)
            else:
                robot.move_j([begin[0] + side * 2.0, *begin[1:]], speed_rad_s=0.5)
    except ClientError:
        pass  # a machine so busy that a setpoint came too late: the next driver is struck instead
    finally:
        os._exit(1)


# resources


def descriptors(connections: int) -> Result:
    """More connections than the emulator has descriptors for, alongside a client that was connected before."""
    result = Result("no descriptors left")
    with emulator() as robot, ExitStack() as opened, Memory(robot) as memory:
        client = Witness(robot)
        held = len(list(Path(f"/proc/{robot.pid}/fd").iterdir()))
        resource.prlimit(robot.pid, resource.RLIMIT_NOFILE, (held + 32, held + 32))
        printed = len(robot.output)
        for number in range(connections):
            port = robot.ports[("dashboard", "primary", "rtde", "realtime")[number % 4]]
            with suppress(OSError):
                opened.enter_context(socket.create_connection((robot.host, port), timeout=2.0))
        time.sleep(3.0)
        report = client.report()
        unharmed(result, report)
        result.figures["log_bytes"] = len(robot.output) - printed
        result.bar(len(robot.output) - printed < 20_000, f"the log grew by {len(robot.output) - printed} bytes")
        result.bar(report["pace"] > _PACE, f"robot time went at {report['pace']:.2f} of the wall's")
        opened.close()
        result.bar(_answers(robot), "nobody is let in after the others have gone")
        said(result, robot.output)
    flat(result, memory)
    return result


def _answers(robot: EmulatorProcess, patience_s: float = 10.0) -> bool:
    until = time.monotonic() + patience_s
    while time.monotonic() < until:
        with suppress(OSError), socket.create_connection((robot.host, robot.ports["dashboard"]), timeout=2.0) as asking:
            asking.settimeout(2.0)
            asking.recv(200)
            asking.sendall(b"robotmode\n")
            if asking.recv(200).startswith(b"Robotmode: RUNNING"):
                return True
        time.sleep(0.2)
    return False


def full_disk() -> Result:
    """Recorders whose disk is full from the beginning, or becomes so."""
    result = Result("disk full")
    texts = []
    with emulator() as robot, tempfile.TemporaryDirectory(prefix="chaos-") as folder:
        client = Witness(robot)
        for suffix in (".mcap", ".csv", ".npz"):
            full, limited = Path(folder, f"full{suffix}"), Path(folder, f"limited{suffix}")
            full.symlink_to("/dev/full")
            for path, most in ((full, None), (limited, 20_000)):
                command = [sys.executable, "-m", "client", "record", str(path), "--robot-ip", robot.host]
                done = subprocess.run(
                    [*command, "--duration", "2", "--overwrite"],
                    capture_output=True,
                    text=True,
                    timeout=60,
                    preexec_fn=_no_longer_than(most),
                    cwd=ROOT,
                )
                texts.append(done.stdout + done.stderr)
                report = [line for line in done.stderr.splitlines() if line.strip()]
                result.bar(done.returncode != 0, f"recording {path.name} on a full disk ends with status 0")
                result.bar(1 <= len(report) <= 3, f"{path.name}: {len(report)} lines say why: {done.stderr[-300:]}")
        unharmed(result, client.report())
        said(result, robot.output, *texts)
    return result


def _no_longer_than(most: int | None) -> Callable[[], None] | None:
    """Before a program starts: a limit to its files, beyond which writing fails (EFBIG)."""
    return (lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))) if most is not None else None


_HUNGRY = (
    'def f():\n  a = "0123456789"\n  i = 0\n  while i < 40:\n    a = str_cat(a, a)\n    i = i + 1\n  end\nend\n',
    "def f():\n  i = 0\n  while i < 1000000:\n    l = make_list(10000, i, 10000)\n    i = i + 1\n  end\nend\n",
)


def low_memory(seconds: float) -> Result:
    """An emulator that gets only 32 MiB of address space more, and programs and clients that want it."""
    result = Result("little memory")
    with emulator() as robot, ExitStack() as opened:
        client = Witness(robot)
        size = int(Path(f"/proc/{robot.pid}/statm").read_text().split()[0]) * PAGE
        resource.prlimit(robot.pid, resource.RLIMIT_AS, (size + (32 << 20), resource.RLIM_INFINITY))
        for program in _HUNGRY:
            with socket.create_connection((robot.host, robot.ports["secondary"])) as sending:
                sending.sendall(program.encode())
                time.sleep(seconds / 4)
        for _ in range(40):
            hungry = opened.enter_context(socket.create_connection((robot.host, robot.ports["secondary"])))
            hungry.setblocking(False)
            with suppress(OSError):
                hungry.send(b"def f():\n" + b"  x = [1, 2, 3]\n" * 60_000)
        time.sleep(seconds / 2)
        opened.close()
        result.bar(robot.running, "the emulator is gone")
        if robot.running:
            unharmed(result, client.report())
        said(result, robot.output)
    return result


# time


def clock_jumps(seconds: float) -> Result:
    """The wall clock of emulator and recorder jumps by an hour, back and forth, twice a second; then a sleep of 2 s."""
    result = Result("clock jumps")
    with tempfile.TemporaryDirectory(prefix="chaos-") as folder, ExitStack() as held:
        held.enter_context(_environment(PYTHONPATH=folder))
        Path(folder, "sitecustomize.py").write_text(_JUMPING)
        robot = held.enter_context(emulator())
        client = Witness(robot)
        path = Path(folder, "run.csv")
        command = [sys.executable, "-m", "client", "record", str(path), "--robot-ip", robot.host]
        root = ROOT
        done = subprocess.run(
            [*command, "--duration", str(seconds)], capture_output=True, text=True, timeout=120, cwd=root
        )
        rows = len(path.read_text().splitlines()) - 1 if path.exists() else 0
        result.figures |= {"recorded": rows, "how": "time.time and time.time_ns of the processes, no system clock"}
        result.bar(done.returncode == 0, f"the recorder ended with {done.returncode}: {done.stderr[-300:]}")
        result.bar(rows >= seconds * 490, f"{rows} states were recorded in {seconds:g} s")
        os.kill(robot.pid, signal.SIGSTOP)  # a laptop that is closed
        time.sleep(2.0)
        os.kill(robot.pid, signal.SIGCONT)
        time.sleep(1.0)
        report = client.report()
        unharmed(result, report)
        result.bar(_answers(robot), "it does not answer after it slept")
        said(result, robot.output, done.stderr)
    return result


_JUMPING = """
import time as _time
_now, _now_ns, _steps = _time.time, _time.time_ns, _time.monotonic
def _offset():
    return (0, 3600, -3600, 86400 * 400)[int(_steps() * 2) % 4]
_time.time = lambda: _now() + _offset()
_time.time_ns = lambda: _now_ns() + _offset() * 10**9
"""


@contextmanager
def _environment(**values: str) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


def soak(robot_s: float) -> Result:
    """An hour of robot time, as fast as it goes: motion, messages, stops and recoveries."""
    from emulator.machine import ControllerConfig
    from emulator.virtual import VirtualRobot
    from urproto.robots import load_model

    result = Result(f"{robot_s:g} s in virtual time")
    robot = VirtualRobot(ControllerConfig(model=load_model("ur3"), initial_q=HOME, running=True))
    generator = random.Random(1)
    samples: list[float] = []
    began = time.monotonic()
    rounds, stops = 0, 0
    while robot.controller.snapshot.timestamp < robot_s:
        rounds += 1
        goal = [q + generator.uniform(-0.3, 0.3) for q in HOME]
        robot.send_script(
            f'def p():\n  i = 0\n  while i < 3:\n    movej({goal}, a=3, v=1.5)\n    textmsg("at ", i)\n'
            f"    movel(get_forward_kin({list(HOME)}), a=2, v=0.5)\n    i = i + 1\n  end\nend\n"
        )
        for _ in range(generator.randint(100, 1000)):
            robot.step()
        if rounds % 3 == 0:
            robot.press_emergency_stop()
            robot.step(50)
            robot.release_emergency_stop()
            robot.release_brakes()
            robot.run_until("robot_mode == RUNNING")
            stops += 1
        samples.append(memory_mib(os.getpid()))
    growth = slope(samples[int(len(samples) * WARM_SHARE) :])
    result.figures |= {"programs": rounds, "emergency_stops": stops, "memory_mib": round(growth, 2)}
    result.figures["times_real_time"] = round(robot.controller.snapshot.timestamp / (time.monotonic() - began))
    result.bar(growth < FLAT_MIB, f"memory grew by {growth:.1f} MiB")
    return result


_PAGES = ("/", "/move", "/log", "/program", "/nosuch", "/pendant/pendant.js")


def mixed_use(seconds: float) -> Result:
    """Everyday use in real time: programs, dashboard commands, a client at 500 Hz, requests to the pendant."""
    result = Result(f"{seconds:g} s of mixed use")
    generator = random.Random(2)
    with emulator() as robot, Memory(robot) as memory, _pendant(robot.host) as pendant:
        client = Witness(robot)
        memory.watch("pendant", pendant.pid)
        memory.watch("client", client.pid)
        until, rounds = time.monotonic() + seconds, 0
        while time.monotonic() < until:
            goal = [q + generator.uniform(-0.3, 0.3) for q in HOME]
            _send(robot.host, robot.ports["secondary"], f"def p():\n  movej({goal}, a=3, v=1.5)\nend\n".encode())
            line = generator.choice((b"robotmode", b"programState", b"addToLog hello", b"stop", b"saveLog"))
            _send(robot.host, robot.ports["dashboard"], line + b"\nquit\n")
            head = f"GET {generator.choice(_PAGES)} HTTP/1.1\r\nHost: {robot.host}\r\nConnection: close\r\n\r\n"
            _send(robot.host, PENDANT_PORT, head.encode())
            rounds += 1
            time.sleep(0.3)
        result.figures["rounds"] = rounds
        unharmed(result, client.report())
        said(result, robot.output)
    flat(result, memory)
    return result


@contextmanager
def _pendant(host: str) -> Iterator["subprocess.Popen[str]"]:
    command = [sys.executable, "-u", "-m", "client", "pendant", "--robot-ip", host, "--host", host, "--with-parent"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        process.stdout.readline()  # it serves
        yield process


def _send(host: str, port: int, data: bytes) -> None:
    """Send something and read the answer until the other side has no more for a moment."""
    with suppress(TimeoutError), socket.create_connection((host, port), timeout=5.0) as connection:
        connection.sendall(data)
        connection.settimeout(1.0 if data.endswith(b"\r\n\r\n") or b"quit" in data else 0.01)
        while connection.recv(1 << 16):
            pass


# hostile robots


def hostile_robots(count: int) -> Result:
    """Robots whose every port is spoilt on its way to the client: garbage, half messages, absurd numbers, silence."""
    result = Result("hostile robots")
    command = [sys.executable, __file__, "--work", "victims", str(count)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60 + 10 * count)
    report = (
        json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 else {"met": 0, "errors": {}, "strange": []}
    )
    result.figures |= {"robots": report["met"], "kinds_of_errors": len(report["errors"])}
    result.bar(
        not report["strange"], f"{len(report['strange'])} errors are none of the library's: {report['strange'][:3]}"
    )
    result.bar(report["met"] == count, f"{report['met']} of {count} were met: {done.stderr[-500:]}")
    said(result, done.stderr)
    return result


def meet_robots(count: int) -> None:
    """The process of the clients."""
    import client
    from client.dashboard import ROBOT_MODE

    sys.path.insert(0, str(ROOT))
    from tests.hostile import KINDS, HostileRobot

    kinds = [
        lambda host: client.BlockingDashboardClient(host, timeout_s=0.5),
        lambda host: client.BlockingRTDEClient(host, ["timestamp"], timeout_s=0.5),
        lambda host: client.BlockingPrimaryClient(host, timeout_s=0.5),
        lambda host: client.BlockingRealtimeClient(host, timeout_s=0.5),
    ]
    generator = random.Random(0)
    met, seen, strange = 0, {}, []
    with HostileRobot() as robot:
        for number in range(count):
            robot.begin((generator.choice(KINDS),), number)
            try:
                with kinds[number % len(kinds)](robot.host) as victim:
                    if isinstance(victim, client.BlockingDashboardClient):
                        victim.request(ROBOT_MODE)
                    elif isinstance(victim, client.BlockingPrimaryClient):
                        victim.run(victim.core.robot_state())
                    else:
                        for _ in range(20):
                            victim.receive()
            except URError as error:
                seen[type(error).__name__] = seen.get(type(error).__name__, 0) + 1
            except Exception as error:
                strange.append(f"{type(error).__name__}: {error}")
            met += 1
    print(json.dumps({"met": met, "errors": seen, "strange": strange}))


# all of them


def scenarios(quick: bool, hours: float = 0.0) -> dict[str, Callable[[], Result]]:
    """By name, each with its size."""
    return {
        "flood": lambda: flood(10_000 if quick else 1_000_000),
        "drivers": lambda: drivers(4 if quick else 300),
        "hostile": lambda: hostile_robots(8 if quick else 400),
        "descriptors": lambda: descriptors(100 if quick else 400),
        "disk": full_disk,
        "memory": lambda: low_memory(2.0 if quick else 20.0),
        "clock": lambda: clock_jumps(2.0 if quick else 20.0),
        "slow": lambda: slow_readers(2.0 if quick else 60.0),
        "clients": lambda: many_clients(20 if quick else 100, 2.0 if quick else 60.0),
        "soak": lambda: soak(60.0 if quick else 3600.0),
        "mixed": lambda: mixed_use(10.0 if quick else 3600.0 * hours),
    }


def work(arguments: Sequence[str]) -> None:
    """One of the processes of a scenario."""
    match arguments:
        case ["witness", host, port, clients, rate_hz]:
            witness(host, int(port), int(clients), float(rate_hz))
        case ["drivers", count, seed]:
            kill_drivers(int(count), int(seed))
        case ["victims", count]:
            meet_robots(int(count))


def main() -> int:
    """Run scenarios, and say how they went."""
    if sys.argv[1:2] == ["--work"]:
        work(sys.argv[2:])
        return 0
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="SCENARIO", help=f"all unless given: {', '.join(scenarios(True))}")
    parser.add_argument("--quick", action="store_true", help="a little of each, in less than a minute")
    parser.add_argument("--hours", type=float, default=0.1, help="how long the scenario mixed takes")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there, too")
    options = parser.parse_args()
    if not sys.platform.startswith("linux"):
        parser.error("it needs /proc and limits of other processes: Linux only")
    chosen = scenarios(options.quick, options.hours)
    if unknown := set(options.names) - set(chosen):
        parser.error(f"unknown: {', '.join(sorted(unknown))}")
    results = []
    for name in options.names or chosen:
        began = time.monotonic()
        result = chosen[name]()
        figures = ", ".join(f"{key} {value}" for key, value in result.figures.items())
        print(f"{'MISSED' if result.missed else 'ok'}  {result.name} ({time.monotonic() - began:.0f} s): {figures}")
        for missed in result.missed:
            print(f"    {missed}")
        sys.stdout.flush()
        results.append(result)
    if options.json:
        machine = {"cores": os.cpu_count(), "load": os.getloadavg(), "python": platform.python_version()}
        report = {"machine": machine, "quick": options.quick, "scenarios": [asdict(result) for result in results]}
        options.json.write_text(json.dumps(report, indent=1) + "\n")
    missed = [result.name for result in results if result.missed]
    print(f"make chaos: {len(results) - len(missed)} of {len(results)} met their bars")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
