"""A profile of robot time by line.

Robot time passes only between control periods, so what each thread executes at the end of a period is not a sample but
where it spends the time.
"""

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from emulator.builtins.host import ProgramHost
from urscript.scripttest.program import Place, TestProgram

Frame: TypeAlias = tuple[str, str, int]
"""Function, file and line."""

_PIECE: Final = re.compile(r"p\d+_(?=\w)")
_BODY: Final = "main"
_SCHEMA: Final = "https://www.speedscope.app/file-format-schema.json"
_SHOWN: Final = 10  # lines in the table


@dataclass
class ThreadProfile:
    """The stacks of one thread one after the other, outermost function first, and how long each lasted [s]."""

    stacks: list[tuple[Frame, ...]] = field(default_factory=list)
    durations_s: list[float] = field(default_factory=list)

    def add(self, stack: tuple[Frame, ...], duration_s: float) -> None:
        """The thread was there for this time."""
        if self.stacks and self.stacks[-1] == stack:
            self.durations_s[-1] += duration_s
        else:
            self.stacks.append(stack)
            self.durations_s.append(duration_s)


class Profiler:
    """Collects the profiles of the threads of a run, by their names."""

    def __init__(self, program: TestProgram) -> None:
        self.threads: dict[str, ThreadProfile] = {}
        self._program = program
        self._functions: dict[str, str] = {}

    def sample(self, host: ProgramHost | None) -> None:
        """Call after each control period."""
        if host is None:
            return
        runtime = host.runtime
        self._functions = self._functions or {plan.symbol: name for name, plan in runtime.program.functions.items()}
        for thread in runtime.threads:
            places = [(symbol, self._program.place(line)) for symbol, line in thread.stack]
            stack = tuple(self._frame(symbol, place) for symbol, place in places if place is not None)
            if stack:
                self.threads.setdefault(thread.name, ThreadProfile()).add(stack, host.period_s)

    def _frame(self, symbol: str, place: Place) -> Frame:
        symbol = symbol if symbol in self._functions else _PIECE.sub("", symbol)
        return self._functions.get(symbol, _BODY), str(place.path), place.line


Profiles: TypeAlias = Mapping[str, ThreadProfile]
"""The profile of each thread, by the test's title and the thread's name."""


def profile_table(profiles: Profiles) -> str:
    """The lines with the most robot time of their own."""
    times: Counter[Frame] = Counter()
    for profile in profiles.values():
        for stack, duration_s in zip(profile.stacks, profile.durations_s, strict=True):
            times[stack[-1]] += duration_s  # type: ignore[assignment]  # a counter of seconds
    rows = [f"{seconds:10.3f} s  {file}:{line} {name}" for (name, file, line), seconds in times.most_common(_SHOWN)]
    return "\n".join(["robot time  line", *rows])


def speedscope(profiles: Profiles) -> str:
    """The profiles in the format of speedscope.app."""
    frames: dict[Frame, int] = {}

    def samples(stacks: Sequence[tuple[Frame, ...]]) -> list[list[int]]:
        return [[frames.setdefault(frame, len(frames)) for frame in stack] for stack in stacks]

    shown = [
        {
            "type": "sampled",
            "name": title,
            "unit": "seconds",
            "startValue": 0,
            "endValue": sum(profile.durations_s),
            "samples": samples(profile.stacks),
            "weights": profile.durations_s,
        }
        for title, profile in profiles.items()
    ]
    shared = [{"name": f"{name}:{line}", "file": file, "line": line} for name, file, line in frames]
    return json.dumps({"$schema": _SCHEMA, "shared": {"frames": shared}, "profiles": shown})
