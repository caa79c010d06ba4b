"""The world of one arm: its things, the tool that touches them, and hands that push.

Once per control period, before the arm moves, ``act`` looks where the tool is and says what that does to it. So a
force is that of the place and the speed the arm published last; the motion looks ahead by itself
(emulator.motion.contact).
Without a world none of this runs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from emulator.devices.robotiq import Gripper
from emulator.io.encoders import Encoders
from emulator.io.signals import Signals
from emulator.motion import Motion
from emulator.motion.contact import Contact
from emulator.world.disturbances import Disturbances
from emulator.world.shapes import Plane, Push, Sphere, WorldObject, contacts
from urproto.robots import RobotModel
from urproto.vectors import ZERO6, Vector6, lerp

if TYPE_CHECKING:
    from emulator.robot.arm import Arm
    from emulator.world.links import Links


MOST_OBJECTS: Final = 32  # a limit of this implementation: it bounds the work of one tick
POINT: Final = WorldObject(Sphere(0.0))  # a tool that touches with its TCP alone


class WorldError(ValueError):
    """A thing that is there already, is not there, or cannot be."""


class Wiring(NamedTuple):
    """What a world can be wired to."""

    signals: Signals
    encoders: Encoders
    gripper: Gripper | None


@dataclass
class World:
    """What an arm can meet. ``tool``: what touches, its pose in the frame of the TCP; its material does not count.

    ``links``: the arm's own, when they touch too. ``contacts``: of the tool, as of the latest period.
    """

    tool: WorldObject = POINT
    links: "Links | None" = None
    contacts: tuple[Contact, ...] = field(default=(), init=False)
    _things: dict[str, WorldObject] = field(default_factory=dict, init=False)
    _pushes: dict[str, Push] = field(default_factory=dict, init=False)

    disturbances: Disturbances | None = field(default=None, init=False)
    """What can go wrong in it on purpose; None for a world of springs."""

    failure = ""
    """Why it stands still, "" while all is well: a world of springs cannot fail."""

    def __post_init__(self) -> None:
        self.mount(self.tool)

    def wire(self, wiring: Wiring) -> None:
        """For a world with something in it to wire: once, before the first period."""

    def names(self) -> list[str]:
        """Names of everything that stands around."""
        return list(self._things)

    def poses(self) -> dict[str, Vector6]:
        """Where everything is, by name, in the base frame."""
        return {name: thing.pose for name, thing in self._things.items()}

    def pose(self, name: str) -> Vector6:
        """Where one thing is, in the base frame. Raises WorldError for an unknown name."""
        return self._known(name).pose

    def save(self) -> list[float] | None:
        """The state of what moves in it, for `restore`; None for a world in which nothing does."""
        return None

    def restore(self, state: Sequence[float] | None) -> None:
        """Take over what `save` gave; None is how everything was at first. Raises WorldError for another world's."""
        if state is not None:
            raise WorldError("nothing in this world moves: there is no state of it to restore")

    @property
    def things(self) -> Mapping[str, WorldObject]:
        """Everything that stands around, by name."""
        return MappingProxyType(self._things)

    @property
    def pushes(self) -> Mapping[str, Push]:
        """Hands that push now, by name."""
        return MappingProxyType(self._pushes)

    def add(self, name: str, thing: WorldObject) -> None:
        """Put a thing there. Raises WorldError when there is one of this name, or too many."""
        if name in self._things:
            raise WorldError(f"there is an object {name!r} already: remove or move it, or choose another name")
        if len(self._things) >= MOST_OBJECTS:
            raise WorldError(f"a world holds at most {MOST_OBJECTS} objects")
        if isinstance(thing.shape, Sphere) and not thing.shape.radius:
            raise WorldError(f"the object {name!r} is a sphere without a radius")
        self._things[name] = thing
        self._changed()

    def move(self, name: str, pose_base: Vector6) -> None:
        """Put a thing elsewhere, at once. Raises WorldError for an unknown name, ValueError for a bad pose."""
        self._things[name] = self._known(name).at(pose_base)
        self._changed()

    def remove(self, name: str) -> None:
        """Remove an object. Raises WorldError for an unknown name."""
        self._known(name)
        del self._things[name]
        self._changed()

    def mount(self, tool: WorldObject) -> None:
        """Touch with another tool from now on. Raises WorldError for one without end."""
        if isinstance(tool.shape, Plane):
            raise WorldError("a plane has no end and cannot be a tool: give a sphere or a box")
        self.tool = tool

    def push(self, name: str, push: Push) -> None:
        """Push the tool until the push is over or released; one of the same name is replaced.

        Raises WorldError when there are too many.
        """
        if name not in self._pushes and len(self._pushes) >= MOST_OBJECTS:
            raise WorldError(f"at most {MOST_OBJECTS} hands push at a time: release one")
        self._pushes[name] = push

    def release(self, name: str) -> bool:
        """End a push; False when there is none of this name."""
        return self._pushes.pop(name, None) is not None

    def act(self, arm: "Arm", motion: Motion, wrench: Vector6, period_s: float) -> Vector6:
        """One period: what the world does to the tool is added to a wrench at its TCP [N, Nm], base frame.

        Also tells the motion of the contacts, and the arm what the world does to its links.
        """
        wrench = lerp(wrench, self._tool_wrench(arm, period_s), 1.0)
        motion.force_control.contacts = self.contacts
        if self.links is not None:
            arm.link_torque = self.links.torques(arm.q, arm.qd)
        return wrench

    def _changed(self) -> None:
        if self.links is not None:
            self.links.surround(self._things.values())

    def _tool_wrench(self, arm: "Arm", period_s: float) -> Vector6:
        total = self._pushed(arm, period_s)
        self.contacts = tuple(contacts(self.tool, self._things.values(), arm.tcp_pose, arm.tcp_speed))
        for contact in self.contacts:
            total = lerp(total, contact.wrench, 1.0)
        return total

    def _pushed(self, arm: "Arm", period_s: float) -> Vector6:
        total = ZERO6
        for name, push in tuple(self._pushes.items()):
            total = lerp(total, push.wrench_base(arm.tcp_pose), 1.0)
            if push.over(period_s):
                del self._pushes[name]
        return total

    def _known(self, name: str) -> WorldObject:
        try:
            return self._things[name]
        except KeyError:
            there = ", ".join(self.names()) or "none"
            raise WorldError(f"there is no object {name!r}; there are: {there}") from None


class Plan(Protocol):
    """A world to be made: as often as there are controllers to stand in it."""

    @property
    def links(self) -> bool:
        """The arm's own links touch too."""

    def check(self, model: RobotModel, q: Sequence[float]) -> None:
        """Raise WorldError when it cannot be built around an arm that stands at q [rad]."""

    def build(self, model: RobotModel, period_s: float) -> World:
        """A world of its own for one arm. Raises WorldError."""
