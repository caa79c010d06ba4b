"""What a user does to the world while the controller runs, as commands to post; each with its inverse.

The answer is "" when it was done, else what was wrong with it.
"""

from dataclasses import dataclass, replace

from emulator.controller import Controller
from emulator.mailbox import Command
from emulator.world.shapes import Push, WorldObject
from emulator.world.world import World
from urproto.vectors import Vector6

HAND = "hand"


class WorldCommand(Command):
    """Base of the commands that change the world. The first one makes it."""

    def apply(self, controller: Controller) -> str:
        if controller.world is None:
            controller.world = World()
        try:
            self.change(controller.world)
        except ValueError as error:
            return str(error)
        return ""

    def change(self, world: World) -> None:
        """Do it. Raises ValueError when it cannot be done; nothing has changed then."""
        raise NotImplementedError

    @property
    def failure(self) -> str:
        return f"{self!r} failed: see the log"


@dataclass(frozen=True, slots=True)
class PushTool(WorldCommand):
    """Push the tool, until ``push`` is over or ReleaseTool of the same name comes."""

    push: Push
    name: str = HAND

    def change(self, world: World) -> None:
        world.push(self.name, replace(self.push))  # a push counts its time down: each has its own


@dataclass(frozen=True, slots=True)
class ReleaseTool(WorldCommand):
    """Push no more."""

    name: str = HAND

    def change(self, world: World) -> None:
        if not world.release(self.name):
            raise ValueError(f"nothing named {self.name!r} pushes the tool")


@dataclass(frozen=True, slots=True)
class AddObject(WorldCommand):
    """Put a thing into the world."""

    name: str
    thing: WorldObject

    def change(self, world: World) -> None:
        world.add(self.name, self.thing)


@dataclass(frozen=True, slots=True)
class MoveObject(WorldCommand):
    """Put a thing elsewhere; pose in the base frame."""

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
    """Put everything that moves back to where it was at first, at rest; also after a failure of its physics."""

    def change(self, world: World) -> None:
        world.restore(None)


@dataclass(frozen=True, slots=True)
class MountTool(WorldCommand):
    """Touch with another shape; its pose in the frame of the TCP. ``POINT`` is the tool there was at first."""

    tool: WorldObject

    def change(self, world: World) -> None:
        world.mount(self.tool)
