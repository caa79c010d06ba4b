"""Forward controllers, which pass commands to the joints unchanged."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from client.controllers.controller import Controller, controller_type


@dataclass(frozen=True, slots=True)
class ForwardCommandParameters:
    """interface_name: position [rad], velocity [rad/s] or effort [Nm]."""

    joints: tuple[str, ...]
    interface_name: str


@dataclass(frozen=True, slots=True)
class JointGroupParameters:
    """Parameters of the older controller types, whose names imply the interface; naming it as well does no harm."""

    joints: tuple[str, ...]
    interface_name: str = ""


class _Interpolation:
    """Interpolates from one set of values to another, at rest at both ends."""

    def __init__(
        self, begin: tuple[float, ...], end: tuple[float, ...], duration_s: float, time_rate: Callable[[], float]
    ) -> None:
        self._begin = begin
        self._end = end
        self._duration_s = duration_s
        self._time_rate = time_rate
        self._elapsed_s = 0.0

    @property
    def done(self) -> bool:
        """True once the end is reached."""
        return self._elapsed_s >= self._duration_s

    def after(self, period_s: float) -> tuple[float, ...]:
        """The values after another ``period_s``."""
        self._elapsed_s += period_s * self._time_rate()
        if self.done:
            return self._end
        share = self._elapsed_s / self._duration_s
        smooth = share * share * (3.0 - 2.0 * share)
        return tuple(a + smooth * (b - a) for a, b in zip(self._begin, self._end, strict=True))


@controller_type("forward_command_controller/ForwardCommandController")
class ForwardCommandController(Controller[Any]):
    """Passes the last commanded positions, velocities or torques to the joints unchanged; nothing before the first."""

    parameters_type: ClassVar[type[Any]] = ForwardCommandParameters

    def __init__(self, name: str, parameters: Any, update_rate_hz: float) -> None:
        super().__init__(name, parameters, update_rate_hz)
        self._values: tuple[float, ...] | None = None
        self._interpolation: _Interpolation | None = None

    @property
    def interface_name(self) -> str:
        """Name of the interface that it commands."""
        return str(self.parameters.interface_name)

    @property
    def command_interfaces(self) -> tuple[str, ...]:
        return tuple(f"{joint}/{self.interface_name}" for joint in self.parameters.joints)

    def on_configure(self) -> None:
        if not self.parameters.joints:
            raise self.error("joints is empty: list the joints to command")

    def on_activate(self, time_s: float) -> None:
        self._values = self._interpolation = None

    def on_deactivate(self) -> None:
        self._values = self._interpolation = None

    def on_halt(self, reason: str) -> None:
        self._values = self._interpolation = None

    def command(self, values: Sequence[float]) -> None:
        """Set the command for each joint from now on. Raises ControllerError, also while it is not active."""
        self.check_active()
        self.check(values)
        self._values, self._interpolation = tuple(values), None

    def go_to(self, values: Sequence[float], duration_s: float, time_rate: Callable[[], float]) -> None:
        """Move the commands gradually from the present ones to ``values``, along a cubic from rest to rest.

        time_rate: returns how fast the time of the motion passes, 0 while the arm waits. Raises ControllerError, also
        if the controller does not command positions.
        """
        self.check_active()
        self.check(values)
        if self.interface_name != "position":
            raise self.error("only positions can be approached gradually")
        self._interpolation = _Interpolation(tuple(self.commands.get()), tuple(values), duration_s, time_rate)

    def hold_position(self) -> None:
        """Stop a gradual motion: keep the present commands."""
        self._interpolation = None

    def check(self, values: Sequence[float]) -> None:
        """Check that values can be commanded. Raises ControllerError if not."""
        if len(values) != len(self.parameters.joints):
            raise self.error(f"{len(values)} commands for {len(self.parameters.joints)} joints")
        if not all(map(math.isfinite, values)):
            raise self.error(f"these commands are not numbers: {list(values)}")

    def update(self, time_s: float, period_s: float) -> None:
        if (interpolation := self._interpolation) is not None:
            self._values = interpolation.after(period_s)
            if interpolation.done:
                self._interpolation = None
        if self._values is not None:
            self.commands.put(self._values)


class _JointGroupController(ForwardCommandController):
    """Base class of the older types."""

    parameters_type: ClassVar[type[Any]] = JointGroupParameters
    implied: ClassVar[str]

    @property
    def interface_name(self) -> str:
        return self.implied

    def on_configure(self) -> None:
        super().on_configure()
        if self.parameters.interface_name not in ("", self.implied):
            raise self.error(f"{self.type_name} commands {self.implied}: leave interface_name out")


@controller_type("position_controllers/JointGroupPositionController")
class JointGroupPositionController(_JointGroupController):
    """Forward command controller for positions."""

    implied = "position"


@controller_type("velocity_controllers/JointGroupVelocityController")
class JointGroupVelocityController(_JointGroupController):
    """Forward command controller for velocities, which end when it is deactivated."""

    implied = "velocity"


@controller_type("effort_controllers/JointGroupEffortController")
class JointGroupEffortController(_JointGroupController):
    """Forward command controller for torques, which end when it is deactivated."""

    implied = "effort"
