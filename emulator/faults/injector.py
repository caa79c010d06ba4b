"""Faults in force: when each begins, strikes and ends.

One step a control period, at its beginning. Without a fault that waits or is in force nothing is called.
"""

import logging
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Literal

from emulator.faults.catalogue import checked, describe
from emulator.faults.fault import Act, Fault, FaultError, FaultImpossible, Machine, Rate, Site, Strikes
from emulator.servers.port import PortServer

if TYPE_CHECKING:
    from emulator.controller import Controller


_MOST: Final = 100  # faults at a time (guess): the work of a control period is bounded
_REMEMBERED: Final = 100  # faults that are over

_logger = logging.getLogger(__name__)


@dataclass
class _Entry:
    number: int
    fault: Fault
    strikes: Strikes
    begins: int  # period of the injector
    ends: int | None
    act: Act | None = None
    state: Literal["waiting", "in force", "over"] = "waiting"
    problem: str = ""
    claims: set[str] = field(default_factory=set)

    def begin(self, site: Site) -> None:
        """Raises FaultImpossible."""
        self.fault.check(site)
        self.state = "in force"
        if not self.fault.occasion and not self.strikes.count:
            self.strikes.count = 1
        self.act = self.fault.act(site, self.strikes)
        self.go_on()

    def go_on(self) -> None:
        """One control period."""
        assert self.act is not None
        try:
            next(self.act)
        except StopIteration:
            self.act, self.state = None, "over"

    def suspend(self) -> None:
        """Take back what it did."""
        act, self.act = self.act, None
        if act is not None:
            act.close()

    def end(self) -> None:
        """For good."""
        self.state = "over"
        self.suspend()


class FaultInjector:
    """The faults of one robot. What it lacks of servers, clock and machine, it has no faults of."""

    def __init__(
        self,
        controller: "Controller",
        servers: Mapping[str, PortServer] | None = None,
        rate: Rate | None = None,
        machine: Machine | None = None,
    ) -> None:
        self.site = Site(controller, servers or {}, rate, machine)
        self._now = 0  # control periods in which there were faults
        self._number = 0
        self._up = True  # the controller is there
        self._present: list[_Entry] = []
        self._over: deque[_Entry] = deque(maxlen=_REMEMBERED)

    def inject(self, fault: Fault) -> int:
        """Let a fault happen; its number. Raises FaultError, FaultImpossible; then nothing happened."""
        checked(fault)
        fault.check(self.site)
        begins, ends = self._times(fault)
        claims = fault.claims(self.site)
        self._check_room(claims)
        entry = _Entry(self._number + 1, fault, Strikes(fault, self._number + 1), begins, ends, claims=claims)
        if begins <= self._now and self._reaches(fault):
            self._begin(entry)
        self._number += 1
        self._present.append(entry)
        self._tidy()
        return entry.number

    def clear(self, number: int) -> bool:
        """End a fault, or forget one that waits; False when it is over, or never was."""
        found = [entry for entry in self._present if entry.number == number]
        for entry in found:
            self._end(entry)
        self._tidy()
        return bool(found)

    def clear_all(self) -> None:
        """End every fault, the latest first."""
        for entry in reversed(self._present):
            self._end(entry)
        self._tidy()

    def listing(self) -> list[dict[str, Any]]:
        """Every fault, those that are over too: id, kind, arguments, state, how often it struck."""
        return [
            {
                "id": entry.number,
                "kind": entry.fault.kind,
                "arguments": describe(entry.fault),
                "state": entry.state,
                "strikes": entry.strikes.count,
                "problem": entry.problem,
            }
            for entry in sorted((*self._over, *self._present), key=lambda entry: entry.number)
        ]

    def step(self) -> None:
        """A control period begins."""
        self._now += 1
        for entry in tuple(self._present):
            try:
                self._step(entry)
            except FaultImpossible as error:
                self._fail(entry, str(error))
            except Exception as error:
                _logger.exception("fault %d (%s) failed", entry.number, entry.fault.kind)
                self._fail(entry, f"{type(error).__name__}: {error}")
        self._tidy()

    # a controller that goes and comes

    def controller_gone(self) -> None:
        """Take back everything done to a controller that is being switched off."""
        for entry in reversed(self._present):
            if not entry.fault.outside:
                entry.suspend()
        self._unhook()
        self._up = False

    def controller_back(self, controller: "Controller") -> None:
        """Do it to its successor."""
        self.site.controller, self._up = controller, True
        for entry in tuple(self._present):
            if entry.state == "in force" and entry.act is None:
                try:
                    self._begin(entry)
                except FaultImpossible as error:
                    self._fail(entry, str(error))
        self._tidy()

    # helpers

    def _reaches(self, fault: Fault) -> bool:
        """Whether what it acts on is there."""
        return self._up or fault.outside

    def _times(self, fault: Fault) -> tuple[int, int | None]:
        """First and last period, by the injector's count."""
        now_s = self.site.controller.time_s
        for name, moment in (("at", fault.at), ("until", fault.until)):
            if moment is not None and moment < now_s:
                raise FaultError(f"{name}: {moment:g} s of uptime are over, it is {now_s:.3f} s")
        wait_s = fault.at - now_s if fault.at is not None else fault.after or 0.0
        begins = self._now + self.site.periods(wait_s)
        first = max(begins, self._now + 1)  # period that it shows in
        if fault.until is not None:
            ends = self._now + self.site.periods(fault.until - now_s)
            if ends <= first:
                raise FaultError(f"until: it would end at {fault.until:g} s, before it begins")
            return begins, ends
        return begins, None if fault.lasting is None else first + max(1, self.site.periods(fault.lasting))

    def _check_room(self, claims: set[str]) -> None:
        if len(self._present) >= _MOST:
            raise FaultError(f"{_MOST} faults wait or are in force: clear some")
        for entry in self._present:
            if common := claims & entry.claims:
                raise FaultError(
                    f"fault {entry.number} ({entry.fault.kind}) has {', '.join(sorted(common))}: clear it first"
                )

    def _step(self, entry: _Entry) -> None:
        if entry.state == "waiting" and self._now >= entry.begins and self._reaches(entry.fault):
            self._begin(entry)
        elif entry.state == "in force" and entry.ends is not None and self._now >= entry.ends:
            entry.end()
        elif entry.act is not None:
            entry.go_on()

    def _begin(self, entry: _Entry) -> None:
        entry.begin(self.site)
        self.site.controller.messages.trace("fault %d begins: %s", entry.number, entry.fault)

    def _end(self, entry: _Entry) -> None:
        try:
            entry.end()
        except Exception as error:
            _logger.exception("ending fault %d (%s) failed", entry.number, entry.fault.kind)
            entry.problem = f"{type(error).__name__}: {error}"

    def _fail(self, entry: _Entry, problem: str) -> None:
        entry.problem = problem
        self._end(entry)

    def _tidy(self) -> None:
        """Remember what is over, and be called only while something is not."""
        over = [entry for entry in self._present if entry.state == "over"]
        for entry in over:
            self.site.controller.messages.trace("fault %d is over: %s", entry.number, entry.fault.kind)
        self._over += over
        self._present = [entry for entry in self._present if entry.state != "over"]
        if not self._present:
            self._unhook()
        elif self.step not in self.site.controller.on_tick:
            self.site.controller.on_tick.append(self.step)

    def _unhook(self) -> None:
        hooks = self.site.controller.on_tick
        if self.step in hooks:
            hooks.remove(self.step)
