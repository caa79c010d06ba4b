"""Streaming of targets: servoj and servoc.

servoj is a critically damped follower whose lag behind a steadily moving target is

    0.3 * lookahead_time + 0.7 / sqrt(gain)

(25 ms with 0.03 and 2000, 70 ms with the defaults 0.1 and 300). It is based on two measurements; that it is linear in
both terms is a guess:

- Target angles of a UR5 with the defaults: 60 to 80 ms, in the shape of a first or second order lag
  (el-Lennard/Robotik, Modularbeit Code/A2_servoj.csv).
- A UR10e with 0.03 and 1200: 34 ms from a command to the angle, of which 5 ms are the connection
  (UniversalRobots/Universal_Robots_Client_Library, issue 86).

A UR5 with 0.03 and 2000 agrees: 35 ms including all delays of a driver (Universal_Robots_ROS2_Driver, issue 1311).

A distant target is approached within the joints' limits, without overshoot. A target that moves from command to command
is followed at the above lag whatever its speed: the joint brakes for it as if it kept its speed. If it suddenly stops,
it is overshot by the part of the braking distance that exceeds the lag (guess).
"""

from math import exp, inf, sqrt

from emulator.motion.faults import slider_raised
from emulator.motion.generator import Clock
from emulator.motion.legs import path_length
from emulator.motion.profile import Limits
from emulator.motion.reach import Reach
from urproto.robots.model import Joints, RobotModel
from urproto.robots.pose import Pose, point_dist, pose_add, pose_sub
from urproto.vectors import ZERO6, largest, lerp, norm3, scaled, scaled_sub, sub

LOOKAHEAD_RANGE_S = (0.03, 0.2)  # Script Manual, servoj; values outside are clamped (guess)
GAIN_RANGE = (100.0, 2000.0)  # Script Manual, servoj
_LAG_OF_LOOKAHEAD, _LAG_OF_GAIN = 0.3, 0.7  # see above

_TIME_TOLERANCE = 1e-9  # s
_BRAKE_SHARE = 0.8  # of the acceleration is used to plan the approach to a distant target; the rest corrects
_ARRIVED_RAD = 1e-7  # closer and slower than this, the arm counts as at rest on its target (guess)
_ARRIVED_RAD_S = 1e-5


class JointServo:
    """servoj: follows the newest joint target; keeps its speed from one command to the next."""

    clock = Clock.SCALED

    def __init__(self, reach: Reach, q: Joints, qd: Joints) -> None:
        self._reach = reach
        self._model: RobotModel = reach.model
        self._target = q
        self._target_qd = ZERO6  # its speed according to the last two commands
        self._since = 0.0  # program time since the last command
        self._at = self._next_at = q
        self._qd = self._next = qd
        self._omega = 1.0
        self._left = 0.0  # remaining time of the command; negative once it is over
        self._h = self._next_h = 0.0  # the last step
        self._begun = False
        self._overdue = False  # it was ready before the last step
        self._slider_at_0 = False

    def slider(self, fraction: float) -> None:
        """Set the speed slider's value for this period. Raises MotionFault if it was at 0 and no longer is."""
        if self._slider_at_0 and fraction > 0.0:
            raise slider_raised()
        self._slider_at_0 = fraction <= 0.0

    def command(self, target: Joints, t: float, lookahead_time: float, gain: float) -> None:
        """Set a new target [rad], valid for t seconds of program time, at least one period."""
        lag = _LAG_OF_LOOKAHEAD * _within(lookahead_time, LOOKAHEAD_RANGE_S)
        lag += _LAG_OF_GAIN / sqrt(_within(gain, GAIN_RANGE))
        self._omega = 2.0 / lag
        if self._since > 0.0:
            self._target_qd = ZERO6 if self._overdue else scaled_sub(target, self._target, 1.0 / self._since)
        self._target, self._since = target, 0.0
        # a program that commands in step with the periods loses none of its time: see emulator.motion.speed
        carried = self._left if self.ready and not self._overdue and self._left > -self._h else 0.0
        self._left, self._begun = t + carried, False

    def propose(self, h: float, q: Joints) -> Joints:
        self._next_h = h
        model, omega, decay = self._model, self._omega, exp(-self._omega * h)
        target_qd = ZERO6 if self.ready else self._target_qd  # without a new command, the target counts as standing
        positions, speeds = [], []
        for now, qd, target, towards, most, acceleration in zip(
            q, self._qd, self._target, target_qd, model.qd_max, model.qdd_max, strict=True
        ):
            # the exact step of the critically damped follower, unless a limit is lower
            error = now - target
            slope = qd + omega * error
            speed = (qd - omega * slope * h) * decay
            position = target + (error + slope * h) * decay
            # at the end of this step the joint must still be able to brake to the target
            change = acceleration * h
            slowing = 0.5 * _BRAKE_SHARE * change
            left = abs(error) - 0.5 * h * (-qd if error > 0.0 else qd)
            # beyond the target's own speed; braking from it takes surplus * (surplus + 2 * slowing) of twice the room
            surplus = abs(speed) - (max(0.0, towards) if speed > 0.0 else max(0.0, -towards))
            room = 2.0 * _BRAKE_SHARE * acceleration * left
            if (
                abs(speed) > most
                or abs(speed - qd) > change
                or (surplus > 0.0 and surplus * (surplus + 2.0 * slowing) > room)
            ):
                braking = sqrt(slowing * slowing + room) - slowing if left > 0.0 else 0.0
                highest = min(most, braking + towards if towards > 0.0 else braking)
                lowest = -min(most, braking - towards if towards < 0.0 else braking)
                speed = max(qd - change, min(qd + change, max(lowest, min(highest, speed))))
                position = now + 0.5 * (qd + speed) * h
            positions.append(position)
            speeds.append(speed)
        a, b, c, d, e, f = positions
        self._next_at = (a, b, c, d, e, f)
        a, b, c, d, e, f = speeds
        self._next = (a, b, c, d, e, f)
        if self._settled(self._next_at, self._next):
            self._next, self._next_at = ZERO6, self._target
        return self._next_at

    def _settled(self, q: Joints, qd: Joints) -> bool:
        return largest(sub(q, self._target)) < _ARRIVED_RAD and largest(qd) < _ARRIVED_RAD_S

    def commit(self) -> None:
        self._overdue = self.ready
        self._at, self._qd, self._h = self._next_at, self._next, self._next_h
        self._left -= self._h
        self._since += self._h
        self._begun = True

    @property
    def done(self) -> bool:
        return self.ready and self._qd == ZERO6 and self._at == self._target

    @property
    def ready(self) -> bool:
        return self._begun and self._left <= 0.5 * self._h + _TIME_TOLERANCE

    def goal(self) -> Pose:
        return self._reach.pose(self._target)


