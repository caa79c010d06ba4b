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
from urscript_programs import CASES

from emulator.builtins import LIBRARIES
from urproto.versions import DEFAULT_VERSION, Series
from urscript import LibrarySet, Runtime, ScriptThread, compile_script

BLOCKS = 9
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


class _OneFrame:
    """A host whose frame lasts until the program ends.

    Its budget is nevertheless a number that Python computes with in one step, like that of a controller's frame.
    """

    period_s = 100.0

    def on_label(self, number: int, text: str, option: str, thread: ScriptThread) -> bool:
        return False


def measure() -> Table:
    """Ratios of the best blocks; the program, its statements outside a def, and Python take turns."""
    rows = [[name, *_ratios(script, python)] for name, script, python in CASES]
    note = f"CPU time: best of {BLOCKS} alternating runs each. Top level: the same statements outside a def."
    columns = ["program", "URScript", "Python", "ratio", "top level", "against the def"]
    return Table("URScript against plain Python", note, columns, rows)


def measure_compiling() -> Table:
    """A program as long as the official control script, new to the cache and known to it."""
    size = len(BIG_PROGRAM) / 1000
    cold = _best(lambda: compile_script(BIG_PROGRAM.replace("big", f"big_{next(FRESH)}"), LIBRARY_SET, VERSION))
    warm = _best(lambda: compile_script(BIG_PROGRAM, LIBRARY_SET, VERSION))
    note = (
        f"Parse, check and compile {size:.0f} kB: best of {BLOCKS}. Requirement: 150 ms for a new text, 2 ms for a "
        "known one."
    )
    rows = [["new", f"{cold * 1e3:.1f} ms"], ["known", f"{warm * 1e3:.3f} ms"]]
    return Table("Compiling", note, ["text", "time"], rows)


def _ratios(script: str, python: Callable[[], float]) -> list[str]:
    texts = [f"{script}\n  result = run_it()", *_at_top_level(script)]
    programs = [compile_script(f"def bench():\n{text}\nend\n", LIBRARY_SET, VERSION) for text in texts]
    ours, theirs = [float("inf")] * len(programs), float("inf")
    for _ in range(BLOCKS):
        for number, program in enumerate(programs):
            runtime = Runtime(program, _OneFrame())
            ours[number] = min(ours[number], _seconds(runtime.step))
            _check(runtime, python())
        theirs = min(theirs, _seconds(python))
    times = [f"{seconds * 1e3:.3f} ms" for seconds in (ours[0], theirs, *ours[1:])]
    return [*times[:2], f"{ours[0] / theirs:.2f}", *times[2:], *(f"{time / ours[0]:.2f}" for time in ours[1:])]


def _at_top_level(script: str) -> list[str]:
    """The statements of ``run_it`` outside it; nothing if there are other functions."""
    head, *body, result, _ = script.strip().splitlines()
    if head != "def run_it():" or "  def " in script[3:]:
        return []
    statements = "\n".join(body).replace("local ", "")
    return [f"{statements}\n    result = {result.replace('return ', '').strip()}"]


def _check(runtime: Runtime, expected: float) -> None:
    """What is compared must be the same computation."""
    if runtime.error is not None or not runtime.finished or runtime.globals["result"] != expected:
        raise AssertionError(f"URScript gave {dict(runtime.globals)} and {runtime.error}, Python {expected}")


def _best(function: Callable[[], Any]) -> float:
    return min(_seconds(function) for _ in range(BLOCKS))


def _seconds(function: Callable[[], Any]) -> float:
    began = time.thread_time()  # not the time in which others had the processor
    function()
    return time.thread_time() - began


if __name__ == "__main__":
    sys.stdout.write(f"{measure_compiling().markdown()}\n{measure().markdown()}")
