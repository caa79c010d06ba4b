"""A servo loop at 500 Hz: what it costs, and what gets lost while other processes want the processor.

The emulator is a process of its own. A thread of this one streams joint angles by `Robot.servo_j`, receives every
state, and counts; hogs are processes that do nothing but count. Nobody holds them back, the machine decides.
"""

import math
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, Literal

from jitter import serve_at
from table import Table

from client import LateSetpointError, ProgramEndedError, Robot

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
        rows = [_stream(hogs, how, seconds) for hogs in (0, HOGS) for how in ("auto", "off")]
    finally:
        serve.communicate()
    about = (
        f"`Robot.servo_j` for {seconds:g} s beside an emulated UR5e; busy processes that want a whole core each. Cost: "
        "processor time of the client, in shares of a core, from receiving to sending. Without: control periods that "
        "got no setpoint. Late: setpoints after which the robot had stopped the arm."
    )
    columns = ["hogs", "real time", "rate", "cost", "setpoints", "without", "longest gap", "late", "programs ended"]
    return Table("Streaming", about, columns, rows)


def _stream(hogs: int, how: Literal["auto", "off"], seconds: float) -> list[str]:
    late = ended = setpoints = 0
    with Robot(HOST, realtime=how) as robot, _busy(hogs):
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


@contextmanager
def _busy(count: int) -> Iterator[None]:
    hogs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()


if __name__ == "__main__" and sys.argv[1:] == ["serve"]:
    serve_at("ur5e", HOST)
elif __name__ == "__main__":
    sys.stdout.write(measure().markdown())
