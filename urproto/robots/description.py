"""URDF of an arm, calibrated or nominal: joints, limits, masses, and simple or provided geometry.

Names, frames and joint zeros are those of ur_description, so software for that package works with this description:
``base_link`` has x forward, ``base`` is rotated by pi about z and is the controller's base frame, ``flange`` and
``tool0`` are on ``wrist_3_link``, and ``base`` to ``tool0`` is the pose that the controller reports without a TCP. The
mass properties of the links are those of the model; the base has none, because they are not well known. Joint limits
are the controller's; in ur_description, the elbow has a smaller range, to help planners.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import atan2, cos, dist, hypot, pi, sin
from pathlib import Path
from typing import Final, NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from urproto.joints import JOINT_NAMES
from urproto.robots.calibration import Chain, LinkFrame, chain_of
from urproto.robots.model import DH, Link, RobotModel
from urproto.robots.pose import Pose, matrix_to_rotvec, rpy_to_rotvec
from urproto.robots.shapes import Capsule, capsules
from urproto.vectors import ZERO3, Vector3

_LINKS: Final = (
    "base_link_inertia",
    "shoulder_link",
    "upper_arm_link",
    "forearm_link",
    "wrist_1_link",
    "wrist_2_link",
    "wrist_3_link",
)
_FIXED: Final[Sequence[tuple[str, str, str, Vector3]]] = (
    ("base_link-base_link_inertia", "base_link", "base_link_inertia", (0.0, 0.0, pi)),
    ("base_link-base_fixed_joint", "base_link", "base", (0.0, 0.0, pi)),
    ("wrist_3_link-ft_frame", "wrist_3_link", "ft_frame", (pi, 0.0, 0.0)),
    ("wrist_3-flange", "wrist_3_link", "flange", (0.0, -pi / 2, -pi / 2)),
    ("flange-tool0", "flange", "tool0", (pi / 2, 0.0, pi / 2)),
)
_GREY: Final = ("0.75 0.76 0.78 1", "0.35 0.5 0.65 1")  # alternating between links
_VISUAL: Final = (".dae", ".glb", ".obj", ".stl")
_COLLISION: Final = (".stl", ".obj", ".dae")

_AddShape = Callable[[Element, str | None], None]
_Shapes = tuple[list[_AddShape], list[_AddShape]]

_MESHES: Final = ("base", "shoulder", "upperarm", "forearm", "wrist1", "wrist2", "wrist3")
_MESH_RPY: Final[Sequence[Vector3]] = (
    *((0.0, 0.0, pi), (0.0, 0.0, pi), (pi / 2, 0.0, -pi / 2), (pi / 2, 0.0, -pi / 2)),
    *((pi / 2, 0.0, 0.0), ZERO3, (pi / 2, 0.0, 0.0)),
)


class JointFrame(NamedTuple):
    """A joint: pose of its child link in the parent's frame, at angle 0 if it moves, about the child's z axis."""

    joint: str
    parent: str
    child: str
    pose: Pose
    moves: bool


def joint_frames(model: RobotModel, prefix: str = "") -> list[JointFrame]:
    """The joints of the description written by `urdf`, with its names: six moving ones from the base on, then the
    fixed ones."""
    chain = zip(JOINT_NAMES, pairwise(_LINKS), _chain(model), strict=True)
    moving = [
        JointFrame(prefix + name, prefix + parent, prefix + child, (*position, *matrix_to_rotvec(axes)), True)
        for name, (parent, child), (position, axes) in chain
    ]
    return moving + [
        JointFrame(prefix + name, prefix + parent, prefix + child, (*ZERO3, *rpy_to_rotvec(*rpy)), False)
        for name, parent, child, rpy in _FIXED
    ]


def _chain(model: RobotModel) -> Chain:
    return chain_of(model.dh if model.calibration is None else model.calibration)


def urdf(model: RobotModel, *, meshes: Path | None = None, prefix: str = "") -> str:
    """Write the description, that of the calibrated arm if the model has a calibration.

    meshes: a folder structured like ``meshes/ur5e`` in ur_description (``visual/base.dae``, ``collision/base.stl``,
    upperarm, wrist1, ...), or with all files directly inside; without one, the geometry consists of capsules.
    prefix: prepended to each name of a link or joint. Raises MissingMeshesError.
    """
    root = Element("robot", name=model.name)
    _fixed_link(root, f"{prefix}base_link")
    geometry = _capsules(model) if meshes is None else _meshes(model, meshes)
    for i, name in enumerate(_LINKS):
        link = SubElement(root, "link", name=prefix + name)
        for kind, shapes in zip(("visual", "collision"), geometry[i], strict=True):
            for shape in shapes:
                shape(SubElement(link, kind), _GREY[i % 2] if kind == "visual" else None)
        if i > 0:
            _inertial(link, model.links[i - 1], model.dh, i - 1)
    for i, ((parent, child), frame) in enumerate(zip(pairwise(_LINKS), _chain(model), strict=True)):
        _moving_joint(root, model, i, prefix + parent, prefix + child, frame, prefix)
    for name, parent, child, rpy in _FIXED:
        if child not in _LINKS:
            _fixed_link(root, prefix + child)
        joint = SubElement(root, "joint", name=prefix + name, type="fixed")
        _origin(joint, ZERO3, rpy)
        SubElement(joint, "parent", link=prefix + parent)
        SubElement(joint, "child", link=prefix + child)
    indent(root)
    return '<?xml version="1.0"?>\n' + tostring(root, encoding="unicode") + "\n"


def _fixed_link(root: Element, name: str) -> None:
    SubElement(root, "link", name=name)


def _moving_joint(
    root: Element, model: RobotModel, i: int, parent: str, child: str, frame: LinkFrame, prefix: str
) -> None:
    endless = i == 5 and model.wrist3_unlimited
    joint = SubElement(root, "joint", name=prefix + JOINT_NAMES[i], type="continuous" if endless else "revolute")
    _origin(joint, frame.position, frame.rpy)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    SubElement(joint, "axis", xyz="0 0 1")
    range_ = {} if endless else {"lower": repr(model.q_min[i]), "upper": repr(model.q_max[i])}
    SubElement(joint, "limit", {**range_, "effort": repr(model.torque_max[i]), "velocity": repr(model.qd_max[i])})
    SubElement(joint, "dynamics", damping="0", friction="0")


def _inertial(parent: Element, link: Link, dh: DH, i: int) -> None:
    """Add the mass properties. The model has them in the Denavit-Hartenberg frame at the link's far end, which is
    Trans_x(a) Rot_x(alpha) further."""
    inertial = SubElement(parent, "inertial")
    (x, y, z), s, c = link.com_m, sin(dh.alpha[i]), cos(dh.alpha[i])
    place = (dh.a[i] + x, c * y - s * z, s * y + c * z)
    _origin(inertial, place, (dh.alpha[i], 0.0, 0.0))
    SubElement(inertial, "mass", value=repr(link.mass_kg))
    xx, yy, zz, xy, xz, yz = map(repr, link.inertia_kg_m2)
    SubElement(inertial, "inertia", ixx=xx, ixy=xy, ixz=xz, iyy=yy, iyz=yz, izz=zz)


def _origin(parent: Element, xyz: Vector3, rpy: Vector3) -> None:
    SubElement(parent, "origin", xyz=_numbers(xyz), rpy=_numbers(rpy))


def _numbers(values: Vector3) -> str:
    return " ".join(repr(value + 0.0) for value in values)


def _capsules(model: RobotModel) -> list[_Shapes]:
    shapes = [_parts(capsule) for capsule in capsules(model)]
    return [(parts, parts) for parts in shapes]


def _parts(capsule: Capsule) -> list[_AddShape]:
    """URDF has no capsules: a cylinder and two spheres."""
    (ax, ay, az), (bx, by, bz) = capsule.start, capsule.end
    u, v, w = bx - ax, by - ay, bz - az
    middle = ((ax + bx) / 2, (ay + by) / 2, (az + bz) / 2)
    turn = (0.0, atan2(hypot(u, v), w), atan2(v, u))
    radius = repr(capsule.radius)
    length = repr(dist(capsule.start, capsule.end))
    return [
        _shape(middle, turn, "cylinder", radius=radius, length=length),
        _shape(capsule.start, ZERO3, "sphere", radius=radius),
        _shape(capsule.end, ZERO3, "sphere", radius=radius),
    ]


def _shape(xyz: Vector3, rpy: Vector3, kind: str, **size: str) -> _AddShape:
    def add(parent: Element, colour: str | None) -> None:
        _origin(parent, xyz, rpy)
        SubElement(SubElement(parent, "geometry"), kind, size)
        if colour is not None and kind != "mesh":
            material = SubElement(parent, "material", name=f"colour {colour}")
            SubElement(material, "color", rgba=colour)

    return add


def _meshes(model: RobotModel, folder: Path) -> list[_Shapes]:
    def shapes_of(mesh: PlacedMesh, kind: str, endings: Sequence[str]) -> list[_AddShape]:
        uri = mesh_file(folder, kind, mesh.name, endings).resolve().as_uri()
        return [_shape(mesh.position, mesh.rpy, "mesh", filename=uri)]

    return [
        (shapes_of(mesh, "visual", _VISUAL), shapes_of(mesh, "collision", _COLLISION)) for mesh in placed_meshes(model)
    ]


class MissingMeshesError(ValueError):
    """The folder does not contain the meshes of this arm, or their placement is not known."""


class PlacedMesh(NamedTuple):
    """A mesh with its placement. name: of its files, without extension. position [m], rpy [rad, about fixed axes]: in
    the link's frame."""

    name: str
    position: Vector3
    rpy: Vector3


def placed_meshes(model: RobotModel) -> tuple[PlacedMesh, ...]:
    """The meshes of base, shoulder, upper arm, forearm, wrist 1, 2 and 3. Raises MissingMeshesError."""
    if model.wrist_mesh_offsets is None:
        raise MissingMeshesError(f"the placement of the meshes of {model.title} has not been published: leave them out")
    offsets = (0.0, 0.0, *model.tube_offsets, *model.wrist_mesh_offsets)
    return tuple(PlacedMesh(name, (0.0, 0.0, z), rpy) for name, rpy, z in zip(_MESHES, _MESH_RPY, offsets, strict=True))


def mesh_file(folder: Path, kind: str, name: str, endings: Sequence[str]) -> Path:
    """The path of a mesh: ``visual/base.dae``, or ``base.dae`` if all are in one folder. Raises MissingMeshesError."""
    places = [folder / kind / f"{name}{ending}" for ending in endings]
    places += [folder / f"{name}{ending}" for ending in endings]
    for place in places:
        if place.is_file():
            return place
    raise MissingMeshesError(
        f"{folder} has no {kind}/{name} ({', '.join(endings)}): it must contain {', '.join(_MESHES)}"
    )
