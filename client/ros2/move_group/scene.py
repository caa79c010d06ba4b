"""The planning scene as in MoveIt: collision objects of several shapes, attached objects, and allowed collisions.

A scene is never changed in place: `SceneState.changed` returns another one, or refuses the whole message. A planner
therefore keeps the scene that it started with.
"""

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import pi
from typing import Any, Final

from client.errors import SceneError
from client.planning import Box, Cylinder, Hull, Plane, PlanningScene, Shape, Sphere
from client.planning.scene import LINKS, PADDING_M
from client.ros2.host import interface
from client.ros2.move_group.arm import Arm, RefusedError, pose_message, pose_of
from urproto.robots.pose import Pose, matrix_to_rotvec, pose_inv, pose_trans
from urproto.vectors import ZERO6

_KINDS: Final = (("primitives", "primitive_poses"), ("meshes", "mesh_poses"), ("planes", "plane_poses"))
_ADJACENT_LINKS: Final = 2  # links this close along the arm always touch, except base and upper arm
# moveit_msgs/PlanningSceneComponents
_SETTINGS, _STATE, _ATTACHED, _NAMES, _GEOMETRY, _MATRIX, _PADDING, _COLORS = 1, 2, 4, 8, 16, 128, 256, 512
_TOLERANCE: Final = 1e-9
EVERYTHING: Final = 0
"""Components of a scene: all of them, as in MoveIt."""

_SHOULDER: Final = (0.0, 0.0, 0.1, 0.0, 0.0, 0.0)  # a point inside every upright arm


@dataclass(frozen=True)
class BodyPart:
    """One shape of a body. kind: the field of the message that contains it. pose: in the body's frame."""

    kind: str
    geometry: Any
    pose: Pose


@dataclass(frozen=True)
class Body:
    """A collision object. pose: in the base frame, or the flange's when it is attached to a link.

    touching: links that an attached body may touch.
    """

    parts: tuple[BodyPart, ...]
    pose: Pose
    type: Any
    subframes: Mapping[str, Pose] = field(default_factory=dict)
    link: str = ""
    touching: tuple[str, ...] = ()
    weight: float = 0.0


