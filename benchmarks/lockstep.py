"""A servo loop with ur_rtde in real time and by ``ur-emulator exec``, with and without busy processes beside it.

python benchmarks/lockstep.py [seconds]
"""

import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from streaming import busy
from table import Table
from ur_rtde_servo import HZ

from urproto.testing.process import EmulatorProcess

SECONDS: Final = 60.0
HOGS: Final = 8
HOST: Final = "127.0.0.78"
_LOOP: Final = Path(__file__).with_name("ur_rtde_servo.py")
_MODEL: Final = ("--model", "ur3", "--host", HOST)


def measure(seconds: float = SECONDS) -> Table:
    """One row in real time, and two by ``exec``."""
    loop = (sys.executable, str(_LOOP), HOST, str(round(seconds * HZ)))
    emulator = (sys.executable, "-m", "emulator")
    with EmulatorProcess(_MODEL, HOST):
        real = _run(loop)
    rows = [["real time", *_row(real, real)]]
    for hogs in (0, HOGS):
        with busy(hogs):
            again = _run((*emulator, "exec", *_MODEL, "--", *loop))
        rows.append([f"exec{f', {hogs} busy processes' if hogs else ''}", *_row(again, real)])
    about = (
        f"ur_rtde 1.6 with a UR3 at {HZ:g} Hz: {seconds:g} s of servoJ, a sine of 0.1 rad on the base. Whole: from the "
        "start of the command to its end, of which powering on, connecting and starting the script take some seconds "
        "of the robot's time. Lag: between the commanded and the measured angle."
    )
    heads = ["", "whole", "times real time", "client's time", "robot's time", "mean lag", "largest lag"]
    return Table("Unmodified programs in lockstep", about, heads, rows)


def _run(command: Sequence[str]) -> tuple[float, str]:
    began = time.monotonic()
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    return time.monotonic() - began, done.stdout


def _row(run: tuple[float, str], real: tuple[float, str]) -> list[str]:
    client_s, robot_s, middle, largest = map(float, run[1].split())
    lags = (f"{1e3 * lag:.2f} mrad" for lag in (middle, largest))
    return [f"{run[0]:.1f} s", f"{real[0] / run[0]:.1f}", f"{client_s:.2f} s", f"{robot_s:.2f} s", *lags]


if __name__ == "__main__":
    sys.stdout.write(measure(*map(float, sys.argv[1:])).markdown())
