"""Small controllers for one setting each: gravity, friction, and the robot's version."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from client.controllers.calls import Call, CallingController
from client.controllers.controller import Controller, controller_type
from client.controllers.parameters import without_effect


@dataclass(frozen=True, slots=True)
class SettingParameters:
    """tf_prefix: prefix of all interface names."""

    tf_prefix: str = ""
    check_io_successful_retries: int = without_effect(10, "the timeout is measured in robot time")


class _SettingController(CallingController[SettingParameters]):
    """Base class: a group of command interfaces with an answer."""

    names: ClassVar[tuple[str, ...]] = ()
    answer: ClassVar[str] = ""

    @property
    def command_interfaces(self) -> tuple[str, ...]:
        return tuple(self.parameters.tf_prefix + name for name in (*self.names, self.answer))

    def _set(self, title: str, values: Sequence[float]) -> Call:
        if len(values) != len(self.names):
            raise self.error(f"{title} has {len(self.names)} numbers, not {len(values)}")
        return self._send(title, dict(zip(self.names, values, strict=True)), self.answer)


@controller_type("ur_controllers/GravityUpdateController")
class GravityUpdateController(_SettingController):
    """Sets the direction of gravity, that is, how the robot is mounted."""

    names: ClassVar[tuple[str, ...]] = ("gravity/x", "gravity/y", "gravity/z")
    answer: ClassVar[str] = "gravity/gravity_async_success"

    def set_gravity(self, gravity_m_s2: Sequence[float]) -> Call:
        """Set the acceleration of the base (3,) [m/s2]: [0, 0, 9.82] for an upright arm. Raises ControllerError."""
        return self._set("gravity", gravity_m_s2)


@controller_type("ur_controllers/FrictionModelController")
class FrictionModelController(_SettingController):
    """Sets how much friction torque control compensates; PolyScope 5.25.1 or newer."""

    names: ClassVar[tuple[str, ...]] = tuple(
        f"friction_model/{kind}_{joint}" for kind in ("viscous", "coulomb") for joint in range(6)
    )
    answer: ClassVar[str] = "friction_model/async_success"

    def set_friction_model_parameters(self, viscous: Sequence[float], coulomb: Sequence[float]) -> Call:
        """Set the compensated share, 0 to 1, of each joint's friction (6,). Raises ControllerError."""
        if not all(0.0 <= share <= 1.0 for share in (*viscous, *coulomb)):
            raise self.error("friction compensation takes shares from 0 to 1")
        return self._set("friction", (*viscous, *coulomb))


@controller_type("ur_controllers/URConfigurationController")
class URConfigurationController(Controller[SettingParameters]):
    """Reports the version of the robot's software."""

    @property
    def state_interfaces(self) -> tuple[str, ...]:
        name = f"{self.parameters.tf_prefix}get_robot_software_version/get_version"
        return tuple(f"{name}_{part}" for part in ("major", "minor", "bugfix", "build"))

    def robot_software_version(self) -> tuple[int, ...]:
        """Major, minor, bugfix and build. Raises ControllerError while it is not active."""
        self.check_active()
        return tuple(int(value) for value in self.states.get())
