"""What the parts of a controller see of each other: the machine as they find it, whoever built it.

The safety system, programs with their built-ins and the field bus act on more than their own state. What they may reach
stands here and nowhere else; `emulator.controller.Controller` is what implements it.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol

from emulator.devices.robotiq import GripperModel
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
from emulator.robot.installation import Installation
from emulator.robot.simulation import Simulation
from emulator.robot.worldmodel import WorldModel
from emulator.services.freedrive_inputs import FreedriveInputs
from emulator.services.modbus import ModbusSignals
from emulator.services.urcap import DriverAddress
from emulator.snapshot import Snapshot
from emulator.world.world import Plan
from urproto.modes import RuntimeState
from urproto.robots import START_Q, RobotModel
from urproto.robots.pose import Pose
from urproto.vectors import Vector6
from urproto.versions import PolyscopeVersion
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.safety_configuration import SafetyConfiguration

# As found in program files of the vendor's simulators; clients want digits only, starting with 20.
_NEW_YEAR_2024_S: Final = 1_704_067_200.0


@dataclass(frozen=True, kw_only=True)
class ControllerConfig:
    """What a controller is born with.

    version: None takes the default of the model's series. initial_q: where the arm
    stands [rad]. running: start with the brakes released. uptime_s: clients wait for 40 s of it.
    programs_dir: where ``load`` looks and reports are written; its default.installation, and the program which that
    names, are loaded at boot. external_control: where the driver hands out the program of External Control nodes,
    before what the installation says. remote_control: what ``is in remote control`` answers; commands are accepted
    either way, as by a simulator, unless enforce_remote_control says that a local arm takes none, as a real
    e-Series arm.
    encoder_speeds: ticks/s of the emulated conveyors at encoder 0 and 1.
    gripper: what is mounted on the arm; gripper_object_mm: width of what its fingers meet.
    safety: limits, planes and safety inputs; None takes a simulator's, which limits the joints only.
    self_collision: stop when links touch each other, which a controller itself does not look after.
    wall_clock_s: date and time of its start [s since 1970, GMT]; always the same unless given.
    world: what stands around the arm; None for nothing.
    dynamic: torques move the arm, which follows its targets as well as servo loops can, and measures with noise;
    otherwise it is where its targets are. seed: of the noise.
    """

    model: RobotModel
    version: PolyscopeVersion | None = None
    initial_q: Vector6 = START_Q
    running: bool = False
    uptime_s: float = 41.0
    programs_dir: Path | None = None
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
    timings: PowerTimings = field(default_factory=PowerTimings)


class ProgramControl(Protocol):
    """The main program, to those who stop it and let it go on."""

    state: RuntimeState

    @property
    def paused(self) -> bool:
        """The main program is being paused, or is."""

    def stop(self, reason: str = "") -> bool:
        """End the main program, paused or not, and those about to start; False when there is none."""

    def pause(self, reason: str = "") -> bool:
        """Let the arm come to rest on its path and hold the program; False when none runs."""

    def resume(self) -> bool:
        """Go on after a pause; False when the program is not paused or the arm may not move."""


class Machine(ABC):
    """One controller with its arm, from the inside."""

    config: ControllerConfig
    model: RobotModel
    version: PolyscopeVersion
    serial_number: str
    period_s: float
    """Control period [s]."""
    step_count: int
    """Control periods since the controller was switched on."""
    snapshot: Snapshot
    """What was published last."""

    messages: MessageLog
    popups: Popups
    power: Power
    safety: Safety
    """The safety mode; what leads to it is the safety board's."""
    speed: Speed
    """The speed slider, and what else scales the speed."""
    arm: Arm
    """The arm that programs move: in simulation not the real one."""
    simulation: Simulation
    motion: Motion
    programs: ProgramControl

    signals: Signals
    registers: Registers
    modbus_registers: ModbusRegisters
    encoders: Encoders
    base_light: BaseLight
    ft_input: ForceInput
    freedrive_inputs: FreedriveInputs
    modbus: ModbusSignals
    """Signals of programs on other devices."""
    tool_line: ToolLine
    rtde_inputs: dict[str, Any]
    """The last value of every RTDE input by name."""
    rtde_refreshed: dict[str, int]
    """The control period in which each RTDE input came last."""
    rtde_refused: set[str]
    """RTDE inputs that came with unusable values, and were reported."""

    installation: Installation
    world_model: WorldModel
    operational_mode: str
    """NONE, MANUAL or AUTOMATIC, as the dashboard answers."""
    shutdown_requested: bool
    last_good_q: Vector6
    """Where the arm was in the last period in which its state made sense [rad]."""
    reports_dir: Path | None
    """Where reports go without a programs directory; made when needed."""

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
        """Time since 1970 [ns]: that of the start, and the control periods since."""

    @property
    @abstractmethod
    def standing(self) -> bool:
        """The arm stands and is to stand."""

    @property
    @abstractmethod
    def may_run(self) -> bool:
        """True when the arm may move: brakes released and no stop in force."""

    @property
    @abstractmethod
    def may_play(self) -> bool:
        """True when a program may run: the arm may move, and stands inside its limits."""

    @property
    @abstractmethod
    def local_control(self) -> bool:
        """True while the arm takes no orders from the network; an arm of the CB3 series always does."""

    @property
    @abstractmethod
    def external_control(self) -> DriverAddress:
        """Where a driver is asked for its program: as configured, else as the installation says."""

    @abstractmethod
    def power_event(self, event: PowerEvent) -> bool:
        """Apply an event to the power state; False when the safety system forbids it."""

    @abstractmethod
    def safety_event(self, event: SafetyEvent) -> bool:
        """Apply an event to the safety mode with all its consequences; True when it changed."""

    @abstractmethod
    def protective_stop(self, cause: StopCause) -> None:
        """Stop the arm protectively and log why; nothing more happens when it is stopped already.

        Where the program asked for it, it is paused instead.
        """

    @abstractmethod
    def warn(self, code: int, argument: int, text: str) -> None:
        """Report something that stops nothing; a program that asked for it (pause_on_error_code) is paused."""

    @abstractmethod
    def set_tcp(self, tcp_offset: Pose) -> None:
        """Use another TCP (flange to TCP) from now on, within this period. Raises ValueError for an absurd one."""

    @abstractmethod
    def apply_installation(self, path: Path, file: InstallationFile) -> None:
        """Apply what was read from an installation file."""

    @abstractmethod
    def simulate(self, on: bool) -> None:
        """Turn the pendant's switch to Simulation, or back to Real Robot. Raises ValueError while anything moves."""

    @abstractmethod
    def forget_movement(self) -> None:
        """For the guard: what this period computed of the arm is neither judged nor published."""
