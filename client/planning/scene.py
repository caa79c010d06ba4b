"""The planning scene: the objects around an arm, the objects it carries, and which of them may touch.

Poses are x, y, z [m] and a rotation vector [rad]: of objects in the controller's base frame, of attached objects in the
flange's frame. Links have the names of ur_description.
"""

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from client.errors import SceneError
from client.quantities import QUANTITIES, check_fields, checked
from urproto.errors import LocalProtocolError
from urproto.robots import Kinematics, RobotModel, kinematics_of, load_model
from urproto.robots.pose import Pose, pose_inv, pose_trans
from urproto.vectors import ZERO6, Vector3, as_six
from urproto.worldfile import ObjectDescription, WorldFileError, read_world_file
from urscript.polyscope.document import DocumentError, read_document
from urscript.polyscope.safety_configuration import BoundaryMode, SafetyConfiguration
from urscript.polyscope.safety_configuration import Plane as SafetyPlane
from urscript.polyscope.safety_section import SafetySettingsError, read_safety_settings

LINKS: Final = ("base_link", "shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link",
                "wrist_3_link")  # fmt: skip
"""From the base to the last wrist."""

PADDING_M: Final = 0.01
_MIN_THICKNESS_M: Final = 1e-6  # of a hull (guess)
_SHAPES: Final = ("plane", "box", "sphere", "cylinder", "mesh")


@dataclass(frozen=True, slots=True)
class Box:
    """Edge lengths along x, y, z [m]; the pose is that of its centre."""

    size: Vector3


@dataclass(frozen=True, slots=True)
class Sphere:
    """Radius [m]."""

    radius: float


@dataclass(frozen=True, slots=True)
class Cylinder:
    """Radius and length along z [m]; the pose is that of its centre."""

    radius: float
    length: float


@dataclass(frozen=True, slots=True)
class Plane:
    """An infinite plane: solid below the x-y plane of its pose."""


@dataclass(frozen=True, slots=True)
class Mesh:
    """The convex hull of an STL, OBJ or DAE file, scaled. Model a hollow object as several meshes."""

    path: Path
    scale: float = 1.0


@dataclass(frozen=True, slots=True)
class Hull:
    """The convex hull of at least four points [m] (n, 3)."""

    points: tuple[Vector3, ...]


Shape: TypeAlias = Box | Sphere | Cylinder | Plane | Mesh | Hull


@dataclass(frozen=True, slots=True)
class SceneObject:
    """An object in a scene. attached: it moves with the flange, and its pose is in the flange's frame."""

    shape: Shape
    pose: Pose
    attached: bool = False


@dataclass(frozen=True, slots=True)
class Safety:
    """The robot's safety planes and the parts of the arm they restrict, as in its safety configuration.

    tcp_offset: flange to TCP. reduced: use the planes of reduced mode instead of those of normal mode.
    """

    configuration: SafetyConfiguration
    tcp_offset: Pose
    reduced: bool

    @property
    def planes(self) -> tuple[SafetyPlane, ...]:
        """The planes that limit positions in this mode; planes that only trigger reduced mode do not."""
        mode = BoundaryMode.REDUCED if self.reduced else BoundaryMode.NORMAL
        return tuple(plane for plane in self.configuration.planes if plane.mode in (mode, BoundaryMode.BOTH))


