"""Fleets as processes, on addresses that no other test uses."""

import contextlib
import os
import re
import select
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from ipaddress import ip_address
from pathlib import Path

from urproto.compat import module_command

DEADLINE_S = 60  # under load by other tests
DASHBOARD = 29999
ADDRESSES_PER_PROCESS = 16
# specific to this test process, by its process number
FIRST = ip_address("127.96.0.1") + os.getpid() % 2**16 * ADDRESSES_PER_PROCESS


def host(index: int) -> str:
    return str(FIRST + index)


class Fleet:
    """``ur-emulator fleet`` in a separate process, from ``first host`` on."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        command = [*module_command("emulator"), "fleet", "--first-host", host(0), *arguments]
        self.process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        self.seen = ""

    def read_until(self, text: str) -> str:
        """Standard output up to the text."""
        assert self.process.stdout is not None
        while text not in self.seen:
            readable, _, _ = select.select([self.process.stdout], [], [], DEADLINE_S)
            more = os.read(self.process.stdout.fileno(), 4096).decode() if readable else ""
            if not more:
                self.process.kill()
                raise AssertionError(f"{text!r} did not come: {self.seen}{self.process.communicate()}")
            self.seen += more
        return self.seen

    @property
    def workers(self) -> dict[str, int]:
        """The process of each host, from the table on the screen."""
        rows = re.findall(r"^\s*(127\.\S+) .*? (\d+)\s*$", self.seen, re.MULTILINE)
        return {address: int(pid) for address, pid in rows}

    def interrupt(self) -> tuple[int, str]:
        """End it with Ctrl-C: exit status and standard error."""
        self.process.send_signal(signal.SIGINT)
        _, error = self.process.communicate(timeout=DEADLINE_S)
        return self.process.returncode, error.decode()


@contextmanager
def running(folder: Path, *arguments: str) -> Iterator[Fleet]:
    fleet = Fleet(folder, *arguments)
    try:
        yield fleet
    finally:
        fleet.process.kill()
        fleet.process.communicate()
        for pid in set(fleet.workers.values()):
            wait_for_end(pid)


def wait_for_end(pid: int) -> None:
    """Wait until the process, which is not a child of this one, has ended."""
    deadline = time.monotonic() + DEADLINE_S
    while alive(pid):
        assert time.monotonic() < deadline, f"process {pid} lives on"
        time.sleep(0.02)


def alive(pid: int) -> bool:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def dashboard(address: str, line: str) -> str:
    with socket.create_connection((address, DASHBOARD), timeout=DEADLINE_S) as connection:
        stream = connection.makefile("rw", newline="\n")
        stream.readline()
        stream.write(f"{line}\n")
        stream.flush()
        return stream.readline().rstrip("\n")


def answers(address: str) -> bool:
    try:
        return dashboard(address, "robotmode").startswith("Robotmode: ")
    except ConnectionRefusedError:
        return False
