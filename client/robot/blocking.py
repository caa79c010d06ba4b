"""`Robot`: the blocking counterpart of `AsyncRobot`, for scripts and notebooks."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractAsyncContextManager, AbstractContextManager, contextmanager
from functools import partial
from typing import Any, Concatenate, ParamSpec, TypeVar

from client.dashboard_commands import Operation
from client.driver.blocking import (
    Blocking,
    BlockingPart,
    blocking,
    blocking_context,
    direct,
    entered_context,
    named_after,
)
from client.driver.endpoint import StreamStatistics
from client.driver.scheduling import real_time
from client.robot.contact import Contact, Force
from client.robot.facade import AsyncRobot
from client.robot.io import IO
from client.robot.kinematics import Dynamics, Kinematics
from client.robot.planned import PlannedMotion
from client.robot.programs import Dashboard, Programs
from client.robot.state import RobotState
from client.robot.streaming import Follow
from urproto.robots import Joints
from urproto.robots.pose import Pose

Answer = TypeVar("Answer")
Given = ParamSpec("Given")


class BlockingKinematics(BlockingPart[Kinematics]):
    """Blocking counterpart of `Kinematics`."""

    forward = blocking(Kinematics.forward)
    inverse = blocking(Kinematics.inverse)
    has_solution = blocking(Kinematics.has_solution)
    pose_within_limits = blocking(Kinematics.pose_within_limits)
    joints_within_limits = blocking(Kinematics.joints_within_limits)
    jacobian = blocking(Kinematics.jacobian)
    jacobian_time_derivative = blocking(Kinematics.jacobian_time_derivative)
    flange_pose = blocking(Kinematics.flange_pose)
    freedrive_status = blocking(Kinematics.freedrive_status)
    pose_trans = staticmethod(Kinematics.pose_trans)


class BlockingDynamics(BlockingPart[Dynamics]):
    """Blocking counterpart of `Dynamics`."""

    mass_matrix = blocking(Dynamics.mass_matrix)
    coriolis_torques = blocking(Dynamics.coriolis_torques)
    joint_torques = blocking(Dynamics.joint_torques)
    target_accelerations = blocking(Dynamics.target_accelerations)


class BlockingContact(BlockingPart[Contact]):
    """Blocking counterpart of `Contact`."""

    steps = blocking(Contact.steps)
    start_detection = blocking(Contact.start_detection)
    detected = blocking(Contact.detected)
    stop_detection = blocking(Contact.stop_detection)


class BlockingForce(BlockingPart[Force]):
    """Blocking counterpart of `Force`."""

    zero_sensor = blocking(Force.zero_sensor)
    set_mode_parameters = blocking(Force.set_mode_parameters)
    use_external_sensor = blocking(Force.use_external_sensor)
    set_external_wrench = blocking(Force.set_external_wrench)


class BlockingPlannedMotion(BlockingPart[PlannedMotion]):
    """Blocking counterpart of `PlannedMotion`."""

    model = blocking(PlannedMotion.model)
    tcp_offset = direct(PlannedMotion.tcp_offset)
    plan = blocking(PlannedMotion.plan)
    plan_sequence = blocking(PlannedMotion.plan_sequence)
    compute_cartesian_path = blocking(PlannedMotion.compute_cartesian_path)
    execute = blocking(PlannedMotion.execute)


class BlockingIO(BlockingPart[IO]):
    """Blocking counterpart of `IO`."""

    set_analog_voltage = blocking(IO.set_analog_voltage)
    set_analog_current = blocking(IO.set_analog_current)
    analog_in = direct(IO.analog_in)
    analog_out = direct(IO.analog_out)
    set_tool_voltage = blocking(IO.set_tool_voltage)
    set_int_register = blocking(IO.set_int_register)
    set_double_register = blocking(IO.set_double_register)
    int_register = direct(IO.int_register)
    double_register = direct(IO.double_register)


class BlockingPrograms(BlockingPart[Programs]):
    """Blocking counterpart of `Programs`."""

    send = blocking(Programs.send)
    run = blocking(Programs.run)
    run_function = blocking(Programs.run_function)
    run_file = blocking(Programs.run_file)


class BlockingDashboard(BlockingPart[Dashboard]):
    """Blocking counterpart of `Dashboard`."""

    def request(self, operation: Operation[Answer]) -> Answer:
        """Carry out any operation of `client.dashboard_commands`; use its ``command("...")`` for any other command."""
        return self.call(self.inner.request(operation))

    power_on = blocking(Dashboard.power_on)
    power_off = blocking(Dashboard.power_off)
    brake_release = blocking(Dashboard.brake_release)
    unlock_protective_stop = blocking(Dashboard.unlock_protective_stop)
    restart_safety = blocking(Dashboard.restart_safety)
    close_safety_popup = blocking(Dashboard.close_safety_popup)
    load = blocking(Dashboard.load)
    play = blocking(Dashboard.play)
    pause = blocking(Dashboard.pause)
    stop = blocking(Dashboard.stop)
    popup = blocking(Dashboard.popup)
    close_popup = blocking(Dashboard.close_popup)
    add_to_log = blocking(Dashboard.add_to_log)
    shutdown = blocking(Dashboard.shutdown)
    set_user_role = blocking(Dashboard.set_user_role)
    robot_mode = blocking(Dashboard.robot_mode)
    safety_mode = blocking(Dashboard.safety_mode)
    safety_status = blocking(Dashboard.safety_status)
    running = blocking(Dashboard.running)
    program_state = blocking(Dashboard.program_state)
    loaded_program = blocking(Dashboard.loaded_program)
    is_program_saved = blocking(Dashboard.is_program_saved)
    is_in_remote_control = blocking(Dashboard.is_in_remote_control)
    polyscope_version = blocking(Dashboard.polyscope_version)
    robot_model = blocking(Dashboard.robot_model)
    serial_number = blocking(Dashboard.serial_number)


def _streaming(
    method: Callable[Concatenate[AsyncRobot, Given], AbstractAsyncContextManager[Follow]],
) -> Callable[Concatenate[Any, Given], AbstractContextManager[Callable[[Sequence[float]], RobotState]]]:
    """Return the blocking form of a setpoint stream: the caller's thread sends directly, with real-time priority."""

    @contextmanager
    def enter(
        self: Blocking[AsyncRobot], /, *args: Given.args, **kwargs: Given.kwargs
    ) -> Iterator[Callable[[Sequence[float]], RobotState]]:
        realtime = self.inner.driver.config.realtime
        with entered_context(self, method(self.inner, *args, **kwargs)) as follow, real_time(realtime):
            yield partial(follow.from_thread, self.call)

    return named_after(method, enter)


