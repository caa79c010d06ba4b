"""Commands that change the world while the controller runs, each with its inverse.

The answer is "" after success, otherwise the error.
"""

from dataclasses import dataclass, replace

from emulator.controller import Controller
from emulator.mailbox import Command
from emulator.world.shapes import Push, WorldObject
from emulator.world.world import World
from urproto.vectors import Vector6

HAND = "hand"


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

    @property
    def failure(self) -> str:
        return f"{self!r} failed: see the log of the emulator"


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
