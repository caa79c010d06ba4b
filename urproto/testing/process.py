"""An emulator in a separate process, on its own loopback address."""

import errno
import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from urproto.compat import Self
from urproto.controlapi import ControlClient, RemoteControl
from urproto.joints import JOINT_NAMES
from urproto.testing import launch

_FIRST: Final = 0x7F40_0000  # 127.64.0.0: away from addresses that people type
_COUNT: Final = 2**22
_STRIDE: Final = 61  # between two processes; prime, so that neighbours are soon apart
_ATTEMPTS: Final = 200
_LOCK_PORT: Final = 29999  # UDP, which controllers do not use
_DASHBOARD_PORT: Final = 29999
_ONLY_ADDRESS: Final = "127.0.0.1"
_START_DEADLINE_S: Final = 60.0  # guess: it takes a second, a loaded machine a few
_STOP_DEADLINE_S: Final = 10.0  # guess
_POLL_S: Final = 0.02  # between two checks whether it is ready
_LOG_LINES: Final = 30
_LOG_WAIT_S: Final = 3.0  # guess: short, because a test has already failed when this is used
_TAIL: Final = 4000  # characters of its output in an error


def command_line(options: Mapping[str, Any]) -> list[str]:
    """``speed=10, running=True`` as ``--speed 10 --running``. Lists repeat their option, None and False omit it."""
    words: list[str] = []
    for name, value in options.items():
        option = "--" + name.replace("_", "-")
        if value is True:
            words.append(option)
        elif value is not None and value is not False:
            values = value if isinstance(value, list | tuple) else [value]
            words += [word for item in values for word in (option, str(item))]
    return words


def write_positions(path: Path, q_rad: Sequence[float]) -> Path:
    """Write a file for ``--initial-positions``. Raises ValueError unless there are six angles."""
    path.write_text("".join(f"{name}: {float(q)}\n" for name, q in zip(JOINT_NAMES, q_rad, strict=True)))
    return path


_next = itertools.count(os.getpid() * _STRIDE)


class NoAddressError(OSError):
    """The usual ports are not free on any loopback address."""


@dataclass
class ClaimedAddress:
    """An address that no other process claims until ``release``. shared: the only address; use free ports."""

    host: str
    shared: bool
    _lock: socket.socket | None = None

    def release(self) -> None:
        """Give up the claim."""
        if self._lock is not None:
            self._lock.close()


def claim_address() -> ClaimedAddress:
    """Claim an address. Raises NoAddressError if a process on this machine uses the usual ports on all addresses."""
    for number in itertools.islice(_next, _ATTEMPTS):
        host = socket.inet_ntoa((_FIRST + number % _COUNT).to_bytes(4, "big"))
        lock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            lock.bind((host, _LOCK_PORT))
            _bind_once(host)
        except OSError as error:
            lock.close()
            if error.errno == errno.EADDRNOTAVAIL:
                return ClaimedAddress(_ONLY_ADDRESS, shared=True)
            continue
        return ClaimedAddress(host, shared=False, _lock=lock)
    raise NoAddressError(
        f"port {_DASHBOARD_PORT} is taken on every loopback address: something listens on 0.0.0.0, perhaps another "
        "emulator or a container. Stop it, or let this emulator have free ports (ephemeral_ports=True)"
    )


def _bind_once(host: str) -> None:
    with socket.socket() as probe:
        probe.bind((host, _DASHBOARD_PORT))


class EmulatorError(AssertionError):
    """The emulator did not become ready, or did not stop; the message includes the end of its output."""