class SceneState:
    """The objects around an arm, and the allowed collisions."""

    def __init__(self, arm: Arm, *, padding_m: float = PADDING_M) -> None:
        self.arm = arm
        self.name = "(noname)"  # MoveIt's
        self.padding_m = padding_m
        self.bodies: dict[str, Body] = {}
        self._entries: dict[frozenset[str], bool] = {}
        self._defaults: dict[str, bool] = {}
        self._colors: dict[str, Any] = {}

    # changes

    def changed(self, message: Any, q_rad: Sequence[float]) -> "SceneState":
        """The scene after a moveit_msgs/PlanningScene, CollisionObject, AttachedCollisionObject or PlanningSceneWorld.

        q_rad: the arm's current configuration. Raises RefusedError and SceneError; this scene stays as it is in any
        case.
        """
        new = copy(self)
        new.bodies, new._entries = dict(self.bodies), dict(self._entries)
        new._defaults, new._colors = dict(self._defaults), dict(self._colors)
        if hasattr(message, "is_diff"):
            new._apply(message, q_rad)
        elif hasattr(message, "collision_objects"):
            new._world(message, q_rad)
        elif hasattr(message, "object"):
            new._attached(message, q_rad)
        else:
            new._object(message, q_rad)
        new.scene()  # raises for what client.planning does not support
        return new

    def with_attached(self, messages: Sequence[Any], q_rad: Sequence[float]) -> "SceneState":
        """The scene with the objects that a request's robot state attaches in addition."""
        state = self
        for message in messages:
            state = state.changed(message, q_rad)
        return state

    def _apply(self, message: Any, q_rad: Sequence[float]) -> None:
        if message.fixed_frame_transforms:
            raise RefusedError(
                "FAILURE", "only the frames of the arm and of objects are supported: leave out fixed_frame_transforms"
            )
        if any(one.scale != 1.0 for one in message.link_scale):
            raise RefusedError("FAILURE", "link scaling is not supported: use padding")
        if not message.is_diff:
            self.bodies, self._entries, self._defaults, self._colors = {}, {}, {}, {}
        self.name = message.name or self.name
        if message.link_padding:
            self.padding_m = _one_padding(message.link_padding)
        for one in message.object_colors:
            self._colors[one.id] = one.color
        if message.allowed_collision_matrix.entry_names or message.allowed_collision_matrix.default_entry_names:
            self._matrix(message.allowed_collision_matrix)
        for attached in message.robot_state.attached_collision_objects:
            self._attached(attached, q_rad)
        self._world(message.world, q_rad)

    def _world(self, message: Any, q_rad: Sequence[float]) -> None:
        if message.octomap.octomap.data:
            raise RefusedError("FAILURE", "octomaps are not supported: give boxes or meshes")
        for one in message.collision_objects:
            self._object(one, q_rad)

    def _object(self, message: Any, q_rad: Sequence[float]) -> None:
        name, operation = message.id, _byte(message.operation)
        if operation == _byte(message.REMOVE):
            self._remove(name)
            return
        frame = self.arm.frame(message.header.frame_id, q_rad, self.frames(q_rad))
        body = _body(message, frame, name)
        known = self.bodies.get(name)
        if operation == _byte(message.MOVE):
            self.bodies[name] = _moved(known, body, message, name)
        elif operation == _byte(message.APPEND) and known is not None:
            self.bodies[name] = replace(known, parts=known.parts + body.parts)
        elif operation in (_byte(message.ADD), _byte(message.APPEND)):
            self._put(name, body)
        else:
            raise RefusedError("FAILURE", f"{name}: unknown operation {operation}")

    def _put(self, name: str, body: Body) -> None:
        if not name or not body.parts:
            raise RefusedError("INVALID_OBJECT_NAME", f"an object needs a name and a shape: {name!r}")
        if name in (*self.arm.links, *LINKS):
            raise RefusedError("INVALID_OBJECT_NAME", f"{name!r} is the name of a link")
        self.bodies[name] = body

    def _remove(self, name: str) -> None:
        """Remove an object from the world; "" removes all."""
        if not name:
            self.bodies = {name: body for name, body in self.bodies.items() if body.link}
        elif name not in self.bodies:
            raise RefusedError("INVALID_OBJECT_NAME", f"there is no object {name!r} to remove")
        elif not self.bodies[name].link:  # an attached object is no longer in the world
            del self.bodies[name]

    def _attached(self, message: Any, q_rad: Sequence[float]) -> None:
        obj = message.object
        if _byte(obj.operation) == _byte(obj.REMOVE):
            self._detach(obj.id, message.link_name, q_rad)
            return
        link = message.link_name or self.arm.tip
        link_offset = self.arm.flange_to_link(link)
        flange = self.arm.kinematics.forward(q_rad)
        if any(getattr(obj, kind) for kind, _ in _KINDS):
            frame = self.arm.frame(obj.header.frame_id or link, q_rad, self.frames(q_rad))
            if (obj.header.frame_id or link) == link:
                frame = pose_trans(flange, link_offset)
            body = _body(obj, frame, obj.id)
        elif obj.id in self.bodies:
            body = self._in_world(obj.id, q_rad)
        else:
            raise RefusedError(
                "INVALID_OBJECT_NAME", f"there is no object {obj.id!r} to attach, and the message has no shape"
            )
        pose = pose_trans(pose_inv(flange), body.pose)
        touching = tuple(message.touch_links)
        self._put(obj.id, replace(body, pose=pose, link=link, touching=touching, weight=message.weight))

    def _detach(self, name: str, link: str, q_rad: Sequence[float]) -> None:
        """Detach a body, or all of a link, or all, and leave them where the arm has them."""
        attached_names = [
            one for one, body in self.bodies.items() if body.link and link in ("", body.link) and name in ("", one)
        ]
        if name and not attached_names:
            raise RefusedError("INVALID_OBJECT_NAME", f"no object {name!r} is attached{f' to {link}' if link else ''}")
        for one in attached_names:
            self.bodies[one] = replace(self._in_world(one, q_rad), link="", touching=(), weight=0.0)

    def _in_world(self, name: str, q_rad: Sequence[float]) -> Body:
        body = self.bodies[name]
        return replace(body, pose=pose_trans(self.arm.kinematics.forward(q_rad), body.pose)) if body.link else body

    def _matrix(self, message: Any) -> None:
        names = list(message.entry_names)
        if len(names) != len(message.entry_values) or any(
            len(row.enabled) != len(names) for row in message.entry_values
        ):
            raise RefusedError("FAILURE", "the allowed collision matrix must have a row and a column for each name")
        if len(message.default_entry_names) != len(message.default_entry_values):
            raise RefusedError("FAILURE", "the allowed collision matrix must have one default value for each name")
        self._entries = {
            frozenset((names[i], names[j])): bool(message.entry_values[i].enabled[j])
            for i, j in combinations(range(len(names)), 2)
        }
        self._defaults = dict(zip(message.default_entry_names, map(bool, message.default_entry_values), strict=True))

    # contents

    def frames(self, q_rad: Sequence[float]) -> dict[str, Pose]:
        """The frames of bodies and, as ``body/subframe``, their subframes."""
        found = {}
        for name in self.bodies:
            body = self._in_world(name, q_rad)
            found[name] = body.pose
            found |= {f"{name}/{sub}": pose_trans(body.pose, pose) for sub, pose in body.subframes.items()}
        return found

    def scene(self) -> PlanningScene:
        """A new `client.planning` scene. Raises SceneError, RefusedError."""
        scene = PlanningScene(self.arm.model, padding_m=self.padding_m)
        own: dict[str, list[str]] = {link: [self.arm.planning_name(link)] for link in self.arm.collision_links}
        for name, body in self.bodies.items():
            own[name] = [one for one, _ in _numbered_parts(name, body)]
            for one, part in _numbered_parts(name, body):
                shape, pose = _shape(part, name, body.pose)
                (scene.attach if body.link else scene.add)(one, shape, pose)
        for one, other in combinations(own, 2):
            if self._may_touch(one, other):
                for first in own[one]:
                    for second in own[other]:
                        scene.allow(first, second)
        return scene

    def body_of(self, name: str) -> str:
        """The body that an object of `scene` belongs to."""
        return name if name in self.bodies else name.rpartition("#")[0]

    def _may_touch(self, one: str, other: str) -> bool:
        pair = frozenset((one, other))
        for name, partner in ((one, other), (other, one)):
            if name in self.bodies and partner in self.bodies[name].touching:
                return True
        if pair in self._entries:
            return self._entries[pair]
        values = [self._defaults[name] for name in pair if name in self._defaults]
        return bool(values) and all(values)

    # messages

    def message(self, q_rad: Sequence[float], components: int = EVERYTHING) -> Any:
        """A moveit_msgs/PlanningScene with these components."""
        wanted = components or -1
        message = interface("moveit_msgs/msg/PlanningScene")()
        message.name, message.robot_model_name = self.name, self.arm.model.name
        if wanted & (_STATE | _ATTACHED):
            message.robot_state = self.arm.state_message(q_rad)
            if wanted & _ATTACHED:
                message.robot_state.attached_collision_objects = self.attached_messages()
        if wanted & _MATRIX:
            message.allowed_collision_matrix = self._matrix_message()
        if wanted & _PADDING:
            padding, scale = interface("moveit_msgs/msg/LinkPadding"), interface("moveit_msgs/msg/LinkScale")
            message.link_padding = [
                padding(link_name=link, padding=self.padding_m) for link in self.arm.collision_links
            ]
            message.link_scale = [scale(link_name=link, scale=1.0) for link in self.arm.collision_links]
        if wanted & _COLORS:
            color = interface("moveit_msgs/msg/ObjectColor")
            message.object_colors = [color(id=name, color=one) for name, one in self._colors.items()]
        if wanted & (_NAMES | _GEOMETRY):
            free = {name: body for name, body in self.bodies.items() if not body.link}
            message.world.collision_objects = [
                self._object_message(name, body, geometry=bool(wanted & _GEOMETRY)) for name, body in free.items()
            ]
        return message

    def attached_messages(self) -> list[Any]:
        """The moveit_msgs/AttachedCollisionObject of each attached object, in the frame of its link."""
        found = []
        for name, body in self.bodies.items():
            if body.link:
                message = interface("moveit_msgs/msg/AttachedCollisionObject")()
                message.link_name, message.weight = body.link, body.weight
                message.touch_links = list(body.touching)
                message.object = self._object_message(name, body)
                found.append(message)
        return found

    def _object_message(self, name: str, body: Body, *, geometry: bool = True) -> Any:
        message = interface("moveit_msgs/msg/CollisionObject")()
        message.id = name
        self.arm.stamp(message.header, body.link)
        if not geometry:
            return message
        frame = self.arm.flange_to_link(body.link) if body.link else None
        message.pose = self.arm.pose_message(body.pose, frame)
        message.type = body.type
        for part in body.parts:
            getattr(message, part.kind).append(part.geometry)
            getattr(message, dict(_KINDS)[part.kind]).append(pose_message(part.pose))
        message.subframe_names = list(body.subframes)
        message.subframe_poses = [pose_message(pose) for pose in body.subframes.values()]
        return message

    def _matrix_message(self) -> Any:
        message = interface("moveit_msgs/msg/AllowedCollisionMatrix")()
        named = sorted({name for pair in self._entries for name in pair} - {*self.arm.collision_links, *self.bodies})
        names = [*self.arm.collision_links, *self.bodies, *named]
        row = interface("moveit_msgs/msg/AllowedCollisionEntry")
        message.entry_names = names
        message.entry_values = [row(enabled=[self._is_allowed(one, other) for other in names]) for one in names]
        message.default_entry_names = list(self._defaults)
        message.default_entry_values = list(self._defaults.values())
        return message

    def _is_allowed(self, one: str, other: str) -> bool:
        return one == other or self._may_touch(one, other) or self.is_collision_disabled(one, other)

    def is_collision_disabled(self, one: str, other: str) -> bool:
        """Whether two links are never checked, because they always touch or can never touch."""
        if not {one, other} <= set(self.arm.collision_links):
            return False
        low, high = sorted((self.arm.collision_links.index(one), self.arm.collision_links.index(other)))
        return high - low <= _ADJACENT_LINKS and (low, high) != (1, 3)


