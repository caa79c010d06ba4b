"""Tracking: paths that move along with a conveyor, measured by an encoder, or with a named frame.

From the start of tracking, the path is displaced by the motion of its leader (the conveyor or frame) since then. While
the leader moves evenly, the path keeps pace exactly. Any remaining distance to the leader, because it was already
moving when tracking began or because it jumped, is caught up at limited speed and acceleration. A leader at constant
speed is therefore followed without lag, and a jump of the leader does not jerk the arm.

A conveyor moves along one coordinate, m or rad, which `Follower` follows. A frame moves in steps, at most once a
period, when a program moves it; its displacement in a period is its speed. The path moves exactly along with it, in
translation and rotation, and catches up relative to the frame. That a real controller does the same with frames is a
guess.

Velocities of the tool are (linear, angular) pairs in the axes of the base.
"""

from collections.abc import Callable
from math import copysign, hypot, pi, sqrt
from typing import NamedTuple, Protocol

from emulator.motion.faults import conveyor_too_fast, frame_lost, frame_too_fast
from emulator.motion.legs import TOOL_LIMITS
from emulator.motion.profile import Limits
from urproto.robots.model import Joints
from urproto.robots.pose import Pose, axes_of, pose_add, pose_inv, pose_sub, pose_trans
from urproto.vectors import ZERO6, Vector3, all_finite, cross, largest, lerp, norm3, out_of6, scaled, sub, unit

LEVER_M = 0.25  # lever from a leading joint to the tool: converts a deceleration of joints into one of the tool (guess)

_BANDWIDTH = 25.0  # rad/s, of catching up where no limit is reached: critically damped (guess)
_BRAKE_SHARE = 0.8  # of the acceleration is used to plan the approach to a distant target; the rest corrects
_ARRIVED = 1e-9  # m, rad: closer than this to a standing leader, and slower, the path stands with it (guess)
_ARRIVED_SPEED = 1e-6
_CATCHING_UP = Limits(0.25, 2.0)  # m/s beyond the leader's own speed, m/s2 (guess)
_CATCHING_UP_TURN = Limits(_CATCHING_UP.speed / LEVER_M, _CATCHING_UP.acceleration / LEVER_M)
_FASTEST_TURN = TOOL_LIMITS.speed / LEVER_M  # rad/s
_JUMPS_S = 0.02  # a frame that exceeds these speeds for a shorter time has been placed elsewhere (guess)
_SHORTEST_RADIUS_M = 0.05  # closer to its centre, a rotating conveyor is followed as at this radius


class Tick(NamedTuple):
    """One control period of ``dt`` seconds, in which ``pace`` periods of the program's time pass.

    ``ramp``: None while the movement runs; otherwise the deceleration of a leading joint [rad/s2] with which whatever
    moves by itself has to come to a standstill.
    """

    dt: float
    pace: float
    ramp: float | None


class Follower:
    """Follows a target along one coordinate, from 0 at a given speed; ``position`` and ``speed`` in any unit."""

    def __init__(self, speed: float = 0.0) -> None:
        self.position = 0.0
        self.speed = speed

    def follow(self, dt: float, target: float, rate: float, limits: Limits) -> None:
        """Follow a target that moves at ``rate``; the limits are those for catching up."""
        error = target - self.position - rate * dt  # at the end of the period, keeping pace
        if rate == 0.0 and abs(error) < _ARRIVED and abs(self.speed) < _ARRIVED_SPEED:
            self.position, self.speed = target, 0.0
            return
        a = limits.acceleration
        change = 2.0 * _BANDWIDTH * dt * (rate + copysign(_closing(abs(error), limits), error) - self.speed)
        self._move(dt, self.speed + max(-a * dt, min(a * dt, change)))

    def brake(self, dt: float, deceleration: float) -> None:
        slower = max(0.0, abs(self.speed) - deceleration * dt)
        self._move(dt, copysign(slower, self.speed) if slower else 0.0)

    def _move(self, dt: float, speed: float) -> None:
        self.position += 0.5 * (self.speed + speed) * dt
        self.speed = speed


def pursuit(dt: float, missing: Vector3, velocity: Vector3, limits: Limits) -> Vector3:
    """Velocity after a period, to cover the distance ``missing``; both are relative to the leader."""
    far = hypot(*missing)
    share = _closing(far, limits) / far if far else 0.0
    gain = 2.0 * _BANDWIDTH * dt
    x, y, z = (gain * (share * way - speed) for way, speed in zip(missing, velocity, strict=True))
    size = norm3(x, y, z)
    cut = limits.acceleration * dt / size if size > limits.acceleration * dt else 1.0
    return (velocity[0] + cut * x, velocity[1] + cut * y, velocity[2] + cut * z)


