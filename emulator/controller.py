"""The controller: one synchronous, deterministic tick per control period.

    controller = Controller(ControllerConfig(model=load_model("ur3")))
    controller.post(DashboardLine("power on"), reply=print)
    controller.tick()
    controller.snapshot.actual_q

A tick processes the commands posted since the last one, runs every script thread for one frame,
advances the motion by one period, moves the arm, and checks it. Its snapshot is published at
once if somebody subscribes to snapshots, and otherwise when somebody asks for it.
There is no clock: time is the number of ticks.

A tick never raises: exceptions of its stages are handled by the guard (`emulator.guard`).
"""

from collections.abc import Callable
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

from emulator.devices.robotiq import Gripper
from emulator.devices.tool_line import ToolLine
from emulator.guard import MOVING, PUBLISHING, Guard
from emulator.io.encoders import Encoders
from emulator.io.signals import BaseLight, ForceInput, ModbusRegisters, Registers, Signals
from emulator.lifecycle.power import Power, PowerEvent, PowerState
from emulator.lifecycle.runstate import START_S, Speed, StopCause
from emulator.lifecycle.safety import Safety, SafetyEvent
from emulator.machine import ControllerConfig, InputRecorder, Machine
from emulator.mailbox import Command, Mailbox, Reply
from emulator.motion import Motion, MotionFault
from emulator.programs.runner import Programs
from emulator.reporting.messages import MessageLog
from emulator.reporting.popups import Popups
from emulator.robot.arm import Arm
from emulator.robot.chance import Chances
from emulator.robot.electrics import Electrics
from emulator.robot.installation import Installation
from emulator.robot.simulation import Simulation
from emulator.robot.worldmodel import WorldModel
from emulator.safety.board import SafetyBoard
from emulator.safety.causes import Cause
from emulator.services.freedrive_inputs import FreedriveInputs
from emulator.services.modbus import ModbusSignals
from emulator.services.urcap import DriverAddress
from emulator.snapshot import Snapshot, plausible
from emulator.startup import Startup
from emulator.workshare import WorkShare
from emulator.world.world import Wiring, World
from urproto.facts import Personality, Situation, find, known
from urproto.modes import AnalogDomain, ReportLevel, RobotStatusBits, RuntimeState
from urproto.primary.messages import RobotMessage
from urproto.primary.program_state import VariableMessage
from urproto.robots.measured import supply_of
from urproto.robots.pose import Pose
from urproto.vectors import ZERO6, Vector6
from urproto.versions import Series
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.safety_settings import SAFETY_SECTIONS

_SAFETY: Final = frozenset(section.name for section in SAFETY_SECTIONS)
_POWER_ON: Final = int(RobotStatusBits.POWER_ON)
_PROGRAM_RUNNING: Final = int(RobotStatusBits.PROGRAM_RUNNING)
_CHECKED: Final = {
    "target joint angles": "target_q",
    "joint angles": "q",
    "joint speeds": "qd",
    "joint accelerations": "qdd",
    "TCP force": "tcp_force",
    "joint torques": "efforts.actual_torque",
    "TCP pose": "tcp_pose",
    "TCP speed": "tcp_speed",
    "force sensor": "state.sensors.raw_wrench",
}
"""Values of the arm that are checked for plausibility, and their attributes."""
_vectors_of = attrgetter(*_CHECKED.values())


