"""The wire formats between a driver and the control program it runs on the robot (External Control).

The driver listens, the robot's program connects. Every message is a fixed number of big-endian
32-bit integers; physical values are multiplied by a million.

| port  | interface       | driver to robot               | robot to driver                      |
|-------|-----------------|-------------------------------|--------------------------------------|
| 50001 | reverse         | `ReverseMessage`, 8 words     |                                      |
| 50002 | script sender   | the program, as text          | the line ``request_program``         |
| 50003 | trajectory      | `TrajectoryPoint`, 21 words   | `TrajectoryResult`, 1 word           |
| 50004 | script commands | `ScriptCommand`, 28 words     | tool contact's `TrajectoryResult`, `Answer` |

This project's own control program first sends a line (`GREETING`); the vendor's does not.

Source: the messages sent by Universal_Robots_Client_Library 2.14 and read by its control program. The script commands
from 100 on and their answers are specific to this project. Encoding raises LocalProtocolError for a value that does not
fit into a word; decoding raises RemoteProtocolError.
"""

import math
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NoReturn, TypeVar

from urproto.compat import IntEnum, Self
from urproto.errors import LocalProtocolError, RemoteProtocolError

SCALE: Final = 1_000_000
"""Every physical value (rad, m, N, s, …) is sent as round(value * SCALE)."""

REQUEST_PROGRAM: Final = b"request_program\n"
"""The robot's request to the script sender; the program sent in reply has no end mark."""

GREETING: Final = b"external_control "
"""The beginning of the line sent first; the token of the program's driver follows."""
_MAX_GREETING: Final = 128  # bytes; guess

_MAX_VALUE: Final = (2**31 - 1) / SCALE
_WORD: Final = struct.Struct(">i")
_REVERSE: Final = struct.Struct(">8i")
_TRAJECTORY: Final = struct.Struct(">21i")
_COMMAND: Final = struct.Struct(">28i")
_FINE: Final = 1_000_000_000
_MAX_VALUES: Final = 36  # a 6 by 6 matrix


class ControlMode(IntEnum):
    """How the robot interprets a `ReverseMessage`."""

    STOPPED = -2
    UNINITIALIZED = -1
    IDLE = 0
    SERVOJ = 1
    SPEEDJ = 2
    FORWARD = 3
    SPEEDL = 4
    POSE = 5
    FREEDRIVE = 6
    TOOL_IN_CONTACT = 7
    TORQUE = 8

    @property
    def real_time(self) -> bool:
        """True for modes that require a continuous stream of setpoints."""
        return self in _REAL_TIME


_REAL_TIME: Final = frozenset(
    [ControlMode.SERVOJ, ControlMode.SPEEDJ, ControlMode.SPEEDL, ControlMode.POSE, ControlMode.TORQUE]
)


class TrajectoryAction(IntEnum):
    """First word of the payload in mode FORWARD; the second is the number of points."""

    CANCEL = -1
    NOOP = 0
    START = 1
    STREAM_START = 2
    STREAM_END = 3


class FreedriveAction(IntEnum):
    """First word of the payload in mode FREEDRIVE."""

    STOP = -1
    NOOP = 0
    START = 1


class TrajectoryResult(IntEnum):
    """Result of a trajectory, or of waiting for tool contact."""

    SUCCESS = 0
    CANCELED = 1
    FAILURE = 2


class MotionType(IntEnum):
    """How a `TrajectoryPoint` is reached; a suffix gives the kind of target if it is not the usual one of the move."""

    MOVEJ = 0
    MOVEL = 1
    MOVEP = 2
    MOVEC = 3
    OPTIMOVEJ = 4
    OPTIMOVEL = 5
    MOVEJ_POSE = 6
    MOVEL_JOINT = 7
    MOVEP_JOINT = 8
    MOVEC_JOINT = 9
    MOVEC_JOINT_POSE = 10
    MOVEC_POSE_JOINT = 11
    OPTIMOVEJ_POSE = 12
    OPTIMOVEL_JOINT = 13
    SPLINE = 51


class SplineType(IntEnum):
    """Degree of a spline segment: cubic without accelerations at its end, quintic with them."""

    CUBIC = 1
    QUINTIC = 2


