"""The safety control board: it connects inputs, limits and the safety mode, once per control period.

`latch` reads inputs before programs run, `check_arm` checks the arm after it has moved, and `mode_changed` carries out
what the new safety mode requires: stop categories, the state of the program, the active limits.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import hypot
from typing import Final

from emulator.lifecycle.power import PowerEvent, PowerState
from emulator.lifecycle.runstate import StopCause
from emulator.lifecycle.safety import STOP_CATEGORY, SafetyEvent, StopCategory
from emulator.machine import Machine
from emulator.safety.causes import Cause
from emulator.safety.conditions import Conditions
from emulator.safety.geometry import Boundaries
from emulator.safety.governor import TRANSITION_S, Governor, manual_limits, operational_positions
from emulator.safety.signals import SafetyInputs, drive_outputs, output_levels
from emulator.safety.supervision import Finding, Supervision
from emulator.snapshot import Snapshot
from urproto.modes import ControlMode, JointMode, RobotStatusBits, RuntimeState, SafetyMode, SafetyStatusBits
from urproto.versions import Availability
from urscript.polyscope.safety_configuration import (
    RECOVERY_LIMITS,
    LimitSet,
    SafetyConfiguration,
    SafetyInput,
    simulator_configuration,
)

_STOPS_COUNTED_S: Final = 8 * 3600.0
_MAX_STOPS: Final = 50  # dashboard manual, on C163
_ENABLING_BIT: Final = Availability.since(None, "5.25")
_HARD: Final = (SafetyMode.VIOLATION, SafetyMode.FAULT)
_STOP_WITHIN_S: Final = 0.524  # CB3 manual: braking begins within 24 ms and takes at most 500 ms
_REST_RAD_S: Final = 0.2  # CB3 manual: a slower joint counts as standing


class SafetyBoard:
    """State of one controller's safety system, apart from its mode.

    supply_lost: the arm has no 48 V supply. joint_at_fault: the joint that caused a violation or fault.
    safety_popup: text of a stop's dialogue, empty when it is closed. on_restart: called when the safety system
    has been restarted.
    """

    def __init__(self, machine: Machine) -> None:
        model = machine.model
        self._machine = machine
        self.on_restart: Callable[[], None] = lambda: None
        self.configuration = machine.config.safety or simulator_configuration(model)
        self.inputs = SafetyInputs(self.configuration, machine.signals)
        self.boundaries = Boundaries(self.configuration, model.elbow_radius)
        self.governor = Governor(model, machine.arm, machine.period_s, self.limits)
        self.supervision = Supervision(model, machine.period_s, self_collision=machine.config.self_collision)
        self._conditions = Conditions(machine, self.configuration, self.inputs, self.boundaries, self.supervision)
        self._stop_monitor = StopMonitor(machine)
        self.supply_lost = False
        self.joint_at_fault: int | None = None
        self.safety_popup = ""
        self.freedrive_held = False
        self._operational_mode = ""
        self._power = PowerState.OFF
        self._stops: list[deque[float]] = [deque(maxlen=_MAX_STOPS + 1) for _ in range(6)]
        self._transition_until_s = 0.0  # until then, both sets of limits are accepted
        self._resume = False  # the program was playing when the safeguard opened
        self._checksum = self.configuration.checksum
        self._positions_apply()

    @property
    def last_stop(self) -> "StopRecord | None":
        """Record of the last stop; None if there was none."""
        return self._stop_monitor.last

    # active limits

    @property
    def limits(self) -> LimitSet:
        """The limit set of the present safety mode."""
        mode = self._machine.safety.mode
        if mode is SafetyMode.RECOVERY:
            return RECOVERY_LIMITS
        return self.configuration.reduced if mode is SafetyMode.REDUCED else self.configuration.normal

    @property
    def manual(self) -> bool:
        """Whether manual mode is active with an enabling device that has to be held."""
        machine = self._machine
        wired = self.inputs.assigned(SafetyInput.ENABLING_DEVICE)
        known = wired or SafetyEvent.ENABLING_RELEASED in self._conditions.raised
        return known and machine.operational_mode == "MANUAL"

    def _limits_changed(self) -> None:
        machine, limits = self._machine, self.limits
        if self.manual and not self.configuration.manual_high_speed:
            limits = manual_limits(limits)
        self.governor.use(limits)
        self._transition_until_s = machine.time_s + TRANSITION_S
        self._positions_apply()

    def _positions_apply(self) -> None:
        self._machine.motion.limit_positions(*operational_positions(self.limits, self._machine.model))

    # once per control period

    def latch(self) -> None:
        """Read inputs and devices, before programs run."""
        machine = self._machine
        if self.inputs.latch() or machine.operational_mode is not self._operational_mode:
            self._follow_inputs()
        if machine.power.state is not self._power:
            self._power = machine.power.state
            if self._power in (PowerState.IDLE, PowerState.RUNNING):
                self._conditions.check_position()
            if self._power is PowerState.RUNNING:
                self._accept_load()

    def check_arm(self, *, changed: bool) -> None:
        """Check the arm, after it has moved. ``changed``: it differs from the last period."""
        machine = self._machine
        if self._stop_monitor.follow():
            self.trip(Cause.STOP_TIME_VIOLATION)
        if (changed or self.supervision.pending) and machine.power.running:
            self._supervise()
        if not machine.safety.power_allowed and machine.standing:
            machine.power.handle(PowerEvent.POWER_OFF)
        if self.configuration.outputs:
            drive_outputs(
                machine.signals, self.configuration.outputs, output_levels(machine, self.configuration.safe_home)
            )

    def _supervise(self) -> None:
        machine, arm = self._machine, self._machine.arm
        if self.boundaries.triggers:
            self._conditions.follow_triggers()
        safety = machine.safety
        if safety.stopped:
            self.supervision.reset()
            return
        mode = safety.mode
        if mode is SafetyMode.RECOVERY:
            self._conditions.check_position()
        finding = self.supervision.protective_stop(arm, self.boundaries, mode, self._is_stiff)
        if machine.time_s >= self._transition_until_s:
            finding = self.supervision.violation(arm, self.limits, self.boundaries, mode) or finding
        if finding is not None:
            self._report_finding(finding)

    def _is_stiff(self) -> bool:
        """Whether the arm holds its path and is not compliant."""
        return self._machine.motion.control_mode is ControlMode.POSITION

    def _report_finding(self, finding: Finding) -> None:
        self.supervision.reset()
        self.trip(finding.cause, finding.joint, finding.text)

    # causes

    def trip(self, cause: Cause, joint: int | None = None, text: str = "") -> bool:
        """Trigger a cause that has a report code; returns True if the safety mode changed.

        Lasting conditions are not triggered but held: see `SafetyInputs`. Raises ValueError for those, and for causes
        that this series does not have.
        """
        row = cause.value
        if row.code is None:
            raise ValueError(f"{cause.name} lasts as long as its condition: use a safety device")
        if row.only not in (None, self._machine.model.series):
            raise ValueError(f"{self._machine.model.title} has no {cause.name}: only the {row.only} series has it")
        blamed = (joint or 0) if row.per_joint else joint
        argument = row.argument + (joint or 0 if row.per_joint else 0)
        before = self._machine.safety.mode
        if row.event is SafetyEvent.PROTECTIVE_STOP:
            self._machine.protective_stop(StopCause(row.code, argument, text or row.what, blamed))
        elif self._machine.safety_event(row.event):
            self.joint_at_fault = blamed
            self._machine.messages.error(row.code, argument, row.level, text or row.what)
        return self._machine.safety.mode is not before

    def count_stop(self, joint: int | None) -> None:
        """Count a protective stop caused by a joint: more than 50 in 8 h are a fault."""
        if joint is None:
            return
        times, now = self._stops[joint], self._machine.time_s
        times.append(now)
        if len(times) > _MAX_STOPS and now - times[0] <= _STOPS_COUNTED_S:
            times.clear()
            self.trip(Cause.STOP_COUNT, joint)

    def restarted(self) -> None:
        """The safety system has been restarted: a fault that is still present occurs again."""
        self.joint_at_fault, self.safety_popup = None, ""
        self.on_restart()
        if self.supply_lost:
            self.trip(Cause.POWER_LOSS)

    def configure(self, configuration: SafetyConfiguration) -> None:
        """Activate another configuration, like the pendant's Apply: the arm is powered off."""
        machine = self._machine
        machine.power_event(PowerEvent.POWER_OFF)
        self.configuration = configuration
        self.inputs.assign(configuration)
        self.boundaries = Boundaries(configuration, machine.model.elbow_radius)
        self._conditions.use(configuration, self.boundaries)
        self._checksum = configuration.checksum
        self.supervision.reset()
        self._limits_changed()
        machine.messages.note(f"another safety configuration is active (checksum {self._checksum})")

    def compare(self, name: str, other: SafetyConfiguration | None) -> None:
        """Log if a loaded installation has another configuration: the pendant would ask to confirm it."""
        if other is not None and other.checksum != self._checksum:
            self._machine.messages.note(
                f"the safety configuration of {name} (checksum {other.checksum}) is not the active one "
                f"({self._checksum}): start with --safety to use it"
            )

    def set_supply(self, present: bool) -> None:
        """Remove or restore the arm's 48 V supply."""
        self.supply_lost = not present
        if self.supply_lost:
            self.trip(Cause.POWER_LOSS)

    def hold_freedrive(self, held: bool) -> None:
        """Hold or release freedrive: the button on the pendant's back, or an input assigned to it."""
        self.freedrive_held = held
        if held:
            self._machine.freedrive_inputs.hold_button()
        else:
            self._machine.freedrive_inputs.remove("button", 0)

    def _follow_inputs(self) -> None:
        machine, inputs = self._machine, self.inputs
        if inputs.assigned(SafetyInput.OPERATIONAL_MODE):
            machine.operational_mode = "MANUAL" if inputs.high(SafetyInput.OPERATIONAL_MODE) else "AUTOMATIC"
        if inputs.assigned(SafetyInput.FREEDRIVE) and inputs.high(SafetyInput.FREEDRIVE) is not self.freedrive_held:
            self.hold_freedrive(not self.freedrive_held)
        switched = machine.operational_mode != self._operational_mode
        self._operational_mode = machine.operational_mode
        self._conditions.follow_inputs()
        if switched and inputs.assigned(SafetyInput.ENABLING_DEVICE):
            self._limits_changed()

    # requirements of a safety mode

    def mode_changed(self, before: SafetyMode) -> None:
        """Carry out the safety mode that has just begun."""
        machine, mode = self._machine, self._machine.safety.mode
        self.supervision.reset()
        self._limits_changed()
        if SafetyMode.REDUCED in (before, mode):
            machine.motion.mode_changed()
        if machine.safety.stopped:
            self._stop()
        else:
            self._release(before)

    def _stop(self) -> None:
        machine, mode = self._machine, self._machine.safety.mode
        programs, category = machine.programs, STOP_CATEGORY[mode]
        if mode is SafetyMode.SAFEGUARD_STOP:
            self._resume = programs.state is RuntimeState.PLAYING
        self.safety_popup = mode.name
        self._stop_monitor.begin(category, mode)
        machine.messages.trace(
            "stop: category %s for %s, the program is %s", category.value, mode.name, programs.state.name
        )
        if category is StopCategory.POWER_REMOVED:
            programs.stop(mode.name)
            machine.motion.engage_brakes()
            machine.power.handle(PowerEvent.POWER_OFF)
            return
        programs.pause(mode.name, for_safety=True)
        if not machine.programs.paused:
            machine.motion.commands.stop(min(machine.model.qdd_max))
        elif mode is SafetyMode.SAFEGUARD_STOP:
            machine.motion.safeguard_stop()
        else:
            machine.motion.protective_stop()

    def _release(self, before: SafetyMode) -> None:
        """End a stop. A paused program waits to be resumed; after a safeguard stop, it resumes by itself."""
        self.safety_popup = ""
        self._stop_monitor.end()
        if before in STOP_CATEGORY:
            self._accept_load()
        if before in _HARD:
            self.restarted()
        if self._machine.power.report.powered and self._machine.safety.mode is not SafetyMode.RECOVERY:
            self._conditions.check_position()
        if before is SafetyMode.SAFEGUARD_STOP and self._resume and self._machine.safety.programs_allowed:
            self._machine.programs.resume()

    def _accept_load(self) -> None:
        """The arm may move again: what it presses against now does not stop it once more."""
        self._machine.arm.released()
        self.supervision.released()

    # reports

    def publish(self, snapshot: Snapshot) -> None:
        machine, safety = self._machine, self._machine.safety
        snapshot.safety_checksum = self._checksum
        snapshot.safety_mode = safety.mode
        snapshot.safety_status = safety.status
        bits, raised = safety.status_bits, self._conditions.raised
        if raised and SafetyEvent.ENABLING_RELEASED in raised and _ENABLING_BIT.covers(machine.version):
            bits |= SafetyStatusBits.ENABLING_INPUT_ACTIVE
        snapshot.safety_status_bits = bits
        if self.joint_at_fault is not None and safety.mode in _HARD:
            modes = list(snapshot.joint_mode)
            modes[self.joint_at_fault] = JointMode.FAULT if safety.mode is SafetyMode.FAULT else JointMode.VIOLATION
            snapshot.joint_mode = tuple(modes)

    def robot_status_bits(self) -> int:
        """Bits of the robot status that belong to the pendant's buttons."""
        return int(RobotStatusBits.TEACH_BUTTON) if self.freedrive_held else 0