def braked(dt: float, velocity: Vector3, deceleration: float) -> Vector3:
    """Velocity after a period of braking to a standstill."""
    size = norm3(*velocity)
    left = 1.0 - deceleration * dt / size if size > deceleration * dt else 0.0
    return (velocity[0] * left, velocity[1] * left, velocity[2] * left)


def _closing(far: float, limits: Limits) -> float:
    """Approach speed at this distance from the target."""
    return min(0.5 * _BANDWIDTH * far, sqrt(2.0 * _BRAKE_SHARE * limits.acceleration * far), limits.speed)


class Belt(Protocol):
    """Measures the motion of a conveyor."""

    travel: float
    """Ticks, interpolated, never wrapped."""
    speed: float
    """Ticks/s."""


class _Conveyor:
    """A tracked conveyor. ``position``: how far the path has moved along with it, in m or rad."""

    def __init__(self, belt: Belt, ticks_per_unit: float) -> None:
        self._belt = belt
        self._origin = belt.travel
        self._ticks = ticks_per_unit
        self._follower = Follower()

    @property
    def position(self) -> float:
        """How far the path has moved along with the conveyor [m or rad]."""
        return self._follower.position

    def _advance(self, tick: Tick, radius: float) -> None:
        """Advance one period. ``radius``: metres that a unit of position moves the tool."""
        rate = self._belt.speed / self._ticks
        if tick.ramp is not None:
            self._follower.brake(tick.dt, tick.ramp * LEVER_M / radius)
            return
        if abs(rate) * radius > TOOL_LIMITS.speed:
            raise conveyor_too_fast(rate * radius, TOOL_LIMITS.speed)
        bounds = Limits(_CATCHING_UP.speed / radius, _CATCHING_UP.acceleration / radius)
        self._follower.follow(tick.dt, (self._belt.travel - self._origin) / self._ticks, rate, bounds)


class LinearConveyor(_Conveyor):
    """Moves along ``direction``, given in the base frame; its length is ignored."""

    def __init__(self, belt: Belt, direction: Vector3, ticks_per_meter: float) -> None:
        super().__init__(belt, ticks_per_meter)
        self._direction = unit(direction, (1.0, 0.0, 0.0))

    def step(self, tick: Tick, path: Pose, shift: Joints) -> None:
        self._advance(tick, 1.0)

    def apply(self, pose: Pose) -> Pose:
        return pose_add(self._shift(self.position), pose)

    def undo(self, pose: Pose) -> Pose:
        return pose_add(self._shift(-self.position), pose)

    def _shift(self, length: float) -> Pose:
        x, y, z = self._direction
        return (length * x, length * y, length * z, 0.0, 0.0, 0.0)


class CircularConveyor(_Conveyor):
    """Rotates about the z axis of ``center``, a pose in the base frame; positive ticks: counter-clockwise (guess)."""

    def __init__(self, belt: Belt, center: Pose, ticks_per_revolution: float, *, rotate_tool: bool) -> None:
        super().__init__(belt, ticks_per_revolution / (2.0 * pi))
        self._center, self._inverse = center, pose_inv(center)
        self._axis = axes_of(center)[2]
        self._rotate_tool = rotate_tool

    def step(self, tick: Tick, path: Pose, shift: Joints) -> None:
        self._advance(tick, max(self._radius(path), _SHORTEST_RADIUS_M))

    def _radius(self, pose: Pose) -> float:
        out = (pose[0] - self._center[0], pose[1] - self._center[1], pose[2] - self._center[2])
        return norm3(*cross(out, self._axis))

    def apply(self, pose: Pose) -> Pose:
        return self._turned(pose, self.position)

    def undo(self, pose: Pose) -> Pose:
        return self._turned(pose, -self.position)

    def _turned(self, pose: Pose, angle: float) -> Pose:
        turn = pose_trans(pose_trans(self._center, (0.0, 0.0, 0.0, 0.0, 0.0, angle)), self._inverse)
        there = pose_trans(turn, pose)
        return there if self._rotate_tool else (*there[:3], *pose[3:])