class ScriptCommandKind(IntEnum):
    """First word of a `ScriptCommand`."""

    ZERO_FTSENSOR = 0
    SET_PAYLOAD = 1
    SET_TOOL_VOLTAGE = 2
    START_FORCE_MODE = 3
    END_FORCE_MODE = 4
    START_TOOL_CONTACT = 5
    END_TOOL_CONTACT = 6
    SET_FRICTION_COMPENSATION = 7
    FT_RTDE_INPUT_ENABLE = 8
    SET_GRAVITY = 9
    SET_TCP_OFFSET = 10
    SET_FRICTION_SCALES = 11
    SET_TARGET_PAYLOAD = 12
    ARGUMENT = 100
    QUERY = 101
    SET_STREAM_PARAMETERS = 102
    SET_FREEDRIVE_AXES = 103
    START_CONTACT_DETECTION = 104
    STOP_CONTACT_DETECTION = 105
    SET_FORCE_MODE_PARAMETERS = 106


class Query(IntEnum):
    """A query of `ScriptCommand.query`: the URScript function whose result the control program returns.

    PROGRESS: how many points it has read, times 1e-6, and 1 during a trajectory. MESSAGES: how many messages of the
    reverse port it has read, and how many setpoints of the last stream it ignored after a late one; both
    times 1e-6.
    """

    FORWARD_KIN = 0
    INVERSE_KIN = 1
    INVERSE_KIN_HAS_SOLUTION = 2
    POSE_WITHIN_SAFETY_LIMITS = 3
    JOINTS_WITHIN_SAFETY_LIMITS = 4
    JOINT_TORQUES = 5
    TCP_OFFSET = 6
    STEADY = 7
    STEP_TIME = 8
    FLANGE_POSE = 9
    PROGRESS = 10
    CONTACT_DETECTED = 11
    JOINT_POSITIONS_HISTORY = 12
    TARGET_WAYPOINT = 13
    TOOL_CONTACT = 14
    FREEDRIVE_STATUS = 15
    JACOBIAN = 16
    JACOBIAN_TIME_DERIVATIVE = 17
    MASS_MATRIX = 18
    CORIOLIS_AND_CENTRIFUGAL_TORQUES = 19
    TARGET_JOINT_ACCELERATIONS = 20
    MESSAGES = 21


def to_words(values: Iterable[float]) -> tuple[int, ...]:
    """Convert physical values to words. Raises LocalProtocolError for one that is not finite or beyond ±2147 units."""
    # A single expression, because hundreds of setpoints per second pass through here. NaN fails the comparison.
    try:
        return tuple(
            [round(value * SCALE) if -_MAX_VALUE <= value <= _MAX_VALUE else _unsendable(value) for value in values]
        )
    except (TypeError, ValueError):
        raise LocalProtocolError(f"{str(values)[:40]} cannot be sent: External Control carries numbers") from None


def from_words(words: Iterable[int]) -> tuple[float, ...]:
    """Convert words to physical values."""
    return tuple(word / SCALE for word in words)


def _unsendable(value: float) -> NoReturn:
    raise LocalProtocolError(f"{value} cannot be sent: External Control is limited to numbers from -2147 to 2147")


def _exactly(name: str, values: Sequence[float], size: int) -> Sequence[float]:
    count = len(values) if hasattr(values, "__len__") else 1
    if count != size:
        raise LocalProtocolError(f"{name} must have {size} numbers, not {count}")
    return values


def _six(name: str, values: Sequence[float]) -> tuple[int, ...]:
    return to_words(_exactly(name, values, 6))


def _three(name: str, values: Sequence[float]) -> Sequence[float]:
    return _exactly(name, values, 3)


def _filled(words: Sequence[int], size: int) -> tuple[int, ...]:
    return (*words, *(0,) * (size - len(words)))


# 50001


