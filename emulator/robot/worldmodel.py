"""Named coordinate frames around the arm, in a tree, and the masses they carry.

Four frames always exist: "world" is the root, "base" is fixed in it, "flange" moves with the
arm and "tcp" with the flange. Programs add others, which persist after the program's end
(MotionPlus manual). A frame that is attached to another moves along with it. Poses: x, y, z [m]
and a rotation vector [rad].
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

from emulator.robot.installation import Payload
from urproto.robots.pose import Pose, pose_inv, pose_trans, rotvec_to_matrix
from urproto.vectors import ZERO6, Vector3, Vector6

_ORIGIN: Final = ZERO6
_WORLD, _BASE, _FLANGE, _TCP = "world", "base", "flange", "tcp"
_PREDEFINED: Final = (_WORLD, _BASE, _FLANGE, _TCP)
_FIXED: Final = (_WORLD, _FLANGE, _TCP)  # MotionPlus manual: these are never attached elsewhere
_MAX_FRAMES: Final = 100  # a limit of this implementation, which bounds the cost of a look-up
_NOT_MOVED: Final = {
    _WORLD: "it is the root of all frames",
    _FLANGE: "the arm moves it",
    _TCP: "set_tcp() places it",
}


class WorldModelError(ValueError):
    """A frame does not exist, exists already, or cannot be changed like that."""


@dataclass(frozen=True, slots=True)
class ArmPose:
    """Pose of the arm: flange in the base frame, TCP in the flange frame."""

    base_flange: Pose
    flange_tcp: Pose


@dataclass(frozen=True, slots=True)
class MassProperties:
    """Mass [kg], centre of gravity in the frame [m], and inertia about it, axes as the frame's:
    Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg m2]."""

    mass: float
    cog: Vector3
    inertia: Vector6


_NO_ARM: Final = ArmPose(_ORIGIN, _ORIGIN)  # for frames that do not depend on the arm


@dataclass(frozen=True, slots=True)
class _Frame:
    parent: str
    pose: Pose  # in the parent's frame; for flange and tcp, the arm determines it


class WorldModel:
    """The tree of frames. Methods that depend on flange and TCP take an ``ArmPose``."""

    def __init__(self) -> None:
        self._frames: dict[str, _Frame] = {}
        self._masses: dict[str, MassProperties] = {}
        self.reset()

    def reset(self) -> None:
        """Remove all added frames and masses, and return the base to the world's origin."""
        self._frames = {
            _WORLD: _Frame("", _ORIGIN),
            _BASE: _Frame(_WORLD, _ORIGIN),
            _FLANGE: _Frame(_BASE, _ORIGIN),
            _TCP: _Frame(_FLANGE, _ORIGIN),
        }
        self._masses = {}

    def __contains__(self, name: str) -> bool:
        return name in self._frames

    def parent(self, name: str) -> str:
        """The frame that this one is attached to; the world has none."""
        self._check_known(name)
        if name == _WORLD:
            raise WorldModelError('the frame "world" is the root: it has no parent')
        return self._frames[name].parent

    def children(self, name: str) -> list[str]:
        """Frames attached directly to this one, in order of creation."""
        self._check_known(name)
        return [child for child, frame in self._frames.items() if frame.parent == name]

    def add(self, name: str, pose: Pose, reference: str, arm: ArmPose) -> None:
        """Add a frame that is fixed in the world, given in a reference frame to which it is not attached."""
        if name in self._frames:
            raise WorldModelError(f'the frame "{name}" exists already: move it with move_frame(), or delete it first')
        if not name:
            raise WorldModelError("a frame needs a name")
        if len(self._frames) >= _MAX_FRAMES:
            raise WorldModelError(f"there are already {_MAX_FRAMES} frames, the maximum: delete some")
        self._frames[name] = _Frame(_WORLD, pose_trans(self.in_world(reference, arm), pose))

    def attach(self, child: str, parent: str, arm: ArmPose) -> None:
        """Attach a frame to another, with which it then moves; its present pose does not change."""
        self._check_known(child)
        self._check_known(parent)
        if child in _FIXED:
            raise WorldModelError(f'the frame "{child}" cannot be attached to another one')
        if child in self._chain(parent):
            raise WorldModelError(f'"{child}" cannot be attached to "{parent}": "{parent}" moves along with it')
        self._frames[child] = _Frame(parent, self.pose(child, parent, parent, arm))

    def move(self, name: str, pose: Pose, reference: str, arm: ArmPose) -> None:
        """Move a frame to a pose given in a reference frame; frames attached to it move along."""
        self._check_known(name)
        if name in _FIXED:
            raise WorldModelError(f'the frame "{name}" cannot be moved: ' + _NOT_MOVED[name])
        placed = pose_trans(self.in_world(reference, arm), pose)
        frame = self._frames[name]
        self._frames[name] = replace(frame, pose=pose_trans(pose_inv(self.in_world(frame.parent, arm)), placed))

    def delete(self, name: str, arm: ArmPose) -> None:
        """Remove a frame; frames attached to it stay where they are, attached to the world."""
        self._check_known(name)
        if name in _PREDEFINED:
            raise WorldModelError(f'the frame "{name}" cannot be deleted')
        for child in self.children(name):
            self.attach(child, _WORLD, arm)
        del self._frames[name]
        self._masses.pop(name, None)

    def delete_all(self, arm: ArmPose) -> None:
        """Remove all frames except the four predefined ones; the base stays where it is."""
        for name in [name for name in self._frames if name not in _PREDEFINED]:
            self.delete(name, arm)

    # poses

    def in_world(self, name: str, arm: ArmPose) -> Pose:
        self._check_known(name)
        pose = _ORIGIN
        for link in self._chain(name):
            pose = pose_trans(self._in_parent(link, arm), pose)
        return pose

    def pose(self, name: str, relative_to: str, expressed_in: str, arm: ArmPose) -> Pose:
        """Pose of ``name`` relative to ``relative_to``, in the axes of ``expressed_in``."""
        relative = pose_trans(pose_inv(self.in_world(relative_to, arm)), self.in_world(name, arm))
        if expressed_in == relative_to:
            return relative
        axes = _turn_between(self.in_world(relative_to, arm), self.in_world(expressed_in, arm))
        return pose_trans(pose_trans(axes, relative), pose_inv(axes))

    def convert(self, pose: Pose, source: str, target: str, arm: ArmPose) -> Pose:
        return pose_trans(self.pose(source, target, target, arm), pose)

    def carries(self, carrier: str, name: str) -> bool:
        """Whether ``name`` is the carrier or moves along with it."""
        self._check_known(name)
        return carrier in self._chain(name)

    def in_base(self, name: str) -> Pose:
        """Pose in the base of a frame that the arm does not carry. Raises WorldModelError for one that it does."""
        if self.carries(_FLANGE, name):
            raise WorldModelError(f'the frame "{name}" moves with the arm itself: attach it to another frame')
        return self.pose(name, _BASE, _BASE, _NO_ARM)

    def _in_parent(self, name: str, arm: ArmPose) -> Pose:
        if name == _FLANGE:
            return arm.base_flange
        return arm.flange_tcp if name == _TCP else self._frames[name].pose

    def _chain(self, name: str) -> Iterator[str]:
        """The frame and all its ancestors, without the world."""
        while name != _WORLD:
            yield name
            name = self._frames[name].parent

    def _check_known(self, name: str) -> None:
        if name not in self._frames:
            raise WorldModelError(f'there is no frame "{name}"; the frames are {", ".join(self._frames)}')

    # masses

    def set_mass(self, name: str, properties: MassProperties) -> None:
        self._check_known(name)
        self._masses[name] = properties

    def payload(self, arm: ArmPose) -> Payload:
        """Payload on the flange: the combined masses of all frames that move with it, including the TCP."""
        carried = [
            _expressed_in(self.pose(name, _FLANGE, _FLANGE, arm), properties)
            for name, properties in self._masses.items()
            if _FLANGE in self._chain(name)
        ]
        return _combined(carried)


