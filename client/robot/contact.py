"""Tool contact detection, the force sensor, and contexts in which the arm gives way: freedrive and force mode."""

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Final

from client.quantities import checked
from client.robot.motion import MotionRunner
from client.robot.readiness import Readiness
from urproto.external_control import Query
from urproto.vectors import ZERO6

_ANY: Final = ZERO6
_WRENCHES_AHEAD: Final = 8  # guess: at one per control period, an answer takes less

_SLOW: Final = (0.1, 0.1, 0.1, 0.17, 0.17, 0.17)  # m/s, rad/s along compliant axes, m, rad along others; guess: slow


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


class Compliance:
    """Freedrive and force mode of `AsyncRobot`."""

    def __init__(self, motion: MotionRunner) -> None:
        self._motion = motion
        self._driver = motion.driver

    @asynccontextmanager
    async def freedrive(
        self, axes: Sequence[int] = (1,) * 6, frame_base: Sequence[float] = ZERO6
    ) -> AsyncIterator[None]:
        """Let a person guide the arm by hand; the arm holds the position in which it is left.

        axes: 1 for each free axis (6,). frame_base: the frame of these axes, as a pose in the base frame (6,) [m,
        rotation vector]. Freeing only some axes requires PolyScope 5.10 or newer.
        """
        async with self._motion.exclusive("freedrive"):
            self._driver.set_freedrive_axes(axes, frame_base)
            await self._motion.settle("freedrive")
            self._driver.start_freedrive()
            yield

    @asynccontextmanager
    async def force_mode(
        self,
        task_frame_base: Sequence[float],
        selection: Sequence[int],
        wrench: Sequence[float],
        *,
        kind: int = 2,
        limits: Sequence[float] = _SLOW,
        damping: float = 0.025,
        gain_scaling: float = 0.5,
    ) -> AsyncIterator[None]:
        """Be compliant along some axes of a frame, while moves continue along the others.

        task_frame_base: the frame, as a pose in the base frame (6,) [m, rotation vector]. selection: 1 for each
        compliant axis (6,). wrench: applied to the environment (6,) [N, Nm]. kind: 1 turns the frame's y axis towards
        the TCP, 2 takes the frame as it is, 3 aligns its x axis with the velocity. limits (6,): maximum speeds of
        compliant axes [m/s, rad/s], maximum deviations of the others [m, rad]. damping: 0 to 1. gain_scaling: 0 to 2,
        e-Series only.
        """
        await self._motion.ready("force_mode")
        self._driver.start_force_mode(
            task_frame_base, selection, wrench, kind, limits, damping=damping, gain_scaling=gain_scaling
        )
        await self._motion.settle("force_mode")
        try:
            yield
        finally:
            if self._driver.program_running:  # force mode ends with the program
                self._driver.end_force_mode()
        if not self._driver.program_running:
            raise await self._motion.readiness.end_error("force_mode")
        if not self._motion.moving:
            await self._motion.come_to_rest()
