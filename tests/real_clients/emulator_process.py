"""An emulator in a process of its own, on a loopback address of its own.

ur_rtde knows only the standard port numbers, so emulators that run side by side differ in
their address: every 127.x.y.z is the local machine on Linux.
"""

import contextlib
import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Self, TextIO

START_DEADLINE_S = 60.0  # guess: a loaded two-core machine needs a few seconds
STOP_DEADLINE_S = 10.0
DASHBOARD_PORT = 29999
SCRIPT_PORT = 30002

_count = itertools.count(1)


def own_loopback_address() -> str:
    """An address in 127.0.0.0/8 that no other test process and no other call gets."""
    number = (os.getpid() % 2**20) * 16 + next(_count) % 16
    return f"127.{number >> 16 & 255}.{number >> 8 & 255}.{number & 255}"


class EmulatorProcess:
    """``python -m emulator`` with its output in a log file; start() returns when it is ready."""

    def __init__(self, arguments: Sequence[str], host: str | None = None) -> None:
        self.host = host or own_loopback_address()
        self._arguments = list(arguments)
        self._folder = tempfile.TemporaryDirectory(prefix="emulator-")
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def running(self) -> bool:
        return self._process is not None and self._process.poll() is None

    @property
    def log(self) -> str:
        """What the emulator printed since its last start, at most the last 4000 characters."""
        path = Path(self._folder.name, "log")
        return path.read_text(errors="replace")[-4000:] if path.exists() else ""

    def start(self) -> Self:
        ports_file = Path(self._folder.name, "ports.json")
        ports_file.unlink(missing_ok=True)
        command = [sys.executable, "-m", "emulator", "--host", self.host, "--ports-file", str(ports_file)]
        with Path(self._folder.name, "log").open("wb") as log:
            self._process = subprocess.Popen([*command, *self._arguments], stdout=log, stderr=subprocess.STDOUT)
        self._wait_for(ports_file)
        return self

    def _wait_for(self, ports_file: Path) -> None:
        assert self._process is not None
        deadline = time.monotonic() + START_DEADLINE_S
        while not _holds_json(ports_file):
            with contextlib.suppress(subprocess.TimeoutExpired):
                status = self._process.wait(timeout=0.02)
                raise AssertionError(f"the emulator ended with status {status} before it was ready:\n{self.log}")
            if time.monotonic() > deadline:
                self.kill()
                raise AssertionError(f"the emulator was not ready within {START_DEADLINE_S} s:\n{self.log}")

    def stop(self) -> int:
        """End it the way Ctrl-C does and return its exit status."""
        assert self._process is not None
        self._process.send_signal(signal.SIGINT)
        try:
            return self._process.wait(STOP_DEADLINE_S)
        except subprocess.TimeoutExpired:
            self.kill()
            raise AssertionError(f"the emulator did not end within {STOP_DEADLINE_S} s:\n{self.log}") from None

    def kill(self) -> None:
        """End it without any goodbye, as a power cut does."""
        assert self._process is not None
        self._process.kill()
        self._process.wait()

    def dispose(self) -> None:
        """Remove what it left on disk."""
        if self.running:
            self.kill()
        self._folder.cleanup()

    def dashboard(self, *lines: str) -> list[str]:
        """Send dashboard commands over a connection of their own and return the answers."""
        with socket.create_connection((self.host, DASHBOARD_PORT), timeout=10) as connection:
            stream = connection.makefile("rw", newline="\n")
            greeting = stream.readline()
            assert greeting == "Connected: Universal Robots Dashboard Server\n", greeting
            return [_ask(stream, line) for line in lines]

    def send_script(self, text: str) -> None:
        """Hand text to the secondary script port."""
        with socket.create_connection((self.host, SCRIPT_PORT), timeout=10) as connection:
            connection.sendall(text.encode())
            connection.shutdown(socket.SHUT_WR)


def _holds_json(path: Path) -> bool:
    try:
        return bool(json.loads(path.read_text()))
    except (FileNotFoundError, json.JSONDecodeError):
        return False


def _ask(stream: TextIO, line: str) -> str:
    stream.write(f"{line}\n")
    stream.flush()
    return stream.readline().rstrip("\n")