class EmulatorProcess:
    """An emulator with options of ``ur-emulator``, which runs from ``start`` (or entering the context) to ``dispose``
    (or leaving it).

    host: its address; by default, it gets its own. On machines with a single loopback address, it uses free ports
    instead. token: required by its control API. environment: variables in addition to those of this process. Verbs of
    the control API are methods: ``robot.press_emergency_stop()``; ``control`` has all of them, including those whose
    names mean something else here.
    """

    def __init__(
        self,
        arguments: Sequence[str] = (),
        host: str | None = None,
        token: str = "",
        environment: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self._address = None if host else claim_address()
        self.host: str = host or (self._address.host if self._address else "")
        self._arguments = [*arguments]
        if self._address is not None and self._address.shared and "--ephemeral-ports" not in arguments:
            self._arguments.append("--ephemeral-ports")
        if token:
            self._arguments += ["--control-token", token]
        self._token = token
        self._environment = environment
        self._folder = tempfile.TemporaryDirectory(prefix="ur-emulator-")
        self._process: subprocess.Popen[bytes] | None = None
        self._control: RemoteControl | None = None
        self._ended_here = False

    def __enter__(self) -> Self:
        try:
            return self.start()
        except BaseException:
            self.dispose()
            raise

    def __exit__(self, *_: object) -> None:
        self.dispose()

    def start(self, *, wait: bool = True) -> Self:
        """Start or restart it, and wait until it is ready. Raises EmulatorError."""
        __tracebackhide__ = True
        if self.running:
            raise EmulatorError(f"the emulator on {self.host} is already running")
        self._ports_file.unlink(missing_ok=True)
        place = ["--host", self.host, "--no-pendant", "--ports-file", str(self._ports_file)]
        command = [sys.executable, launch.__file__, *place, *self._arguments]
        self._ended_here = False
        with self._output_file.open("wb") as output:
            self._process = subprocess.Popen(
                command,
                env={**os.environ, **self._environment},
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        return self.wait_ready() if wait else self

    def wait_ready(self, timeout_s: float = _START_DEADLINE_S) -> Self:
        """Wait until every port has answered a handshake. Raises EmulatorError."""
        __tracebackhide__ = True  # the emulator's output is more useful than this traceback
        process = self._started()
        deadline = time.monotonic() + timeout_s
        while not self._ports_file.exists():
            try:
                status = process.wait(timeout=_POLL_S)
            except subprocess.TimeoutExpired:
                pass
            else:
                self._ended_here = True  # reported by this error
                raise EmulatorError(f"the emulator ended with status {status} before it was ready:\n{self._tail()}")
            if time.monotonic() > deadline:
                self.kill()
                raise EmulatorError(f"the emulator was not ready within {timeout_s:g} s:\n{self._tail()}")
        return self

    @property
    def running(self) -> bool:
        """Whether the process is running."""
        return self._process is not None and self._process.poll() is None

    @property
    def pid(self) -> int:
        """Process id, for limits and signals. Raises EmulatorError before it was started."""
        return self._started().pid

    @property
    def crashed(self) -> bool:
        """Whether it exited by itself with an error."""
        return self._process is not None and not self._ended_here and self._process.poll() not in (None, 0)

    @property
    def status(self) -> int | None:
        """Its exit status; None while it runs."""
        return self._started().poll()

    @property
    def ports(self) -> Mapping[str, int]:
        """The ports of the servers by name: ``ports["rtde"]``."""
        self.wait_ready()
        ports: dict[str, int] = json.loads(self._ports_file.read_text())
        return ports

    @property
    def output(self) -> str:
        """Its output since the last start."""
        return self._output_file.read_text(errors="replace") if self._output_file.exists() else ""

    def explanation(self) -> dict[str, str]:
        """Texts that may explain a failure: its output and the robot's own log, if available."""
        texts = {"output": self.output.strip(), "log": "\n".join(self._log_lines())}
        return {name: text for name, text in texts.items() if text}

    @property
    def control(self) -> RemoteControl:
        """The verbs of its control API."""
        if self._control is None:
            if "control" not in self.ports:
                raise RuntimeError("this emulator was started without its control API")
            self._control = RemoteControl(self.host, self.ports["control"], self._token, timeout_s=None)
        return self._control

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.control, name)

    def stop(self) -> int:
        """Stop it like Ctrl-C does and return its exit status. Raises EmulatorError if it does not stop."""
        process = self._started()
        self._ended_here = True
        process.send_signal(signal.SIGINT)
        try:
            status = process.wait(_STOP_DEADLINE_S)
        except subprocess.TimeoutExpired:
            self.kill()
            raise EmulatorError(f"the emulator did not stop within {_STOP_DEADLINE_S:g} s:\n{self._tail()}") from None
        self._clean_up()
        return status

    def kill(self) -> None:
        """End it immediately, like a power cut; ``start`` switches it on again."""
        process = self._started()
        self._ended_here = self._ended_here or process.poll() is None
        process.kill()
        process.wait()
        self._clean_up()

    def dispose(self) -> None:
        """Kill the process if it runs, remove its files, and release its address."""
        if self._process is not None:
            self.kill()
        self._folder.cleanup()
        if self._address is not None:
            self._address.release()

    @property
    def _ports_file(self) -> Path:
        return Path(self._folder.name, "ports.json")

    @property
    def _output_file(self) -> Path:
        return Path(self._folder.name, "output")

    def _started(self) -> "subprocess.Popen[bytes]":
        if self._process is None:
            raise EmulatorError(f"the emulator on {self.host} was not started")
        return self._process

    def _clean_up(self) -> None:
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()
        if self._control is not None:
            self._control.close()
            self._control = None

    def _log_lines(self) -> list[str]:
        if not self.running or not self._ports_file.exists() or "control" not in self.ports:
            return []
        with closing(ControlClient(self.host, self.ports["control"], self._token, _LOG_WAIT_S)) as client:
            try:
                return list(client.call("log", {"lines": _LOG_LINES}))
            except OSError as error:
                return [str(error)]

    def _tail(self) -> str:
        return self.output[-_TAIL:]