class Controller(Machine):
    """The whole controller, except for its sockets and its clock."""

    programs: Programs

    def __init__(self, config: ControllerConfig) -> None:
        self.config = config
        self.model = config.model
        self.situation = config.situation
        self.version = self.situation.version
        self.serial_number = config.serial_number or find("serial_number", self.situation).value
        self.period_s = self.version.series.period_s
        self._frequency_hz = self.version.series.frequency_hz
        self.step_count = self._first_step = round(config.uptime_s * self._frequency_hz)
        self.work = WorkShare(self.period_s)
        self.shutdown_requested = False
        self.execution_time_ms = 0.0  # duration of the last tick, set by the clock
        self.user_role = "NONE"
        self.operational_mode = "NONE"
        self.remote_control = config.remote_control  # the pendant's switch, if its settings enable it
        forced = config.remote_control or config.enforce_remote_control
        self.remote_control_enabled = forced or known("remote_control.switch", self.situation) is not None
        self.reports_dir: Path | None = None  # folder for reports without a programs directory; created when needed

        self.messages = MessageLog(self._time_us)
        self.popups = Popups(self.messages, lambda: self.time_s, config.popup_auto_close_s)
        self.registers = Registers()
        self.modbus_registers: ModbusRegisters = ModbusRegisters()
        analog_inputs = AnalogDomain[find("analog_inputs", self._situation_of_arm).value.upper()]
        self.signals = Signals(analog_inputs)
        self.encoders = Encoders(self.period_s, config.encoder_speeds)
        self.rtde_inputs: dict[str, Any] = {}  # last value of every RTDE input by name
        self.rtde_refreshed: dict[str, int] = {}  # step of its last update
        self.rtde_refused: set[str] = set()  # inputs with unusable values that have been reported
        self.chances = Chances(config.seed)
        self.installation = Installation()
        self.world_model = WorldModel()
        self.base_light = BaseLight()
        self.speed = Speed(round(START_S / self.period_s) if config.dynamic else 1)
        self.power = Power(config.power_timings, running=config.running)
        self.safety = Safety()
        self.external_wrench: Vector6 = ZERO6  # external wrench on the TCP, base frame [N, Nm]
        self.world: World | None = config.world.build(self.model, self.period_s) if config.world else None
        self.ft_input = ForceInput()
        self.arm = Arm(self.model, chances=self.chances if config.dynamic else None)
        self.simulation = Simulation(self.arm)
        supply = supply_of(self.model) if config.dynamic else None
        self.electrics = Electrics(self._situation_of_arm, self.chances, supply)
        self.motion = Motion(self.model, self.period_s, config.start_q)
        self.modbus = ModbusSignals(self.version.series)
        self.freedrive_inputs = FreedriveInputs(self.signals, self.registers, self.modbus, self.motion)
        self.safety_board = SafetyBoard(self)
        self.motion.govern(self.safety_board.governor.excess)
        self.tool_line = ToolLine(self.period_s)
        self.gripper = Gripper(config.gripper, config.gripper_object_mm) if config.gripper else None
        self.programs = Programs(self)
        if self.world is not None:
            self.world.wire(Wiring(self.signals, self.encoders, self.gripper))
        # hooks for faults: called at the beginning of each period, and with each snapshot before it is published
        self.on_tick: list[Callable[[], None]] = []
        self.snapshot_hooks: list[Callable[[Snapshot], None]] = []

        self.recorder: InputRecorder | None = None
        self.guard = Guard(self, self.programs, self.safety_board)
        self.safety_board.on_restart = self.guard.restarted
        self.last_good_q = self.motion.q  # position in the last period with a plausible state
        self.startup = Startup(self, self.programs)
        self._mailbox = Mailbox(self)
        self._subscribers: list[Callable[[Snapshot], None]] = []
        self._own_sensor = self.model.series is Series.E
        self._power_seen = PowerState.OFF
        self._publishing = False  # True at the beginning of a period: publishing the last one failed
        self._unpublished = True  # the last period has no snapshot yet
        self._instead: Snapshot | None = None  # shown until the next period
        self.new_messages: tuple[RobotMessage | VariableMessage, ...] = ()  # of the last period
        self._arm_changed = self._simulated = False
        self._fault: MotionFault | None = None
        self._stages: tuple[tuple[str, Callable[[], None]], ...] = (
            ("letting faults act", self._call_hooks),
            ("carrying out commands", self._mailbox.carry_out),
            ("advancing timers", self._advance_timers),
            ("reading inputs", self._latch_inputs),
            ("running the program", self.programs.step),
            (MOVING, self._move_arm),
            ("advancing the tool", self._advance_tool),
            ("judging safety", self._check_safety),
        )
        self._snapshot = self._unaltered = Snapshot(target_execution_time=1000.0 * self.period_s)
        self._move_arm()
        self.published()

    @property
    def _situation_of_arm(self) -> Situation:
        """A dynamic arm is a real one, even if the controller reports a simulator's identity."""
        return self.situation._replace(personality=Personality.ARM) if self.config.dynamic else self.situation

    # time

    @property
    def time_s(self) -> float:
        return self.step_count / self._frequency_hz

    @property
    def uptime_ns(self) -> int:
        return self.step_count * 1_000_000_000 // self._frequency_hz

    @property
    def wall_clock_ns(self) -> int:
        steps = self.step_count - self._first_step
        seconds, fraction = divmod(self.config.wall_clock_s, 1.0)
        return int(seconds) * 1_000_000_000 + round(fraction * 1e9) + steps * 1_000_000_000 // self._frequency_hz

    def _time_us(self) -> int:
        return self.step_count * 1_000_000 // self._frequency_hz

    # interface for servers

    def post(self, command: Command, reply: Reply | None = None, client: str = "") -> None:
        """Queue a command for the next tick. ``reply`` is called with its answer, once; client: address and port."""
        if self.recorder is not None:
            self.recorder.posted(command, client)
        self._mailbox.post(command, reply)

    @property
    def commands_waiting(self) -> int:
        """Number of commands that are not answered yet."""
        return len(self._mailbox)

    def subscribe(self, callback: Callable[[Snapshot], None]) -> Callable[[], None]:
        """Call back with every snapshot from now on; returns a function that ends the subscription."""
        self._subscribers.append(callback)
        return lambda: self._subscribers.remove(callback)

    @property
    def snapshot(self) -> Snapshot:
        """The state at the end of the last period, or what `publish_instead` shows."""
        return self._instead or self.published()

    def published(self) -> Snapshot:
        """The state at the end of the last period, which is written now if nobody has asked for it before."""
        if self._unpublished:
            self._unpublished = False
            try:
                self._publish()
            except Exception as error:
                self.guard.caught(PUBLISHING, error)
                self._publish_minimum()
        return self._snapshot

    def publish_instead(self, snapshot: Snapshot) -> None:
        """Show another snapshot until the next period."""
        self._instead = snapshot

    def tick(self) -> None:
        """Advance one control period; ``snapshot`` is the result. Raises nothing."""
        if (recorder := self.recorder) is not None:
            recorder.begin()
        if self._unpublished and (self._mailbox or self.on_tick or self.programs.may_read_state):
            self.published()  # before what this period changes
        self._instead = None
        self.step_count += 1
        for name, stage in self._stages:
            try:
                stage()
            except Exception as error:
                self.guard.caught(name, error)
        self.new_messages, self._unpublished = self.messages.take(), True
        if self._subscribers or self.snapshot_hooks:
            self._tell_subscribers(self.published())
        if recorder is not None:
            recorder.end(self)

    def _tell_subscribers(self, snapshot: Snapshot) -> None:
        for callback in tuple(self._subscribers):
            try:
                callback(snapshot)
            except Exception as error:
                self.guard.listener_failed(callback, error)

    # interface for programs, commands and faults

    @property
    def standing(self) -> bool:
        return not any(self.motion.qd) and self.arm.standing

    @property
    def may_run(self) -> bool:
        return self.power.running and not self.safety.stopped

    @property
    def may_play(self) -> bool:
        return self.power.running and self.safety.programs_allowed

    def power_event(self, event: PowerEvent) -> bool:
        if event is PowerEvent.POWER_OFF:
            self.programs.stop("power off")
            self.motion.engage_brakes()
        elif not self.safety.power_allowed:
            self.messages.trace("power: %s refused in safety mode %s", event.name, self.safety.mode.name)
            return False
        self.messages.trace("power: %s in state %s", event.name, self.power.state.name)
        self.power.handle(event)
        return True

    def safety_event(self, event: SafetyEvent) -> bool:
        before = self.safety.mode
        if not self.safety.handle(event):
            self.messages.trace("safety: %s changes nothing in mode %s", event.name, before.name)
            return False
        self.messages.trace("safety: %s leads from %s to %s", event.name, before.name, self.safety.mode.name)
        self.messages.safety_mode(self.safety.mode)
        self.safety_board.mode_changed(before)
        return True

    def protective_stop(self, cause: StopCause) -> None:
        if self.programs.pauses_on(cause.code, cause.argument):
            self.warn(cause.code, cause.argument, cause.text)
        elif self.safety_event(SafetyEvent.PROTECTIVE_STOP):
            self.messages.error(cause.code, cause.argument, ReportLevel.WARNING, cause.text)
            self.safety_board.count_stop(cause.joint)

    def warn(self, code: int, argument: int, text: str) -> None:
        self.messages.error(code, argument, ReportLevel.WARNING, text)
        if self.programs.pauses_on(code, argument):
            self.programs.pause(f"pause_on_error_code: C{code}A{argument}")

    @property
    def local_control(self) -> bool:
        return self.config.enforce_remote_control and not self.remote_control and self.version.series is Series.E

    @property
    def play_refused(self) -> bool:
        """Whether ``play`` is refused because the pendant's switch is at local control.

        A pendant whose settings do not enable remote control has no such switch, and refuses nothing.
        """
        return self.remote_control_enabled and not self.remote_control and self.version.series is Series.E

    @property
    def external_control(self) -> DriverAddress:
        return self.config.external_control.over(DriverAddress.of(self.installation.file))

    def set_tcp(self, tcp_offset: Pose) -> None:
        self.installation.set_tcp(tcp_offset)
        self.motion.tcp_offset = tcp_offset

    def apply_installation(self, path: Path, file: InstallationFile) -> None:
        self.installation.apply(path, file)
        self._installation_changed()

    def use_installation(self, path: Path, file: InstallationFile, section: str) -> None:
        """Apply a file in which one section has changed; other settings of the arm stay as programs have set them."""
        before = self.installation.file
        self.installation.name, self.installation.path, self.installation.file = path.name, path, file
        if section == "tcps" and file.tcp != before.tcp:
            self.installation.use_tcp()
            self.set_tcp(self.installation.tcp)
        elif section == "payloads" and file.payload != before.payload:
            self.installation.use_payload()
        elif section == "mounting":
            self.installation.use_mounting()
        elif file.safety is not None and section in _SAFETY:
            self.safety_board.configure(file.safety)

    def _installation_changed(self) -> None:
        self.set_tcp(self.installation.tcp)
        self.safety_board.compare(self.installation.name, self.installation.file.safety)

    def simulate(self, on: bool) -> None:
        if on is self.simulation.on:
            return
        if self.programs.busy or self.programs.state is not RuntimeState.STOPPED:
            raise ValueError("a program is running: stop it before switching between simulation and real robot")
        if not (self.standing and self.motion.idle):
            raise ValueError("the arm is moving: wait until it stands, then switch between simulation and real robot")
        place = self.simulation.place
        self.arm = self.simulation.begin() if on else self.simulation.end()
        self.safety_board.governor.watch(self.arm)
        self.motion.stand_at(place)
        self.messages.note("simulation: the real arm stands still" if on else "simulation is over: the real arm moves")

    def discard_movement(self) -> None:
        self._fault, self._arm_changed = None, False

    # stages of a tick

    def _call_hooks(self) -> None:
        for step in tuple(self.on_tick):
            step()

    def _latch_inputs(self) -> None:
        self.safety_board.latch()
        if self.encoders.enabled:
            self.encoders.advance(self.signals.digital_inputs)
        self.freedrive_inputs.advance(allowed=self.may_run and self.programs.state is RuntimeState.STOPPED)
        self.startup.advance()

    def _advance_timers(self) -> None:
        self.power.advance(self.period_s)
        self.safety.advance(self.period_s)
        self.installation.advance(self.period_s)
        self.popups.advance()

    def _move_arm(self) -> None:
        driven = self.power.running
        wrench = self.external_wrench
        if self.ft_input.enabled:
            wrench = self.ft_input.wrench_base(self.arm)
        if self.world is not None:
            failed = self.world.failure
            wrench = self.world.act(self.simulation.real, self.motion, wrench, self.period_s)
            if self.world.failure and not failed:
                self.safety_board.trip(Cause.WORLD_FAILURE, text=self.world.failure)
        if wrench != ZERO6 and not plausible(*wrench):
            wrench = ZERO6  # no real wrench is that large
        self.arm.sensor_in_flange = self._own_sensor and not self.ft_input.enabled
        motion = self.motion
        real_changed = False
        if self.simulation.on:
            real_changed = self.simulation.hold(self.installation, wrench, self.period_s, driven=driven)
            wrench, motion.force_control.contacts = ZERO6, ()
        if driven or motion.braking:
            motion.force_control.set_external_wrench(wrench, self.arm.q)
            self.speed.advance()
            self._fault = motion.advance(self.speed.fraction)
        elif not (motion.idle or self.programs.paused):
            motion.halt()  # the brakes hold the arm: no movement is left to complete
        target = motion.target
        targets = (target.q, target.qd, target.qdd)
        self._arm_changed = self.arm.update(
            targets, self.installation, wrench, self.period_s, driven=driven, torque=motion.torque
        )
        self._arm_changed |= self.simulation.on is not self._simulated
        self._simulated = self.simulation.on
        if self._arm_changed:
            self._check_arm()
        if not driven and self.arm.standing:
            motion.stand_at(self.arm.q)
        power_changed = self.power.state is not self._power_seen
        if power_changed:
            self.messages.trace("power: %s is left for %s", self._power_seen.name, self.power.state.name)
        self._power_seen = self.power.state
        if power_changed:
            self.programs.outputs.power_changed()
        self.electrics.advance(
            self.simulation.real,
            self.period_s,
            powered=self.power.report.powered,
            changed=self._arm_changed or real_changed or power_changed,
        )

    def _check_arm(self) -> None:
        """Raise ArithmeticError on implausible values, which must neither be published nor reach the next period."""
        arm = self.arm
        if not (arm.ordinary and plausible(*arm.target_q, *arm.q, *arm.qd, *arm.qdd, *arm.tcp_force)):
            for name, values in zip(_CHECKED, _vectors_of(arm), strict=True):
                if not plausible(*values):
                    raise ArithmeticError(f"the {name} exceeded all bounds: {values}")
        self.last_good_q = arm.q

    def _advance_tool(self) -> None:
        """Advance gripper and tool line, which have power only while the arm has."""
        powered = self.power.report.powered
        if self.gripper is not None:
            self.gripper.advance(self.period_s, powered=powered)
        if self.tool_line.device is not None:
            self.tool_line.advance(powered=powered and self.signals.tool_voltage > 0)

    def _check_safety(self) -> None:
        """Stop the arm if its movement cannot continue, or if the safety system detects a violation."""
        if self._fault is not None:
            self.protective_stop(StopCause(self._fault.code, self._fault.argument, self._fault.text, self._fault.joint))
            self._fault = None
        for warning in self.motion.commands.take_warnings():
            self.warn(warning.code, warning.argument, warning.text)
        self.safety_board.check_arm(changed=self._arm_changed)

    # the snapshot

    def _publish_minimum(self) -> None:
        """Publish the last snapshot with new time, modes and messages, which must be available whatever else fails."""
        snapshot = self._snapshot.successor()
        snapshot.step, snapshot.timestamp = self.step_count, self.time_s
        self.power.publish(snapshot)
        snapshot.safety_mode, snapshot.safety_status = self.safety.mode, self.safety.status
        snapshot.safety_status_bits = self.safety.status_bits
        snapshot.runtime_state = self.programs.state
        snapshot.program_running = snapshot.program_paused = False
        snapshot.robot_status_bits = 0
        snapshot.messages = self.new_messages
        self._snapshot = snapshot

    def _publish(self) -> None:
        failed, self._publishing = self._publishing, True
        if failed:  # the changes that parts wrote to the last snapshot are lost
            for part in (self.electrics, self.installation, self.signals, *self.registers.banks):
                part.mark()
        snapshot = self._unaltered.successor()
        snapshot.step, snapshot.timestamp = self.step_count, self.time_s
        if self.arm.state is not snapshot.arm or failed:  # at rest, the values are already in the copy
            self.arm.publish(snapshot)
        powered = self.power.report.powered
        self.electrics.publish(snapshot, powered=powered)
        self.power.publish(snapshot)
        self.safety_board.publish(snapshot)
        self.programs.publish(snapshot)
        self.speed.publish(snapshot, self.motion.limiter_share)
        self.installation.publish(snapshot)
        self.signals.publish(snapshot)
        if self.encoders.enabled:
            self.encoders.publish(snapshot)
        self.registers.publish(snapshot)
        snapshot.control_mode, snapshot.force_mode_frame = self.motion.control_mode, self.motion.force_control.frame
        snapshot.tool_communication, snapshot.tool_bytes = self.tool_line.settings, self.tool_line.received
        snapshot.io_freedrive, snapshot.local_control = self.freedrive_inputs.free, self.local_control
        snapshot.actual_execution_time = self.execution_time_ms
        status = (_POWER_ON if powered else 0) | (_PROGRAM_RUNNING if snapshot.program_running else 0)
        snapshot.robot_status_bits = status | self.safety_board.robot_status_bits()
        snapshot.simulation = self.simulation.on
        self._unaltered = snapshot
        if self.snapshot_hooks:
            snapshot = snapshot.successor()
            for hook in self.snapshot_hooks:
                hook(snapshot)
        snapshot.messages = self.new_messages
        self._snapshot, self._publishing = snapshot, False
