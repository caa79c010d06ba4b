"""Tool contact detection and the force sensor."""

from collections.abc import Sequence
from typing import Final

from client.quantities import checked
from client.robot.readiness import Readiness
from urproto.external_control import Query
from urproto.vectors import ZERO6

_ANY: Final = ZERO6
_WRENCHES_AHEAD: Final = 8  # guess: at one per control period, an answer takes less


@checked
class Contact:
    """Detects tool contact, during any motion; PolyScope 5.4 or newer. See also `AsyncRobot.move_until_contact`.

    direction_base: direction of motion in which contact counts (6,), in the base frame; only the first three numbers
    are used. All zeros stand for any direction.
    """

    def __init__(self, readiness: Readiness) -> None:
        self._readiness = readiness
        self._driver = readiness.driver

    async def steps(self, direction_base: Sequence[float] = _ANY) -> int:
        """Number of control periods since just before the contact, 0 without contact; see `AsyncRobot.history`."""
        return round((await self._readiness.query("contact", Query.TOOL_CONTACT, direction_base, gate="contact"))[0])

    async def start_detection(self, direction_base: Sequence[float] = _ANY) -> None:
        """Let the robot check for contact in every control period, and remember the first one."""
        await self._readiness.require_program("contact")
        self._driver.start_contact_detection(direction_base)

    async def detected(self) -> bool:
        """Whether a contact occurred since `start_detection`."""
        return bool((await self._readiness.query("contact", Query.CONTACT_DETECTED, gate="contact"))[0])

    async def stop_detection(self) -> bool:
        """Stop checking, and return whether a contact occurred."""
        await self._readiness.require_program("contact")
        self._driver.stop_contact_detection()
        return await self.detected()


@checked
class Force:
    """The force sensor, and force mode while it is in effect (`AsyncRobot.force_mode`)."""

    def __init__(self, readiness: Readiness) -> None:
        self._readiness = readiness
        self._driver = readiness.driver

    async def zero_sensor(self) -> None:
        """Zero the force/torque sensor (take the present wrench as zero); e-Series."""
        await self._driver.zero_ftsensor()

    async def set_mode_parameters(self, damping: float = 0.025, gain_scaling: float = 0.5) -> None:
        """Set parameters of the active force mode: damping 0 to 1, gain scaling 0 to 2 (e-Series only)."""
        await self._readiness.require_program("force mode")
        self._driver.set_force_mode_parameters(damping, gain_scaling)

    async def use_external_sensor(
        self,
        enabled: bool,
        sensor_mass_kg: float = 0.0,
        offset_m: Sequence[float] = (0.0, 0.0, 0.0),
        cog_m: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:
        """Use the wrench from `set_external_wrench` instead of the built-in sensor's.

        sensor_mass_kg, offset_m (3,) and cog_m (3,): the sensor's mass, measuring point and centre of gravity.
        """
        await self._readiness.require_program("external sensor")
        self._driver.ft_rtde_input_enable(enabled, sensor_mass_kg, offset_m, cog_m)

    async def set_external_wrench(self, wrench: Sequence[float]) -> None:
        """Send the wrench that an external sensor measures (6,) [N, Nm].

        Raises RobotRefused while another client writes this input.
        """
        await self._driver.link.write_inputs(_WRENCHES_AHEAD, external_force_torque=tuple(wrench))
