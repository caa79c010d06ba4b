"""Control periods and packages of one healthy client alongside a crowd: idle clients, and more than are admitted."""

import json
import resource
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path

from jitter import child, connect, gaps, result
from table import Table

from urproto.robots import load_model

SECONDS = 10.0
IDLE = 1100
FEW = 400  # descriptors
CROWDED = ("dashboard", "primary", "secondary", "realtime", "rtde", "modbus", "control", "secondary read-only")
CROWDED += ("realtime read-only",)
HOST = "127.0.0.1"


def measure(seconds: float = SECONDS) -> Table:
    """One row for each arm and crowd."""
    rows = []
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 2 * IDLE), hard))
    for model in ("ur3", "ur5e"):
        for name, crowd in CROWDS.items():
            rows.append([model, name, *_run(model, crowd, seconds)])
    note = (
        f"Lateness over {seconds:g} s, with one RTDE client at the full rate. Idle clients never read; they connect in "
        f"the first second, spread over the ports. The third crowd faces a limit of {FEW} files and connections, and "
        "reconnects whenever it is refused. Bare loop: periods missed by a loop that only sleeps, at the same time."
    )
    columns = ["arm", "crowd", "p50", "p99", "p99.9", "worst", "missed", "collector", "lost", "sockets", "bare loop"]
    return Table("A crowd of clients", note, columns, rows)


def _run(model: str, crowd: "Crowd", seconds: float) -> list[str]:
    serve = child("serve", model)
    assert serve.stdout is not None
    ports = json.loads(serve.stdout.readline())
    period_s = load_model(model).series.period_s
    healthy, received = connect(ports["rtde"], 1 / period_s), bytearray()
    bare = child("sleep", str(period_s), str(seconds))
    with crowd(serve, ports) as let_in:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            received += healthy.recv(65536)
        inside = let_in()
    healthy.close()
    return [*result(serve), str(gaps(bytes(received), period_s)), str(inside), result(bare)[-1]]


Crowd = Callable[["subprocess.Popen[str]", Mapping[str, int]], AbstractContextManager[Callable[[], int]]]


@contextmanager
def nobody(serve: "subprocess.Popen[str]", ports: Mapping[str, int]) -> Iterator[Callable[[], int]]:
    """None but the healthy client."""
    yield lambda: 0


@contextmanager
def idle(serve: "subprocess.Popen[str]", ports: Mapping[str, int]) -> Iterator[Callable[[], int]]:
    """They come, and do nothing."""
    with ExitStack() as clients:
        inside: list[socket.socket] = []

        def come() -> None:
            for number in range(IDLE):
                place = (HOST, ports[CROWDED[number % len(CROWDED)]])
                inside.append(clients.enter_context(socket.create_connection(place)))

        coming = threading.Thread(target=come)
        coming.start()
        yield lambda: _descriptors(serve)
        coming.join()


@contextmanager
def insistent(serve: "subprocess.Popen[str]", ports: Mapping[str, int]) -> Iterator[Callable[[], int]]:
    """More than there are descriptors for, who come again."""
    resource.prlimit(serve.pid, resource.RLIMIT_NOFILE, (FEW, FEW))
    leaving = threading.Event()

    def insist() -> None:
        with ExitStack() as clients:
            number = 0
            while not leaving.is_set():
                number += 1
                client = socket.create_connection((HOST, ports[CROWDED[number % len(CROWDED)]]))
                client.settimeout(0.001)
                try:
                    ended = not client.recv(1)
                except TimeoutError:
                    ended = False
                except OSError:
                    ended = True
                (client.close if ended else lambda client=client: clients.enter_context(client))()

    insisting = threading.Thread(target=insist)
    insisting.start()
    try:
        yield lambda: _descriptors(serve)
    finally:
        leaving.set()
        insisting.join()


def _descriptors(process: "subprocess.Popen[str]") -> int:
    """Sockets that the emulator has: its clients and its ports."""
    count = 0
    for link in Path(f"/proc/{process.pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed since it was listed
            count += "socket:" in str(link.readlink())
    return count


CROWDS = {"nobody": nobody, f"{IDLE:,} idle clients": idle, "insistent, no descriptors left": insistent}


if __name__ == "__main__":
    sys.stdout.write(measure(float(sys.argv[1]) if sys.argv[1:] else SECONDS).markdown())
