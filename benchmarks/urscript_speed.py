"""URScript against the same algorithm in plain Python, and how long a big program takes to compile.

The programs run on a host with one endless frame, so that only the language is measured and not the
share of a control period it may use.
"""

import sys
import time
from collections.abc import Callable, Iterator
from itertools import count
from typing import Any

from table import Table

from emulator.builtins import LIBRARIES
from urproto.versions import DEFAULT_VERSION, Series
from urscript import LibrarySet, Runtime, ScriptThread, compile_script

BLOCKS = 7
LIBRARY_SET = LibrarySet(LIBRARIES)
VERSION = DEFAULT_VERSION[Series.E]
FRESH: Iterator[int] = count()  # makes each text new to the cache of programs

FUNCTION = """
  def step_{n}(q, gain=0.5):
    local goal = [0.1, -1.2, 1.3, -0.4, 0.5, 0.6]
    local k = 0
    while k < 6:
      if norm(goal[k] - q[k]) > 0.01 and gain > 0.0:
        goal[k] = q[k] + gain * (goal[k] - q[k]) / 2.0
      else:
        textmsg("joint reached: ", k)
      end
      k = k + 1
    end
    movel(pose_trans(get_actual_tcp_pose(), p[0.0, 0.0, -0.01, 0, 0, 0]), a=0.3, v=0.1, r=0.001)
    return goal
  end
"""
BIG_PROGRAM = "def big():\n" + "".join(FUNCTION.format(n=n) for n in range(86)) + "  step_0([0, 0, 0, 0, 0, 0])\nend\n"

LOOP_SCRIPT = """
  def run_it():
    local total = 0.0
    local k = 0
    local odd = 0
    while k < 100000:
      total = total + k * 0.5 - total / 3.0
      if k % 2 == 1:
        odd = odd + 1
      end
      k = k + 1
    end
    return total + odd
  end
"""


def _loop() -> float:
    total, k, odd = 0.0, 0, 0
    while k < 100000:
        total = total + k * 0.5 - total / 3.0
        if k % 2 == 1:
            odd = odd + 1
        k = k + 1
    return total + odd


STRAIGHT_SCRIPT = (
    """
  def run_it():
    local x = 0.0
    local y = 1.0
    local z = 0.5
    local k = 0
    while k < 5000:
"""
    + 4
    * """
      x = x + 0.01 * (y - x) * 10.0
      y = y + 0.01 * (x * (28.0 - z) - y)
      z = z + 0.01 * (x * y - 2.5 * z)
      if z > 40.0:
        z = z - 1.0
      end
"""
    + """
      k = k + 1
    end
    return x + y + z
  end
"""
)


def _straight() -> float:
    x, y, z, k = 0.0, 1.0, 0.5, 0
    while k < 5000:
        x = x + 0.01 * (y - x) * 10.0
        y = y + 0.01 * (x * (28.0 - z) - y)
        z = z + 0.01 * (x * y - 2.5 * z)
        if z > 40.0:
            z = z - 1.0
        x = x + 0.01 * (y - x) * 10.0
        y = y + 0.01 * (x * (28.0 - z) - y)
        z = z + 0.01 * (x * y - 2.5 * z)
        if z > 40.0:
            z = z - 1.0
        x = x + 0.01 * (y - x) * 10.0
        y = y + 0.01 * (x * (28.0 - z) - y)
        z = z + 0.01 * (x * y - 2.5 * z)
        if z > 40.0:
            z = z - 1.0
        x = x + 0.01 * (y - x) * 10.0
        y = y + 0.01 * (x * (28.0 - z) - y)
        z = z + 0.01 * (x * y - 2.5 * z)
        if z > 40.0:
            z = z - 1.0
        k = k + 1
    return x + y + z


CALLS_SCRIPT = """
  def square(x):
    return x * x
  end
  def run_it():
    local total = 0
    local k = 0
    while k < 50000:
      total = (total + square(k % 100)) % 9973
      k = k + 1
    end
    return total
  end
"""


def _square(x: int) -> int:
    return x * x


def _calls() -> int:
    total = k = 0
    while k < 50000:
        total = (total + _square(k % 100)) % 9973
        k = k + 1
    return total


