"""Verbs about the objects around the arm, the forces on it, and its true payload."""

from collections.abc import Mapping
from typing import Any, Final, Literal

from emulator.control.verbs import Verbs, refusing, verb
from emulator.robot.installation import Payload
from emulator.snapshot import plausible
from emulator.world.file import describe_object, read_object
from emulator.world.shapes import Frame, Push
from emulator.world.world import World
from urproto.controlapi import BadArguments
from urproto.vectors import ZERO3, Vector3, Vector6

_HAND: Final = "hand"  # the name of the only push


class WorldVerbs(Verbs):
    """Verbs about objects, pushes on the tool, and the payload that is really mounted."""

    @verb
    def push_tool(
        self, wrench: Vector6, frame: Literal["base", "tool"] = "base", duration_s: float | None = None
    ) -> None:
        """Push the tool at the TCP with a force [N] and torque [Nm], for ``duration_s`` or until ``release_tool``."""
        with refusing(BadArguments):
            push = Push(wrench, Frame(frame), duration_s)
            self._world().push(_HAND, push)

    @verb
    def release_tool(self) -> None:
        """Stop pushing the tool."""
        if not self._world().release(_HAND):
            raise BadArguments(f"no push of the tool is named {_HAND!r}")

    @verb
    def world(self) -> dict[str, Any]:
        """Describe the world as in a world file: objects and tool; in addition the push, and the mounted payload."""
        world, payload = self.controller.world or World(), self.controller.simulation.real.mounted
        push = world.pushes.get(_HAND)
        return {
            "objects": {name: describe_object(obj) for name, obj in world.objects.items()},
            "tool": describe_object(world.tool, tool=True),
            "push": None if push is None else {"wrench": list(push.wrench), "frame": push.frame.value},
            "payload": None if payload is None else {"mass_kg": payload.mass, "cog_m": list(payload.cog)},
        }

    @verb
    def objects(self) -> list[str]:
        """List the names of the objects around the arm."""
        world = self.controller.world
        return world.names() if world is not None else []

    @verb
    def object_poses(self) -> dict[str, Vector6]:
        """The current pose of each object around the arm: x, y, z [m], rx, ry, rz [rad] in the base frame."""
        world = self.controller.world
        return world.poses() if world is not None else {}

    @verb
    def reset_world(self) -> None:
        """Return everything that moves (``--physics``) to its initial pose, at rest; also after a failure."""
        with refusing(BadArguments):
            self._world().restore(None)

    @verb
    def add_object(self, name: str, description: Mapping[str, Any]) -> None:
        """Add an object, described as in a world file.

        For example {"box": [0.1, 0.1, 0.1], "pose": [0.3, 0, 0], "stiffness": 1e4}.
        """
        with refusing(BadArguments):
            added = read_object(name, dict(description))
            self._world().add(name, added)

    @verb
    def move_object(self, name: str, pose: Vector6) -> None:
        """Move an object to a pose in the base frame, x, y, z [m], rx, ry, rz [rad]."""
        with refusing(BadArguments):
            self._world().move(name, pose)

    @verb
    def remove_object(self, name: str) -> None:
        """Remove an object."""
        with refusing(BadArguments):
            self._world().remove(name)

    @verb
    def mount_tool(self, description: Mapping[str, Any]) -> None:
        """Give the tool a shape for contacts, other than a point: {"sphere": 0.01}, with a pose in the TCP frame."""
        with refusing(BadArguments):
            tool = read_object("tool", dict(description), tool=True)
            self._world().mount(tool)

    @verb
    def mount_payload(self, mass_kg: float | None = None, cog_m: Vector3 = ZERO3) -> None:
        """Mount a payload that programs do not know about; without a mass, the payload is the one that they set."""
        payload = None if mass_kg is None else Payload.of(mass_kg, cog_m)
        if payload is not None and not (payload.mass >= 0.0 and plausible(payload.mass, *cog_m, *payload.inertia)):
            raise BadArguments(f"{payload} is not a payload: its numbers must be finite, and its mass at least 0")
        self.controller.simulation.real.mounted = payload

    def _world(self) -> World:
        """The world that is to be changed; there is none before the first change, or without ``--world``."""
        if self.controller.world is None:
            self.controller.world = World()
        return self.controller.world
