"""Faults of the arm. Faults of feedback change what ports publish; programs still see true values (docs/faults.md)."""

from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Final, Literal

from msgspec import Meta

from emulator.faults.fault import Act, Fault, FaultImpossibleError, Site, Strikes, added, register, until_ended
from emulator.faults.network import NotNegative
from emulator.lifecycle.runstate import StopCause
from emulator.safety.causes import Cause
from emulator.snapshot import Snapshot
from urproto.modes import JointMode
from urproto.robots.pose import pose_trans
from urproto.vectors import Vector6, as_six

Sensor = Callable[[float, float], tuple[float, float]]  # rad, rad/s
Joint = Annotated[int, Meta(ge=0, le=5)]
_DEVIATION: Final = 153  # error code: the position deviates from the path


def _with(values: Vector6, joint: int, value: float) -> Vector6:
    return as_six(value if index == joint else other for index, other in enumerate(values))


@dataclass(frozen=True, kw_only=True)
class FeedbackFault(Fault):
    """A joint (0 is the base) is measured wrongly; the pose of the TCP follows from the measured angles.

    stop_above_rad: deviation from the target above which the controller triggers a protective stop, C153; 0 for
    never.
    """

    joint: Joint
    stop_above_rad: NotNegative = 0.0

    @abstractmethod
    def sensor(self, site: Site) -> Sensor:
        """A function of true angle and speed that returns the measured ones; called once per control period."""

    def claims(self, site: Site) -> set[str]:
        return {f"the feedback of joint {self.joint}"}

    def act(self, site: Site, strikes: Strikes) -> Act:
        measure, joint, controller = self.sensor(site), self.joint, site.controller

        def distort(snapshot: Snapshot) -> None:
            q, qd = measure(snapshot.actual_q[joint], snapshot.actual_qd[joint])
            snapshot.actual_q = _with(snapshot.actual_q, joint, q)
            snapshot.actual_qd = _with(snapshot.actual_qd, joint, qd)
            flange = controller.arm.kinematics.forward(snapshot.actual_q)
            snapshot.arm = snapshot.arm.measured_at(pose_trans(flange, snapshot.tcp_offset))

        with added(controller.snapshot_hooks, distort):
            while True:
                yield
                shown = controller.snapshot
                deviation = abs(shown.actual_q[joint] - shown.target_q[joint])
                if self.stop_above_rad and deviation > self.stop_above_rad and controller.power.running:
                    controller.protective_stop(StopCause(_DEVIATION, joint))


@register
class LaggingJoint(FeedbackFault):
    """A joint is measured where it was ``delay_s`` ago, plus an offset ``offset_rad``."""

    delay_s: NotNegative = 0.0
    offset_rad: float = 0.0

    def sensor(self, site: Site) -> Sensor:
        path: deque[tuple[float, float]] = deque(maxlen=site.periods(self.delay_s) + 1)

        def measure(q: float, qd: float) -> tuple[float, float]:
            path.append((q, qd))
            return path[0][0] + self.offset_rad, path[0][1]

        return measure


@register
class FrozenFeedback(FeedbackFault):
    """A joint is measured where it was when the fault began, with a speed of 0."""

    def sensor(self, site: Site) -> Sensor:
        held = site.controller.snapshot.actual_q[self.joint]
        return lambda q, qd: (held, 0.0)


@register
class EncoderJump(FeedbackFault):
    """The encoder of a joint jumps by ``by_rad``, and keeps that error."""

    by_rad: float

    def sensor(self, site: Site) -> Sensor:
        return lambda q, qd: (q + self.by_rad, qd)


@register
class JointFault(Fault):
    """A joint reports a fault or a violation; so does the safety system, repeatedly while the arm has power.

    To continue afterwards, proceed as on a robot: ``restart_safety``, power on, release the brakes.
    """

    joint: Joint
    severity: Literal["fault", "violation"] = "fault"

    def claims(self, site: Site) -> set[str]:
        return {f"the mode of joint {self.joint}"}

    def act(self, site: Site, strikes: Strikes) -> Act:
        controller = site.controller
        broken, cause = {
            "fault": (JointMode.FAULT, Cause.JOINT_FAULT),
            "violation": (JointMode.VIOLATION, Cause.JOINT_SPEED_VIOLATION),
        }[self.severity]

        def show(snapshot: Snapshot) -> None:
            modes = enumerate(snapshot.joint_mode)
            snapshot.joint_mode = tuple(broken if index == self.joint else mode for index, mode in modes)

        with added(controller.snapshot_hooks, show):
            while True:
                if controller.power.report.powered and controller.safety.power_allowed:
                    controller.safety_board.trip(cause, self.joint)
                yield


@register
class LostBrake(Fault):
    """The brake of a joint does not hold: without power the arm sags, as far as friction permits (dynamic arm)."""

    joint: Joint

    def claims(self, site: Site) -> set[str]:
        return {f"the brake of joint {self.joint}"}

    def check(self, site: Site) -> None:
        if site.controller.simulation.real.drives is None:
            raise FaultImpossibleError("an ideal arm has no weight and does not sag without a brake: use --arm dynamic")

    def act(self, site: Site, strikes: Strikes) -> Act:
        drives = site.controller.simulation.real.drives
        assert drives is not None
        drives.set_brake(self.joint, holds=False)
        yield from until_ended(lambda: drives.set_brake(self.joint, holds=True))