LISTS_SCRIPT = """
  def run_it():
    local q = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    local goal = [1.0, 1.1, 1.2, 1.3, 1.4, 1.5]
    local k = 0
    while k < 20000:
      q = q + (goal - q) * 0.01
      k = k + 1
    end
    return q[5]
  end
"""


def _lists() -> float:
    q = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    goal = [1.0, 1.1, 1.2, 1.3, 1.4, 1.5]
    k = 0
    while k < 20000:
        difference = [a - b for a, b in zip(goal, q, strict=True)]
        step = [a * 0.01 for a in difference]
        q = [a + b for a, b in zip(q, step, strict=True)]
        k = k + 1
    return q[5]


ELEMENTS_SCRIPT = """
  def run_it():
    local q = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    local total = 0.0
    local k = 0
    while k < 100000:
      total = total + q[k % 6] * q[2]
      k = k + 1
    end
    return total
  end
"""


def _elements() -> float:
    q = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    total, k = 0.0, 0
    while k < 100000:
        total = total + q[k % 6] * q[2]
        k = k + 1
    return total


CASES: tuple[tuple[str, str, Callable[[], float]], ...] = (
    ("loop of scalar arithmetic", LOOP_SCRIPT, _loop),
    ("straight-line arithmetic", STRAIGHT_SCRIPT, _straight),
    ("function calls", CALLS_SCRIPT, _calls),
    ("elements of lists", ELEMENTS_SCRIPT, _elements),
    ("arithmetic of 6-vectors", LISTS_SCRIPT, _lists),
)


class _OneFrame:
    """A host whose frame never ends."""

    period_s = 1e6

    def on_label(self, number: int, text: str, option: str, thread: ScriptThread) -> bool:
        return False


def measure() -> Table:
    """Ratios of the best blocks; URScript and Python take turns."""
    rows = [[name, *_ratio(script, python)] for name, script, python in CASES]
    note = (
        f"Best of {BLOCKS} runs each, in turns. The bar: arithmetic within 3 times Python, that of 6-vectors within 2."
    )
    return Table("URScript against plain Python", note, ["what", "URScript", "Python", "ratio"], rows)


def measure_compiling() -> Table:
    """A program as long as the official control script, new to the cache and known to it."""
    size = len(BIG_PROGRAM) / 1000
    cold = _best(lambda: compile_script(BIG_PROGRAM.replace("big", f"big_{next(FRESH)}"), LIBRARY_SET, VERSION))
    warm = _best(lambda: compile_script(BIG_PROGRAM, LIBRARY_SET, VERSION))
    note = f"Parse, check and compile {size:.0f} kB; best of {BLOCKS}. The bar: 150 ms cold, 2 ms warm."
    rows = [["new text", f"{cold * 1e3:.1f} ms"], ["same text again", f"{warm * 1e3:.3f} ms"]]
    return Table("Compiling", note, ["what", "takes"], rows)


def _ratio(script: str, python: Callable[[], float]) -> tuple[str, str, str]:
    program = compile_script(f"def bench():\n{script}\n  result = run_it()\nend\n", LIBRARY_SET, VERSION)
    ours = theirs = float("inf")
    for _ in range(BLOCKS):
        runtime = Runtime(program, _OneFrame())
        ours = min(ours, _seconds(runtime.step))
        _check(runtime, python())
        theirs = min(theirs, _seconds(python))
    return f"{ours * 1e3:.1f} ms", f"{theirs * 1e3:.1f} ms", f"{ours / theirs:.2f}"


def _check(runtime: Runtime, expected: float) -> None:
    """What is compared must be the same computation."""
    if runtime.error is not None or not runtime.finished or runtime.globals["result"] != expected:
        raise AssertionError(f"URScript gave {dict(runtime.globals)} and {runtime.error}, Python {expected}")


def _best(function: Callable[[], Any]) -> float:
    return min(_seconds(function) for _ in range(BLOCKS))


def _seconds(function: Callable[[], Any]) -> float:
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


if __name__ == "__main__":
    sys.stdout.write(f"{measure_compiling().markdown()}\n{measure().markdown()}")
