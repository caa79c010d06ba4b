"""What can be done to the safety system from outside, each with its inverse: press and release, lose and restore."""

from dataclasses import dataclass

from emulator.controller import Controller
from emulator.mailbox import Command
from emulator.safety.causes import Cause
from emulator.safety.conditions import SafetyDevice
from emulator.snapshot import plausible
from urproto.modes import RuntimeState
from urproto.robots.model import Joints
from urscript.polyscope.safety_configuration import SafetyInput

_JOG_RAD_S2 = 1.4


@dataclass(frozen=True, slots=True)
class SetSafetyDevice(Command):
    """Press or release an emergency stop, open or close a safeguard, and so on."""

    device: SafetyDevice
    active: bool

    def apply(self, controller: Controller) -> None:
        controller.safety_board.set_device(self.device, self.active)


@dataclass(frozen=True, slots=True)
class SetSafetyInput(Command):
    """Drive both channels of a configurable safety input. Answer: False when the function has no pins."""

    function: SafetyInput
    high: bool

    def apply(self, controller: Controller) -> bool:
        mask = controller.safety_board.inputs.pins_of(self.function)
        signals = controller.signals
        signals.digital_inputs = signals.digital_inputs | mask if self.high else signals.digital_inputs & ~mask
        return bool(mask)

    @property
    def failure(self) -> bool:
        return False


@dataclass(frozen=True, slots=True)
class TripSafety(Command):
    """Let a violation, a fault or a protective stop happen. Answer: whether the safety mode changed.

    What lasts as long as somebody holds it is no such cause: it takes a device.
    """

    cause: Cause
    joint: int | None = None

    def apply(self, controller: Controller) -> bool:
        return controller.safety_board.trip(self.cause, self.joint)

    @property
    def failure(self) -> bool:
        return False


@dataclass(frozen=True, slots=True)
class ArmSupply(Command):
    """Take the arm's 48 V away, or give them back."""

    present: bool

    def apply(self, controller: Controller) -> None:
        controller.safety_board.set_supply(self.present)


@dataclass(frozen=True, slots=True)
class FreedriveButton(Command):
    """Hold the pendant's freedrive button, or let it go. The arm is free while no program runs and it may move."""

    held: bool

    def apply(self, controller: Controller) -> None:
        controller.safety_board.hold_freedrive(self.held)


@dataclass(frozen=True, slots=True)
class Jog(Command):
    """The pendant's Move tab: joint speeds [rad/s] until the next command, zeros to stop.

    Answer: False when the arm may not move, a program moves it, or these are no speeds.
    """

    qd: Joints

    def apply(self, controller: Controller) -> bool:
        if not controller.may_run or controller.programs.state is not RuntimeState.STOPPED:
            return False
        if not plausible(*self.qd):
            return False
        if any(self.qd):
            controller.motion.commands.speedj(self.qd, a=_JOG_RAD_S2)
        else:
            controller.motion.commands.stopj(_JOG_RAD_S2)
        return True

    @property
    def failure(self) -> bool:
        return False
