"""The arm models. Each has a data file, which is read once, checked, and never modified.

Everything model-specific in the project comes from here. To add an arm, add a file to ``data/``; its comments give the
source of each number.
"""

import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from math import inf
from pathlib import Path
from typing import Any, Final, NamedTuple

from urproto.compat import Self, load_toml
from urproto.errors import URError
from urproto.facts import Situation, find
from urproto.robots.drivetrain import Drivetrain
from urproto.text import unknown
from urproto.vectors import Vector3, Vector6
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series

Joints = Vector6
"""One number for each joint: base, shoulder, elbow, wrist 1, wrist 2, wrist 3."""

START_Q: Final[Joints] = find("start_q", Situation(DEFAULT_VERSION[Series.CB3], "ur5")).six
"""Joint angles at which URSim starts a UR5 [rad]: tool down, away from singularities."""

UPRIGHT_GRAVITY: Final[Vector3] = (0.0, 0.0, 9.82)
"""Gravity for an upright base [m/s2]: the value in the Script Manual's set_gravity example."""

_PARTS: Final = ("base", "shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
_DATA: Final = Path(__file__).parent / "data"
_FIRST_X: Final = "first_polyscope_x"
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


class LinkCylinders(NamedTuple):
    """Cylinders that contain a link: about the axis of its first joint, its tube, and about the axis of the next joint.

    tube: along the link, from the first joint on. tube_height: offset of the tube's axis along the joint axis [m].
    """

    joint: Span
    tube: Span | None
    tube_height: float
    next: Span | None


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotModel:
    """The properties of an arm model. Joint vectors have six numbers, base to wrist 3."""

    name: str
    """As in ``--model``: "ur3"."""
    title: str
    """As PolyScope writes it: "UR3"."""
    series: Series
    first_polyscope_x: PolyscopeVersion | None
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
    links: tuple[Link, ...]
    """Shoulder, upper arm, forearm, wrist 1, wrist 2, wrist 3."""
    tube_offsets: tuple[float, float]
    """m; offsets of the centre lines of upper arm and forearm along their joint axes."""
    wrist_mesh_offsets: Vector3 | None
    """m; of ur_description's meshes of the wrists, along the z axes of their links. None: not published."""
    housing_radii: HousingRadii
    cylinders: tuple[LinkCylinders, ...]
    """Base, shoulder, upper arm, forearm, wrist 1, 2 and 3."""
    base_light: bool
    """Whether it has a light ring in its base."""
    elbow_offset: float
    """m; of the elbow that the controller reports and monitors, from the plane of the arm along joint 3's axis."""
    elbow_radius: float
    """m; of the sphere around it that planes restrict."""
    clamping: ClampingShapes | None
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
        table = _Table(load_toml(text), f"{name}.toml")
        limits, motion, links = table.sub("limits"), table.sub("motion"), table.tables("links")
        shape, safety = table.sub("shape"), table.sub("safety")
        if len(links) != 6:
            raise ValueError(f"{name}.toml: there must be six [[links]], not {len(links)}")
        return cls(
            name=name,
            title=table.text("title"),
            series=Series(table.text("series")),
            first_polyscope_x=PolyscopeVersion.parse(table.text(_FIRST_X)) if _FIRST_X in table else None,
            robot_type=table.integer("robot_type"),
            sub_type=table.integer("sub_type"),
            controller_box=table.integer("controller_box"),
            payload_max_kg=table.number("payload_max_kg"),
            reach_m=table.number("reach_m"),
            dh=_dh(table.sub("dh")),
            q_min=limits.joints("q_min_rad"),
            q_max=limits.joints("q_max_rad"),
            qd_max=limits.joints("qd_max_rad_s"),
            qdd_max=limits.joints("qdd_max_rad_s2"),
            torque_max=limits.joints("torque_max_Nm"),
            wrist3_unlimited=limits.flag("wrist3_unlimited"),
            v_joint_default=motion.number("v_joint_rad_s"),
            a_joint_default=motion.number("a_joint_rad_s2"),
            v_tool_default=motion.number("v_tool_m_s"),
            a_tool_default=motion.number("a_tool_m_s2"),
            eq_radius=motion.number("eq_radius_m"),
            torque_constants=table.sub("electrics").joints("torque_constants_Nm_A"),
            links=tuple(_link(link) for link in links),
            tube_offsets=shape.pair("tube_offsets_m"),
            wrist_mesh_offsets=shape.vector("wrist_mesh_offsets_m") if "wrist_mesh_offsets_m" in shape else None,
            housing_radii=HousingRadii(*shape.numbers("housing_radii_m", 4)),
            cylinders=tuple(_cylinders(table.sub("cylinders").sub(name)) for name in _PARTS),
            base_light=shape.flag("base_light"),
            elbow_offset=safety.number("elbow_offset_m"),
            elbow_radius=safety.number("elbow_radius_m"),
            clamping=ClampingShapes(*safety.numbers("clamping_m", 3)) if "clamping_m" in safety else None,
        )


class _Table:
    """A TOML table whose errors name the file and the entry."""

    def __init__(self, values: Mapping[str, Any], where: str) -> None:
        self._values = values
        self._where = where

    def _get(self, key: str, kind: type | tuple[type, ...], what: str) -> Any:
        value = self._values.get(key)
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise ValueError(f"{self._where}: {key} must be {what}, not {value!r}")
        return value

    def sub(self, key: str) -> "_Table":
        return _Table(self._get(key, dict, "a table"), f"{self._where} [{key}]")

    def tables(self, key: str) -> list["_Table"]:
        tables = self._get(key, list, "an array of tables")
        return [_Table(table, f"{self._where} [[{key}]] no. {n}") for n, table in enumerate(tables, 1)]

    def text(self, key: str) -> str:
        return str(self._get(key, str, "a text"))

    def flag(self, key: str) -> bool:
        return bool(self._get(key, bool, "true or false"))

    def integer(self, key: str) -> int:
        return int(self._get(key, int, "a whole number"))

    def number(self, key: str) -> float:
        return float(self._get(key, (int, float), "a number"))

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def numbers(self, key: str, count: int) -> list[float]:
        values = self._get(key, list, f"{count} numbers")
        if len(values) != count or not all(type(value) in (int, float) for value in values):
            raise ValueError(f"{self._where}: {key} must be {count} numbers, not {values!r}")
        return [float(value) for value in values]

    def joints(self, key: str) -> Joints:
        a, b, c, d, e, f = self.numbers(key, 6)
        return (a, b, c, d, e, f)

    def pair(self, key: str) -> tuple[float, float]:
        first, second = self.numbers(key, 2)
        return (first, second)

    def vector(self, key: str) -> Vector3:
        x, y, z = self.numbers(key, 3)
        return (x, y, z)


def _dh(table: _Table) -> DH:
    return DH(table.joints("a_m"), table.joints("d_m"), table.joints("alpha_rad"), table.joints("theta_rad"))


def _link(table: _Table) -> Link:
    return Link(table.number("mass_kg"), table.vector("com_m"), table.joints("inertia_kg_m2"))


def _cylinders(table: _Table) -> LinkCylinders:
    joint = Span(*table.numbers("joint", 3))
    *tube, height = table.numbers("tube", 4) if "tube" in table else [0.0]
    after = Span(*table.numbers("next", 3)) if "next" in table else None
    return LinkCylinders(joint, Span(*tube) if tube else None, height, after)


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
