"""Gravity, friction and the robot's version: small controllers around one setting."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from client.controllers.calls import Call, CallingController
from client.controllers.controller import Controller, controller_type
from client.controllers.parameters import without_effect


@dataclass(frozen=True, slots=True)
class SettingParameters:
    """tf_prefix: in front of all names."""

    tf_prefix: str = ""
    check_io_successful_retries: int = without_effect(10, "the answer is waited for in robot time")


class _SettingController(CallingController[SettingParameters]):
    """Base: a group of command interfaces with an answer."""

    parameters_type: ClassVar[type[Any]] = SettingParameters
    names: ClassVar[tuple[str, ...]] = ()
    answer: ClassVar[str] = ""

    @property
    def command_interfaces(self) -> tuple[str, ...]:
        return tuple(self.parameters.tf_prefix + name for name in (*self.names, self.answer))

    def _set(self, what: str, values: Sequence[float]) -> Call:
        if len(values) != len(self.names):
            raise self.error(f"{what} has {len(self.names)} numbers, not {len(values)}")
        return self._send(what, dict(zip(self.names, values, strict=True)), self.answer)


@controller_type("ur_controllers/GravityUpdateController")
class GravityUpdateController(_SettingController):
    """Tells the robot how it is mounted."""

    names: ClassVar[tuple[str, ...]] = ("gravity/x", "gravity/y", "gravity/z")
    answer: ClassVar[str] = "gravity/gravity_async_success"

    def set_gravity(self, gravity_m_s2: Sequence[float]) -> Call:
        """Acceleration of the base (3,) in its frame: [0, 0, 9.82] for an upright arm. Raises ControllerError."""
        return self._set("gravity", gravity_m_s2)


@controller_type("ur_controllers/FrictionModelController")
class FrictionModelController(_SettingController):
    """Sets how much friction torque control makes up for; from 5.25.1 on."""

    names: ClassVar[tuple[str, ...]] = tuple(
        f"friction_model/{kind}_{joint}" for kind in ("viscous", "coulomb") for joint in range(6)
    )
    answer: ClassVar[str] = "friction_model/async_success"

    def set_friction_model_parameters(self, viscous: Sequence[float], coulomb: Sequence[float]) -> Call:
        """Shares of each joint's friction (6,), 0 to 1. Raises ControllerError."""
        if not all(0.0 <= share <= 1.0 for share in (*viscous, *coulomb)):
            raise self.error("friction compensation takes shares from 0 to 1")
        return self._set("friction", (*viscous, *coulomb))


@controller_type("ur_controllers/URConfigurationController")
class URConfigurationController(Controller[SettingParameters]):
    """Tells the version of the robot's software."""

    parameters_type: ClassVar[type[Any]] = SettingParameters

    @property
    def state_interfaces(self) -> tuple[str, ...]:
        name = f"{self.parameters.tf_prefix}get_robot_software_version/get_version"
        return tuple(f"{name}_{part}" for part in ("major", "minor", "bugfix", "build"))

    def robot_software_version(self) -> tuple[int, ...]:
        """Major, minor, bugfix and build. Raises ControllerError while it is not active."""
        self.check_active()
        return tuple(int(value) for value in self.states.get())
