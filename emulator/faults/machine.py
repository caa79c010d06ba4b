"""Faults of the controller as a whole: its clock and its power."""

from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, ClassVar

from msgspec import Meta

from emulator.faults.fault import Act, Fault, FaultImpossible, Machine, Rate, Share, Site, Strikes, register
from emulator.faults.network import NotNegative


def _rate(site: Site) -> Rate:
    if site.rate is None:
        raise FaultImpossible("this robot's time is driven step by step: nothing in it can be late")
    return site.rate


@register
@dataclass(frozen=True, kw_only=True)
class LateTicks(Fault):
    """Control periods begin ``by_s`` late, one in 1000 by default.

    The ones after it catch up (made_up), or that much time is lost for good. Real time only.
    """

    occasion: ClassVar[str] = "each control period"
    outside: ClassVar[bool] = True
    by_s: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.008
    made_up: bool = True
    probability: Share = 0.001

    def check(self, site: Site) -> None:
        _rate(site)

    def act(self, site: Site, strikes: Strikes) -> Act:
        rate = _rate(site)
        while not strikes.spent:
            if strikes():
                rate.delay_next(self.by_s, made_up=self.made_up)
            yield


@register
@dataclass(frozen=True, kw_only=True)
class ClockDrift(Fault):
    """The controller's clock goes fast by ``share``, or slow if that is negative. Real time only."""

    outside: ClassVar[bool] = True
    share: Annotated[float, Meta(gt=-0.5, le=1.0)] = 0.001

    def check(self, site: Site) -> None:
        _rate(site)

    def claims(self, site: Site) -> set[str]:
        return {"the rate of the clock"}

    def act(self, site: Site, strikes: Strikes) -> Act:
        rate = _rate(site)
        rate.set_drift(self.share)
        try:
            while True:
                yield
        finally:
            rate.set_drift(0.0)


@dataclass(frozen=True, kw_only=True)
class Outage(Fault):
    """The controller is gone. It comes back with a new one's state: uptime 0, no program, arm off where it stood.

    boot_s: how long its robot mode is BOOTING then, its ports open (guess: real ones take about a minute).
    """

    outside: ClassVar[bool] = True
    boot_s: NotNegative = 2.0

    def check(self, site: Site) -> None:
        self._machine(site)

    def claims(self, site: Site) -> set[str]:
        return {"the power of the controller"}

    def act(self, site: Site, strikes: Strikes) -> Act:
        with self._off(self._machine(site), silent=self.silent):
            yield from self.outage(site)

    silent: ClassVar[bool] = False

    @abstractmethod
    def outage(self, site: Site) -> Act:
        """As long as the controller is gone."""

    def _machine(self, site: Site) -> Machine:
        if site.machine is None:
            raise FaultImpossible("nothing here could start the controller again")
        return site.machine

    @contextmanager
    def _off(self, machine: Machine, *, silent: bool) -> Iterator[None]:
        machine.switch_off(silent=silent)
        try:
            yield
        finally:
            machine.switch_on(self.boot_s)


@register
@dataclass(frozen=True, kw_only=True)
class RestartController(Outage):
    """The controller's software ends and starts again: connections end, for ``outage_s`` nobody listens."""

    outage_s: NotNegative = 1.0

    def outage(self, site: Site) -> Act:
        for _ in range(site.periods(self.outage_s) + 1):
            yield


@register
@dataclass(frozen=True, kw_only=True)
class PowerLoss(Outage):
    """The mains are gone while the fault lasts: the arm drops off, ports and connections fall silent without an end.

    With the power, the controller comes back; connections from before are reset then.
    """

    silent: ClassVar[bool] = True

    def outage(self, site: Site) -> Act:
        while True:
            yield
