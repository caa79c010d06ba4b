"""Slower movements where the payload would otherwise be accelerated too hard.

The wrench that accelerates a payload grows with the square of the pace: driven k times slower, a movement needs 1/k^2
of it everywhere. So a leg is looked at once, when it is planned, and slowed by one factor.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, sqrt

from emulator.installation import Payload
from emulator.motion.legs import Leg
from emulator.motion.profile import Limits, Profile
from emulator.motion.vectors import Joints, Vec3, as_six
from urproto.robots.pose import Pose, pose_inv, pose_sub, pose_trans, rotvec_to_matrix, wrench_trans

__all__ = ["WrenchLimit"]

_SAMPLES = 24  # along a leg; each costs about 25 us
_NO_TURN = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class WrenchLimit:
    """The most a movement may exert on the payload of the moment.

    ``frame``: from the flange; ``most``: N, Nm, inf for no limit.
    """

    frame: Pose
    most: Joints
    payload: Callable[[], Payload]

    def slow(self, leg: Leg, tcp_offset: Pose, period_s: float) -> None:
        """Reduce speed and acceleration of a planned leg until the limit holds all along it."""
        payload = self.payload()
        excess = max((self._share(leg, t, tcp_offset, payload, period_s) for t in _times(leg, period_s)), default=0.0)
        if excess <= 1.0:
            return
        leg.limits = Limits(leg.limits.speed / sqrt(excess), leg.limits.acceleration / excess)
        leg.profile = Profile.plan(0.0, leg.length, leg.limits)

    def _share(self, leg: Leg, t: float, tcp_offset: Pose, payload: Payload, period_s: float) -> float:
        """The wrench at time t of the leg, as a share of what is allowed; the largest of six."""
        back = pose_inv(tcp_offset)
        before, now, after = (
            pose_trans(leg.pose(leg.profile.position(t + shift)), back) for shift in (-period_s, 0.0, period_s)
        )
        wrench = wrench_trans(self._from_cog(payload), _accelerating(before, now, after, payload, period_s))
        return max(abs(part) / most for part, most in zip(wrench, self.most, strict=True))

    def _from_cog(self, payload: Payload) -> Pose:
        x, y, z = payload.cog
        return (self.frame[0] - x, self.frame[1] - y, self.frame[2] - z, *self.frame[3:])

    @classmethod
    def of(cls, frame: Pose, most: tuple[float | None, ...], payload: Callable[[], Payload]) -> "WrenchLimit":
        """None leaves a direction unlimited."""
        return cls(frame, as_six(inf if limit is None else limit for limit in most), payload)


def _times(leg: Leg, period_s: float) -> list[float]:
    """Where to look: all along the leg, and on both sides of where its acceleration changes."""
    profile = leg.profile
    last = profile.duration - period_s
    if last <= period_s:
        return [0.5 * profile.duration] if profile.duration else []
    even = [period_s + (last - period_s) * i / (_SAMPLES - 1) for i in range(_SAMPLES)]
    corners = [t + side * period_s for t in (profile.t_cruise, profile.t_brake) for side in (-1.0, 1.0)]
    return even + [min(max(t, period_s), last) for t in corners]


def _accelerating(before: Pose, now: Pose, after: Pose, payload: Payload, dt: float) -> Joints:
    """Newton and Euler for the payload at three flange poses dt apart: wrench at its centre of gravity, flange axes."""
    places = [pose_trans(pose, (*payload.cog, *_NO_TURN)) for pose in (before, now, after)]
    force = [payload.mass * (places[0][i] - 2.0 * places[1][i] + places[2][i]) / dt**2 for i in range(3)]
    first, second = pose_sub(now, before)[3:], pose_sub(after, now)[3:]
    to_flange = pose_inv((*_NO_TURN, *now[3:]))
    spin = _turned(to_flange, [0.5 * (a + b) / dt for a, b in zip(first, second, strict=True)])
    gain = _turned(to_flange, [(b - a) / dt**2 for a, b in zip(first, second, strict=True)])
    momentum = _times_inertia(payload, spin)
    torque = [rate + turn for rate, turn in zip(_times_inertia(payload, gain), _cross(spin, momentum), strict=True)]
    return as_six([*_turned(to_flange, force), *torque])


def _turned(pose: Pose, v: list[float]) -> Vec3:
    m = rotvec_to_matrix(*pose[3:])
    x, y, z = v
    return (m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z)


def _times_inertia(payload: Payload, v: Vec3) -> Vec3:
    xx, yy, zz, xy, xz, yz = payload.inertia
    x, y, z = v
    return (xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z)


def _cross(a: Vec3, b: Vec3) -> Vec3:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
