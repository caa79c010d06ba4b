"""The arm models. Each has a data file, which is read once, checked, and never modified.

Everything model-specific in the project comes from here. To add an arm, add a file to ``data/``; its comments give the
source of each number.
"""

import re
import sys
from dataclasses import dataclass
from functools import cache
from math import inf
from pathlib import Path
from typing import Final, NamedTuple

from urproto.compat import Self, load_toml
from urproto.errors import URError
from urproto.facts import Situation, find
from urproto.robots.drivetrain import Drivetrain
from urproto.structures import converted
from urproto.text import unknown
from urproto.vectors import Vector3, Vector6
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series

Joints = Vector6
"""One number for each joint: base, shoulder, elbow, wrist 1, wrist 2, wrist 3."""

START_Q: Final[Joints] = find("start_q", Situation(DEFAULT_VERSION[Series.CB3], "ur5")).six
"""Joint angles at which URSim starts a UR5 [rad]: tool down, away from singularities."""

UPRIGHT_GRAVITY: Final[Vector3] = (0.0, 0.0, 9.82)
"""Gravity for an upright base [m/s2]: the value in the Script Manual's set_gravity example."""

_DATA: Final = Path(__file__).parent / "data"
_SECTIONS: Final = ("limits", "motion", "shape", "safety", "electrics")  # of a data file, as it groups the properties
_DEFAULT_MODEL: Final = {Series.CB3: "ur3", Series.E: "ur3e"}
_RUNS: Final = {Series.CB3: (3, 15, "3.0 to 3.15"), Series.E: (5, sys.maxsize, "5.x, or 10.7 to 10.13")}
"""Major version, newest minor version, and the range as text; the CB3 line ended with 3.15."""

_RUNS_X: Final = ((10, 7), (10, 13))
"""Oldest and newest PolyScope X: those whose simulators the official C++ client is tested against."""


class UnknownModelError(URError, ValueError):
    """There is no data file for an arm of this name."""

    def __init__(self, name: str) -> None:
        super().__init__(unknown("robot model", name, MODELS))
        self.name = name


@dataclass(frozen=True, slots=True)
class DH:
    """Denavit-Hartenberg parameters; link transform Rot_z(theta) Trans_z(d) Trans_x(a) Rot_x(alpha)."""

    a: Joints  # m
    d: Joints  # m
    alpha: Joints  # rad
    theta: Joints  # rad, added to the joint angle


@dataclass(frozen=True, slots=True)
class Link:
    """Mass properties of the link that a joint moves, in the Denavit-Hartenberg frame at its far end."""

    mass_kg: float
    com_m: Vector3
    inertia_kg_m2: tuple[float, float, float, float, float, float]
    """Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass."""


class HousingRadii(NamedTuple):
    """Radii of the joint housings and of the base [m]."""

    shoulder: float
    elbow: float
    wrist: float
    foot: float


class ClampingShapes(NamedTuple):
    """What must not come close: a sphere around the flange's centre and a cylinder around the lower arm [m]."""

    flange_radius: float
    lower_arm_radius: float
    lower_arm_offset: float
    """Of the cylinder's axis from the plane of the arm, along joint 3's axis."""


