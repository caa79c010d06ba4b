"""A servo loop at 500 Hz: what it costs, and what gets lost while other processes want the processor.

The emulator is a process of its own. A thread of this one streams joint angles by `Robot.servo_j`, receives every
state, and counts; hogs are processes that do nothing but count. Nobody holds them back, the machine decides.

Beside it stand bare sockets: a thread that receives the same packages and does nothing with them, and one that sends 32
bytes after each. What they cost, waking up costs on this machine, in Python.
"""

import math
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, Literal

from jitter import connect, serve_at
from table import Table

from client import LateSetpointError, ProgramEndedError, Robot
from client.driver.scheduling import real_time
from client.robot.state import MORE_OUTPUTS, OUTPUTS

SECONDS: Final = 5.0
HOGS: Final = 4
HOST: Final = "127.0.0.77"


def measure(seconds: float = SECONDS) -> Table:
    """One row without and with hogs, with and without real-time priority where it is allowed."""
    command = [sys.executable, __file__, "serve"]
    serve = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert serve.stdout is not None
    serve.stdout.readline()
    try:
        rows = [_bare(seconds), *(_stream(hogs, how, seconds) for hogs in (0, HOGS) for how in ("auto", "off"))]
    finally:
        serve.communicate()
    about = (
        f"`Robot.servo_j` for {seconds:g} s with an emulated UR5e on the same machine. Busy processes: each needs a "
        "whole core. Cost: of the client, for receiving and sending. Without: control periods that received no "
        "setpoint. Late: setpoints that came after the robot had stopped the arm. Bare: two threads that only receive "
        "the packages and send 32 bytes."
    )
    columns = [
        "busy processes",
        "real-time priority",
        "rate",
        "cost",
        "setpoints",
        "without",
        "longest gap",
        "late",
        "programs ended",
    ]
    return Table("Streaming", about, columns, rows)


def _stream(hogs: int, how: Literal["auto", "off"], seconds: float) -> list[str]:
    late = ended = setpoints = 0
    with Robot(HOST, realtime=how) as robot, busy(hogs):
        robot.make_ready()
        q = robot.q
        cost_s, began_s = time.process_time(), time.monotonic()
        skipped, gap_s = 0, 0.0
        while (left := began_s + seconds - time.monotonic()) > 0:
            try:
                with robot.servo_j() as follow:
                    until = time.monotonic() + left
                    while (now := time.monotonic()) < until:
                        follow((q[0] + 0.1 * math.sin(now - began_s) ** 2, *q[1:]))
            except LateSetpointError:
                late += 1
            except ProgramEndedError:
                ended += 1
                robot.make_ready()
            setpoints += robot.stream.sent
            skipped += robot.stream.skipped
            gap_s = max(gap_s, robot.stream.longest_gap_s)
        took_s, cost_s = time.monotonic() - began_s, time.process_time() - cost_s
    return [
        str(hogs),
        how,
        f"{setpoints / took_s:.0f} Hz",
        f"{cost_s / took_s:.1%}",
        str(setpoints),
        str(skipped),
        f"{1000.0 * gap_s:.0f} ms",
        str(late),
        str(ended),
    ]


def _bare(seconds: float) -> list[str]:
    """The same sockets and threads, and nothing else."""
    packages = connect(30004, 500.0, HOST, ("timestamp", *OUTPUTS, *MORE_OUTPUTS))
    sink = subprocess.Popen([sys.executable, __file__, "sink"], stdout=subprocess.PIPE, text=True)
    assert sink.stdout is not None
    setpoints = socket.create_connection((HOST, int(sink.stdout.readline())))
    setpoints.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    came, sent = threading.Semaphore(0), 0

    def receive() -> None:
        with real_time("auto"):
            while packages.recv(65536):
                came.release()

    receiving = threading.Thread(target=receive)
    with packages, setpoints, real_time("auto"):
        cost_s, began_s = time.process_time(), time.monotonic()
        receiving.start()
        while time.monotonic() < began_s + seconds:
            came.acquire()
            setpoints.send(b"\0" * 32)
            sent += 1
        took_s, cost_s = time.monotonic() - began_s, time.process_time() - cost_s
        packages.shutdown(socket.SHUT_RDWR)
        receiving.join()
    sink.communicate()
    return ["0", "bare", f"{sent / took_s:.0f} Hz", f"{cost_s / took_s:.1%}", str(sent), "", "", "", ""]


def _sink() -> None:
    """Take what comes over one connection, until it ends."""
    with socket.create_server((HOST, 0)) as server:
        sys.stdout.write(f"{server.getsockname()[1]}\n")
        sys.stdout.flush()
        with server.accept()[0] as connection:
            while connection.recv(4096):
                pass


@contextmanager
def busy(count: int) -> Iterator[None]:
    hogs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()


if __name__ == "__main__" and sys.argv[1:] == ["serve"]:
    serve_at("ur5e", HOST)
elif __name__ == "__main__" and sys.argv[1:] == ["sink"]:
    _sink()
elif __name__ == "__main__":
    sys.stdout.write(measure().markdown())
