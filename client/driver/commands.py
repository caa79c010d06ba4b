"""Commands beside the motion: force mode, contact, payload, TCP, gravity, tool voltage, sensors, friction."""

from collections.abc import Sequence

from client.control_program import DECELERATION, SPEED_ACCELERATION, check_servo_parameters
from client.driver.core import DriverCore
from urproto.errors import LocalProtocolError
from urproto.external_control import Question, ScriptCommand, ScriptCommandKind, TrajectoryResult, to_words
from urproto.vectors import ZERO3, ZERO6


class Commands(DriverCore):
    """What the program does without interrupting the motion.

    Those that set something up (payload, tool voltage, gravity, zeroing) work without the
    control program too: then the robot is sent a small script. The others raise
    ProgramNotRunningError. Any raises LocalProtocolError for values that make no sense and
    RobotRefused for what this version does not have.
    """

    async def zero_ftsensor(self) -> None:
        """Let what the force sensor feels now be zero; e-Series."""
        self._require("zero_ftsensor")
        await self._command_or_script(ScriptCommand.plain(ScriptCommandKind.ZERO_FTSENSOR), "zero_ftsensor()")

    async def set_payload(self, mass_kg: float, cog_m: Sequence[float]) -> None:
        """Mass and its centre of gravity (3,) in the flange frame."""
        _check_mass(mass_kg)
        script = f"set_payload({mass_kg}, {_list(cog_m)})"
        await self._command_or_script(ScriptCommand.set_payload(mass_kg, cog_m), script)

    async def set_target_payload(
        self,
        mass_kg: float,
        cog_m: Sequence[float],
        inertia_kg_m2: Sequence[float] = ZERO6,
        transition_time_s: float = 0.0,
    ) -> None:
        """As set_payload with the inertia Ixx, Iyy, Izz, Ixy, Ixz, Iyz (6,), taking effect gradually; from 5.10 on."""
        self._require("set_target_payload")
        _check_mass(mass_kg)
        command = ScriptCommand.set_target_payload(mass_kg, cog_m, inertia_kg_m2, transition_time_s)
        script = f"set_target_payload({mass_kg}, {_list(cog_m)}, {_list(inertia_kg_m2)}, {transition_time_s})"
        await self._command_or_script(command, script)

    async def set_tool_voltage(self, volts: int) -> None:
        """0, 12 or 24 V."""
        await self._command_or_script(ScriptCommand.set_tool_voltage(volts), f"set_tool_voltage({volts})")

    async def set_gravity(self, gravity_m_s2: Sequence[float]) -> None:
        """Acceleration of the base (3,) in its frame: [0, 0, 9.82] for an upright arm."""
        await self._command_or_script(ScriptCommand.set_gravity(gravity_m_s2), f"set_gravity({_list(gravity_m_s2)})")

    def set_tcp(self, pose_flange_tcp: Sequence[float]) -> None:
        """Flange to TCP (6,) [m, rotation vector]."""
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
        """Comply along the axes of a frame.

        task_frame_base: pose in the base frame (6,) [m, rotation vector]. selection: 1 for
        axes that comply (6,). wrench: to press with [N, Nm] (6,). kind: 1 the frame's y axis
        points to the TCP, 2 the frame as it is, 3 its x axis follows the velocity. limits:
        top speeds of complying axes [m/s, rad/s], deviations of the others [m, rad] (6,).
        damping: 0 to 1. gain_scaling: 0 to 2, e-Series only.
        """
        if kind not in (1, 2, 3):
            raise LocalProtocolError(f"the kind of force mode is 1, 2 or 3, not {kind}")
        if any(axis not in (0, 1) for axis in selection):
            raise LocalProtocolError(f"the selection of force mode has a 0 or 1 for each axis, not {list(selection)}")
        _check_force_mode(damping, gain_scaling)
        if any(not limit >= 0.0 for limit in limits):
            raise LocalProtocolError(f"the limits of force mode cannot be negative: {list(limits)}")
        command = ScriptCommand.start_force_mode(
            task_frame_base, selection, wrench, kind, limits, damping=damping, gain_scaling=gain_scaling
        )
        self.commands.send(command)

    def end_force_mode(self) -> None:
        """Hold the pose again."""
        self.commands.send(ScriptCommand.plain(ScriptCommandKind.END_FORCE_MODE))

    def start_tool_contact(self, direction_base: Sequence[float] = ZERO6) -> None:
        """Stop the motion where the tool touches something, and go back to where the contact began; e-Series.

        direction_base: along which it counts (6,), the first three in the base frame; all zero for that of the motion.
        Afterwards the arm rests until `end_tool_contact`. Watched once with each message to the
        robot, so best with setpoints in every control period.
        """
        self._require("start_tool_contact")
        self.commands.forget_results()
        self.commands.send(ScriptCommand(ScriptCommandKind.START_TOOL_CONTACT, to_words(direction_base)))

    def end_tool_contact(self) -> None:
        """Watch for contact no longer; the result is CANCELED if there was none."""
        self._require("end_tool_contact")
        self.commands.send(ScriptCommand.plain(ScriptCommandKind.END_TOOL_CONTACT))

    async def tool_contact_result(self, timeout_s: float | None = None) -> TrajectoryResult:
        """SUCCESS when the arm is back at the beginning of a contact, CANCELED when watching ended without one."""
        return await self.commands.result(timeout_s)

    async def ask(
        self, question: Question, *arguments: Sequence[float] | None, number: int = 0, gate: str | None = None
    ) -> tuple[float, ...]:
        """What the robot answers to a question, beside any motion; no values when there is no solution.

        arguments: up to three (6,), None for one that the robot is to choose. gate: the feature of
        `client.availability` that it needs. Raises RobotRefused for a version without it,
        ProgramNotRunningError, NoAnswerError.
        """
        if gate is not None:
            self._require(gate)
        return await self.commands.ask(question, arguments, number)

    def set_stream_parameters(
        self,
        *,
        lookahead_s: float | None = None,
        gain: float | None = None,
        acceleration: float = SPEED_ACCELERATION,
        deceleration_rad_s2: float = DECELERATION,
    ) -> None:
        """How setpoints are followed from now on.

        lookahead_s (0.03 to 0.2) and gain (100 to 2000): of servoing, None for those of the configuration.
        acceleration: towards speeds [rad/s2 or m/s2]. deceleration_rad_s2: to rest.
        """
        lookahead_s = self.config.servoj_lookahead_s if lookahead_s is None else lookahead_s
        gain = self.config.servoj_gain if gain is None else gain
        check_servo_parameters(lookahead_s, gain)
        if not (acceleration > 0.0 and deceleration_rad_s2 > 0.0):
            raise LocalProtocolError(
                f"acceleration and deceleration are above 0, not {acceleration} and {deceleration_rad_s2}"
            )
        self.commands.send(ScriptCommand.set_stream_parameters(lookahead_s, gain, acceleration, deceleration_rad_s2))

    def set_freedrive_axes(self, axes: Sequence[int] = (1,) * 6, frame_base: Sequence[float] = ZERO6) -> None:
        """Which axes (6,) of a frame, given in the base frame (6,), the next freedrive frees; from 5.10 on."""
        if list(axes) != [1] * 6:
            self._require("freedrive_axes")
        self.commands.send(ScriptCommand.set_freedrive_axes(axes, frame_base))

    def set_force_mode_parameters(self, damping: float = 0.025, gain_scaling: float = 0.5) -> None:
        """Of the force mode that is in effect: damping 0 to 1, gain scaling 0 to 2 (e-Series only)."""
        _check_force_mode(damping, gain_scaling)
        self.commands.send(ScriptCommand.set_force_mode_parameters(damping, gain_scaling))

    def start_contact_detection(self, direction_base: Sequence[float] = ZERO6) -> None:
        """Note from now on whether the tool meets something on its way along a direction (6,), all zero for any."""
        self._require("contact")
        self.commands.send(ScriptCommand.start_contact_detection(direction_base))

    def stop_contact_detection(self) -> None:
        """Note it no longer; what was noted can still be asked for."""
        self._require("contact")
        self.commands.send(ScriptCommand.plain(ScriptCommandKind.STOP_CONTACT_DETECTION))

    def ft_rtde_input_enable(
        self,
        enabled: bool,
        sensor_mass_kg: float = 0.0,
        offset_m: Sequence[float] = ZERO3,
        cog_m: Sequence[float] = ZERO3,
    ) -> None:
        """Take the wrench from RTDE inputs; mass, measuring point (3,) and centre of gravity (3,) are the sensor's."""
        self.commands.send(ScriptCommand.ft_rtde_input_enable(enabled, sensor_mass_kg, offset_m, cog_m))

    def set_friction_compensation(self, enabled: bool) -> None:
        """Whether torque control makes up for friction; from 5.23 on."""
        self._require("set_friction_compensation")
        self.commands.send(ScriptCommand.set_friction_compensation(enabled))

    def set_friction_scales(self, viscous: Sequence[float], coulomb: Sequence[float]) -> None:
        """Shares 0 to 1 of each joint's friction (6,) that torque control makes up for; from 5.25.1 on."""
        self._require("set_friction_scales")
        self.commands.send(ScriptCommand.set_friction_scales(viscous, coulomb))

    async def _command_or_script(self, command: ScriptCommand, statement: str) -> None:
        if self.program_running:
            self.commands.send(command)
        else:
            await self.robot.send_script(f"sec command():\n  {statement}\nend")


def _check_force_mode(damping: float, gain_scaling: float) -> None:
    if not (0.0 <= damping <= 1.0 and 0.0 <= gain_scaling <= 2.0):
        raise LocalProtocolError(f"damping is 0 to 1 and gain scaling 0 to 2, not {damping} and {gain_scaling}")


def _check_mass(mass_kg: float) -> None:
    if not mass_kg >= 0.0:
        raise LocalProtocolError(f"a mass is 0 kg or more, not {mass_kg}")


def _list(values: Sequence[float]) -> str:
    return f"[{', '.join(str(float(value)) for value in values)}]"
