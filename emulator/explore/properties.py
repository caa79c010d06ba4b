"""What must hold in every run, in signal temporal logic: always, eventually, after, until, with bounds in time.

    never stops:   {always: "safety_mode == NORMAL"}
    slow at part:  {always: "actual_TCP_speed[0] < 0.25", when: "output.0 == true"}
    finishes:      {eventually: "runtime_state == STOPPED", within: 20}
    reacts:        {after: "input.0 == true", eventually: "output.1 == true", within: 0.5}
    holds part:    {always: "output.0 == true", until: "var.placed == true"}

A monitor sees every control period. Its margin says how far the property was from being broken: the least margin of
its condition, or the share of the time that was left.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

from emulator.control.conditions import Condition, Outside, parse_condition
from emulator.explore.choices import PlanError
from emulator.snapshot import Snapshot
from urproto.text import unknown

_READY: Final[dict[str, dict[str, Any]]] = {
    "no_unexpected_stop": {"always": "safety.unexpected == false"},
    "ends_at_rest": {"finally": "arm.moving == false"},
    "program_ends": {"finally": "program.running == false"},
    "no_exception": {"always": "program.exceptions == 0"},
    "no_protective_stop": {"always": "safety_mode != PROTECTIVE_STOP"},
}
_LIMITS: Final = {  # ready-made, with a number
    "tool_speed": "tool.speed <= {}",
    "tool_force": "tcp_force_scalar <= {}",
}
_TIMES: Final = {  # ready-made, with a time in seconds
    "recovers": {"after": "choices.over == true", "eventually": "program.going_on == true"},
    "every_wait_ends": {"after": "program.waits == true", "eventually": "program.waits == false"},
}
_KEYS: Final = ("always", "when", "until", "eventually", "within", "after", "finally")


class Monitor(Protocol):
    """Watches one property. broken: why and when, once it is. margin: how far it was from that; less is nearer."""

    broken: str
    margin: float

    def look(self, snapshot: Snapshot, time_s: float) -> None:
        """A control period is over."""

    def end(self, snapshot: Snapshot, time_s: float) -> None:
        """The run is over."""


@dataclass
class Always:
    """A condition holds: whenever another one does, and until a third one does for the first time."""

    condition: Condition
    when: Condition | None = None
    until: Condition | None = None
    broken: str = ""
    margin: float = math.inf
    over: bool = False

    def look(self, snapshot: Snapshot, time_s: float) -> None:
        if self.broken or self.over:
            return
        if self.until is not None and self.until(snapshot):
            self.over = True
        elif self.when is None or self.when(snapshot):
            self.margin = min(self.margin, self.condition.margin(snapshot))
            if not self.condition(snapshot):
                self.broken = f"not {self.condition.text} at {time_s:.3f} s"

    def end(self, snapshot: Snapshot, time_s: float) -> None:
        if self.until is not None and not (self.over or self.broken):
            self.broken = f"not {self.until.text} by the end"


@dataclass
class Eventually:
    """A condition becomes true within a time [s]: of the start, or of each moment when another one becomes true."""

    condition: Condition
    within_s: float
    after: Condition | None = None
    broken: str = ""
    margin: float = math.inf
    since_s: float | None = None
    _before: bool = False

    def __post_init__(self) -> None:
        if self.after is None:
            self.since_s = 0.0

    def look(self, snapshot: Snapshot, time_s: float) -> None:
        if self.broken:
            return
        if self.after is not None:
            now = self.after(snapshot)
            if now and not self._before and self.since_s is None:
                self.since_s = time_s
            self._before = now
        if self.since_s is None:
            return
        waited_s = time_s - self.since_s
        if waited_s > self.within_s:
            self.broken = f"not {self.condition.text} within {self.within_s:g} s of {self.since_s:.3f} s"
            self.margin = 0.0
        elif self.condition(snapshot):
            self.margin = min(self.margin, 1.0 - waited_s / self.within_s)
            self.since_s = None

    def end(self, snapshot: Snapshot, time_s: float) -> None:
        """Whatever is still waited for may yet come."""


@dataclass
class Finally:
    """A condition holds at the end of the run."""

    condition: Condition
    broken: str = ""
    margin: float = math.inf

    def look(self, snapshot: Snapshot, time_s: float) -> None: ...

    def end(self, snapshot: Snapshot, time_s: float) -> None:
        self.margin = self.condition.margin(snapshot)
        if not self.condition(snapshot):
            self.broken = f"not {self.condition.text} at the end, after {time_s:.3f} s"


@dataclass(frozen=True)
class Property:
    """A property by its name. entry: as in the plan."""

    name: str
    entry: Mapping[str, Any] = field(hash=False)

    def monitor(self, outside: Outside) -> Monitor:
        """A monitor for one run. Raises PlanError."""
        entry = dict(self.entry)
        if wrong := sorted(set(entry) - set(_KEYS)):
            raise PlanError(f"{self.name}: {unknown('word', wrong[0], _KEYS)}")
        try:
            read = {
                key: parse_condition(str(entry[key]), outside)
                for key in ("always", "when", "until", "eventually", "after", "finally")
                if key in entry
            }
            if set(entry) <= {"always", "when", "until"} and "always" in entry:
                return Always(read["always"], read.get("when"), read.get("until"))
            if set(entry) <= {"eventually", "within", "after"} and {"eventually", "within"} <= set(entry):
                return Eventually(read["eventually"], float(entry["within"]), read.get("after"))
            if set(entry) == {"finally"}:
                return Finally(read["finally"])
        except (ValueError, TypeError) as error:
            raise PlanError(f"{self.name}: {error}") from error
        raise PlanError(f"{self.name}: write always (when, until), eventually and within (after), or finally")


def parse_property(name: str, entry: Any) -> Property:
    """The property that an entry of the plan describes: of its own, or ready-made. Raises PlanError."""
    if isinstance(entry, Mapping):
        return Property(name, entry)
    if name in _READY and entry is True:
        return Property(name, _READY[name])
    if isinstance(entry, int | float) and not isinstance(entry, bool) and entry > 0:
        if name in _LIMITS:
            return Property(name, {"always": _LIMITS[name].format(entry)})
        if name in _TIMES:
            return Property(name, {**_TIMES[name], "within": entry})
    ready = ", ".join([f"{known}: true" for known in _READY] + [f"{known}: NUMBER" for known in (*_LIMITS, *_TIMES)])
    raise PlanError(f"{name}: write {{always: CONDITION}} or the like, or one of the ready-made properties: {ready}")
