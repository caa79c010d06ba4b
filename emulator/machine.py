"""The interface through which the parts of a controller access each other.

The safety system, programs with their built-ins and the field bus act on more than their own state. This module defines
everything they may access; `emulator.controller.Controller` implements it.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol

from emulator.devices.tool_line import ToolLine
from emulator.io.encoders import Encoders
from emulator.io.signals import BaseLight, ForceInput, ModbusRegisters, Registers, Signals
from emulator.lifecycle.power import Power, PowerEvent, PowerTimings
from emulator.lifecycle.runstate import Speed, StopCause
from emulator.lifecycle.safety import Safety, SafetyEvent
from emulator.motion import Motion
from emulator.reporting.messages import MessageLog
from emulator.reporting.popups import Popups
from emulator.robot.arm import Arm
from emulator.robot.chance import Chances
from emulator.robot.electrics import Electrics
from emulator.robot.installation import Installation
from emulator.robot.simulation import Simulation
from emulator.robot.worldmodel import WorldModel
from emulator.services.freedrive_inputs import FreedriveInputs
from emulator.services.modbus import ModbusSignals
from emulator.services.urcap import DriverAddress
from emulator.snapshot import Snapshot
from emulator.workshare import WorkShare
from emulator.world.world import Plan
from urproto.facts import Personality, Situation, find, release_of
from urproto.modes import RuntimeState
from urproto.robotiq import GripperModel
from urproto.robots import RobotModel
from urproto.robots.pose import Pose
from urproto.vectors import Vector6
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.safety_configuration import SafetyConfiguration

# As found in program files of the vendor's simulators; clients expect digits only, starting with 20.
_NEW_YEAR_2024_S: Final = 1_704_067_200.0


@dataclass(frozen=True, kw_only=True)
class ControllerConfig:
    """Initial configuration of a controller.

    version: None selects the default of the model's series. personality: whose properties the robot has where a
    simulator and a real arm differ. initial_q, serial_number, timings: of the personality unless given [rad, s].
    running: start with the brakes released. uptime_s: initial uptime; clients wait until it is 40 s.
    programs_dir: folder for ``load`` and for reports; its default.installation, and the program named there, are
    loaded at boot. external_control: address at which the driver serves the program of External Control nodes; takes
    precedence over the installation. remote_control: the answer to ``is in remote control``; commands are accepted
    either way, like by a simulator (from 5.26 on except ``play``), unless enforce_remote_control makes an arm in local
    control refuse them, like a real e-Series arm. encoder_speeds: ticks/s of the emulated conveyors at encoder 0 and 1.
    gripper: mounted on the arm; gripper_object_mm: width of the object between its fingers.
    safety: limits, planes and safety inputs; None selects those of a simulator, which limits the joints only.
    self_collision: stop when links touch each other, which a controller itself does not monitor.
    wall_clock_s: date and time of the start [s since 1970, GMT]; constant unless given.
    world: the objects around the arm; None for none.
    dynamic: torques move the arm, which follows its targets as well as servo loops can, with noisy measurements;
    otherwise, it is exactly at its targets. seed: of the noise, and of ``random()``.
    options: of the command line, from which all this was made, if it was; for journals.
    """

    model: RobotModel
    version: PolyscopeVersion | None = None
    initial_q: Vector6 | None = None
    running: bool = False
    uptime_s: float = 41.0
    programs_dir: Path | None = None
    personality: Personality = Personality.URSIM
    serial_number: str | None = None
    remote_control: bool = False
    enforce_remote_control: bool = False
    popup_auto_close_s: float | None = None
    encoder_speeds: tuple[float, float] = (0.0, 0.0)
    gripper: GripperModel | None = None
    gripper_object_mm: float | None = None
    safety: SafetyConfiguration | None = None
    self_collision: bool = False
    wall_clock_s: float = _NEW_YEAR_2024_S
    dynamic: bool = False
    seed: int = 0
    external_control: DriverAddress = field(default_factory=DriverAddress)
    world: Plan | None = None
    timings: PowerTimings | None = None
    options: Mapping[str, Any] | None = field(default=None, compare=False, repr=False)

    @property
    def situation(self) -> Situation:
        """The robot about which the ledger of facts is asked."""
        version = release_of(self.version or DEFAULT_VERSION[self.model.series]).version
        return Situation(version, self.model.name, self.personality)

    @property
    def power_timings(self) -> PowerTimings:
        """Durations of boot, switching on and brake release."""
        return self.timings or PowerTimings.of(self.situation)

    @property
    def start_q(self) -> Vector6:
        """Joint angles when the controller starts [rad]."""
        return find("start_q", self.situation).six if self.initial_q is None else self.initial_q


class InputRecorder(Protocol):
    """Records what enters a controller; see `emulator.journal`. periods: that are over."""

    periods: int

    def posted(self, command: Any, client: str) -> None:
        """A client has posted a command; "" is this process."""

    def begin(self) -> None:
        """A control period begins."""

    def end(self, controller: Any) -> None:
        """A control period of this controller is over."""

    def wrap_backends(self, controller: Any) -> None:
        """Its programs have other connections from now on."""

    def rebooted(self, controller: Any, boot_s: float, periods_off: int) -> None:
        """The controller was switched off and on; this is the new one."""

    def called(self, name: str, arguments: Mapping[str, Any], call: Callable[[], Any], client: str) -> Any:
        """Call a verb for a client and return its result."""

    @property
    def journal(self) -> bytes:
        """The run so far, if it is kept in memory; empty if not."""


class ProgramControl(Protocol):
    """Control of the main program, for parts that stop and resume it."""

    state: RuntimeState

    @property
    def paused(self) -> bool:
        """Whether the main program is paused or being paused."""

    def stop(self, reason: str = "") -> bool:
        """End the main program, paused or not, and those about to start; returns False if there is none."""

    def pause(self, reason: str = "", *, for_safety: bool = False) -> bool:
        """Bring the arm to rest on its path and hold the program; returns False if none runs.

        for_safety: a program that a client sends replaces it; otherwise that only ends it.
        """

    def resume(self) -> bool:
        """Continue after a pause; returns False if the program is not paused or the arm may not move."""


class Machine(ABC):
    """One controller with its arm, as its parts see it."""

    config: ControllerConfig
    model: RobotModel
    version: PolyscopeVersion
    """The release, with its build."""
    situation: Situation
    """The robot about which the ledger of facts is asked."""
    serial_number: str
    period_s: float
    """Control period [s]."""
    step_count: int
    """Control periods since the controller was switched on."""
    work: WorkShare
    """The budget for work that others cause."""
    recorder: "InputRecorder | None"
    """Records what enters; None if nothing does."""

    messages: MessageLog
    popups: Popups
    power: Power
    safety: Safety
    """The safety mode; the safety board determines it."""
    speed: Speed
    """The speed slider and other scaling of the speed."""
    arm: Arm
    """The arm that programs move: in simulation, not the real one."""
    simulation: Simulation
    electrics: Electrics
    motion: Motion
    chances: Chances
    programs: ProgramControl

    signals: Signals
    registers: Registers
    modbus_registers: ModbusRegisters
    encoders: Encoders
    base_light: BaseLight
    ft_input: ForceInput
    freedrive_inputs: FreedriveInputs
    modbus: ModbusSignals
    """Programs' signals on other devices."""
    tool_line: ToolLine
    rtde_inputs: dict[str, Any]
    """The last value of every RTDE input by name."""
    rtde_refreshed: dict[str, int]
    """The control period in which each RTDE input was last received."""
    rtde_refused: set[str]
    """RTDE inputs whose unusable values have been reported."""

    installation: Installation
    world_model: WorldModel
    operational_mode: str
    """NONE, MANUAL or AUTOMATIC, as the dashboard answers."""
    shutdown_requested: bool
    last_good_q: Vector6
    """Joint angles in the last period with a plausible state [rad]."""
    reports_dir: Path | None
    """Folder for reports without a programs directory; created when needed."""

    @property
    @abstractmethod
    def snapshot(self) -> Snapshot:
        """The state at the end of the last period."""

    @property
    @abstractmethod
    def time_s(self) -> float:
        """Uptime [s], from the step counter."""

    @property
    @abstractmethod
    def uptime_ns(self) -> int:
        """Uptime [ns], from the step counter."""

    @property
    @abstractmethod
    def wall_clock_ns(self) -> int:
        """Time since 1970 [ns]: that of the start plus the control periods since."""

    @property
    @abstractmethod
    def standing(self) -> bool:
        """Whether arm and target are at rest."""

    @property
    @abstractmethod
    def may_run(self) -> bool:
        """Whether the arm may move: brakes released and no stop active."""

    @property
    @abstractmethod
    def may_play(self) -> bool:
        """Whether a program may run: the arm may move and is inside its limits."""

    @property
    @abstractmethod
    def local_control(self) -> bool:
        """Whether the arm refuses commands from the network; a CB3 arm never does."""

    @property
    @abstractmethod
    def external_control(self) -> DriverAddress:
        """Address at which a driver is asked for its program: as configured, else from the installation."""

    @abstractmethod
    def power_event(self, event: PowerEvent) -> bool:
        """Apply an event to the power state; returns False if the safety system forbids it."""

    @abstractmethod
    def safety_event(self, event: SafetyEvent) -> bool:
        """Apply an event to the safety mode with all its consequences; returns True if the mode changed."""

    @abstractmethod
    def protective_stop(self, cause: StopCause) -> None:
        """Trigger a protective stop and log its cause; does nothing if the arm is already stopped.

        If the program has requested it (pause_on_error_code), it is paused instead.
        """

    @abstractmethod
    def warn(self, code: int, argument: int, text: str) -> None:
        """Report a condition that does not stop the arm; it pauses a program with pause_on_error_code() for it."""

    @abstractmethod
    def set_tcp(self, tcp_offset: Pose) -> None:
        """Set the TCP (flange to TCP) immediately, within this period. Raises ValueError if it is implausible."""

    @abstractmethod
    def apply_installation(self, path: Path, file: InstallationFile) -> None:
        """Apply the contents of an installation file."""

    @abstractmethod
    def simulate(self, on: bool) -> None:
        """Set the pendant's switch to Simulation or Real Robot. Raises ValueError during programs and movements."""

    @abstractmethod
    def discard_movement(self) -> None:
        """Discard this period's results of the arm, so that they are neither checked nor published; for the guard."""