@partial(checked, error=SceneError)
class PlanningScene:
    """An arm and the objects around it.

    model: a name such as ``ur3``, or a robot model, calibrated or not. padding_m: the clearance that links and attached
    objects keep from everything else. revision: incremented by each change. safety: see `set_safety`.
    """

    def __init__(self, model: RobotModel | str, *, padding_m: float = PADDING_M) -> None:
        self.model = load_model(model) if isinstance(model, str) else model
        self.kinematics: Kinematics = kinematics_of(self.model)
        self.padding_m = padding_m
        self.revision = 0
        self.safety: Safety | None = None
        self._objects: dict[str, SceneObject] = {}
        self._allowed: set[frozenset[str]] = set()

    def copy(self) -> "PlanningScene":
        """A snapshot of the scene, for a thread that must not see it change."""
        other = copy(self)
        other._objects, other._allowed = dict(self._objects), set(self._allowed)
        return other

    # objects

    @property
    def objects(self) -> Mapping[str, SceneObject]:
        return self._objects

    def add(self, name: str, shape: Shape, pose: Sequence[float] = ZERO6) -> None:
        """Add an object, or replace the one with this name. Raises SceneError."""
        self._add_object(name, SceneObject(_validated(name, shape), _pose(name, pose)))

    def attach(self, name: str, shape: Shape | None = None, pose: Sequence[float] = ZERO6) -> None:
        """Attach an object to the flange: a tool, or a gripped part. Raises SceneError.

        shape: None takes the shape of the object with this name. A gripped part touches the tool that holds it: see
        `allow`.
        """
        if shape is None:
            shape = self._find(name).shape
        if isinstance(shape, Plane):
            raise SceneError(f"{name} is an infinite plane: an arm cannot carry it")
        self._add_object(name, SceneObject(_validated(name, shape), _pose(name, pose), attached=True))

    def pick(self, name: str, q_rad: Sequence[float]) -> None:
        """Attach an object of the scene where it is, with the arm in this configuration (6,) [rad]."""
        obj = self._find(name)
        if obj.attached:
            raise SceneError(f"{name} is already attached")
        flange = self.kinematics.forward(q_rad)
        self.attach(name, obj.shape, pose_trans(pose_inv(flange), obj.pose))

    def place(self, name: str, q_rad: Sequence[float]) -> None:
        """Detach an object and leave it where the flange has it in this configuration (6,) [rad]."""
        obj = self._find(name)
        if not obj.attached:
            raise SceneError(f"{name} is not attached")
        self._add_object(name, SceneObject(obj.shape, pose_trans(self.kinematics.forward(q_rad), obj.pose)))

    def move(self, name: str, pose: Sequence[float]) -> None:
        self._add_object(name, replace(self._find(name), pose=_pose(name, pose)))

    def remove(self, name: str) -> None:
        self._find(name)
        del self._objects[name]
        self._allowed = {pair for pair in self._allowed if name not in pair}
        self.revision += 1

    # allowed collisions

    def allow(self, one: str, other: str) -> None:
        """Allow two objects, an object and a link, or two links to touch."""
        self._allowed.add(frozenset((self._check_name(one), self._check_name(other))))
        self.revision += 1

    def allows(self, one: str, other: str) -> bool:
        """Whether these two may touch."""
        return frozenset((one, other)) in self._allowed

    @property
    def allowed(self) -> Iterator[tuple[str, str]]:
        """All pairs that may touch, in alphabetical order."""
        for pair in sorted(tuple(sorted(pair)) for pair in self._allowed):
            yield pair[0], pair[-1]

    # the safety system

    def set_safety(
        self, configuration: SafetyConfiguration | None, tcp_offset: Sequence[float] = ZERO6, *, reduced: bool = False
    ) -> None:
        """Keep the TCP, the tool spheres and, where a plane restricts it, the elbow inside the safety planes.

        configuration: such as `read_safety` returns; None removes the planes. The robot stops at the planes; plans also
        keep the padding from them. The configuration's limits of speed, force and tool orientation are ignored.
        """
        safety = None
        if configuration is not None:
            safety = Safety(configuration, _pose("the TCP", tcp_offset), reduced)
        self.safety = safety
        self.revision += 1

    # files

    @classmethod
    def read(
        cls, model: RobotModel | str, path: Path, *, tcp_offset: Sequence[float] = ZERO6, padding_m: float = PADDING_M
    ) -> "PlanningScene":
        """Create a scene from a world file, as ``ur-emulator --world`` reads it, with its tool attached; see `update`.

        Raises SceneError, OSError.
        """
        scene = cls(model, padding_m=padding_m)
        scene.update(path, tcp_offset)
        return scene

    def update(self, path: Path, tcp_offset: Sequence[float] = ZERO6) -> None:
        """Add the objects and the tool of a world file. Raises SceneError, naming the file and the place in it, and
        OSError.

        tcp_offset: flange to TCP (6,) [m, rotation vector]. The file gives the pose of the tool relative to the TCP.
        """
        try:
            world = read_world_file(path, _SHAPES)
        except WorldFileError as error:
            raise SceneError(str(error)) from error
        try:
            for name, obj in world.objects.items():
                self.add(name, _shape(obj, path.parent), obj.pose)
            if world.tool is not None:
                pose = pose_trans(_pose("the TCP", tcp_offset), world.tool.pose)
                self.attach("tool", _shape(world.tool, path.parent), pose)
        except SceneError as error:
            raise SceneError(f"{path}: {error}") from None

    def _add_object(self, name: str, obj: SceneObject) -> None:
        if not name or name in LINKS:
            raise SceneError(f"{name!r} cannot name an object: it is empty or the name of a link")
        self._objects[name] = obj
        self.revision += 1

    def _find(self, name: str) -> SceneObject:
        if name not in self._objects:
            raise SceneError(f"the scene has no object {name!r}; it has {', '.join(sorted(self._objects)) or 'none'}")
        return self._objects[name]

    def _check_name(self, name: str) -> str:
        if name not in LINKS:
            self._find(name)
        return name


def _shape(obj: ObjectDescription, folder: Path) -> Shape:
    match obj.shape, obj.sizes:
        case "box", (x, y, z):
            return Box((x, y, z))
        case "sphere", (radius,):
            return Sphere(radius)
        case "cylinder", (radius, length):
            return Cylinder(radius, length)
        case "mesh", _:
            return Mesh(folder / obj.mesh)
    return Plane()


def _validated(name: str, shape: Shape) -> Shape:
    try:
        check_fields(shape)
        if isinstance(shape, Hull):
            for point in shape.points:
                QUANTITIES["center"].check(point)
    except LocalProtocolError as error:
        raise SceneError(f"{name}: {error}") from None
    if isinstance(shape, Mesh) and not shape.path.is_file():
        raise SceneError(f"{name}: there is no file {shape.path}")
    if isinstance(shape, Hull):
        _check_volume(name, shape.points)
    return shape


def _check_volume(name: str, points: Sequence[Vector3]) -> None:
    places = np.array(points, dtype=float).reshape(-1, 3)
    if len(places) < 4 or np.linalg.matrix_rank(places - places[0], tol=_MIN_THICKNESS_M) < 3:
        raise SceneError(f"{name}: its {len(places)} points are coplanar: a hull needs a volume")


def _pose(name: str, pose: Sequence[float]) -> Pose:
    try:
        QUANTITIES["pose"].check(pose)
    except LocalProtocolError as error:
        raise SceneError(f"{name}: {error}") from None
    return as_six(pose)


def read_safety(path: Path) -> SafetyConfiguration:
    """Read the safety settings of an ``.installation`` saved by PolyScope; a robot does not report them to its clients.

    Raises SceneError, OSError.
    """
    try:
        settings = read_document(path.read_bytes()).child("SafetySettings")
        if settings is None:
            raise SceneError(f"{path}: the installation has no safety settings")
        return read_safety_settings(settings.text)
    except (DocumentError, SafetySettingsError) as error:
        raise SceneError(f"{path}: {error}") from error
