"""Faults of the controller as a whole: its clock and its power."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, ClassVar

from msgspec import Meta

from emulator.faults.fault import (
    Act,
    Fault,
    FaultImpossibleError,
    Machine,
    Rate,
    Share,
    Site,
    Strikes,
    register,
    until_ended,
)
from emulator.faults.network import NotNegative
from emulator.lifecycle.power import PowerEvent


def _rate(site: Site) -> Rate:
    if site.rate is None:
        raise FaultImpossibleError("the time of this robot advances step by step: no control period can be late")
    return site.rate


@register
class LateTicks(Fault):
    """Control periods begin ``by_s`` late, one in 1000 by default. In real time only.

    The following ones catch up (made_up), or that time is lost for good.
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
class ClockDrift(Fault):
    """The controller's clock is fast by the fraction ``share``, or slow if that is negative. In real time only."""

    outside: ClassVar[bool] = True
    share: Annotated[float, Meta(gt=-0.5, le=1.0)] = 0.001

    def check(self, site: Site) -> None:
        _rate(site)

    def claims(self, site: Site) -> set[str]:
        return {"the rate of the clock"}

    def act(self, site: Site, strikes: Strikes) -> Act:
        rate = _rate(site)
        rate.set_drift(self.share)
        yield from until_ended(lambda: rate.set_drift(0.0))


@register
class UnconfirmedSafetySetup(Fault):
    """The safety setup is not confirmed, as at the first start of a controller.

    Robot mode CONFIRM_SAFETY while the arm is off; RTDE tells each client that it sends no data, and refuses to start.
    It ends when the fault is cleared, by the verb confirm_safety_setup, or by the text command confirm user safety
    parameters.
    """

    def claims(self, site: Site) -> set[str]:
        return {"the confirmation of the safety setup"}

    def act(self, site: Site, strikes: Strikes) -> Act:
        controller = site.controller
        controller.power.revoke_confirmation()
        try:
            while not controller.power.safety_confirmed:
                yield
        finally:
            controller.power.handle(PowerEvent.CONFIRM)


@dataclass(frozen=True, kw_only=True)
class Outage(Fault):
    """The controller is off. It returns with the state of a new one: uptime 0, no program, the arm off where it stood.

    boot_s: how long the robot mode is then BOOTING, with open ports (guess: real ones take about a minute).
    """

    outside: ClassVar[bool] = True
    boot_s: NotNegative = 2.0

    def check(self, site: Site) -> None:
        self._machine(site)

    def claims(self, site: Site) -> set[str]:
        return {"the power of the controller"}

    def act(self, site: Site, strikes: Strikes) -> Act:
        machine = self._machine(site)
        machine.switch_off(silent=self.silent)
        try:
            yield from self.outage(site)
        finally:
            machine.switch_on(self.boot_s)

    silent: ClassVar[bool] = False

    @abstractmethod
    def outage(self, site: Site) -> Act:
        """Wait as long as the controller is off."""

    def _machine(self, site: Site) -> Machine:
        if site.machine is None:
            raise FaultImpossibleError("nothing can restart the controller of this robot")
        return site.machine


@register
class RestartController(Outage):
    """The controller's software restarts: connections are closed, and no port listens for ``outage_s``."""

    outage_s: NotNegative = 1.0

    def outage(self, site: Site) -> Act:
        for _ in range(site.periods(self.outage_s) + 1):
            yield


@register
class PowerLoss(Outage):
    """Mains power fails while the fault lasts: the arm is off, ports and connections fall silent without being closed.

    When the power returns, the controller boots, and the old connections are reset.
    """

    silent: ClassVar[bool] = True

    def outage(self, site: Site) -> Act:
        while True:
            yield
