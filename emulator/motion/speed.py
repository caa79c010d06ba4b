"""Speeds held until the next command: speedj and speedl.

A command with a time is valid for exactly that much of the movement's own time, so that the distance covered is the
integral of the commanded speeds, whatever the speed slider. But programs run once per control period, and a command
seldom ends together with one. The program therefore continues at the end of the period that is nearest to the command's
end, and the next command begins where the previous one ends:

- if the previous one has time left, that is run first;
- if it has already ended, the new command is run retroactively from that moment.

The arm's position that the program reads just then is the one at the command's end (`Motion.program_q`), so that a path
planned from there is not off by a fraction of a period.
"""

from math import inf
from typing import NamedTuple

from emulator.motion.generator import Clock
from emulator.motion.reach import Reach
from urproto.robots.model import Joints
from urproto.robots.pose import Pose, pose_add
from urproto.vectors import ZERO6, largest, lerp, norm3, scaled, sub

_TIME_TOLERANCE = 1e-9  # s


class State(NamedTuple):
    """``place``: joint angles or a TCP pose; ``speed``: its rate of change."""

    place: Joints
    speed: Joints


class _Command(NamedTuple):
    """A speed to reach and hold, with an acceleration and, for a tool, a rotational acceleration."""

    speed: Joints
    a: float
    a_rot: float
    left: float | None  # remaining time [s], negative once it is over; None without a time


class _HeldSpeed:
    """Ready after the command's time or, without one, when the speed is reached; at the earliest after one period."""

    clock = Clock.SCALED

    def __init__(self, state: State) -> None:
        self._now = state
        self._end: State | None = None  # state when the command's time ran out within the last period
        self._start, self._owed = state, 0.0  # where the next step begins, and its duration in addition to a period [s]
        self._commands = [_Command(ZERO6, 0.0, 0.0, None)]  # valid one after the other
        self._h = 0.0  # the last step
        self._next: tuple[State, State | None, list[_Command], float] = (state, None, self._commands, 0.0)
        self._begun = False
        self._overdue = False  # it was ready before the last period

    def _rule(self, speed: Joints, a: float, a_rot: float, t: float | None) -> None:
        """Add a command; it starts at the end of the previous one if that has a time which ends now."""
        before, in_time = self._commands[-1], self._ending
        self._commands = [_Command(speed, a, a_rot, t)]
        self._start, self._owed = self._now, 0.0
        if in_time and before.left is not None:
            if self._end is not None:
                self._start, self._owed = self._end, -before.left
            elif before.left > _TIME_TOLERANCE:
                self._commands.insert(0, before)
        self._begun = False

    @property
    def _ending(self) -> bool:
        """Whether the command's time ended in the last period or is about to: a program continuing now is in time."""
        left = self._commands[-1].left
        return left is not None and self.ready and not self._overdue and left > -self._h

    @property
    def timeless(self) -> bool:
        """Whether the last command takes no time: one for 0 s, or without a time when its speed is reached already."""
        command = self._commands[-1]
        return self._now.speed == command.speed if command.left is None else command.left <= 0.0

    @property
    def late_s(self) -> float | None:
        """Time since the command's end if that is just now, negative if it is still to come; otherwise None."""
        left = self._commands[-1].left
        return -left if self._ending and left is not None else None

    @property
    def end(self) -> State:
        """State at the command's end if that is just now; else the present state."""
        command = self._commands[-1]
        if not self._ending or command.left is None or abs(command.left) <= _TIME_TOLERANCE:
            return self._now
        return self._end or self._run(self._now, command, command.left)

    def _step(self, h: float) -> State:
        """State h after the last commit."""
        state, duration = self._start, h + self._owed
        end: State | None = None
        commands = list(self._commands)
        while len(commands) > 1 and duration > 0.0:
            first = commands.pop(0)
            assert first.left is not None, "only a command with a time makes another one wait"
            part = min(first.left, duration)
            state, duration = self._run(state, first, part), duration - part
            if first.left - part > _TIME_TOLERANCE:
                commands.insert(0, first._replace(left=first.left - part))
        last = commands[-1]
        if last.left is not None:
            commands[-1] = last._replace(left=last.left - duration)
            if 0.0 < last.left < duration - _TIME_TOLERANCE:
                state = end = self._run(state, last, last.left)
                duration -= last.left
        state = self._run(state, last, duration)
        self._next = (state, end, commands, h)
        return state

    def _run(self, state: State, command: _Command, h: float) -> State:
        """Run a command for h."""
        raise NotImplementedError

    def commit(self) -> None:
        self._overdue = self.ready
        self._now, self._end, self._commands, self._h = self._next
        self._start, self._owed = self._now, 0.0
        self._begun = True

    @property
    def done(self) -> bool:
        return self.ready and self._now.speed == ZERO6 and self._commands[-1].speed == ZERO6

    @property
    def ready(self) -> bool:
        if not self._begun:
            return False
        command = self._commands[-1]
        if command.left is None:
            return self._now.speed == command.speed or command.a <= 0.0
        return command.left <= 0.5 * self._h + _TIME_TOLERANCE

    def goal(self) -> Pose | None:
        return None