class FrameTracking:
    """Tracks a frame. ``place`` returns its pose in the base frame, or raises ValueError if it no longer exists."""

    def __init__(self, name: str, place: Callable[[], Pose]) -> None:
        self.name = name
        self._place = place
        self._frame = place()
        self._inverse = pose_inv(self._frame)
        self._target: Pose = ZERO6  # displacement by the frame
        self._applied: Pose = ZERO6  # displacement of the path
        self._velocity: Joints = ZERO6  # of the tool, due to the displacement
        self._tool: Vector3 = (0.0, 0.0, 0.0)  # position of the tool at that time
        self._too_fast_s = 0.0

    def step(self, tick: Tick, path: Pose, shift: Joints) -> None:
        dt, ramp = tick.dt, tick.ramp
        before, moved = self._frame, self._update_frame()
        if not moved and self._velocity == ZERO6 and (ramp is not None or self._applied == self._target):
            return
        here = self._displaced(path)
        if ramp is not None:
            self._brake(dt, path, here, ramp)
        elif moved:
            self._move_along(dt, path, here, before)
        else:
            self._too_fast_s = 0.0
            self._catch_up(dt, path, here, self._velocity, ZERO6)
            self._settle(path)

    def apply(self, pose: Pose) -> Pose:
        return pose if self._applied == ZERO6 else pose_trans(self._applied, pose)

    def undo(self, pose: Pose) -> Pose:
        return pose_trans(pose_inv(self._applied), pose)

    def at_the_start(self, pose: Pose) -> Pose:
        """Pose at the start of tracking of one that moves with the frame. Raises ValueError if that is gone."""
        return pose_trans(pose_inv(pose_trans(self._place(), self._inverse)), pose)

    def _update_frame(self) -> bool:
        """Update the frame's pose; returns whether it moved."""
        try:
            frame = self._place()
            target = pose_trans(frame, self._inverse)
        except ValueError as error:
            raise frame_lost(self.name, str(error)) from None
        if not all_finite(target):
            raise frame_lost(self.name, "it is infinitely far away")
        moved = frame != self._frame
        if moved:
            self._frame, self._target = frame, target
        return moved

    def _displaced(self, path: Pose) -> Pose:
        """Tool pose with the last period's displacement; also updates the velocity there."""
        here = self.apply(path)
        if self._velocity != ZERO6:
            x, y, z = cross(self._velocity[3:], _way(self._tool, here))
            self._velocity = lerp(self._velocity, (x, y, z, 0.0, 0.0, 0.0), 1.0)
        return here

    def _brake(self, dt: float, path: Pose, here: Pose, ramp: float) -> None:
        linear, angular = self._velocity[:3], self._velocity[3:]
        self._too_fast_s = 0.0
        velocity = (*braked(dt, linear, ramp * LEVER_M), *braked(dt, angular, ramp))
        if velocity != self._velocity:
            self._put(path, here, scaled(lerp(self._velocity, velocity, 1.0), 0.5 * dt), velocity)

    def _move_along(self, dt: float, path: Pose, here: Pose, before: Pose) -> None:
        """Move rigidly with the frame and catch up; a jump counts as a frame that now stands elsewhere."""
        move = pose_trans(self._frame, pose_inv(before))
        along = pose_trans(move, here)
        rate = scaled(pose_sub(along, here), 1.0 / dt)
        if self._jumps(dt, rate):
            self._catch_up(dt, path, here, self._velocity, ZERO6)
            return
        turned = axes_of(move)
        relative = out_of6(turned, sub(self._velocity, rate))
        self._catch_up(dt, path, along, relative, out_of6(turned, rate))

    def _jumps(self, dt: float, rate: Joints) -> bool:
        speed, turn = norm3(*rate[:3]), norm3(*rate[3:])
        if speed <= TOOL_LIMITS.speed and turn <= _FASTEST_TURN:
            self._too_fast_s = 0.0
            return False
        self._too_fast_s += dt
        if self._too_fast_s > _JUMPS_S + 0.5 * dt:
            raise frame_too_fast(self.name, speed, TOOL_LIMITS.speed, turn, _FASTEST_TURN)
        return True

    def _catch_up(self, dt: float, path: Pose, along: Pose, relative: Joints, rate: Joints) -> None:
        """Catch up. ``relative``: the tool's velocity relative to the frame, which moves it by ``rate``."""
        missing = pose_sub(self._goal(path), along)
        nearer = (
            *pursuit(dt, missing[:3], relative[:3], _CATCHING_UP),
            *pursuit(dt, missing[3:], relative[3:], _CATCHING_UP_TURN),
        )
        way = scaled(lerp(relative, nearer, 1.0), 0.5 * dt)
        self._put(path, along, way, lerp(rate, nearer, 1.0))

    def _put(self, path: Pose, start: Pose, way: Joints, velocity: Joints) -> None:
        there = pose_add(way, start)
        self._applied = pose_trans(there, pose_inv(path))
        self._velocity, self._tool = velocity, there[:3]

    def _settle(self, path: Pose) -> None:
        missing = pose_sub(self._goal(path), self.apply(path))
        if largest(missing) < _ARRIVED and largest(self._velocity) < _ARRIVED_SPEED:
            self._applied, self._velocity = self._target, ZERO6

    def _goal(self, path: Pose) -> Pose:
        """Tool pose according to the frame."""
        return pose_trans(self._target, path)


def _way(start: Vector3, end: Pose) -> Vector3:
    return (end[0] - start[0], end[1] - start[1], end[2] - start[2])
