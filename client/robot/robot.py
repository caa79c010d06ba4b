"""`AsyncRobot`: the complete interface to an arm, in one class; the neighbouring modules implement it."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from client.blocking import thread_safe
from client.calibration import geometry_of
from client.driver import URDriver
from client.quantities import Checked, checked, checked_call
from client.robot.contact import Compliance, Contact, Force
from client.robot.diagnosis import Diagnosis
from client.robot.kinematics import Dynamics, Kinematics, Queries
from client.robot.motion import MotionRunner
from client.robot.moves import Moves
from client.robot.planned import PlannedMotion
from client.robot.programs import Dashboard, RobotPrograms
from client.robot.readiness import Readiness
from client.robot.settings import IO, Settings
from client.robot.state import MORE_OUTPUTS, OUTPUTS, RobotState
from client.robot.streaming import Streams
from client.robot.waypoints import Waypoints
from urproto.compat import Self
from urproto.errors import RobotRefused
from urproto.robots import Joints
from urproto.robots.pose import Pose

_FREE_PORTS: Final = {"reverse_port": 0, "trajectory_port": 0, "command_port": 0, "sender_port": 0}
_OPERATIONS: Final[Mapping[str, tuple[type, str]]] = {
    "_readiness": (Readiness, "make_ready recover require_program restart_program query"),
    "_motion": (MotionRunner, "moving stop wait_done wait_for check_free"),
    "_moves": (Moves, "move_j move_l move_p move_c sequence speed_j speed_l jog move_until_contact progress"),
    "planning": (PlannedMotion, "plan_to"),
    "_streams": (Streams, "servo_j servo_pose velocity_j velocity_l direct_torque stream"),
    "_waypoints": (Waypoints, "waypoints_j waypoints_pose"),
    "_compliance": (Compliance, "freedrive force_mode"),
    "driver": (URDriver, "set_payload set_target_payload set_gravity"),
    "_settings": (
        Settings,
        "set_digital_out set_tcp set_speed_slider set_watchdog kick_watchdog trigger_protective_stop",
    ),
    "_queries": (Queries, "tcp_offset history is_steady step_time target_waypoint"),
}
"""The operations of the robot: the attribute that carries them out, its class, and their names."""


class Offered:
    """An operation of a part of an object, as an operation of that object."""

    def __init__(self, part: str, function: Any) -> None:
        self._part = part
        self._function = function

    def __get__(self, owner: Any, kind: type) -> Any:
        return self._function if owner is None else self._function.__get__(getattr(owner, self._part))


def _with_operations(kind: type[Checked]) -> type[Checked]:
    for part, (owner, names) in _OPERATIONS.items():
        for name in names.split():
            member = vars(owner)[name]
            setattr(kind, name, Offered(part, member if isinstance(member, property) else checked_call(member)))
    return kind


@_with_operations
@checked
class AsyncRobot:
    """A robot for asyncio programs; use it with ``async with``. Options are those of `client.driver.DriverConfig`.

    The driver listens on free ports unless you give its ports, for example because of a firewall.

    **Moves** end by themselves. Joint angles are (6,) [rad], base to wrist 3; poses are base to TCP (6,) [m, rotation
    vector]. With ``wait=False`` a call returns as soon as the motion has begun; see `wait_done`, `moving`, `wait_for`
    and `stop`. The next motion replaces such a motion: the arm slows down and continues from there. While another
    caller waits for a motion, starting a second one raises LocalProtocolError.

    **Contexts** (`servo_j` to `force_mode`) last as long as their block. Only one is possible at a time, and leaving it
    brings the arm to rest.

    Moves and contexts start the control program if it has not been started, and restart it if it ended because this
    machine was late. If it ended for any other reason, only `make_ready` starts it again: it may have been stopped on
    purpose. They raise OutOfReachError before anything moves, for the first target out of reach; ProtectiveStopError,
    and SafetyStopError with the cause that the robot reports; MotionStoppedError and ProgramEndedError; RobotRefused in
    a mode in which the arm cannot move; RobotUnreachableError.

    **Settings** work with and without the control program, and during a motion. They raise LocalProtocolError for
    invalid values, and RobotRefused if no effect is seen.

    Kinematics, dynamics, contact, force, planning, I/O, other programs and the dashboard are components, listed below.
    All other operations are those of `_OPERATIONS`: each is written in the module of its class.
    """

    driver: URDriver
    """The driver, for everything that the vendor's control program can do."""
    kinematics: Kinematics
    """Forward and inverse kinematics, computed by the controller."""
    dynamics: Dynamics
    """Mass matrix and torques, computed by the controller."""
    contact: Contact
    """Tool contact detection."""
    force: Force
    """The force/torque sensor, and parameters of the active force mode."""
    planning: PlannedMotion
    """Motions planned around obstacles."""
    io: IO
    """Analog signals, tool voltage and registers."""
    programs: RobotPrograms
    """Programs other than the control program."""
    dashboard: Dashboard
    """The robot's dashboard."""

    def __init__(self, host: str, **options: Any) -> None:
        defaults = {"outputs_if_any": MORE_OUTPUTS, **(_FREE_PORTS if options.get("headless", True) else {})}
        outputs = tuple(dict.fromkeys((*OUTPUTS, *options.pop("outputs", ()))))
        self.driver = URDriver(host, **(defaults | options), outputs=outputs)
        self._diagnosis = Diagnosis(self.driver)
        self._readiness = Readiness(self.driver, self._diagnosis)
        self._motion = MotionRunner(self._readiness)
        self._moves = Moves(self._motion)
        self._streams = Streams(self._motion)
        self._waypoints = Waypoints(self._motion, self._streams)
        self._compliance = Compliance(self._motion)
        self._settings = Settings(self._motion)
        self._queries = Queries(self._readiness)
        self.kinematics = Kinematics(self._readiness)
        self.dynamics = Dynamics(self._readiness)
        self.contact = Contact(self._readiness)
        self.force = Force(self._readiness)
        self.planning = PlannedMotion(self._motion, self._moves)
        self.io = IO(self.driver)
        self.programs = RobotPrograms(self._motion)
        self.dashboard = Dashboard(self.driver)

    async def __aenter__(self) -> Self:
        """Connect. The arm does not move, and a program that is running on the robot continues."""
        await self.driver.__aenter__()
        self._diagnosis.watch()
        return self

    async def __aexit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Stop the arm and disconnect.

        Raises the failure of a motion that has not been reported to a caller yet, unless the block itself failed.
        """
        failure: BaseException | None = None
        try:
            failure = await self._motion.close()
        finally:
            await self.driver.__aexit__(kind, error, trace)
        if failure is not None and error is None:
            raise failure

    @property
    def state(self) -> RobotState:
        """The newest state, whatever its age (``state.age_s``)."""
        return RobotState(self.driver.state)

    @property
    def _fresh(self) -> RobotState:
        return RobotState(self.driver.link.feed.fresh())

    @property
    def q(self) -> Joints:
        """Joint angles (6,) [rad], base to wrist 3. Raises StaleStateError if they are older than ``max_age_s``."""
        return self._fresh.q_rad

    @property
    def tcp_pose(self) -> Pose:
        """TCP in the base frame (6,) [m, rotation vector]. Raises StaleStateError if it is older than ``max_age_s``."""
        return self._fresh.pose_base_tcp

    @thread_safe
    def digital_in(self, number: int) -> bool:
        """Level of a digital input: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool."""
        return self._fresh.digital_in(number)

    @thread_safe
    def digital_out(self, number: int) -> bool:
        """Level of a digital output, numbered like the inputs."""
        return self._fresh.digital_out(number)

    @thread_safe
    def tcp_pose_at(self, q_rad: Sequence[float]) -> Pose:
        """TCP pose in the base frame (6,) at these joint angles (6,) [rad], from the geometry that this arm reports.

        Raises RobotRefused if the robot has not reported its geometry yet, or if its geometry is unknown.
        """
        link = self.driver.link
        arm, state = link.configuration, link.primary_state
        geometry = None if arm is None else geometry_of(arm, link.calibration)
        if geometry is None or state is None or state.cartesian is None:
            raise RobotRefused(
                "its geometry", "it has not reported a known one", "let the robot compute it: get_forward_kin()"
            )
        return geometry.forward(q_rad, state.cartesian.tcp_offset)