class JointSpeed(_HeldSpeed):
    """speedj: all joint speeds change together, the leading one by ``a``, and are then held."""

    def __init__(self, q: Joints, qd: Joints) -> None:
        super().__init__(State(q, qd))

    def command(self, qd: Joints, a: float, t: float | None) -> None:
        """Set a new target speed [rad/s], acceleration of the leading joint [rad/s2], and duration [s] or None."""
        self._rule(qd, a, 0.0, t)

    def propose(self, h: float, q: Joints) -> Joints:
        return lerp(q, sub(self._step(h).place, self._now.place), 1.0)

    def joints_at_end(self, q: Joints) -> Joints:
        """Joints at the command's end if that is just now; at present they are at q."""
        return lerp(q, sub(self.end.place, self._now.place), 1.0)

    def _run(self, state: State, command: _Command, h: float) -> State:
        change = sub(command.speed, state.speed)
        qd, moved = _changed(state.speed, command.speed, _duration(largest(change), command.a), h)
        return State(lerp(state.place, moved, 1.0), qd)


class ToolSpeed(_HeldSpeed):
    """speedl: the tool's velocity changes by ``a`` and ``a_rot`` and is then held."""

    def __init__(self, reach: Reach, q: Joints, qd: Joints) -> None:
        super().__init__(State(reach.pose(q), reach.twist(q, qd) if qd != ZERO6 else ZERO6))
        self.reach = reach

    def command(self, xd: Joints, a: float, a_rot: float, t: float | None) -> None:
        """Set a new tool velocity in the base frame [m/s, rad/s], accelerations [m/s2, rad/s2], duration [s] if any."""
        self._rule(xd, a, a_rot, t)

    def propose(self, h: float, q: Joints) -> Joints:
        pose = self._step(h).place
        return q if pose == self._now.place else self.reach.follow(pose, q)

    def joints_at_end(self, q: Joints) -> Joints:
        """See JointSpeed. Raises MotionFault if the pose is out of reach."""
        pose = self.end.place
        return q if pose == self._now.place else self.reach.follow(pose, q)

    def _run(self, state: State, command: _Command, h: float) -> State:
        change = sub(command.speed, state.speed)
        duration, duration_rot = _duration(norm3(*change[:3]), command.a), _duration(norm3(*change[3:]), command.a_rot)
        velocity, moved = _changed(state.speed, command.speed, duration, h)
        turning, turned = velocity, moved
        if duration != duration_rot:
            turning, turned = _changed(state.speed, command.speed, duration_rot, h)
        twist, way = (*velocity[:3], *turning[3:]), (*moved[:3], *turned[3:])
        return State(state.place if way == ZERO6 else pose_add(way, state.place), twist)


def _duration(change: float, a: float) -> float:
    """Duration of a change of speed [s]."""
    return change / a if a > 0.0 else inf if change else 0.0


def _changed(speed: Joints, goal: Joints, duration: float, h: float) -> tuple[Joints, Joints]:
    """Speed and displacement after h, if the speed changes linearly for ``duration`` and then stays constant."""
    if h < duration:
        end = lerp(speed, sub(goal, speed), h / duration)
        return end, scaled(lerp(speed, end, 1.0), 0.5 * h)
    return goal, lerp(scaled(goal, h), sub(goal, speed), -0.5 * duration)