def _byte(value: Any) -> int:
    """The number of a byte field, which rclpy represents as bytes."""
    return int(value[0]) if isinstance(value, bytes) else int(value)


def _one_padding(messages: Sequence[Any]) -> float:
    values = {float(one.padding) for one in messages}
    if len(values) > 1:
        raise RefusedError("FAILURE", "all links have the same padding here: give each the same")
    return values.pop()


def _numbered_parts(name: str, body: Body) -> Iterator[tuple[str, BodyPart]]:
    for number, part in enumerate(body.parts):
        yield (name if len(body.parts) == 1 else f"{name}#{number}"), part


def _body(message: Any, frame: Pose, name: str) -> Body:
    parts = tuple(
        BodyPart(kind, geometry, pose_of(pose))
        for kind, poses in _KINDS
        for geometry, pose in zip(getattr(message, kind), _poses(message, kind, poses, name), strict=True)
    )
    pose = pose_of(message.pose)
    if (
        len(parts) == 1 and max(map(abs, pose)) < _TOLERANCE
    ):  # as in MoveIt, the frame of such an object is that of its shape
        pose, parts = parts[0].pose, (replace(parts[0], pose=ZERO6),)
    subframes = dict(zip(message.subframe_names, map(pose_of, message.subframe_poses), strict=False))
    return Body(parts, pose_trans(frame, pose), message.type, subframes)


