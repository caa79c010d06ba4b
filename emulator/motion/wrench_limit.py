"""Slows down movements that would otherwise accelerate the payload too hard.

The wrench that accelerates a payload grows with the square of the speed: k times slower, a movement needs 1/k^2 of it
everywhere. A leg is therefore checked once, when it is planned, and slowed down by a single factor.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import inf, sqrt

from emulator.motion.legs import Leg
from emulator.motion.profile import Limits, Profile
from emulator.robot.installation import Payload
from urproto.robots.model import Joints
from urproto.robots.pose import Pose, pose_inv, pose_sub, pose_trans, rotvec_to_matrix, wrench_trans
from urproto.vectors import Vector3, as_six, cross, rotate_back, scaled_sum3, sub3

_STRIDES = 16  # into which a leg is divided for the check


@dataclass(frozen=True, slots=True)
class WrenchLimit:
    """The largest wrench that a movement may exert on the present payload.

    ``frame``: relative to the flange; ``most``: N, Nm, inf for no limit.
    """

    frame: Pose
    most: Joints
    payload: Callable[[], Payload]

    @classmethod
    def of(cls, frame: Pose, most: tuple[float | None, ...], payload: Callable[[], Payload]) -> "WrenchLimit":
        """Create a limit; None leaves a direction unlimited."""
        return cls(frame, as_six(inf if limit is None else limit for limit in most), payload)

    def slow(self, leg: Leg, tcp_offset: Pose) -> None:
        """Reduce speed and acceleration of a planned leg so that the limit is kept everywhere on it."""
        payload = self.payload()
        if leg.length <= 0.0 or payload.mass <= 0.0:
            return
        x, y, z = payload.cog
        from_cog = (self.frame[0] - x, self.frame[1] - y, self.frame[2] - z, *self.frame[3:])
        wrenches = (wrench_trans(from_cog, wrench) for wrench in _accelerating(leg, tcp_offset, payload))
        excess = max(self._share(wrench) for wrench in wrenches)
        if excess > 1.0:
            leg.limits = Limits(leg.limits.speed / sqrt(excess), leg.limits.acceleration / excess)
            leg.profile = Profile.plan(0.0, leg.length, leg.limits)

    def _share(self, wrench: Joints) -> float:
        """The largest of the six ratios of a component to its limit."""
        return max(abs(part) / most for part, most in zip(wrench, self.most, strict=True))


def _accelerating(leg: Leg, tcp_offset: Pose, payload: Payload) -> Iterator[Joints]:
    """Newton-Euler equations of the payload along the leg: wrench at its centre of gravity, flange axes.

    Based on the geometry: first and second derivatives along the path, by differences, and the profile's speed there.
    """
    stride, back = leg.length / _STRIDES, pose_inv(tcp_offset)
    flanges = [pose_trans(leg.pose(stride * i), back) for i in range(_STRIDES + 1)]
    places = [pose_trans(flange, (*payload.cog, 0.0, 0.0, 0.0))[:3] for flange in flanges]
    shifts = [sub3(places[i + 1], places[i]) for i in range(_STRIDES)]
    turns = [pose_sub(flanges[i + 1], flanges[i])[3:] for i in range(_STRIDES)]
    for i, flange in enumerate(flanges):
        m = rotvec_to_matrix(*flange[3:])
        velocity, curvature = _derivatives(shifts, i, stride)
        spin, twist = _derivatives(turns, i, stride)
        for speed, gain in _paces(leg.profile, stride * i):
            force = rotate_back(m, scaled_sum3(velocity, gain * payload.mass, curvature, speed**2 * payload.mass))
            omega = rotate_back(m, scaled_sum3(spin, speed, twist, 0.0))
            alpha = scaled_sum3(spin, gain, twist, speed**2)
            gyroscopic = cross(omega, _times_inertia(payload, omega))
            torque = scaled_sum3(_times_inertia(payload, rotate_back(m, alpha)), 1.0, gyroscopic, 1.0)
            yield (*force, *torque)


def _derivatives(steps: Sequence[Vector3], i: int, stride: float) -> tuple[Vector3, Vector3]:
    """First and second derivative at node i of a value with differences ``steps`` between nodes."""
    first = min(max(i - 1, 0), len(steps) - 2)
    before, after = steps[first], steps[first + 1]
    where = i - 1 - first  # -1, 0, 1: the start, inside, the end
    change = scaled_sum3(after, 1.0, before, -1.0)
    middle = scaled_sum3(before, 0.5 / stride, after, 0.5 / stride)
    curvature = scaled_sum3(after, 1.0 / stride**2, before, -1.0 / stride**2)
    return scaled_sum3(middle, 1.0, change, where / stride), curvature


def _paces(profile: Profile, s: float) -> list[tuple[float, float]]:
    """Speed and acceleration of the profile at path length s; two pairs close to a change of its acceleration."""
    a, peak, length = profile.acceleration, profile.peak_speed, profile.end
    rising, falling = sqrt(2.0 * a * s), sqrt(2.0 * a * max(length - s, 0.0))
    paces = []
    if rising <= 1.2 * peak:
        paces.append((min(rising, peak), a))
    if falling <= 1.2 * peak:
        paces.append((min(falling, peak), -a))
    return paces or [(peak, 0.0)]


def _times_inertia(payload: Payload, v: Vector3) -> Vector3:
    xx, yy, zz, xy, xz, yz = payload.inertia
    x, y, z = v
    return (xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z)
