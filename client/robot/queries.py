"""Values that only the control program knows, answered during any motion."""

from typing import cast

from client.robot.readiness import Readiness
from urproto.external_control import Query
from urproto.robots import Joints
from urproto.robots.pose import Pose


class Queries:
    """The queries of `AsyncRobot`; those about kinematics and dynamics have their own components."""

    def __init__(self, readiness: Readiness) -> None:
        self._query = readiness.query

    async def tcp_offset(self) -> Pose:
        """The active TCP as a pose in the flange frame (6,) [m, rotation vector]; PolyScope 3.6 or newer."""
        return cast(Pose, await self._query("tcp_offset", Query.TCP_OFFSET, gate="tcp_offset"))

    async def history(self, steps: int) -> Joints:
        """Joint angles (6,) [rad] as measured ``steps`` control periods ago; PolyScope 5.4 or newer."""
        return cast(Joints, await self._query("history", Query.JOINT_POSITIONS_HISTORY, number=steps, gate="contact"))

    async def is_steady(self) -> bool:
        """Whether the arm has been at rest for a while, and is in neither force mode nor freedrive."""
        return bool((await self._query("is_steady", Query.STEADY))[0])

    async def step_time(self) -> float:
        """The control period [s]."""
        return (await self._query("step_time", Query.STEP_TIME))[0]

    async def target_waypoint(self) -> Pose:
        """Target TCP pose (6,) [m, rotation vector] of the move under way; PolyScope 5.3 or newer."""
        return cast(Pose, await self._query("target_waypoint", Query.TARGET_WAYPOINT, gate="target_waypoint"))