@dataclass(frozen=True, slots=True)
class ReverseMessage:
    """One setpoint or keep-alive for the control program.

    read_timeout_ms: how long the program waits for the next message, 0 for no limit.
    words: payload, six words; their meaning depends on the mode.
    """

    SIZE = 32

    mode: ControlMode
    words: tuple[int, ...] = (0,) * 6
    read_timeout_ms: int = 0

    @classmethod
    def setpoint(cls, mode: ControlMode, values: Sequence[float], read_timeout_ms: int) -> Self:
        """Joint angles [rad] or speeds [rad/s], tool velocity [m/s, rad/s], pose [m, rotation vector], torques [Nm]."""
        return cls(mode, _six("a setpoint", values), read_timeout_ms)

    @classmethod
    def keep_alive(cls, read_timeout_ms: int) -> Self:
        """Tell the control program that the driver is alive; nothing else happens."""
        return cls(ControlMode.IDLE, read_timeout_ms=read_timeout_ms)

    @classmethod
    def stop(cls) -> Self:
        """End the control program."""
        return cls(ControlMode.STOPPED, read_timeout_ms=100)

    @classmethod
    def trajectory(cls, action: TrajectoryAction, points: int = 0, read_timeout_ms: int = 200) -> Self:
        """Start, keep alive, or cancel a trajectory with this number of points."""
        return cls(ControlMode.FORWARD, _filled((action, points), 6), read_timeout_ms)

    @classmethod
    def freedrive(cls, action: FreedriveAction, read_timeout_ms: int = 200) -> Self:
        """Start, keep alive, or end freedrive."""
        return cls(ControlMode.FREEDRIVE, _filled((action,), 6), read_timeout_ms)

    @property
    def values(self) -> tuple[float, ...]:
        """The payload as physical values (6,)."""
        return from_words(self.words)

    def encode(self) -> bytes:
        """The bytes on the wire."""
        return _REVERSE.pack(self.read_timeout_ms, *self.words, self.mode)

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Decode a message of 32 bytes. In modes without a payload, its words are arbitrary."""
        timeout, *words, mode = _REVERSE.unpack(data)
        return cls(_member(ControlMode, mode), tuple(words), timeout)


# 50003


@dataclass(frozen=True, slots=True)
class TrajectoryPoint:
    """One point of a trajectory.

    target: joint angles [rad] or a pose base to TCP [m, rotation vector], by the type (6,).
    via: second block (6,): joint angles near the target (moves to a pose), the via point
    (MOVEC), or the target velocities [rad/s] (SPLINE).
    parameters: third block (6,): velocity, acceleration, and 1 if `via` is used (moves to a
    pose) or the mode (MOVEC); the target accelerations [rad/s2] of a SPLINE.
    duration_s: 0 to use velocity and acceleration. blend_radius_m: not for a SPLINE.
    """

    SIZE = 84

    type: MotionType
    target: tuple[float, ...]
    via: tuple[float, ...] = (0.0,) * 6
    parameters: tuple[float, ...] = (0.0,) * 6
    duration_s: float = 0.0
    blend_radius_m: float = 0.0
    spline_type: SplineType | None = None

    @classmethod
    def spline(
        cls,
        q_rad: Sequence[float],
        qd_rad_s: Sequence[float],
        duration_s: float,
        qdd_rad_s2: Sequence[float] | None = None,
    ) -> Self:
        """A cubic segment to joint angles and speeds, or a quintic one when accelerations are given."""
        return cls(
            MotionType.SPLINE,
            tuple(q_rad),
            tuple(qd_rad_s),
            tuple(qdd_rad_s2 or (0.0,) * 6),
            duration_s,
            spline_type=SplineType.CUBIC if qdd_rad_s2 is None else SplineType.QUINTIC,
        )

    def encode(self) -> bytes:
        """The bytes on the wire."""
        if (self.type is MotionType.SPLINE) != (self.spline_type is not None):
            raise LocalProtocolError("a spline point requires a spline type, and other points must not have one")
        last = to_words([self.blend_radius_m])[0] if self.spline_type is None else int(self.spline_type)
        return _TRAJECTORY.pack(
            *_six("the target", self.target),
            *_six("the second block", self.via),
            *_six("the third block", self.parameters),
            *to_words([self.duration_s]),
            last,
            self.type,
        )

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Decode a point of 84 bytes."""
        *words, last, kind = _TRAJECTORY.unpack(data)
        values, motion = from_words(words), _member(MotionType, kind)
        blocks = values[0:6], values[6:12], values[12:18]
        if motion is MotionType.SPLINE:
            return cls(motion, *blocks, values[18], spline_type=_member(SplineType, last))
        return cls(motion, *blocks, values[18], last / SCALE)


# 50004


