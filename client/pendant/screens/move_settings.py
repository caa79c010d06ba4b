"""What one browser has chosen on Move: how fast, along which axes, and how rotations are written."""

import asyncio
from collections.abc import Awaitable, Callable
from math import cos, sin
from typing import Final

from client.errors import MotionStoppedError
from client.pendant.page import Page
from client.pendant.situation import Action
from urproto.robots.pose import Matrix3, rotvec_to_matrix

__all__ = ["FEATURES", "JOINT_TOP", "LINE_TOP", "MoveSettings"]

FEATURES: Final = {"base": "Base", "tool": "Tool", "view": "View"}
JOINT_TOP: Final = 1.0472  # rad/s, and rad/s of a tool: speeds at 100 %; 60 degrees a second is URScript's default
LINE_TOP: Final = 0.25  # m/s: URScript's default, and what ISO 10218 lets an arm move at in manual mode
_JOINT_RAMP: Final = 1.4  # rad/s2, m/s2
_LINE_RAMP: Final = 1.2
_IDENTITY: Final[Matrix3] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


class MoveSettings:
    """speed: 0 to 1 of the top speeds. feature: of `FEATURES`. as_rpy: rotations in RPY [deg], not rotation vectors.

    on_rotation: told when as_rpy has changed.
    """

    def __init__(self, page: Page) -> None:
        self.page = page
        self.speed = 0.5
        self.feature = "base"
        self.as_rpy = False
        self.on_rotation: list[Callable[[bool], None]] = []
        self._mine = False
        page.live.on_lost.append(self._stop_what_i_began)

    def write_rotations(self, *, as_rpy: bool) -> None:
        """So from now on."""
        if as_rpy != self.as_rpy:
            self.as_rpy = as_rpy
            for tell in self.on_rotation:
                tell(as_rpy)

    def axes(self, azimuth_rad: float) -> Matrix3:
        """Of the feature, in the base frame. azimuth: how far what the camera calls right is from the base's x."""
        pose = self.page.station.values.get("actual_TCP_pose")
        if self.feature == "tool" and pose is not None:
            return rotvec_to_matrix(*pose[3:])
        if self.feature == "view":
            s, c = sin(azimuth_rad), cos(azimuth_rad)
            return (c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
        return _IDENTITY

    @property
    def joint_speed(self) -> dict[str, float]:
        """For move_j."""
        return {"speed_rad_s": self.speed * JOINT_TOP, "acceleration_rad_s2": _JOINT_RAMP}

    @property
    def line_speed(self) -> dict[str, float]:
        """For move_l."""
        return {"speed_m_s": self.speed * LINE_TOP, "acceleration_m_s2": _LINE_RAMP}

    async def move(self, motion: Callable[[], Awaitable[None]]) -> None:
        """Begin a motion that ends by itself, if it may be; it ends too when this browser is gone.

        Raises NotNowError.
        """
        self.page.station.situation.require(Action.MOVE)
        if await self.page.may_move():
            await self.page.attempt(lambda: self._moved(motion))

    async def _moved(self, motion: Callable[[], Awaitable[None]]) -> None:
        mine, self._mine = self._mine, True
        try:
            await motion()
        except MotionStoppedError:
            self.page.tell("Stopped")
        finally:
            self._mine = mine  # another motion of this browser may be the one that is under way

    def _stop_what_i_began(self) -> None:
        if self._mine:
            self._stopping = asyncio.create_task(self.page.attempt(self.page.station.mover.stop))