class Robot(Blocking[AsyncRobot]):
    """A robot for scripts and notebooks; use it with ``with``.

    The blocking counterpart of `AsyncRobot`, which documents units, frames and errors. `stop` may be called from
    another thread. A KeyboardInterrupt during a move stops the arm.
    """

    def __init__(self, host: str, **options: Any) -> None:
        super().__init__(lambda: AsyncRobot(host, **options))
        self.kinematics = BlockingKinematics(self, lambda robot: robot.kinematics)
        self.dynamics = BlockingDynamics(self, lambda robot: robot.dynamics)
        self.contact = BlockingContact(self, lambda robot: robot.contact)
        self.force = BlockingForce(self, lambda robot: robot.force)
        self.planning = BlockingPlannedMotion(self, lambda robot: robot.planning)
        self.io = BlockingIO(self, lambda robot: robot.io)
        self.programs = BlockingPrograms(self, lambda robot: robot.programs)
        self.dashboard = BlockingDashboard(self, lambda robot: robot.dashboard)

    make_ready = blocking(AsyncRobot.make_ready)
    recover = blocking(AsyncRobot.recover)
    stop = blocking(AsyncRobot.stop)
    wait_done = blocking(AsyncRobot.wait_done)
    wait_for = blocking(AsyncRobot.wait_for)

    move_j = blocking(AsyncRobot.move_j)
    move_l = blocking(AsyncRobot.move_l)
    move_p = blocking(AsyncRobot.move_p)
    move_c = blocking(AsyncRobot.move_c)
    sequence = blocking(AsyncRobot.sequence)
    plan_to = blocking(AsyncRobot.plan_to)
    speed_j = blocking(AsyncRobot.speed_j)
    speed_l = blocking(AsyncRobot.speed_l)
    jog = blocking(AsyncRobot.jog)
    move_until_contact = blocking(AsyncRobot.move_until_contact)
    progress = blocking(AsyncRobot.progress)

    query = blocking(AsyncRobot.query)
    require_program = blocking(AsyncRobot.require_program)
    check_free = blocking(AsyncRobot.check_free)
    restart_program = blocking(AsyncRobot.restart_program)
    tcp_offset = blocking(AsyncRobot.tcp_offset)
    history = blocking(AsyncRobot.history)
    is_steady = blocking(AsyncRobot.is_steady)
    step_time = blocking(AsyncRobot.step_time)
    target_waypoint = blocking(AsyncRobot.target_waypoint)

    servo_j = _streaming(AsyncRobot.servo_j)
    servo_pose = _streaming(AsyncRobot.servo_pose)
    velocity_j = _streaming(AsyncRobot.velocity_j)
    velocity_l = _streaming(AsyncRobot.velocity_l)
    direct_torque = _streaming(AsyncRobot.direct_torque)
    freedrive = blocking_context(AsyncRobot.freedrive)
    force_mode = blocking_context(AsyncRobot.force_mode)

    digital_in = direct(AsyncRobot.digital_in)
    digital_out = direct(AsyncRobot.digital_out)
    set_digital_out = blocking(AsyncRobot.set_digital_out)
    set_payload = blocking(AsyncRobot.set_payload)
    set_target_payload = blocking(AsyncRobot.set_target_payload)
    set_gravity = blocking(AsyncRobot.set_gravity)
    set_tcp = blocking(AsyncRobot.set_tcp)
    set_watchdog = direct(AsyncRobot.set_watchdog)
    kick_watchdog = direct(AsyncRobot.kick_watchdog)
    trigger_protective_stop = blocking(AsyncRobot.trigger_protective_stop)
    set_speed_slider = blocking(AsyncRobot.set_speed_slider)

    @property
    def state(self) -> RobotState:
        """The newest state, whatever its age (``state.age_s``)."""
        return self.inner.state

    @property
    def q(self) -> Joints:
        """Joint angles (6,) [rad], base to wrist 3. Raises StaleStateError if they are older than ``max_age_s``."""
        return self.inner.q

    @property
    def tcp_pose(self) -> Pose:
        """TCP in the base frame (6,) [m, rotation vector]. Raises StaleStateError if it is older than ``max_age_s``."""
        return self.inner.tcp_pose

    def tcp_pose_at(self, q_rad: Sequence[float]) -> Pose:
        """TCP pose in the base frame (6,) at these joint angles (6,) [rad], from the geometry that this arm reports.

        Raises RobotRefused if the robot has not reported its geometry yet, or if its geometry is unknown.
        """
        return self.inner.tcp_pose_at(q_rad)

    @property
    def stream(self) -> StreamStatistics:
        """Statistics of the current or last setpoint stream: sent, skipped and late setpoints, longest gap."""
        return self.inner.stream

    @property
    def moving(self) -> bool:
        """True while a motion started by this object is under way."""
        return self.inner.moving
