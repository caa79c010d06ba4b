"""The world of one arm: its objects, the tool that touches them, and hands that push.

Once per control period, before the arm moves, ``act`` calculates the forces on the tool at its present position. A
force therefore belongs to the position and speed that the arm published last; the motion itself looks ahead
(emulator.motion.contact). Without a world, none of this runs.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from emulator.devices.robotiq import Gripper
from emulator.io.encoders import Encoders
from emulator.io.signals import Signals
from emulator.motion import Motion
from emulator.motion.contact import Contact
from emulator.world.shapes import Plane, Push, Sphere, WorldObject, contacts
from urproto.robots import RobotModel
from urproto.vectors import ZERO6, Vector6, lerp

if TYPE_CHECKING:
    from emulator.robot.arm import Arm
    from emulator.world.links import Links

MAX_OBJECTS: Final = 32  # a limit of this implementation, which bounds the computing time of a period
POINT: Final = WorldObject(Sphere(0.0))  # a tool that touches with its TCP alone


class WorldError(ValueError):
    """An object already exists, does not exist, or is invalid."""


class Wiring(NamedTuple):
    """Parts of the controller that a world can be wired to."""

    signals: Signals
    encoders: Encoders
    gripper: Gripper | None


@dataclass
class World:
    """The objects an arm can touch. ``tool``: its pose in the frame of the TCP; its material is ignored.

    ``links``: the arm's links, if their contacts are enabled. ``contacts``: of the tool in the latest period.
    """

    tool: WorldObject = POINT
    links: "Links | None" = None
    contacts: tuple[Contact, ...] = field(default=(), init=False)
    _objects: dict[str, WorldObject] = field(default_factory=dict, init=False)
    _pushes: dict[str, Push] = field(default_factory=dict, init=False)

    disturbances: "Disturbances | None" = field(default=None, init=False)
    """Injected disturbances; None for a world of springs."""

    failure = ""
    """Reason why the world has stopped, "" otherwise: a world of springs cannot fail."""

    def __post_init__(self) -> None:
        self.mount(self.tool)

    def wire(self, wiring: Wiring) -> None:
        """Connect a world that can be wired; called once, before the first period."""

    def names(self) -> list[str]:
        return list(self._objects)

    def poses(self) -> dict[str, Vector6]:
        """Poses of all objects by name, in the base frame."""
        return {name: obj.pose for name, obj in self._objects.items()}

    def pose(self, name: str) -> Vector6:
        """Pose of one object in the base frame. Raises WorldError for an unknown name."""
        return self._known(name).pose

    def save(self) -> list[float] | None:
        """State of all moving objects, for `restore`; None for a world without any."""
        return None

    def restore(self, state: Sequence[float] | None) -> None:
        """Restore a state from `save`; None stands for the initial one. Raises WorldError for another world's state."""
        if state is not None:
            raise WorldError("no object of this world moves: there is no state to restore")

    @property
    def objects(self) -> Mapping[str, WorldObject]:
        return MappingProxyType(self._objects)

    @property
    def pushes(self) -> Mapping[str, Push]:
        return MappingProxyType(self._pushes)

    def add(self, name: str, obj: WorldObject) -> None:
        """Add an object. Raises WorldError if there is one of this name, or too many."""
        if name in self._objects:
            raise WorldError(f"the object {name!r} exists already: remove or move it, or choose another name")
        if len(self._objects) >= MAX_OBJECTS:
            raise WorldError(f"a world can have at most {MAX_OBJECTS} objects: remove one")
        if isinstance(obj.shape, Sphere) and not obj.shape.radius:
            raise WorldError(f"the object {name!r} is a sphere without a radius")
        self._objects[name] = obj
        self._changed()

    def move(self, name: str, pose_base: Vector6) -> None:
        """Move an object to a pose immediately. Raises WorldError for an unknown name, ValueError for a bad pose."""
        self._objects[name] = self._known(name).at(pose_base)
        self._changed()

    def remove(self, name: str) -> None:
        """Remove an object. Raises WorldError for an unknown name."""
        self._known(name)
        del self._objects[name]
        self._changed()

    def mount(self, tool: WorldObject) -> None:
        """Set another tool. Raises WorldError for one of infinite size."""
        if isinstance(tool.shape, Plane):
            raise WorldError("a plane is infinite and cannot be a tool: use a sphere or a box")
        self.tool = tool

    def push(self, name: str, push: Push) -> None:
        """Push the tool until the push is over or released; it replaces one of the same name.

        Raises WorldError if there are too many.
        """
        if name not in self._pushes and len(self._pushes) >= MAX_OBJECTS:
            raise WorldError(f"at most {MAX_OBJECTS} pushes can be active at a time: release one")
        self._pushes[name] = push

    def release(self, name: str) -> bool:
        """End a push; returns False if there is none of this name."""
        return self._pushes.pop(name, None) is not None

    def act(self, arm: "Arm", motion: Motion, wrench: Vector6, period_s: float) -> Vector6:
        """Advance one period: add the world's forces on the tool to a wrench at its TCP [N, Nm], base frame.

        Also passes the contacts to the motion, and the torques on its links to the arm.
        """
        wrench = lerp(wrench, self._tool_wrench(arm, period_s), 1.0)
        motion.force_control.contacts = self.contacts
        if self.links is not None:
            arm.link_torque = self.links.torques(arm.q, arm.qd)
        return wrench

    def _changed(self) -> None:
        if self.links is not None:
            self.links.surround(self._objects.values())

    def _tool_wrench(self, arm: "Arm", period_s: float) -> Vector6:
        total = self._pushed(arm, period_s)
        self.contacts = tuple(contacts(self.tool, self._objects.values(), arm.tcp_pose, arm.tcp_speed))
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
            return self._objects[name]
        except KeyError:
            there = ", ".join(self.names()) or "none"
            raise WorldError(f"there is no object {name!r}; there are: {there}") from None


class Plan(Protocol):
    """The plan of a world, from which one world per controller is built."""

    @property
    def links(self) -> bool:
        """Whether contacts of the arm's links are enabled."""

    def check(self, model: RobotModel, q: Sequence[float]) -> None:
        """Raise WorldError if the world cannot be built around an arm at q [rad]."""

    def build(self, model: RobotModel, period_s: float) -> World:
        """Build a separate world for one arm. Raises WorldError."""


class Disturbances(Protocol):
    """Disturbances by the names in the world file. Each can be repeated and undone."""

    @property
    def parts(self) -> Collection[str]:
        """Objects that move freely."""

    @property
    def conveyors(self) -> Collection[str]:
        """Belts."""

    @property
    def cameras(self) -> Collection[str]:
        """Cameras."""

    def take_away(self, part: str) -> None:
        """Remove a part, even if it has been put back since."""

    def bring_back(self, part: str) -> None:
        """Return a part, at rest, to its first position or to where it was put since."""

    def set_friction(self, part: str, friction: float | None) -> None:
        """Set a part's coefficient of friction with everything it touches; None restores its own."""

    def jam(self, conveyor: str, *, jammed: bool) -> None:
        """Stop a belt regardless of its output, or release it."""

    def cover(self, camera: str, *, covered: bool) -> None:
        """Cover a camera's lens, or uncover it."""
