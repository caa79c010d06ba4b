"""Actions on a robot that tests post, and that so take place in the next control period: what verbs do at once."""

from dataclasses import dataclass, replace
from typing import Any

from emulator.controller import Controller
from emulator.mailbox import Command
from emulator.robot.installation import Payload
from emulator.safety.causes import Cause
from emulator.safety.signals import SafetyDevice
from emulator.snapshot import plausible
from emulator.world.shapes import Push, WorldObject
from emulator.world.world import World
from urproto.modes import RuntimeState
from urproto.robots.model import Joints
from urproto.vectors import Vector6
from urscript.polyscope.safety_configuration import SafetyInput

_JOG_RAD_S2 = 1.4
HAND = "hand"


@dataclass(frozen=True, slots=True)
class PopupAnswer(Command):
    """An operator's answer to a popup or a question; None cancels a question.

    Answer: whether this dialogue was open and the value has the requested type.
    """

    request_id: int
    value: Any

    def apply(self, controller: Controller) -> bool:
        try:
            return controller.popups.answer(self.request_id, self.value)
        except ValueError as error:
            controller.messages.note(f"answer rejected: {error}")
            return False


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


class WorldCommand(Command):
    """Base of the commands that change the world. The first one creates it."""

    def apply(self, controller: Controller) -> str:
        if controller.world is None:
            controller.world = World()
        try:
            self.change(controller.world)
        except ValueError as error:
            return str(error)
        return ""

    def change(self, world: World) -> None:
        """Carry out the change. Raises ValueError if it is not possible; nothing is changed then."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class PushTool(WorldCommand):
    """Push the tool until ``push`` is over or ReleaseTool with the same name ends it."""

    push: Push
    name: str = HAND

    def change(self, world: World) -> None:
        world.push(self.name, replace(self.push))  # a copy: a push counts down its own time


@dataclass(frozen=True, slots=True)
class ReleaseTool(WorldCommand):
    """Stop pushing the tool."""

    name: str = HAND

    def change(self, world: World) -> None:
        if not world.release(self.name):
            raise ValueError(f"no push of the tool is named {self.name!r}")


@dataclass(frozen=True, slots=True)
class AddObject(WorldCommand):
    """Add an object to the world."""

    name: str
    added: WorldObject

    def change(self, world: World) -> None:
        world.add(self.name, self.added)


@dataclass(frozen=True, slots=True)
class MoveObject(WorldCommand):
    """Move an object to a pose in the base frame."""

    name: str
    pose: Vector6

    def change(self, world: World) -> None:
        world.move(self.name, self.pose)


@dataclass(frozen=True, slots=True)
class RemoveObject(WorldCommand):
    """Remove an object."""

    name: str

    def change(self, world: World) -> None:
        world.remove(self.name)


@dataclass(frozen=True, slots=True)
class ResetWorld(WorldCommand):
    """Return all movable objects to their initial poses, at rest; also after a failure of the physics."""

    def change(self, world: World) -> None:
        world.restore(None)


@dataclass(frozen=True, slots=True)
class MountTool(WorldCommand):
    """Change the shape of the tool for contacts; its pose is in the TCP frame. ``POINT`` is the initial tool."""

    tool: WorldObject

    def change(self, world: World) -> None:
        world.mount(self.tool)


@dataclass(frozen=True, slots=True)
class MountPayload(Command):
    """Set the true payload of the flange, independent of the one that programs set; None: the same as programs set."""

    payload: Payload | None

    def apply(self, controller: Controller) -> None:
        controller.simulation.real.mounted = self.payload
