"""Commands that act on the safety system from outside, each with its inverse: press and release, lose and restore."""

from dataclasses import dataclass

from emulator.controller import Controller
from emulator.mailbox import Command
from emulator.safety.causes import Cause
from emulator.safety.signals import SafetyDevice
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
        controller.safety_board.inputs.set_device(self.device, self.active)


@dataclass(frozen=True, slots=True)
class SetSafetyInput(Command):
    """Set both channels of a configurable safety input. Answer: False if no pins are assigned to the function."""

    failure = False

    function: SafetyInput
    high: bool

    def apply(self, controller: Controller) -> bool:
        mask = controller.safety_board.inputs.pins_of(self.function)
        signals = controller.signals
        signals.digital_inputs = signals.digital_inputs | mask if self.high else signals.digital_inputs & ~mask
        return bool(mask)


@dataclass(frozen=True, slots=True)
class TripSafety(Command):
    """Trigger a violation, a fault or a protective stop. Answer: whether the safety mode changed.

    Causes that last as long as somebody holds them, such as an emergency stop, are devices: see `SetSafetyDevice`.
    """

    failure = False

    cause: Cause
    joint: int | None = None

    def apply(self, controller: Controller) -> bool:
        return controller.safety_board.trip(self.cause, self.joint)


@dataclass(frozen=True, slots=True)
class ArmSupply(Command):
    """Remove the arm's 48 V supply, or restore it."""

    present: bool

    def apply(self, controller: Controller) -> None:
        controller.safety_board.set_supply(self.present)


@dataclass(frozen=True, slots=True)
class FreedriveButton(Command):
    """Press or release the pendant's freedrive button. The arm is free while no program runs and it may move."""

    held: bool

    def apply(self, controller: Controller) -> None:
        controller.safety_board.hold_freedrive(self.held)


@dataclass(frozen=True, slots=True)
class Jog(Command):
    """Jog as on the pendant's Move tab: joint speeds [rad/s] until the next command, zeros to stop.

    Answer: False if the arm may not move, a program is running, or the speeds are not plausible.
    """

    failure = False

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
