"""The cost of programs and streams: random, expensive ones, and reproducible processor times.

The emulator does the same work in the same control period every time. So a long period is measured again, and the
minimum of all times is the cost of its work, since other load on the machine affects another period the next time.
`slowness()` compares the machine with the one on which the bounds were measured.
"""

import gc
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from random import Random
from typing import Final

from emulator.commands.requests import ScriptUnit
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from emulator.programs.compiling import LIBRARY_SET, Compiling, Submission
from emulator.workshare import WorkShare
from tests.networks import MemorySockets
from urproto.robots import load_model
from urproto.versions import DEFAULT_VERSION, Series
from urscript import compiler
from urscript.errors import CompileError

LONG: Final = '"' + "x" * 1020 + '"'
LONGER: Final = '"' + "x" * 40_000 + "\u00e9" + '"'
_TRIES: Final = 4
_REFERENCE_S: Final = 0.0125  # of the loop in `slowness`, on the machine where the bounds were measured

_IN_LOOPS: Final = (
    "a = str_cat(s, 1)",
    'a = str_find(l, "y")',
    "a = str_len(l)",
    "a = str_sub(l, 5, 100)",
    "a = str_at(l, 39999)",
    "b = s == t",
    "b = l == u",
    "a = to_str(v)",
    "textmsg(s)",
    "textmsg(v)",
    "varmsg(s, v)",
    'popup("hello", blocking=False)',
    'h = rpc_factory("xmlrpc", "http://10.0.0.1:80/RPC2")',
    'socket_open("10.0.0.1", 80, "x")\n    socket_close("x")',
    'socket_send_string(s, "y")',
    "v = v + 1",
    "v = [1, 2, 3] * 2",
    "m = m * m",
    "m = inv(m)",
    "w = get_forward_kin([1, 1, 1, 1, 1, 1])",
    "w = pose_trans(w, p[0.1, 0, 0, 0, 0, 0])",
    "c = get_inverse_kin_has_solution(w)",
    "x = get_actual_tcp_speed()",
    "set_digital_out(1, True)",
    "i = i + 1",
    "k = run beside()\n    kill k",
    "i = deep(150)",
    "sync()",
)