def _turn_between(reference: Pose, other: Pose) -> Pose:
    """Rotation of a pose relative to another, without the translation."""
    x, y, z = pose_trans(pose_inv(other), reference)[3:]
    return (0.0, 0.0, 0.0, x, y, z)


def _expressed_in(pose: Pose, body: MassProperties) -> MassProperties:
    """Express a frame's body in the axes of the frame in which that frame is at ``pose``."""
    r = rotvec_to_matrix(*pose[3:])
    cog = pose_trans(pose, (*body.cog, 0.0, 0.0, 0.0))[:3]
    xx, yy, zz, xy, xz, yz = body.inertia
    inertia = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))

    def turned(i: int, j: int) -> float:
        return sum(r[3 * i + k] * inertia[k][m] * r[3 * j + m] for k in range(3) for m in range(3))

    turned_inertia = (turned(0, 0), turned(1, 1), turned(2, 2), turned(0, 1), turned(0, 2), turned(1, 2))
    return MassProperties(body.mass, (cog[0], cog[1], cog[2]), turned_inertia)


def _combined(bodies: list[MassProperties]) -> Payload:
    """Combine bodies in one frame's axes into one, by the parallel axis theorem."""
    mass = sum(body.mass for body in bodies)
    if mass <= 0.0:
        return Payload()
    x, y, z = (sum(body.mass * body.cog[i] for body in bodies) / mass for i in range(3))
    totals = [0.0] * 6
    for body in bodies:
        dx, dy, dz = body.cog[0] - x, body.cog[1] - y, body.cog[2] - z
        steiner = (dy * dy + dz * dz, dx * dx + dz * dz, dx * dx + dy * dy, -dx * dy, -dx * dz, -dy * dz)
        totals = [t + i + body.mass * s for t, i, s in zip(totals, body.inertia, steiner, strict=True)]
    xx, yy, zz, xy, xz, yz = totals
    return Payload(mass, (x, y, z), (xx, yy, zz, xy, xz, yz))
