"""Speeds held until the next command: speedj and speedl."""

from emulator.motion.reach import Reach
from emulator.motion.vectors import ZERO, Joints, Vec3, lerp, norm3, scaled, towards
from urproto.robots.pose import Pose, pose_add

__all__ = ["JointSpeed", "ToolSpeed"]

_TIME_TOLERANCE = 1e-9  # s


class _Timed:
    """Ready after t seconds of the program's time, or without t when the speed is reached; one period at least."""

    scaled = True

    def __init__(self) -> None:
        self._left: float | None = None
        self._begun = False

    def _restart(self, t: float | None) -> None:
        self._left = t
        self._begun = False

    def _elapse(self, clock_s: float) -> None:
        self._begun = True
        if self._left is not None:
            self._left -= clock_s

    def _is_ready(self, reached: bool) -> bool:
        if not self._begun:
            return False
        return reached if self._left is None else self._left <= _TIME_TOLERANCE

    def goal(self) -> Pose | None:
        return None


class JointSpeed(_Timed):
    """speedj: all joint speeds change together, the leading one by ``a``, then hold."""

    def __init__(self, qd: Joints) -> None:
        super().__init__()
        self._qd = self._next = qd
        self._wanted = ZERO
        self._a = 0.0

    def command(self, qd: Joints, a: float, t: float | None) -> None:
        """New target speed [rad/s], acceleration of the leading joint [rad/s2], duration [s] or None."""
        self._wanted, self._a = qd, a
        self._restart(t)

    def propose(self, h: float, q: Joints) -> Joints:
        self._next = towards(self._qd, self._wanted, self._a * h)
        mean = lerp(self._qd, self._next, 1.0)
        return lerp(q, mean, 0.5 * h)

    def commit(self, clock_s: float) -> None:
        self._qd = self._next
        self._elapse(clock_s)

    @property
    def done(self) -> bool:
        return self.ready and self._qd == ZERO and self._wanted == ZERO

    @property
    def ready(self) -> bool:
        return self._is_ready(self._qd == self._wanted or self._a <= 0.0)


class ToolSpeed(_Timed):
    """speedl: the tool's velocity changes by ``a`` and ``a_rot``, then holds."""

    def __init__(self, reach: Reach, q: Joints, qd: Joints) -> None:
        super().__init__()
        self.reach = reach
        self._pose = self._next_pose = reach.pose(q)
        self._twist = self._next = reach.twist(q, qd) if qd != ZERO else ZERO
        self._wanted = ZERO
        self._a = self._a_rot = 0.0

    def command(self, xd: Joints, a: float, a_rot: float, t: float | None) -> None:
        """New tool velocity in the base frame [m/s, rad/s], accelerations [m/s2, rad/s2], duration [s] or None."""
        self._wanted, self._a, self._a_rot = xd, a, a_rot
        self._restart(t)

    def propose(self, h: float, q: Joints) -> Joints:
        now, goal = self._twist, self._wanted
        self._next = (*_towards3(now[:3], goal[:3], self._a * h), *_towards3(now[3:], goal[3:], self._a_rot * h))
        shift = scaled(lerp(now, self._next, 1.0), 0.5 * h)
        if shift == ZERO:
            self._next_pose = self._pose
            return q
        self._next_pose = pose_add(shift, self._pose)
        return self.reach.joints(self._next_pose, q)

    def commit(self, clock_s: float) -> None:
        self._twist, self._pose = self._next, self._next_pose
        self._elapse(clock_s)

    @property
    def done(self) -> bool:
        return self.ready and self._twist == ZERO and self._wanted == ZERO

    @property
    def ready(self) -> bool:
        return self._is_ready(self._twist == self._wanted or self._a <= 0.0)


def _towards3(now: Vec3, goal: Vec3, step: float) -> Vec3:
    x, y, z = goal[0] - now[0], goal[1] - now[1], goal[2] - now[2]
    size = norm3(x, y, z)
    if size <= step:
        return goal
    f = step / size
    return (now[0] + f * x, now[1] + f * y, now[2] + f * z)
