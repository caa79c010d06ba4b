"""Carries faults out: begins, continues and ends each in its time.

It takes one step at the beginning of each control period; without a fault that waits or is in force it is not called.
"""

import logging
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Literal

from emulator.faults.catalogue import checked, describe
from emulator.faults.fault import Act, Fault, FaultError, FaultImpossibleError, Machine, Rate, Site, Strikes
from emulator.servers.port import Port

if TYPE_CHECKING:
    from emulator.controller import Controller


_MAX_FAULTS: Final = 100  # faults at a time (guess), to limit the work in a control period
_REMEMBERED: Final = 100  # faults that are over and still listed

_logger = logging.getLogger(__name__)


@dataclass
class _Entry:
    number: int
    fault: Fault
    strikes: Strikes
    begins: int  # in control periods, as the injector counts them
    ends: int | None
    act: Act | None = None
    state: Literal["waiting", "in force", "over"] = "waiting"
    problem: str = ""
    claims: set[str] = field(default_factory=set)

    def begin(self, site: Site) -> None:
        """Raises FaultImpossibleError."""
        self.fault.check(site)
        self.state = "in force"
        if not self.fault.occasion and not self.strikes.count:
            self.strikes.count = 1
        self.act = self.fault.act(site, self.strikes)
        self.step()

    def step(self) -> None:
        assert self.act is not None
        try:
            next(self.act)
        except StopIteration:
            self.act, self.state = None, "over"

    def suspend(self) -> None:
        """Undo what the fault did, until it begins again."""
        act, self.act = self.act, None
        if act is not None:
            act.close()

    def end(self) -> None:
        """End the fault for good."""
        self.state = "over"
        self.suspend()


class FaultInjector:
    """The faults of one robot. Faults that need servers, clock or machine are impossible without them."""

    def __init__(
        self,
        controller: "Controller",
        servers: Mapping[str, Port] | None = None,
        rate: Rate | None = None,
        machine: Machine | None = None,
    ) -> None:
        self.site = Site(controller, servers or {}, rate, machine)
        self._now = 0  # control periods in which there were faults
        self._number = 0
        self._up = True  # whether the controller is on
        self._present: list[_Entry] = []
        self._over: deque[_Entry] = deque(maxlen=_REMEMBERED)

    def inject(self, fault: Fault) -> int:
        """Inject a fault and return its number. Raises FaultError or FaultImpossibleError, without any effect."""
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

    def skip(self, count: int = 1) -> None:
        """Count faults that are not injected here, so that later ones have their numbers."""
        self._number += count

    def take_over(self, others: "FaultInjector") -> None:
        """Go on with the faults of another injector, and with its controller, in place of these."""
        self.clear_all()
        others._unhook()
        site, mine = others.site, self.site
        site.servers, site.rate, site.machine = mine.servers, mine.rate, mine.machine
        self.site, self._now, self._number, self._up = site, others._now, others._number, others._up
        self._present, self._over = others._present, others._over
        self._tidy()

    def clear(self, number: int) -> bool:
        """End a fault, or cancel one that waits; False if it is over, or never existed."""
        found = [entry for entry in self._present if entry.number == number]
        for entry in found:
            self._end(entry)
        self._tidy()
        return bool(found)

    def clear_all(self) -> None:
        for entry in reversed(self._present):
            self._end(entry)
        self._tidy()

    def listing(self) -> list[dict[str, Any]]:
        """List every fault, also those that are over: id, kind, arguments, state, number of strikes."""
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
        """Advance all faults, at the beginning of a control period."""
        self._now += 1
        for entry in tuple(self._present):
            try:
                self._step(entry)
            except FaultImpossibleError as error:
                self._fail(entry, str(error))
            except Exception as error:
                _logger.exception("fault %d (%s) failed", entry.number, entry.fault.kind)
                self._fail(entry, f"{type(error).__name__}: {error}")
        self._tidy()

    # a controller that is switched off and on

    def controller_gone(self) -> None:
        """Undo what faults did to a controller that is being switched off."""
        for entry in reversed(self._present):
            if not entry.fault.outside:
                entry.suspend()
        self._unhook()
        self._up = False

    def controller_back(self, controller: "Controller") -> None:
        """Begin those faults again on its successor."""
        self.site.controller, self._up = controller, True
        for entry in tuple(self._present):
            if entry.state == "in force" and entry.act is None:
                try:
                    self._begin(entry)
                except FaultImpossibleError as error:
                    self._fail(entry, str(error))
        self._tidy()

    # helpers

    def _reaches(self, fault: Fault) -> bool:
        """Whether the part of the robot on which the fault acts is on."""
        return self._up or fault.outside

    def _times(self, fault: Fault) -> tuple[int, int | None]:
        """First and last period, by the injector's count."""
        now_s = self.site.controller.time_s
        for name, moment in (("at", fault.at), ("until", fault.until)):
            if moment is not None and moment < now_s:
                raise FaultError(f"{name}: an uptime of {moment:g} s has passed, it is now {now_s:.3f} s")
        wait_s = fault.at - now_s if fault.at is not None else fault.after or 0.0
        begins = self._now + self.site.periods(wait_s)
        first = max(begins, self._now + 1)  # period that it shows in
        if fault.until is not None:
            ends = self._now + self.site.periods(fault.until - now_s)
            if ends <= first:
                raise FaultError(f"until: the fault would end at {fault.until:g} s, before it begins")
            return begins, ends
        return begins, None if fault.lasting is None else first + max(1, self.site.periods(fault.lasting))

    def _check_room(self, claims: set[str]) -> None:
        if len(self._present) >= _MAX_FAULTS:
            raise FaultError(f"{_MAX_FAULTS} faults wait or are in force, the maximum: clear some of them")
        for entry in self._present:
            if common := claims & entry.claims:
                raise FaultError(
                    f"fault {entry.number} ({entry.fault.kind}) occupies {', '.join(sorted(common))}: clear it first"
                )

    def _step(self, entry: _Entry) -> None:
        if entry.state == "waiting" and self._now >= entry.begins and self._reaches(entry.fault):
            self._begin(entry)
        elif entry.state == "in force" and entry.ends is not None and self._now >= entry.ends:
            entry.end()
        elif entry.act is not None:
            entry.step()

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
        """Move faults that are over to the history; hook into control periods only while others are left."""
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