def _poses(message: Any, kind: str, poses: str, name: str) -> list[Any]:
    shapes, given = getattr(message, kind), getattr(message, poses)
    moves = message.operation == message.MOVE
    if (len(given) > len(shapes) and not moves) or 0 < len(given) < len(shapes):
        raise RefusedError("FAILURE", f"{name}: {len(shapes)} {kind} have {len(given)} {poses}")
    return list(given[: len(shapes)]) or [pose_message() for _ in shapes]


def _moved(known: Body | None, body: Body, message: Any, name: str) -> Body:
    if known is None or known.link:
        raise RefusedError("INVALID_OBJECT_NAME", f"there is no object {name!r} in the world to move")
    if body.parts:
        raise RefusedError("FAILURE", f"{name}: to move an object, leave its shapes out")
    poses = [pose_of(pose) for _, field_ in _KINDS for pose in getattr(message, field_)]
    if not poses:
        return replace(known, pose=body.pose)
    if len(poses) != len(known.parts):
        raise RefusedError("FAILURE", f"{name} has {len(known.parts)} shapes, and {len(poses)} poses were given")
    parts = tuple(replace(part, pose=pose) for part, pose in zip(known.parts, poses, strict=True))
    return replace(known, pose=body.pose, parts=parts)


# shapes