_SOURCES: Final[dict[str, Callable[[int], str]]] = {
    "assignments that follow from each other": lambda n: (
        "".join(f"  a{i} = a{i + 1}\n" for i in range(n)) + f"  a{n} = 1\n"
    ),
    "functions that call each other": lambda n: (
        "".join(f"  def f{i}():\n    return f{i + 1}() + f{i + 1}()\n  end\n" for i in range(n // 4))
        + f"  def f{n // 4}():\n    return 1\n  end\n"
    ),
    "a list": lambda n: f"  a = [{', '.join(['1.5'] * min(n, 10_000))}]\n",
    "a list of lists": lambda n: f"  a = [{', '.join(['[1, 2, 3]'] * min(n // 4, 3000))}]\n",
    "a comment": lambda n: "  # " + "x" * (50 * n) + "\n",
    "comments": lambda n: "  # x\n" * n,
    "blanks": lambda n: " " * (50 * n) + "\n",
    "lines": lambda n: "\n" * (10 * n),
    "a name": lambda n: "  " + "x" * (10 * n) + " = 1\n",
    "a number": lambda n: "  a = " + "1" * (10 * n) + "\n",
    "a string": lambda n: '  a = "' + "x" * (10 * n) + '"\n',
    "unknown names": lambda n: "".join(f"  a = b{i}\n" for i in range(n)),
    "unknown functions": lambda n: "".join(f"  b{i}()\n" for i in range(n)),
    "calls that fail": lambda n: "".join(f"  movej({i}, 2, 3, 4, 5, 6, 7)\n" for i in range(n)),
    "an error at the end": lambda n: "  a = 1\n" * n + "  a = *\n",
    "no end": lambda n: "  if True:\n" * 3 + "    a = 1\n" * n,
    "a list of texts": lambda n: "  a = [" + ", ".join(['"x"'] * min(n, 10_000)) + "]\n",
    "a long def": lambda n: "  def f(x):\n    y = x\n" + "    y = y + x * 2\n" * n + "    return y\n  end\n  f(1)\n",
    "returns": lambda n: (
        "  def f(x):\n"
        + "".join(f"    if x == {i}:\n      return {i}\n    end\n" for i in range(n // 2))
        + "  end\n  f(-1)\n"
    ),
    "ways out of loops": lambda n: (
        "  thread f():\n    x = 0\n    while True:\n"
        + "".join(
            f"      if x == {i}:\n        break\n      end\n      x = x + 1\n      continue\n" for i in range(n // 3)
        )
        + "    end\n  end\n  run f()\n"
    ),
    "loops in a branch": lambda n: (
        "  k = 0\n  if k < 3:\n" + "    while k < 5:\n      k = k + 1\n    end\n" * (n // 3) + "  end\n"
    ),
    "a long call": lambda n: (
        "  def f("
        + ", ".join(f"x{i}" for i in range(400))
        + "):\n    return 1\n  end\n"
        + ("  a = f(" + ", ".join(["[1, 2]"] * 300 + ["3"] * 100) + ")\n") * (n // 1000)
    ),
    "unknown names like others": lambda n: (
        "".join(f"  value_{i} = 0\n" for i in range(min(n, 1900))) + "  a = valu_x1\n" + "  b = valu_x2\n"
    ),
    "branches": lambda n: (
        "  a = 0\n  if a == -1:\n" + "".join(f"  elif a == {i}:\n    b = {i}\n" for i in range(n // 20)) + "  end\n"
    ),
    "labels": lambda n: "".join(f'  $ {i} "x"\n' for i in range(n)),
    "threads": lambda n: "".join(f"  thread t{i}():\n    sync()\n  end\n" for i in range(n // 4)),
    "sums": lambda n: ("  a = " + " + ".join(["1"] * 140) + "\n") * (n // 100),
    "depth": lambda n: ("  a = " + "(" * 70 + "1" + ")" * 70 + "\n") * (n // 100),
}


@cache
def slowness() -> float:
    """The factor by which this machine is slower than the reference machine, at least 1."""

    def once() -> float:
        began = time.thread_time()
        total = 0
        for number in range(200_000):
            total += number % 7
        return time.thread_time() - began

    return max(1.0, min(once() for _ in range(7)) / _REFERENCE_S)


def busy_program(chance: Random) -> str:
    """A program that repeats some expensive operations."""
    body = "".join(f"    {chance.choice(_IN_LOOPS)}\n" for _ in range(chance.randrange(1, 4)))
    return f"""def busy():
  s = {LONG}
  t = str_cat(str_sub(s, 0, 1019), "x")
  l = {LONGER}
  u = {LONGER.replace("xx", "xy", 1)}
  a = ""
  v = [{", ".join(["1.5"] * chance.choice((3, 40, 400)))}]
  m = [[2, 0, 0], [0, 2, 0], [0, 0, 2]]
  w = p[0.3, 0.2, 0.4, 0, 1, 2]
  i = 0
  thread beside():
    sync()
  end
  def deep(n):
    if n > 0:
      return deep(n - 1)
    end
    return 1
  end
  while True:
{body}  end
end
"""


def long_source(chance: Random, size: int) -> str:
    """A text with some long parts that may be hard to compile."""
    parts = [_SOURCES[chance.choice(sorted(_SOURCES))](size) for _ in range(chance.randrange(1, 3))]
    return "def long():\n" + "".join(parts) + "end\n"


def source(name: str, size: int) -> str:
    return "def long():\n" + _SOURCES[name](size) + "end\n"


SOURCES: Final = tuple(_SOURCES)


def steps_of(text: str) -> list[int]:
    """The work of each step of compiling a text, up to the first error [units of `urscript.work`]."""
    compiler._cache = compiler.CompiledPrograms()
    steps, work = compiler.compile_steps(text, LIBRARY_SET, DEFAULT_VERSION[Series.E]), []
    with suppress(CompileError):
        work.extend(steps)
    return work


def objects_left_by(text: str) -> tuple[int, int]:
    """Number of objects that compiling a text leaves for the garbage collector, and how many of them are garbage."""
    compiler._cache = compiler.CompiledPrograms()
    share = WorkShare(Series.CB3.period_s)
    compiling = Compiling(share)
    compiling.add(Submission(text, DEFAULT_VERSION[Series.E]))
    gc.collect()
    gc.freeze()
    try:
        while compiling.next() is None:
            share.new_period()
        gc.disable()
        left = len(gc.get_objects())
        return left, gc.collect()
    finally:
        gc.enable()
        gc.unfreeze()


def tick_times(text: str, periods: int, model: str) -> list[float]:
    """Processor time of each control period after a text was sent [s]."""
    compiler._cache = compiler.CompiledPrograms()
    controller = Controller(ControllerConfig(model=load_model(model), running=True))
    controller.programs.socket_backend = MemorySockets(("10.0.0.1", 80))
    for _ in range(5):
        controller.tick()
    times = []
    gc.collect()
    gc.freeze()  # as in the emulator's start
    try:
        controller.post(ScriptUnit(text, "block"))
        for _ in range(periods):
            began = time.thread_time()
            controller.tick()
            times.append(time.thread_time() - began)
    finally:
        gc.unfreeze()
    return times


def longest_tick(text: str, periods: int, model: str, bound_s: float, after: int = 0) -> tuple[float, int]:
    """The longest control period after some [s], and its number; those beyond the bound are measured again."""
    least = tick_times(text, periods, model)[after:]
    for _ in range(_TRIES - 1):
        if max(least) <= bound_s:
            break
        least = list(map(min, least, tick_times(text, periods, model)[after:]))
    longest = max(least)
    return longest, after + least.index(longest)


def min_time(work: Callable[[], object]) -> float:
    """Processor time of some work [s]: the minimum of several measurements."""
    times = []
    for _ in range(_TRIES):
        began = time.thread_time()
        work()
        times.append(time.thread_time() - began)
    return min(times)