class ToolServo:
    """servoc: the tool moves towards the newest pose at limited speed; its velocity changes by limited acceleration.

    Ready within ``radius_m`` of the pose.
    """

    clock = Clock.SCALED

    def __init__(self, reach: Reach, q: Joints, qd: Joints) -> None:
        self.reach = reach
        self._pose = self._next_pose = reach.pose(q)
        self._twist = self._next = reach.twist(q, qd) if qd != ZERO6 else ZERO6
        self._target = self._pose
        self._limits = Limits(1.0, 1.0)
        self._radius = 0.0
        self._begun = False
        self._step_m = self._next_step_m = 0.0  # the tool's displacement in the last period, rotation included
        self._from = self._next_from = q  # and where it began

    def command(self, target: Pose, limits: Limits, radius_m: float) -> None:
        """Set a new target pose in the base frame."""
        self._target, self._limits, self._radius = target, limits, radius_m
        self._begun = False

    def propose(self, h: float, q: Joints) -> Joints:
        pose, a = self._pose, self._limits.acceleration
        error = pose_sub(self._target, pose)
        length = self._length(error)
        braking = min(a, self._followable_acceleration(q))
        brake = _BRAKE_SHARE * braking * h  # change of speed per period while braking at the end
        if length <= brake * h and self._length(self._twist) <= 2.0 * braking * h:
            self._next, self._next_pose = ZERO6, self._target
        else:
            speed = min(self._limits.speed, sqrt(0.25 * brake * brake + 2.0 * brake * length / h) - 0.5 * brake)
            wanted = scaled(error, speed / length) if length > 0.0 else ZERO6
            change = sub(wanted, self._twist)
            size = self._length(change)
            self._next = now = wanted if size <= a * h else lerp(self._twist, change, a * h / size)
            self._next_pose = pose_add(scaled(now, h), pose)
        self._next_step_m, self._next_from = self._length(self._next) * h, q
        return q if self._next_pose == pose else self.reach.follow(self._next_pose, q)

    def _followable_acceleration(self, q: Joints) -> float:
        """Tool acceleration that the joints can follow at the last step [m/s2]: small near a singularity."""
        moved = sub(q, self._from)
        hardest = max(abs(way) / most for way, most in zip(moved, self.reach.model.qdd_max, strict=True))
        return self._step_m / hardest if hardest > 0.0 and self._step_m > 0.0 else inf

    def _length(self, screw: Joints) -> float:
        """Magnitude of a change of pose or a tool velocity, with rotation at the equivalent radius: m, m/s."""
        return path_length(norm3(*screw[:3]), norm3(*screw[3:]), self.reach.model.eq_radius)

    def commit(self) -> None:
        self._pose, self._twist = self._next_pose, self._next
        self._step_m, self._from = self._next_step_m, self._next_from
        self._begun = True

    @property
    def done(self) -> bool:
        return self._begun and self._twist == ZERO6 and self._pose == self._target

    @property
    def ready(self) -> bool:
        if not self._begun:
            return False
        near = point_dist(self._target, self._pose)
        return self.done or (self._radius > 0.0 and near <= self._radius)

    def goal(self) -> Pose:
        return self._target


def _within(value: float, bounds: tuple[float, float]) -> float:
    return max(bounds[0], min(bounds[1], value))