def _shape(part: BodyPart, name: str, body: Pose) -> tuple[Shape, Pose]:
    """The shape and pose for client.planning. Raises RefusedError, SceneError."""
    pose = pose_trans(body, part.pose)
    if part.kind == "meshes":
        return Hull(tuple((float(v.x), float(v.y), float(v.z)) for v in part.geometry.vertices)), pose
    if part.kind == "planes":
        return Plane(), _plane(part.geometry.coef, pose, name)
    solid = part.geometry
    sizes = [float(value) for value in solid.dimensions]
    match solid.type, sizes:
        case solid.BOX, [x, y, z]:
            return Box((x, y, z)), pose
        case solid.SPHERE, [radius]:
            return Sphere(radius), pose
        case solid.CYLINDER, [height, radius]:
            return Cylinder(radius, height), pose
    raise RefusedError(
        "FAILURE",
        f"{name}: a solid primitive of type {solid.type} with {len(sizes)} dimensions is not supported: give a box "
        "(three), a sphere (one) or a cylinder (two), and other shapes as meshes",
    )


def _plane(coefficients: Sequence[float], pose: Pose, name: str) -> Pose:
    """The pose of a plane that is solid on the side away from the arm, which the arm cannot reach anyway."""
    a, b, c, d = map(float, coefficients)
    length = (a * a + b * b + c * c) ** 0.5
    if not length > _TOLERANCE:
        raise SceneError(f"{name}: a plane needs a normal that is not zero: {a}, {b}, {c}")
    normal = (a / length, b / length, c / length)
    middle = tuple(-d / length * value for value in normal)
    placed = pose_trans(pose, (*middle, *_turned(normal)))
    above = pose_trans(pose_inv(placed), _SHOULDER)[2] >= 0.0
    return placed if above else pose_trans(placed, (0.0, 0.0, 0.0, pi, 0.0, 0.0))


def _turned(normal: Sequence[float]) -> tuple[float, float, float]:
    """A rotation that turns z to this direction."""
    x, y, z = normal
    u = (1.0, 0.0, 0.0) if abs(x) < 0.9 else (0.0, 1.0, 0.0)
    v = (y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0])
    size = sum(value * value for value in v) ** 0.5
    v = (v[0] / size, v[1] / size, v[2] / size)
    w = (v[1] * z - v[2] * y, v[2] * x - v[0] * z, v[0] * y - v[1] * x)
    return matrix_to_rotvec((w[0], v[0], x, w[1], v[1], y, w[2], v[2], z))