@dataclass(frozen=True, slots=True)
class ScriptCommand:
    """A command sent alongside the setpoints. words: follow its kind, padded with zeros to 27 on the wire."""

    SIZE = 112

    kind: ScriptCommandKind
    words: tuple[int, ...] = ()

    @property
    def values(self) -> tuple[float, ...]:
        """The words as physical values."""
        return from_words(self.words)

    @classmethod
    def set_payload(cls, mass_kg: float, cog_m: Sequence[float]) -> Self:
        """Mass and centre of gravity (3,) from the flange."""
        return cls(ScriptCommandKind.SET_PAYLOAD, to_words([mass_kg, *_three("the centre of gravity", cog_m)]))

    @classmethod
    def set_target_payload(
        cls, mass_kg: float, cog_m: Sequence[float], inertia_kg_m2: Sequence[float], transition_time_s: float = 0.0
    ) -> Self:
        """Like set_payload, with the inertia Ixx, Iyy, Izz, Ixy, Ixz, Iyz (6,); from 5.10 on."""
        cog, inertia = _three("the centre of gravity", cog_m), _exactly("the inertia", inertia_kg_m2, 6)
        return cls(ScriptCommandKind.SET_TARGET_PAYLOAD, to_words([mass_kg, *cog, *inertia, transition_time_s]))

    @classmethod
    def set_tool_voltage(cls, volts: int) -> Self:
        """0, 12 or 24."""
        if volts not in (0, 12, 24):
            raise LocalProtocolError(f"the tool voltage must be 0, 12 or 24 V, not {volts}")
        return cls(ScriptCommandKind.SET_TOOL_VOLTAGE, to_words([volts]))

    @classmethod
    def start_force_mode(
        cls,
        task_frame: Sequence[float],
        selection: Sequence[int],
        wrench: Sequence[float],
        type_: int,
        limits: Sequence[float],
        *,
        damping: float = 0.025,
        gain_scaling: float = 0.5,
    ) -> Self:
        """Be compliant along the selected axes of a frame given in the base frame; see URScript's force_mode."""
        blocks = (("the task frame", task_frame), ("the selection", selection), ("the wrench", wrench))
        values = [value for name, block in blocks for value in _exactly(name, block, 6)]
        values += [type_, *_exactly("the limits", limits, 6), damping, gain_scaling]
        return cls(ScriptCommandKind.START_FORCE_MODE, to_words(values))

    @classmethod
    def ft_rtde_input_enable(
        cls, enabled: bool, mass_kg: float, offset_m: Sequence[float], cog_m: Sequence[float]
    ) -> Self:
        """Use the wrench from RTDE inputs; for a sensor with this mass, offset (3,) and centre of gravity (3,)."""
        sensor = [mass_kg, *_three("the offset", offset_m), *_three("the centre of gravity", cog_m)]
        return cls(ScriptCommandKind.FT_RTDE_INPUT_ENABLE, (int(enabled), *to_words(sensor)))

    @classmethod
    def set_gravity(cls, gravity_m_s2: Sequence[float]) -> Self:
        """Acceleration (3,) in the base frame, [0, 0, 9.82] for an upright arm."""
        return cls(ScriptCommandKind.SET_GRAVITY, to_words(_three("gravity", gravity_m_s2)))

    @classmethod
    def set_tcp_offset(cls, pose_flange_tcp: Sequence[float]) -> Self:
        """Flange to TCP (6,) [m, rotation vector]."""
        return cls(ScriptCommandKind.SET_TCP_OFFSET, _six("the TCP offset", pose_flange_tcp))

    @classmethod
    def set_friction_compensation(cls, enabled: bool) -> Self:
        """Switch friction compensation of direct torque control; 5.23 and 5.24."""
        return cls(ScriptCommandKind.SET_FRICTION_COMPENSATION, (int(enabled),))

    @classmethod
    def set_friction_scales(cls, viscous: Sequence[float], coulomb: Sequence[float]) -> Self:
        """Fractions 0 to 1 of each joint's friction (6,) to compensate in direct torque control; from 5.25.1 on."""
        blocks = (("the viscous scales", viscous), ("the Coulomb scales", coulomb))
        values = [min(1.0, max(0.0, value)) for name, block in blocks for value in _exactly(name, block, 6)]
        return cls(ScriptCommandKind.SET_FRICTION_SCALES, to_words(values))

    @classmethod
    def argument(cls, index: int, values: Sequence[float]) -> Self:
        """Argument 0 to 2 of the next query (6,), with two words per number for the robot's own precision."""
        words = [word for value in _exactly("an argument", values, 6) for word in _to_two_words(value)]
        return cls(ScriptCommandKind.ARGUMENT, (index, *words))

    @classmethod
    def query(cls, query: Query, given: int = 0, number: int = 0) -> Self:
        """A query. given: bits for the arguments that were sent before. number: for queries that take one."""
        return cls(ScriptCommandKind.QUERY, (query, given, number))

    @classmethod
    def set_stream_parameters(
        cls, lookahead_s: float, gain: float, acceleration: float, deceleration_rad_s2: float
    ) -> Self:
        """Parameters for servoing, for speeds [rad/s2 or m/s2], and for stopping."""
        values = (lookahead_s, gain, acceleration, deceleration_rad_s2)
        return cls(ScriptCommandKind.SET_STREAM_PARAMETERS, to_words(values))

    @classmethod
    def set_freedrive_axes(cls, axes: Sequence[int], frame: Sequence[float]) -> Self:
        """Free axes: 1 for each free axis (6,) of a frame given in the base frame (6,); from 5.10 on."""
        free = (int(bool(axis)) for axis in _exactly("the axes", axes, 6))
        return cls(ScriptCommandKind.SET_FREEDRIVE_AXES, (*free, *_six("the frame", frame)))

    @classmethod
    def start_contact_detection(cls, direction_base: Sequence[float]) -> Self:
        """Detect tool contact during motion along a direction (6,), all zero for any direction."""
        return cls(ScriptCommandKind.START_CONTACT_DETECTION, _six("the direction", direction_base))

    @classmethod
    def set_force_mode_parameters(cls, damping: float, gain_scaling: float) -> Self:
        """Parameters of the active force mode, or of the next one."""
        return cls(ScriptCommandKind.SET_FORCE_MODE_PARAMETERS, to_words((damping, gain_scaling)))

    def encode(self) -> bytes:
        """The bytes on the wire."""
        return _COMMAND.pack(self.kind, *_filled(self.words, 27))

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Decode a command of 112 bytes, with all 27 words."""
        kind, *words = _COMMAND.unpack(data)
        return cls(_member(ScriptCommandKind, kind), tuple(words))


def _to_two_words(value: float) -> tuple[int, int]:
    """A value in millionths, and the remainder in billionths of a millionth."""
    to_words([value])  # raises if the value cannot be sent
    whole = math.floor(value * SCALE)
    return whole, math.floor((value * SCALE - whole) * _FINE)


def _from_two_words(whole: int, rest: int) -> float:
    return (whole + rest / _FINE) / SCALE


@dataclass(frozen=True, slots=True)
class Answer:
    """The program's answer to a `Query`; it has no values if there is no solution.

    On the wire, its first word is -1 minus the number of values, each of which has two words.
    """

    values: tuple[float, ...]

    def encode(self) -> bytes:
        """The bytes on the wire."""
        words = [-1 - len(self.values), *(word for value in self.values for word in _to_two_words(value))]
        return struct.pack(f">{len(words)}i", *words)


class ReplyDecoder:
    """Splits the robot's stream on the script command interface into `TrajectoryResult` and `Answer`."""

    def __init__(self) -> None:
        self._buffer = b""

    @staticmethod
    def size(data: bytes) -> int:
        """Size in bytes of the message that begins with this word. Raises RemoteProtocolError."""
        (word,) = _WORD.unpack_from(data)
        if word < -1 - _MAX_VALUES:
            raise RemoteProtocolError(f"an answer of {-1 - word} values is too long")
        return _WORD.size * (1 if word >= 0 else 1 + 2 * (-1 - word))

    @staticmethod
    def decode(data: bytes) -> TrajectoryResult | Answer:
        """Decode a complete message. Raises RemoteProtocolError if it is invalid."""
        word, *words = struct.unpack(f">{len(data) // _WORD.size}i", data)
        if word >= 0:
            return _member(TrajectoryResult, word)
        return Answer(tuple(map(_from_two_words, words[::2], words[1::2])))

    def feed(self, data: bytes) -> list[TrajectoryResult | Answer]:
        """Add bytes; returns the messages they complete. Raises RemoteProtocolError for an invalid message."""
        self._buffer += data
        messages = []
        while len(self._buffer) >= _WORD.size and len(self._buffer) >= (size := self.size(self._buffer)):
            message, self._buffer = self._buffer[:size], self._buffer[size:]
            messages.append(self.decode(message))
        return messages


EnumT = TypeVar("EnumT", bound=IntEnum)


def _member(kind: type[EnumT], value: int) -> EnumT:
    try:
        return kind(value)
    except ValueError:
        raise RemoteProtocolError(f"{value} is not a {kind.__name__}") from None


def split_greeting(data: bytes) -> tuple[str | None, bytes] | None:
    """Split the beginning of a control program's stream into its token (None without one) and the bytes that follow.

    Returns None while more bytes are needed to decide.
    """
    if not data.startswith(GREETING[: len(data)]):
        return None, data
    line, end, rest = data.partition(b"\n")
    if not end:
        return (None, data) if len(data) > _MAX_GREETING else None
    return line.removeprefix(GREETING).decode("ascii", "replace"), rest
