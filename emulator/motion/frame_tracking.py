"""Frame tracking: the path moves along rigidly with a named frame from the moment tracking begins.

Frames move in steps, once a period at best, when a program says so; the way a frame goes in a period is its speed.
The displacement goes exactly along with that. What is missing to the frame's place is caught up with as with conveyors:
seen from the frame, the tool comes nearer with bounded speed and acceleration, in translation and in rotation. So a
frame at constant speed, turning or not, is followed without lag, and one that jumps is no jerk. That a real controller
does the same is a guess.

Velocities are (linear, angular) pairs at the tool, in the axes of the base.
"""

from collections.abc import Callable

from emulator.motion.faults import frame_lost, frame_too_fast
from emulator.motion.legs import TOOL_LIMITS
from emulator.motion.path_motion import braked, pursuit
from emulator.motion.profile import Limits
from emulator.motion.superposition import LEVER_M
from emulator.motion.vectors import (
    ZERO,
    Joints,
    Vec3,
    all_finite,
    cross,
    largest,
    lerp,
    norm3,
    of_rotation,
    out_of6,
    scaled,
    sub,
)
from urproto.robots.pose import Pose, pose_add, pose_inv, pose_sub, pose_trans

_CATCHING_UP = Limits(0.25, 2.0)  # m/s beyond the frame's own speed, m/s2: as with conveyors (guess)
_CATCHING_UP_TURN = Limits(_CATCHING_UP.speed / LEVER_M, _CATCHING_UP.acceleration / LEVER_M)
_FASTEST_TURN = TOOL_LIMITS.speed / LEVER_M  # rad/s
_JUMPS_S = 0.02  # a frame that is beyond these speeds for less is one that was put elsewhere (guess)
_ARRIVED = 1e-9  # m, rad: nearer to a standing frame, and slower, the path stands with it (guess)
_ARRIVED_SPEED = 1e-6


class FrameTracking:
    """``place`` tells the frame's pose in the base frame, and raises ValueError when there is none any more."""

    def __init__(self, name: str, place: Callable[[], Pose]) -> None:
        self.name = name
        self._place = place
        self._frame = place()
        self._inverse = pose_inv(self._frame)
        self._target: Pose = ZERO  # where the frame takes things
        self._applied: Pose = ZERO  # where the path is taken
        self._velocity: Joints = ZERO  # of the tool, by what is applied
        self._tool: Vec3 = (0.0, 0.0, 0.0)  # where the tool was then
        self._too_fast_s = 0.0

    def step(self, dt: float, path: Pose, shift: Joints, ramp: float | None) -> None:
        before, moved = self._frame, self._look()
        if not moved and self._velocity == ZERO and (ramp is not None or self._applied == self._target):
            return
        here = self._taken(path)
        if ramp is not None:
            self._brake(dt, path, here, ramp)
        elif moved:
            self._go_along(dt, path, here, before)
        else:
            self._too_fast_s = 0.0
            self._catch_up(dt, path, here, self._velocity, ZERO)
            self._arrive(path)

    def apply(self, pose: Pose) -> Pose:
        return pose if self._applied == ZERO else pose_trans(self._applied, pose)

    def undo(self, pose: Pose) -> Pose:
        return pose_trans(pose_inv(self._applied), pose)

    def at_the_start(self, pose: Pose) -> Pose:
        """Where a pose that moves along with the frame was when tracking began. Raises ValueError without a frame."""
        return pose_trans(pose_inv(pose_trans(self._place(), self._inverse)), pose)

    def _look(self) -> bool:
        """See where the frame is now; whether it moved."""
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

    def _taken(self, path: Pose) -> Pose:
        """Where the displacement of the last period takes the tool; its velocity there."""
        here = self.apply(path)
        if self._velocity != ZERO:
            x, y, z = cross(self._velocity[3:], _way(self._tool, here))
            self._velocity = lerp(self._velocity, (x, y, z, 0.0, 0.0, 0.0), 1.0)
        return here

    def _brake(self, dt: float, path: Pose, here: Pose, ramp: float) -> None:
        linear, angular = self._velocity[:3], self._velocity[3:]
        self._too_fast_s = 0.0
        velocity = (*braked(dt, linear, ramp * LEVER_M), *braked(dt, angular, ramp))
        if velocity != self._velocity:
            self._put(path, here, scaled(lerp(self._velocity, velocity, 1.0), 0.5 * dt), velocity)

    def _go_along(self, dt: float, path: Pose, here: Pose, before: Pose) -> None:
        """Rigidly with the frame, and nearer to it; a jump is a frame that now stands elsewhere."""
        move = pose_trans(self._frame, pose_inv(before))
        along = pose_trans(move, here)
        rate = scaled(pose_sub(along, here), 1.0 / dt)
        if self._jumps(dt, rate):
            self._catch_up(dt, path, here, self._velocity, ZERO)
            return
        turned = of_rotation(move)
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
        """``relative``: the tool's velocity as seen from the frame, which moves it by ``rate``."""
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

    def _arrive(self, path: Pose) -> None:
        missing = pose_sub(self._goal(path), self.apply(path))
        if largest(missing) < _ARRIVED and largest(self._velocity) < _ARRIVED_SPEED:
            self._applied, self._velocity = self._target, ZERO

    def _goal(self, path: Pose) -> Pose:
        """Where the frame wants the tool."""
        return pose_trans(self._target, path)


def _way(start: Vec3, end: Pose) -> Vec3:
    return (end[0] - start[0], end[1] - start[1], end[2] - start[2])
