"""The safety configuration: limits, planes, tool orientation, and the functions of inputs and outputs.

Sources of the presets: the CB3 user manual (sliders of the general limits). The factory settings (Default, and
Restricted in reduced mode) and the joint limits are from installation files of simulators and arms of both series.
"""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from math import inf, pi
from types import MappingProxyType
from typing import Final

from urproto.robots.model import Joints, RobotModel
from urproto.vectors import Vector3, as_six
from urproto.versions import Series

CHANNELS: Final = 8  # number of configurable inputs, and of outputs
Pins = tuple[int, int]  # the two channels of a safety signal: configurable pins 0-7

_NO_JOINT_LIMIT: Final[Joints] = (inf,) * 6
_SPEED_MARGIN_RAD_S: Final = (
    0.2  # the factory's joint speed limit over the nominal speed: 3.3416 for pi, 2.2944 for 2.0944
)
_POSITION_LIMIT_RAD: Final = 363.0 * pi / 180.0
# As installation files and captures of simulators have it, by the highest joint speeds. The number in the file is the
# one on the wire: UR5e 5.24 and CB3. Which arms and versions share one is a guess
_FACTORY_CHECKSUMS: Final = {
    (Series.CB3, pi, pi): 2588156642,  # shown as CCCC
    (Series.CB3, pi, 2.0 * pi): 121691621,
    (Series.E, pi, pi): 1475618907,
    (Series.E, pi, 2.0 * pi): 3683737400,
    (Series.E, 2.0943951023931953, pi): 1041004964,
}
LIMITS: Final[Mapping[str, tuple[str, str]]] = {  # attribute of a LimitSet -> title and unit
    "tcp_speed": ("TCP speed", "m/s"),
    "force": ("TCP force", "N"),
    "power": ("Power", "W"),
    "momentum": ("Momentum", "kg m/s"),
    "elbow_speed": ("Elbow speed", "m/s"),
    "elbow_force": ("Elbow force", "N"),
    "stopping_time": ("Stopping time", "s"),
    "stopping_distance": ("Stopping distance", "m"),
}
_PRESETS: Final = {  # in the order of a LimitSet
    "least restricted": (5.0, 250.0, 1000.0, 100.0, 5.0, 250.0, 1.0, 4.0),
    "default": (1.5, 150.0, 300.0, 25.0, 1.5, 150.0, 0.4, 0.5),
    "restricted": (0.75, 120.0, 200.0, 10.0, 0.75, 120.0, 0.3, 0.3),
    "very restricted": (0.25, 100.0, 80.0, 5.0, 0.25, 100.0, 0.2, 0.2),
}


class BoundaryMode(Enum):
    """When a plane or the tool orientation is a limit; TRIGGER planes activate reduced mode instead."""

    DISABLED = auto()
    NORMAL = auto()
    REDUCED = auto()
    BOTH = auto()
    TRIGGER = auto()


class SafetyInput(Enum):
    """Functions of configurable inputs. All are active low: a low input requests the function."""

    EMERGENCY_STOP = "emergencyStopInput"
    REDUCED_MODE = "reducedModeInput"
    SAFEGUARD_RESET = "safeguardStopResetInput"
    ENABLING_DEVICE = "threePositionEnablingInput"
    OPERATIONAL_MODE = "operationalModeInput"
    AUTOMATIC_SAFEGUARD = "automaticModeSafeguardStopInput"
    AUTOMATIC_SAFEGUARD_RESET = "automaticModeSafeguardStopResetInput"
    FREEDRIVE = "freedriveOnRobotInput"


class SafetyOutput(Enum):
    """Functions of configurable outputs."""

    SYSTEM_EMERGENCY_STOP = "systemEmergencyStopOutput"
    ROBOT_MOVING = "robotMovingOutput"
    ROBOT_NOT_STOPPING = "robotNotStoppingOutput"
    REDUCED_MODE = "reducedModeOutput"
    NOT_REDUCED_MODE = "notReducedModeOutput"
    SAFE_HOME = "safeHomeOutput"


@dataclass(frozen=True, slots=True)
class LimitSet:
    """Limits of one safety mode [m/s, N, W, kg m/s, s, m; joints rad/s and rad]; infinite if the series lacks one."""

    tcp_speed: float
    force: float
    power: float
    momentum: float
    elbow_speed: float = inf
    elbow_force: float = inf
    stopping_time: float = inf
    stopping_distance: float = inf
    joint_speed: Joints = _NO_JOINT_LIMIT
    joint_min: Joints = (-inf,) * 6
    joint_max: Joints = _NO_JOINT_LIMIT


