"""The driver: complete access to a robot through External Control.

async with URDriver("192.168.56.101") as driver:
    await driver.start_program()
    await driver.execute([points.movej(q) for q in path])
"""

from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack
from typing import Any

from client.blocking import thread_safe
from client.driver.config import DriverConfig, calibration_problem
from client.driver.control_program import DECELERATION, SPEED_ACCELERATION
from client.driver.keep_alive import KeepAliveThread
from client.driver.link import RobotLink
from client.driver.program import ProgramSupervisor
from client.driver.results import ScriptCommandEndpoint, TrajectoryEndpoint
from client.driver.reverse import MAX_REAL_TIME_S, ReverseEndpoint
from client.driver.script_sender import ScriptSender
from client.driver.trajectories import Trajectories
from client.quantities import checked
from client.rtde import ReceivedState
from urproto.compat import Self
from urproto.errors import RobotRefused
from urproto.external_control import (
    ControlMode,
    FreedriveAction,
    Query,
    ScriptCommand,
    ScriptCommandKind,
    TrajectoryResult,
    to_words,
)
from urproto.modes import SafetyMode
from urproto.vectors import ZERO3, ZERO6
from urproto.versions import PolyscopeVersion


@checked
class URDriver(Trajectories):
    """External Control driver for asyncio programs; options are those of `DriverConfig`.

    **Setpoints** (`servoj` to `torque`, and freedrive) may be sent from any thread. timeout_s: how long the robot waits
    for the next message before it stops the arm, from one control period to 0.2 s. Each further setpoint must follow
    within this time, until `idle` or another mode. A later one is not sent: it raises LateSetpointError, and the
    control program continues.

    **Trajectories** are executed one at a time, whole or as a stream of points; client.driver.points creates the
    points. They raise ProgramEndedError if the program ends meanwhile, and LocalProtocolError for points that cannot
    be sent.

    **Commands** that change settings (payload, tool voltage, gravity, zeroing the sensor) also work without the control
    program: the driver then sends a small script.

    All other methods raise ProgramNotRunningError without the control program. Every method raises LocalProtocolError
    for invalid values, and RobotRefused for features that the robot's version does not have.

    In the order of this file, trajectories in `Trajectories`:

    - state: `version`, `state`, `next_state`
    - control program: `start_program`, `stop_program`, `wait_for_program`, `program_running`, `loss_reason`
    - safety and speed: `protective_stopped`, `on_safety_mode`, `recover`, `set_speed_slider`
    - setpoints: `servoj`, `servo_pose`, `speedj`, `speedl`, `torque`, `idle`; `start_freedrive` to `stop_freedrive`
    - trajectories: `execute`; `start_trajectory`, `trajectory_result`, `cancel_trajectory`; `start_stream`, `stream`,
      `end_stream`
    - commands, possible during any motion: payload, gravity, TCP, force mode, tool contact, friction; `query`
    """

    config: DriverConfig
    """Addresses, ports, rates and timeouts, as given."""
    link: RobotLink
    """Connections to the robot, and what it reports about itself."""
    program: ProgramSupervisor
    """The control program, and its parts below: the ports that it connects to, and the pulse."""
    reverse: ReverseEndpoint
    """The port for setpoints and modes."""
    sender: ScriptSender
    """The port from which the URCap fetches the program."""
    trajectory: TrajectoryEndpoint
    """The port for the points of trajectories."""
    commands: ScriptCommandEndpoint
    """The port for commands and queries."""
    keep_alive: KeepAliveThread
    """Keeps the program alive, or ends it if its watchdog is not kicked."""

    def __init__(self, host: str, **options: Any) -> None:
        self.config = DriverConfig(host=host, **options)
        self.link = RobotLink(self.config)
        self.program = program = ProgramSupervisor(self.config, self.link)
        self.reverse, self.sender, self.keep_alive = program.reverse, program.sender, program.keep_alive
        self.trajectory, self.commands = program.trajectory, program.commands
        super().__init__()
        self._open = AsyncExitStack()

    async def __aenter__(self) -> Self:
        """Connect, check the calibration and open the ports; the program is not started yet.

        Raises the errors of client.errors, RobotRefused for a wrong calibration, and OSError for a port that is in use.
        """
        async with AsyncExitStack() as opening:
            await opening.enter_async_context(self.link)
            problem = calibration_problem(await self.link.kinematics(), self.config.calibration)
            if problem is not None:
                raise RobotRefused("the calibration check", problem)
            await opening.enter_async_context(self.program)
            self._open = opening.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        """End the program, which stops the arm, and close everything."""
        await self._open.aclose()

    @property
    def version(self) -> PolyscopeVersion:
        """The robot's PolyScope version."""
        return self.link.version

    @property
    def state(self) -> ReceivedState:
        """The newest RTDE state, by variable name, whatever its age (``state.age_s``)."""
        return self.link.state

    async def next_state(self) -> ReceivedState:
        """The RTDE state after the newest one."""
        return await self.link.next_state()

    # the control program

    @property
    def program_running(self) -> bool:
        """True while the control program is connected, and has not ended or been stopped."""
        return self.program.running

    @property
    def loss_reason(self) -> str:
        """Why the last control program ended, if this machine was the cause; otherwise empty."""
        return self.program.loss_reason

    def program_text(self) -> str:
        """The control program in the form that the URCap receives."""
        return self.program.text()

    def on_program_state(self, callback: Callable[[bool], None]) -> None:
        """Register a callback: called with True when the control program connects, with False when it disconnects."""
        self.reverse.listeners.append(callback)

    async def start_program(self) -> None:
        """Start or restart the control program, and wait until it is connected.

        Raises ScriptFailedError if the robot reports an error in it, RobotRefused in a mode in which no program can
        run, and ProgramNotRunningError if it does not connect in time.
        """
        await self.program.start()

    async def stop_program(self) -> None:
        """End the control program, which stops the arm; does nothing if it is not running."""
        await self.program.stop()

    async def wait_for_program(self, timeout_s: float) -> None:
        """Wait until the control program is started on the robot. Raises ProgramNotRunningError on timeout."""
        await self.reverse.wait_connected(timeout_s)

    # safety and speed

    @property
    def protective_stopped(self) -> bool:
        """True during a protective stop."""
        return self.link.protective_stopped

    def on_safety_mode(self, callback: Callable[[SafetyMode], None]) -> None:
        """Register a callback that is called with each new safety mode."""
        self.link.on_safety_mode(callback)

    async def recover(self) -> None:
        """Unlock a protective stop, 5 s after it occurred, and start the control program again.

        Call it only when you know why the arm stopped and that it may move again. Raises RobotRefused if the robot is
        stopped for another reason, or if the stop recurs immediately.
        """
        if self.protective_stopped:
            await self.link.unlock_protective_stop()
        await self.start_program()

    async def set_speed_slider(self, fraction: float) -> None:
        """Set the speed slider, 0.01 to 1, which scales the speed of every motion.

        Raises RobotRefused while another client controls the slider.
        """
        try:
            await self.link.write_inputs(speed_slider_mask=1, speed_slider_fraction=fraction)
        except RobotRefused as refused:
            if "IN_USE" not in refused.answer:
                raise
            why = "another RTDE client controls the speed slider: disconnect that client first"
            raise RobotRefused("speed_slider_fraction", why) from None

    # setpoints

    @thread_safe
    def servoj(self, q_rad: Sequence[float], timeout_s: float = MAX_REAL_TIME_S) -> None:
        """Send joint angles (6,) [rad] to reach one control period from now."""
        self.reverse.setpoint(ControlMode.SERVOJ, q_rad, timeout_s)

    @thread_safe
    def servo_pose(self, pose_base_tcp: Sequence[float], timeout_s: float = MAX_REAL_TIME_S) -> None:
        """Send a TCP pose in the base frame (6,) [m, rotation vector], reached by the nearest joint angles."""
        self.reverse.setpoint(ControlMode.POSE, pose_base_tcp, timeout_s)

    @thread_safe
    def speedj(self, qd_rad_s: Sequence[float], timeout_s: float = MAX_REAL_TIME_S) -> None:
        """Send joint speeds (6,) [rad/s]."""
        self.reverse.setpoint(ControlMode.SPEEDJ, qd_rad_s, timeout_s)

    @thread_safe
    def speedl(self, velocity_base: Sequence[float], timeout_s: float = MAX_REAL_TIME_S) -> None:
        """Send a TCP velocity in the base frame (6,) [m/s, rad/s]."""
        self.reverse.setpoint(ControlMode.SPEEDL, velocity_base, timeout_s)

    @thread_safe
    def torque(self, torque_Nm: Sequence[float], timeout_s: float = MAX_REAL_TIME_S) -> None:
        """Send joint torques (6,) [Nm] in addition to gravity compensation; PolyScope 5.23 or newer."""
        self.link.require("torque")
        self.reverse.setpoint(ControlMode.TORQUE, torque_Nm, timeout_s)

    @thread_safe
    def idle(self) -> None:
        """Bring the arm to rest and keep the program running, for as long as the driver lives."""
        self.reverse.keep_alive(self.config.keep_alive_timeout_s)

    @thread_safe
    def start_freedrive(self) -> None:
        """Let a person guide the arm by hand until `stop_freedrive`, `idle` or another mode."""
        self.reverse.freedrive(FreedriveAction.START, self.config.keep_alive_timeout_s)

    @thread_safe
    def stop_freedrive(self) -> None:
        """End freedrive; the arm holds its position."""
        self.reverse.freedrive(FreedriveAction.STOP, self.config.keep_alive_timeout_s)

    # commands, possible during any motion

    async def zero_ftsensor(self) -> None:
        """Zero the force/torque sensor (take the present wrench as zero); e-Series."""
        self.link.require("zero_ftsensor")
        await self._command_or_script(ScriptCommand(ScriptCommandKind.ZERO_FTSENSOR), "zero_ftsensor()")

    async def set_payload(self, mass_kg: float, cog_m: Sequence[float] = ZERO3) -> None:
        """Set the payload's mass and its centre of gravity (3,) [m] in the flange frame, within a few periods."""
        script = f"set_payload({mass_kg}, {_list(cog_m)})"
        await self._command_or_script(ScriptCommand.set_payload(mass_kg, cog_m), script)

    async def set_target_payload(
        self,
        mass_kg: float,
        cog_m: Sequence[float],
        inertia_kg_m2: Sequence[float] = ZERO6,
        transition_time_s: float = 0.0,
    ) -> None:
        """Like `set_payload`, with inertia and a gradual transition; PolyScope 5.10 or newer.

        inertia_kg_m2: Ixx, Iyy, Izz, Ixy, Ixz, Iyz (6,).
        """
        self.link.require("set_target_payload")
        command = ScriptCommand.set_target_payload(mass_kg, cog_m, inertia_kg_m2, transition_time_s)
        script = f"set_target_payload({mass_kg}, {_list(cog_m)}, {_list(inertia_kg_m2)}, {transition_time_s})"
        await self._command_or_script(command, script)

    async def set_tool_voltage(self, volts: int) -> None:
        """Set the supply voltage at the tool: 0, 12 or 24 V."""
        await self._command_or_script(ScriptCommand.set_tool_voltage(volts), f"set_tool_voltage({volts})")

    async def set_gravity(self, gravity_m_s2: Sequence[float]) -> None:
        """Set the acceleration of the base (3,) [m/s2] in the base frame: [0, 0, 9.82] for an upright arm."""
        await self._command_or_script(ScriptCommand.set_gravity(gravity_m_s2), f"set_gravity({_list(gravity_m_s2)})")

    def set_tcp(self, pose_flange_tcp: Sequence[float]) -> None:
        """Set the TCP as a pose in the flange frame (6,) [m, rotation vector]."""
        self.commands.send(ScriptCommand.set_tcp_offset(pose_flange_tcp))

    def start_force_mode(
        self,
        task_frame_base: Sequence[float],
        selection: Sequence[int],
        wrench: Sequence[float],
        kind: int,
        limits: Sequence[float],
        *,
        damping: float = 0.025,
        gain_scaling: float = 0.5,
    ) -> None:
        """Start force mode: be compliant along axes of a frame. Arguments are those of `AsyncRobot.force_mode`."""
        command = ScriptCommand.start_force_mode(
            task_frame_base, selection, wrench, kind, limits, damping=damping, gain_scaling=gain_scaling
        )
        self.commands.send(command)

    def end_force_mode(self) -> None:
        """End force mode; the arm holds its pose again."""
        self.commands.send(ScriptCommand(ScriptCommandKind.END_FORCE_MODE))

    def start_tool_contact(self, direction_base: Sequence[float] = ZERO6) -> None:
        """Stop the motion when the tool touches something, and return to where the contact began; e-Series.

        direction_base: direction in which contact counts (6,), in the base frame; only the first three numbers are
        used, and all zeros stand for the direction of motion. Afterwards the arm rests until `end_tool_contact`. The
        robot checks for contact once per message from the driver, so send setpoints in every control period.
        """
        self.link.require("start_tool_contact")
        self.commands.clear_results()
        self.commands.send(ScriptCommand(ScriptCommandKind.START_TOOL_CONTACT, to_words(direction_base)))

    def end_tool_contact(self) -> None:
        """Stop watching for contact; the result is CANCELED if there was none."""
        self.link.require("end_tool_contact")
        self.commands.send(ScriptCommand(ScriptCommandKind.END_TOOL_CONTACT))

    async def tool_contact_result(self, timeout_s: float | None = None) -> TrajectoryResult:
        """Wait for the result: SUCCESS once the arm is back where the contact began, CANCELED without a contact."""
        return await self.commands.result(timeout_s)

    async def query(
        self, query: Query, *arguments: Sequence[float] | None, number: int = 0, gate: str | None = None
    ) -> tuple[float, ...]:
        """Query the control program, during any motion, and return its answer; empty without a solution.

        arguments: up to three (6,); None lets the robot use its present value. gate: the feature of
        `client.driver.availability` that the query needs. Raises RobotRefused for a version without it,
        ProgramNotRunningError and NoAnswerError.
        """
        if gate is not None:
            self.link.require(gate)
        return await self.commands.query(query, arguments, number)

    def set_stream_parameters(
        self,
        *,
        lookahead_s: float | None = None,
        gain: float | None = None,
        acceleration: float = SPEED_ACCELERATION,
        deceleration_rad_s2: float = DECELERATION,
    ) -> None:
        """Set how setpoints are followed from now on.

        lookahead_s (0.03 to 0.2) and gain (100 to 2000): parameters of servoj; None takes those of the configuration.
        acceleration: for reaching speeds [rad/s2 or m/s2]. deceleration_rad_s2: for coming to rest.
        """
        lookahead_s = self.config.servoj_lookahead_s if lookahead_s is None else lookahead_s
        gain = self.config.servoj_gain if gain is None else gain
        self.commands.send(ScriptCommand.set_stream_parameters(lookahead_s, gain, acceleration, deceleration_rad_s2))

    def set_freedrive_axes(self, axes: Sequence[int] = (1,) * 6, frame_base: Sequence[float] = ZERO6) -> None:
        """Set which axes (6,) the next freedrive frees; freeing only some requires PolyScope 5.10 or newer.

        frame_base: the frame of these axes, as a pose in the base frame (6,) [m, rotation vector].
        """
        if list(axes) != [1] * 6:
            self.link.require("freedrive_axes")
        self.commands.send(ScriptCommand.set_freedrive_axes(axes, frame_base))

    def set_force_mode_parameters(self, damping: float = 0.025, gain_scaling: float = 0.5) -> None:
        """Set parameters of the active force mode: damping 0 to 1, gain scaling 0 to 2 (e-Series only)."""
        self.commands.send(ScriptCommand.set_force_mode_parameters(damping, gain_scaling))

    def start_contact_detection(self, direction_base: Sequence[float] = ZERO6) -> None:
        """From now on, record whether the tool touches something in a direction (6,); all zeros for any direction."""
        self.link.require("contact")
        self.commands.send(ScriptCommand.start_contact_detection(direction_base))

    def stop_contact_detection(self) -> None:
        """Stop recording contacts; the result can still be queried."""
        self.link.require("contact")
        self.commands.send(ScriptCommand(ScriptCommandKind.STOP_CONTACT_DETECTION))

    def ft_rtde_input_enable(
        self,
        enabled: bool,
        sensor_mass_kg: float = 0.0,
        offset_m: Sequence[float] = ZERO3,
        cog_m: Sequence[float] = ZERO3,
    ) -> None:
        """Use the wrench in the RTDE inputs instead of the built-in sensor's.

        sensor_mass_kg, offset_m (3,) and cog_m (3,): the sensor's mass, measuring point and centre of gravity.
        """
        self.commands.send(ScriptCommand.ft_rtde_input_enable(enabled, sensor_mass_kg, offset_m, cog_m))

    def set_friction_compensation(self, enabled: bool) -> None:
        """Set whether torque control compensates friction; PolyScope 5.23 or newer."""
        self.link.require("set_friction_compensation")
        self.commands.send(ScriptCommand.set_friction_compensation(enabled))

    def set_friction_scales(self, viscous: Sequence[float], coulomb: Sequence[float]) -> None:
        """Set the share, 0 to 1, of each joint's friction (6,) that torque control compensates; PolyScope 5.25.1."""
        self.link.require("set_friction_scales")
        self.commands.send(ScriptCommand.set_friction_scales(viscous, coulomb))

    async def _command_or_script(self, command: ScriptCommand, statement: str) -> None:
        if self.program_running:
            self.commands.send(command)
        else:
            await self.link.send_script(f"sec command():\n  {statement}\nend")


def _list(values: Sequence[float]) -> str:
    return f"[{', '.join(str(float(value)) for value in values)}]"