class Span(NamedTuple):
    """A cylinder about a known axis: radius, and start and end along the axis [m]."""

    radius: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class LinkCylinders:
    """Cylinders that contain a link: about the axis of its first joint, its tube, and about the axis of the next joint.

    tube: along the link, from the first joint on. tube_height: offset of the tube's axis along the joint axis [m].
    """

    joint: Span
    tube: Span | None = None
    tube_height: float = 0.0
    next: Span | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotModel:
    """The properties of an arm model. Joint vectors have six numbers, base to wrist 3."""

    name: str
    """As in ``--model``: "ur3"."""
    title: str
    """As PolyScope writes it: "UR3"."""
    series: Series
    first_polyscope_x: PolyscopeVersion | None = None
    """The first 10.x for this arm; None for CB3 arms, which PolyScope X does not support."""
    robot_type: int
    """As in the configuration data, like the next two."""
    sub_type: int
    controller_box: int
    payload_max_kg: float
    reach_m: float
    dh: DH
    """Nominal."""
    q_min: Joints
    """rad"""
    q_max: Joints
    """rad"""
    qd_max: Joints
    """rad/s"""
    qdd_max: Joints
    """rad/s2"""
    torque_max: Joints
    """Nm"""
    wrist3_unlimited: bool
    """Whether wrist 3 has no end stop."""
    v_joint_default: float
    """rad/s, of movej. This and the next three are the defaults when a program gives no value."""
    a_joint_default: float
    """rad/s2"""
    v_tool_default: float
    """m/s, of movel"""
    a_tool_default: float
    """m/s2"""
    eq_radius: float
    """m; weight of the tool's rotation relative to its translation."""
    torque_constants: Joints
    """Nm/A, of an ideal arm: those of its simulator, where known. Those of real arms: ``urproto.robots.measured``."""
    links: tuple[Link, Link, Link, Link, Link, Link]
    """Shoulder, upper arm, forearm, wrist 1, wrist 2, wrist 3."""
    tube_offsets: tuple[float, float]
    """m; offsets of the centre lines of upper arm and forearm along their joint axes."""
    wrist_mesh_offsets: Vector3 | None = None
    """m; of ur_description's meshes of the wrists, along the z axes of their links. None: not published."""
    housing_radii: HousingRadii
    cylinders: tuple[
        LinkCylinders, LinkCylinders, LinkCylinders, LinkCylinders, LinkCylinders, LinkCylinders, LinkCylinders
    ]
    """Base, shoulder, upper arm, forearm, wrist 1, 2 and 3."""
    base_light: bool
    """Whether it has a light ring in its base."""
    elbow_offset: float
    """m; of the elbow that the controller reports and monitors, from the plane of the arm along joint 3's axis."""
    elbow_radius: float
    """m; of the sphere around it that planes restrict."""
    clamping: ClampingShapes | None = None
    """None: this arm does not stop where it could clamp a hand (CB3)."""
    calibration: DH | None = None
    """The calibration of an individual arm; None for a nominal arm."""
    drivetrain: Drivetrain | None = None
    """The identified drives of an individual arm; None for those of its model."""

    @property
    def position_limits(self) -> tuple[Joints, Joints]:
        """Minimum and maximum joint angles [rad]; infinite for a wrist 3 without an end stop."""
        if self.wrist3_unlimited:
            return (*self.q_min[:5], -inf), (*self.q_max[:5], inf)
        return self.q_min, self.q_max

    @classmethod
    def from_toml(cls, text: str, name: str) -> Self:
        """Build from a data file's text. Raises ValueError naming the entry that is missing or wrong."""
        content = load_toml(text) | {"name": name}
        for section in _SECTIONS:
            content |= content.pop(section, {})
        return converted(content, cls, f"{name}.toml")


def _by_size(name: str) -> tuple[int, str]:
    match = re.fullmatch(r"ur(\d+)(\w*)", name)
    return (int(match[1]), match[2]) if match else (0, name)


MODELS: Final[tuple[str, ...]] = tuple(sorted((path.stem for path in _DATA.glob("*.toml")), key=_by_size))
"""Names of the known arms, smallest first: ("ur3", "ur3e", "ur5", ...)."""


@cache
def load_model(name: str) -> RobotModel:
    """Load the arm of this name. Raises UnknownModelError, which lists the available names."""
    if name not in MODELS:
        raise UnknownModelError(name)
    return RobotModel.from_toml((_DATA / f"{name}.toml").read_text(encoding="utf-8"), name)


def default_model(version: str | None) -> str:
    """Name of the default arm: ur3, or ur3e if the PolyScope version is an e-Series one.

    Raises ValueError when the text is not a version.
    """
    return _DEFAULT_MODEL[PolyscopeVersion.parse(version).series if version else Series.CB3]


def choose_version(text: str | None, model: RobotModel) -> PolyscopeVersion:
    """The PolyScope version for an arm; the default of its series when no text is given.

    Raises ValueError when the text is not a version, or the arm does not support that version.
    """
    if text is None:
        return DEFAULT_VERSION[model.series]
    version = PolyscopeVersion.parse(text)
    major, newest, known = _RUNS[model.series]
    if version.is_polyscope_x and model.first_polyscope_x is not None:
        if not _RUNS_X[0] <= (version.major, version.minor) <= _RUNS_X[1]:
            raise ValueError(f"PolyScope X is emulated from {' to '.join(map(_dotted, _RUNS_X))}, not as {text}")
        if version < model.first_polyscope_x:
            first = _dotted((model.first_polyscope_x.major, model.first_polyscope_x.minor))
            raise ValueError(f"{model.title} requires PolyScope X {first} or later, not {text}")
        return version
    if version.major != major or version.minor > newest:
        raise ValueError(f"{model.title} ({model.series.value}) requires PolyScope {known}, not {text}")
    return version


def _dotted(version: tuple[int, int]) -> str:
    return ".".join(map(str, version))
