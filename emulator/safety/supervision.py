"""Monitoring by the safety system: the arm's actual state against its limits.

There are two layers, as in a controller. A limit is violated once a value has exceeded it by more than the tolerance
for the detection time. Before that, the arm makes a protective stop if it could not stop inside a boundary, deviates
from its path, or collides.

Source of tolerances and detection times: hardware manuals, tables of the safety functions. The worst case for CB3 is
100 ms for positions and 250 ms for the rest; that e-Series takes as long is a guess.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import hypot, radians
from typing import TYPE_CHECKING, Final, NamedTuple

from emulator.robot.arm import Arm
from emulator.safety.causes import Cause
from emulator.safety.geometry import Boundaries, clamping_room, tool_deviation
from urproto.modes import SafetyMode
from urproto.robots.model import RobotModel
from urproto.vectors import ZERO6, largest, within
from urproto.versions import Series
from urscript.polyscope.safety_configuration import LimitSet

if TYPE_CHECKING:
    from emulator.world.links import Links

_POSITION_S: Final = 0.1
_MOTION_S: Final = 0.25
_COLLISION_S: Final = 0.024  # guess: three periods of a CB3
_PATH_DEVIATION_RAD: Final = 0.1  # guess
_APPROACHING: Final = 1e-4  # m/s or rad/s; a slower motion does not count as an approach
_REACTION_PERIODS: Final = 2.0  # from detection until the arm slows down
_HALT_M: Final = 0.001  # distance from a boundary that remains after a stop (guess)
_HALT_RAD: Final = 0.001
_ROUNDING_RAD: Final = 1e-6  # rounding error of a joint that has braked at its limit
_POSITIONS: Final = frozenset(
    {Cause.JOINT_POSITION_VIOLATION, Cause.TCP_POSITION_VIOLATION, Cause.TCP_ORIENTATION_VIOLATION}
)


class Finding(NamedTuple):
    """A cause, the joint that caused it if there is one, and a text with the values."""

    cause: Cause
    joint: int | None
    text: str


@dataclass(frozen=True, slots=True)
class _Tolerances:
    joint_position: float
    plane: float
    orientation: float
    joint_speed: float = radians(1.15)
    speed: float = 0.05
    force: float = 25.0
    momentum: float = 3.0
    power: float = 10.0


_TOLERANCES: Final = {
    Series.CB3: _Tolerances(joint_position=radians(1.15), plane=0.02, orientation=radians(1.15)),
    Series.E: _Tolerances(joint_position=radians(5.0), plane=0.04, orientation=radians(3.0)),
}


class Supervision:
    """Checks the arm in each control period in which it moves or its loads change."""

    def __init__(self, model: RobotModel, period_s: float, *, self_collision: bool = False) -> None:
        self._model = model
        self._period = period_s
        self._deceleration = min(model.qdd_max)
        self._tolerances = _TOLERANCES[model.series]
        self._clamps = model.series is Series.E
        self._lasting: dict[Cause, float] = {}  # how long each limit has been exceeded [s]
        self._collision_s = 0.0
        self._released = False  # since the last check
        self._carried_N = 0.0  # of the force on the tool when the arm was released, what is left
        self._deviation_before: float | None = None
        self._clamping_before: float | None = None
        self._clamping_room = 0.0
        self._wrist_before = (0.0, 0.0)
        self._wrist_m = hypot(*model.dh.d[3:])
        self._links = _links(model) if self_collision else None
        self._clearance_before: float | None = None

    @property
    def pending(self) -> bool:
        """Whether a limit is exceeded but not yet for long enough: checks must continue even if nothing changes."""
        return bool(self._lasting) or self._collision_s > 0.0

    def reset(self) -> None:
        """The arm is stopped or off: restart all detection times."""
        self._lasting.clear()
        self._collision_s = 0.0
        self._released = False
        self._deviation_before = self._clamping_before = self._clearance_before = None

    def released(self) -> None:
        """The arm is released from a stop, or by its brakes: the force that it carries now is no violation, because it
        could not be moved out of a contact otherwise. A larger one is (guess, as in `emulator.robot.collisions`)."""
        self._released = True

    # violations

    def violation(self, arm: Arm, limits: LimitSet, boundaries: Boundaries, mode: SafetyMode) -> Finding | None:
        """Return the limit that has been exceeded for too long, if any."""
        self._relieve(arm)
        if not self._lasting and not boundaries.any and self._well_within(arm, limits):
            return None
        exceeded = {finding.cause: finding for finding in self._exceeded(arm, limits, boundaries, mode)}
        self._lasting = {cause: self._lasting.get(cause, 0.0) + self._period for cause in exceeded}
        for cause, lasted in self._lasting.items():
            if lasted >= (_POSITION_S if cause in _POSITIONS else _MOTION_S):
                return exceeded[cause]
        return None

    def _relieve(self, arm: Arm) -> None:
        """Note what a released arm carries, and less of it as it is relieved."""
        if not (self._released or self._carried_N):
            return
        force = hypot(*arm.wrench[:3])
        self._carried_N = force if self._released else min(self._carried_N, force)
        self._released = False

    def _well_within(self, arm: Arm, limits: LimitSet) -> bool:
        """Fast check, sufficient in nearly every period: nothing exceeds a limit, even without tolerance."""
        if not within(limits.joint_min, arm.q, limits.joint_max) or largest(arm.qd) > min(limits.joint_speed):
            return False
        free = arm.wrench == ZERO6
        if free and arm.certainly_below(min(limits.tcp_speed, limits.elbow_speed), limits.momentum):
            return True
        u, v, w, *_ = arm.tcp_speed
        x, y, z = arm.elbow_velocity
        f, g, h, *_ = arm.wrench
        speed, force = u * u + v * v + w * w, f * f + g * g + h * h
        return (
            speed <= limits.tcp_speed * limits.tcp_speed
            and x * x + y * y + z * z <= limits.elbow_speed * limits.elbow_speed
            and arm.efforts.momentum <= limits.momentum
            and force <= limits.force * limits.force
            and speed * force <= limits.power * limits.power  # upper bound of the power at this force and speed
        )

    def _exceeded(self, arm: Arm, limits: LimitSet, boundaries: Boundaries, mode: SafetyMode) -> Iterator[Finding]:
        yield from self._joints(arm, limits)
        yield from self._motion(arm, limits)
        if boundaries.any:
            yield from self._boundaries(arm, boundaries, mode, self._tolerances)

    def _joints(self, arm: Arm, limits: LimitSet) -> Iterator[Finding]:
        slack, speed_slack = self._tolerances.joint_position, self._tolerances.joint_speed
        for joint, (q, low, high) in enumerate(zip(arm.q, limits.joint_min, limits.joint_max, strict=True)):
            if not low - slack <= q <= high + slack:
                yield Finding(
                    Cause.JOINT_POSITION_VIOLATION,
                    joint,
                    f"joint {joint} is at {q:.3f} rad, its limits are {low:.3f} and {high:.3f} rad",
                )
        for joint, (qd, most) in enumerate(zip(arm.qd, limits.joint_speed, strict=True)):
            if abs(qd) > most + speed_slack:
                text = f"joint {joint} moves at {abs(qd):.3f} rad/s, its limit is {most:.3f} rad/s"
                yield Finding(Cause.JOINT_SPEED_VIOLATION, joint, text)

    def _motion(self, arm: Arm, limits: LimitSet) -> Iterator[Finding]:
        slack = self._tolerances
        u, v, w, *_ = arm.tcp_speed
        x, y, z, *_ = arm.wrench
        speed, force, power = hypot(u, v, w), hypot(x, y, z), abs(u * x + v * y + w * z)
        if speed > limits.tcp_speed + slack.speed:
            yield _over(Cause.TCP_SPEED_VIOLATION, "tool speed", speed, limits.tcp_speed, "m/s")
        if (elbow := hypot(*arm.elbow_velocity)) > limits.elbow_speed + slack.speed:
            yield _over(Cause.ELBOW_SPEED_VIOLATION, "elbow speed", elbow, limits.elbow_speed, "m/s")
        if force > max(limits.force, self._carried_N) + slack.force:
            yield _over(Cause.FORCE_VIOLATION, "force on the tool", force, limits.force, "N")
        if power > limits.power + slack.power:
            yield _over(Cause.POWER_VIOLATION, "power", power, limits.power, "W")
        if (momentum := arm.efforts.momentum) > limits.momentum + slack.momentum:
            yield _over(Cause.MOMENTUM_VIOLATION, "momentum", momentum, limits.momentum, "kg m/s")

    def _boundaries(self, arm: Arm, boundaries: Boundaries, mode: SafetyMode, slack: _Tolerances) -> Iterator[Finding]:
        planes = boundaries.planes(mode)
        for point in boundaries.points(arm) if planes else ():
            for plane in planes:
                depth = plane.depth(point.at) - point.radius
                if depth < -slack.plane and (plane.elbow or not point.is_elbow):
                    what = "elbow" if point.is_elbow else "tool"
                    text = f'the {what} is {-1000.0 * depth:.0f} mm beyond the safety plane "{plane.name}"'
                    yield Finding(Cause.TCP_POSITION_VIOLATION, None, text)
        orientation = boundaries.orientation(mode)
        if orientation and (angle := tool_deviation(orientation, arm)) > orientation.deviation + slack.orientation:
            yield _over(Cause.TCP_ORIENTATION_VIOLATION, "tool tilt", angle, orientation.deviation, "rad")

    def outside(self, arm: Arm, limits: LimitSet, boundaries: Boundaries, mode: SafetyMode) -> bool:
        """Whether the arm is outside its position limits, without tolerance."""
        exact = _Tolerances(joint_position=_ROUNDING_RAD, plane=0.0, orientation=0.0)
        slack = exact.joint_position
        joints = zip(arm.q, limits.joint_min, limits.joint_max, strict=True)
        return not all(low - slack <= q <= high + slack for q, low, high in joints) or any(
            self._boundaries(arm, boundaries, mode, exact)
        )

    # protective stops

    def protective_stop(
        self, arm: Arm, boundaries: Boundaries, mode: SafetyMode, is_stiff: Callable[[], bool]
    ) -> Finding | None:
        """Return the cause of a protective stop, if any. is_stiff: whether the arm holds its path, not compliant."""
        found = self._deviation(arm) or self._collision(arm, is_stiff)
        if found is None and boundaries.any:
            found = self._near_plane(arm, boundaries, mode) or self._near_orientation(arm, boundaries, mode)
        if found is None and self._clamps:
            found = self._clamping(arm)
        if found is None and self._links is not None:
            found = self._touching(self._links, arm)
        return found

    def _deviation(self, arm: Arm) -> Finding | None:
        errors = arm.following_error
        if errors is ZERO6 or not any(errors):
            return None
        for joint, error in enumerate(errors):
            if abs(error) > _PATH_DEVIATION_RAD:
                text = f"joint {joint} is {abs(error):.3f} rad from its target: check payload and acceleration"
                return Finding(Cause.PATH_DEVIATION, joint, text)
        return None

    def _collision(self, arm: Arm, is_stiff: Callable[[], bool]) -> Finding | None:
        if arm.collisions.ratio < 1.0 or not is_stiff():
            self._collision_s = 0.0
            return None
        self._collision_s += self._period
        if self._collision_s < _COLLISION_S:
            return None
        self._collision_s = 0.0
        shares = arm.collisions.shares
        joint = shares.index(max(shares))
        text = f"joint {joint} is obstructed: its current is off the model by {shares[joint]:.1f} times the window"
        return Finding(Cause.COLLISION, joint, text)

    def _stop_share_s(self, arm: Arm) -> float:
        """Stopping distance divided by speed: the reaction time plus half the braking time."""
        fastest = max(map(abs, arm.qd))
        return _REACTION_PERIODS * self._period + 0.5 * fastest / self._deceleration

    def _near_plane(self, arm: Arm, boundaries: Boundaries, mode: SafetyMode) -> Finding | None:
        planes = boundaries.planes(mode)
        if not planes or not any(arm.qd):
            return None
        share = self._stop_share_s(arm)
        for point in boundaries.points(arm):
            for plane in planes:
                u, v, w = plane.normal
                speed = -(u * point.speed[0] + v * point.speed[1] + w * point.speed[2])
                room = plane.depth(point.at) - point.radius - speed * share
                if speed > _APPROACHING and room < _HALT_M and (plane.elbow or not point.is_elbow):
                    what, cause = ("elbow", self._elbow_cause) if point.is_elbow else ("tool", Cause.SAFETY_PLANE)
                    return Finding(cause, None, f'the {what} is close to the safety plane "{plane.name}": move it away')
        return None

    @property
    def _elbow_cause(self) -> Cause:
        return Cause.ELBOW_PLANE if self._model.series is Series.E else Cause.SAFETY_PLANE

    def _near_orientation(self, arm: Arm, boundaries: Boundaries, mode: SafetyMode) -> Finding | None:
        orientation = boundaries.orientation(mode)
        if orientation is None:
            self._deviation_before = None
            return None
        angle = tool_deviation(orientation, arm)
        before, self._deviation_before = self._deviation_before, angle
        rate = (angle - before) / self._period if before is not None else 0.0
        if rate <= _APPROACHING or angle + rate * self._stop_share_s(arm) < orientation.deviation - _HALT_RAD:
            return None
        text = f"the tool is tilted by {angle:.3f} rad, {orientation.deviation:.3f} rad are allowed: turn it back"
        return Finding(Cause.TOOL_ORIENTATION, None, text)

    def _clamping(self, arm: Arm) -> Finding | None:
        # only joints 4 and 5 move the flange relative to the lower arm: no check is needed until they could reach it
        wrist, (fourth, fifth) = arm.q[3:5], self._wrist_before
        self._wrist_before = wrist
        self._clamping_room -= (abs(wrist[0] - fourth) + abs(wrist[1] - fifth)) * self._wrist_m
        if self._clamping_room > 0.0:
            return None
        self._clamping_room = room = clamping_room(self._model, arm)
        before, self._clamping_before = self._clamping_before, room
        if room >= 0.0 or before is None or room >= before:
            return None
        text = f"the flange is {-1000.0 * room:.1f} mm too close to the lower arm, where it clamps hands: move it away"
        return Finding(Cause.CLAMPING, None, text)

    def _touching(self, links: "Links", arm: Arm) -> Finding | None:
        """Contact of the arm with itself; the fastest joint is the one that detects it (guess)."""
        if not any(arm.qd):
            return None
        clearance = links.clearance(arm.q)
        before, self._clearance_before = self._clearance_before, clearance
        if clearance > 0.0 or before is None or clearance >= before:
            return None
        speeds = [abs(speed) for speed in arm.qd]
        joint = speeds.index(max(speeds))
        return Finding(Cause.COLLISION, joint, f"joint {joint} has moved the arm against itself: move it back")


def _links(model: RobotModel) -> "Links":
    from emulator.world.links import Links  # imports coal and numpy, which printing the options should not wait for

    return Links(model)


def _over(cause: Cause, what: str, value: float, limit: float, unit: str) -> Finding:
    return Finding(cause, None, f"{what} is {value:.3f} {unit}, the limit is {limit:.3f} {unit}")