@dataclass(slots=True)
class StopRecord:
    """Record of a stop: category, duration, and the distance travelled by the tool [m]."""

    category: StopCategory
    mode: SafetyMode
    began_s: float
    duration_s: float = 0.0
    distance_m: float = 0.0
    done: bool = False


class StopMonitor:
    """Monitors stops. last: the stop in progress, or the last one."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self.last: StopRecord | None = None

    def begin(self, category: StopCategory, mode: SafetyMode) -> None:
        """A stop of the arm begins."""
        self.last = StopRecord(category, mode, self._machine.time_s)

    def end(self) -> None:
        """The stop is over, even if it was released before the arm stood still: the arm may move again."""
        if self.last is not None:
            self.last.done = True

    def follow(self) -> bool:
        """Advance one control period; returns True if the stop takes too long."""
        stop, machine = self.last, self._machine
        if stop is None or stop.done:
            return False
        stop.duration_s = machine.time_s - stop.began_s
        stop.distance_m += hypot(*machine.arm.tcp_speed[:3]) * machine.period_s
        stop.done = machine.standing
        if stop.done:
            machine.messages.note(
                f"{stop.mode.name}: stop category {stop.category.value} took {stop.duration_s:.3f} s, "
                f"the tool travelled {stop.distance_m:.3f} m"
            )
            return False
        stop.done = stop.duration_s > _STOP_WITHIN_S and self._too_slow(stop)
        return stop.done

    def _too_slow(self, stop: StopRecord) -> bool:
        """Whether the arm, when a stop should be over, still moves without its brakes or a soft stop being active."""
        machine = self._machine
        soft = stop.mode is SafetyMode.SAFEGUARD_STOP and not machine.motion.hard_transitions
        monitored = stop.category is not StopCategory.POWER_REMOVED and not soft
        return monitored and max(map(abs, machine.arm.qd)) > _REST_RAD_S
