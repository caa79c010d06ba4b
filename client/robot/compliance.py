"""Contexts in which the arm gives way: to a person's hand, or along some axes of a frame."""

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Final

from client.robot.motion import MotionRunner
from urproto.vectors import ZERO6

_SLOW: Final = (0.1, 0.1, 0.1, 0.17, 0.17, 0.17)  # m/s, rad/s along compliant axes, m, rad along others; guess: slow


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