@dataclass(frozen=True, slots=True)
class Plane:
    """A boundary in the base frame. A point p is inside if ``normal . p + distance`` is not negative.

    The sign follows from public installation files: the distance is positive if the base is inside.
    elbow: the elbow is restricted, too.
    """

    name: str
    normal: Vector3
    distance: float  # m
    mode: BoundaryMode
    elbow: bool = False

    def depth(self, point: Vector3) -> float:
        """Distance of a point from the plane [m]; negative outside."""
        x, y, z = self.normal
        return x * point[0] + y * point[1] + z * point[2] + self.distance


@dataclass(frozen=True, slots=True)
class ToolOrientation:
    """Limit of the tool direction (flange frame) to within ``deviation`` [rad] of ``direction`` (base frame)."""

    direction: Vector3
    deviation: float
    mode: BoundaryMode
    tool_direction: Vector3 = (0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class ToolSphere:
    """Sphere that contains the tool: centre in the flange frame and radius [m]."""

    centre: Vector3
    radius: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SafetyConfiguration:
    """The complete safety configuration. inputs, outputs: the two configurable pins of each assigned function.

    crc: the controller's own checksum if it is known; otherwise one is computed here.
    """

    normal: LimitSet
    reduced: LimitSet
    planes: tuple[Plane, ...] = ()
    tool_orientation: ToolOrientation | None = None
    tool_spheres: tuple[ToolSphere, ...] = ()
    inputs: Mapping[SafetyInput, Pins] = field(default_factory=lambda: MappingProxyType({}))
    outputs: Mapping[SafetyOutput, Pins] = field(default_factory=lambda: MappingProxyType({}))
    safe_home: Joints | None = None
    manual_high_speed: bool = True
    crc: int | None = None

    @property
    def checksum(self) -> int:
        """A 32-bit checksum of the configuration; a controller shows it as coloured letters.

        How a controller computes its own is not published. Without one from a file, this is the CRC-32 of our text.
        """
        if self.crc is not None:
            return self.crc
        return zlib.crc32(repr(replace(self, inputs=dict(self.inputs), outputs=dict(self.outputs))).encode()) or 1


PRESETS: Final[Mapping[str, LimitSet]] = MappingProxyType(
    {name: LimitSet(*values) for name, values in _PRESETS.items()}
)

# User manuals of both series: fixed limits of recovery mode; position limits do not count there
RECOVERY_LIMITS: Final = LimitSet(
    tcp_speed=0.25, force=100.0, power=80.0, momentum=10.0, elbow_speed=0.25, joint_speed=(30.0 * pi / 180.0,) * 6
)


def factory_configuration(model: RobotModel) -> SafetyConfiguration:
    """The safety configuration with which an arm of this model is delivered."""
    sets = (preset_of("default", model), preset_of("restricted", model))
    resets = {SafetyInput.SAFEGUARD_RESET: (0, 1)}
    return SafetyConfiguration(
        normal=sets[0], reduced=sets[1], inputs=MappingProxyType(resets), crc=_factory_checksum(model)
    )


def simulator_configuration(model: RobotModel) -> SafetyConfiguration:
    """The factory configuration, but normal mode limits only the joints, as in the vendor's simulator.

    The official C++ client library is tested against that simulator with its default settings: trajectories of 2 m/s at
    the tool of a UR5e, whose limit is 1.5 m/s, are neither slowed down nor stopped.
    """
    factory = factory_configuration(model)
    joints = LimitSet(
        tcp_speed=inf,
        force=inf,
        power=inf,
        momentum=inf,
        joint_speed=factory.normal.joint_speed,
        joint_min=factory.normal.joint_min,
        joint_max=factory.normal.joint_max,
    )
    return replace(factory, normal=joints, crc=factory.checksum)


def preset_of(name: str, model: RobotModel) -> LimitSet:
    """A preset with the joint limits of a model, and without limits that its series does not have."""
    limits = PRESETS[name]
    if model.series is Series.CB3:
        limits = replace(limits, elbow_speed=inf, elbow_force=inf, stopping_time=inf, stopping_distance=inf)
    low = tuple(-_POSITION_LIMIT_RAD for _ in range(6))
    high = tuple(_POSITION_LIMIT_RAD for _ in range(6))
    if model.wrist3_unlimited:
        low, high = (*low[:5], -inf), (*high[:5], inf)
    speeds = tuple(speed + _SPEED_MARGIN_RAD_S for speed in model.qd_max)
    return replace(limits, joint_speed=as_six(speeds), joint_min=as_six(low), joint_max=as_six(high))


def _factory_checksum(model: RobotModel) -> int | None:
    return _FACTORY_CHECKSUMS.get((model.series, model.qd_max[1], model.qd_max[5]))
