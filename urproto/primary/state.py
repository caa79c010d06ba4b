"""Robot state (type 16) of the primary interface, sent at 10 Hz.

A state is a sequence of sub-packages, ``int32 size | uint8 type | body``, in an order that readers must not rely on.
The order here is that of captures of a 5.4, an early 5.x and a 5.24 simulator and of a late CB3 arm, which agree.
"""

from dataclasses import dataclass, fields
from typing import Any

from urproto._wire import Reader
from urproto.errors import RemoteProtocolError
from urproto.primary._wire import MESSAGE_HEADER, ROBOT_STATE, frame
from urproto.primary.subpackages import (
    AdditionalInfo,
    CalibrationData,
    CartesianInfo,
    ConfigurationData,
    ForceModeData,
    JointData,
    KinematicsInfo,
    MasterboardData,
    ModeData,
    SafetyData,
    SingularityInfo,
    SubPackage,
    ToolCommunicationInfo,
    ToolData,
    ToolModeInfo,
)
from urproto.versions import PolyscopeVersion

_PARTS: dict[int, tuple[str, type[SubPackage]]] = {
    kind.type: (name, kind)
    for name, kind in (
        ("mode", ModeData),
        ("joints", JointData),
        ("cartesian", CartesianInfo),
        ("kinematics", KinematicsInfo),
        ("calibration", CalibrationData),
        ("masterboard", MasterboardData),
        ("tool", ToolData),
        ("configuration", ConfigurationData),
        ("force_mode", ForceModeData),
        ("additional", AdditionalInfo),
        ("safety", SafetyData),
        ("tool_communication", ToolCommunicationInfo),
        ("tool_mode", ToolModeInfo),
        ("singularity", SingularityInfo),
    )
}
_ONLY_WHEN_FULL = (KinematicsInfo.type, ConfigurationData.type)


@dataclass(frozen=True, slots=True)
class RawSubPackage:
    """A sub-package of an unknown type, or one that is shorter than any known form of its type."""

    type: int
    body: bytes

    def encode(self, version: PolyscopeVersion) -> bytes:
        """The sub-package as received."""
        return frame(self.type, self.body)


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotStateData:
    """A robot state, with its parts in the order of controllers. A part is None when it was not sent."""

    mode: ModeData | None = None
    joints: JointData | None = None
    cartesian: CartesianInfo | None = None
    kinematics: KinematicsInfo | None = None
    calibration: CalibrationData | None = None
    masterboard: MasterboardData | None = None
    tool: ToolData | None = None
    configuration: ConfigurationData | None = None
    force_mode: ForceModeData | None = None
    additional: AdditionalInfo | None = None
    safety: SafetyData | None = None
    tool_communication: ToolCommunicationInfo | None = None
    tool_mode: ToolModeInfo | None = None
    singularity: SingularityInfo | None = None
    unknown: tuple[RawSubPackage, ...] = ()

    @property
    def parts(self) -> tuple[SubPackage, ...]:
        """The known parts that are present."""
        parts = (getattr(self, field.name) for field in fields(self) if field.name != "unknown")
        return tuple(part for part in parts if part is not None)


def encode_robot_state(state: RobotStateData, version: PolyscopeVersion, *, full: bool) -> bytes:
    """The complete message as sent by a controller of this version.

    Parts that the version does not have are left out. Kinematics and configuration are only part of a ``full`` state,
    which controllers send first on a connection and after a change of either.
    """
    parts = [
        part.encode(version)
        for part in state.parts
        if part.available.covers(version) and (full or part.type not in _ONLY_WHEN_FULL)
    ]
    parts += [part.encode(version) for part in state.unknown]
    return frame(ROBOT_STATE, b"".join(parts))


def _decode_part(kind: int, body: bytes) -> tuple[str, SubPackage] | RawSubPackage:
    if kind not in _PARTS:
        return RawSubPackage(kind, body)
    name, part = _PARTS[kind]
    try:
        return name, part._read(Reader(body, part.__name__))
    except RemoteProtocolError:
        return RawSubPackage(kind, body)


def decode_robot_state(payload: bytes) -> RobotStateData:
    """Decode the payload of a type 16 message (everything after size and type).

    Parts may be in any order or missing; bytes of a known part beyond its newest known form are ignored. Raises
    RemoteProtocolError when the sizes of the parts do not add up.
    """
    reader = Reader(payload, "robot state")
    known: dict[str, Any] = {}
    unknown: list[RawSubPackage] = []
    while reader.remaining:
        size, kind = reader.unpack("iB")
        part = _decode_part(kind, reader.take(size - MESSAGE_HEADER.size))
        if isinstance(part, RawSubPackage):
            unknown.append(part)
        else:
            known[part[0]] = part[1]
    return RobotStateData(**known, unknown=tuple(unknown))
