"""Checks the arguments of public calls before anything is sent: a value is refused where it was given.

Parameters are named after their quantity and unit (``q_rad``, ``mass_kg``). `QUANTITIES` lists, by these names, how
many numbers each has and within which range; the decorator `checked` looks up the parameters of every public method of
a class. The ranges are wide: they catch degrees, millimetres and typing errors. What an arm can do, the robot judges.
"""

import collections.abc
import inspect
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial, wraps
from types import NoneType, UnionType
from typing import Any, Final, Literal, TypeVar, Union, cast, get_args, get_origin

from urproto.errors import LocalProtocolError, URError
from urproto.external_control import TrajectoryPoint
from urproto.text import quoted, unknown

Check = Callable[[Any], object]
Checked = TypeVar("Checked")
Function = TypeVar("Function", bound=Callable[..., Any])

_BY_NAME: Final = inspect.Parameter.KEYWORD_ONLY
_ALL_OTHERS: Final = inspect.Parameter.VAR_POSITIONAL
_POSITIVE: Final = math.ulp(0.0)
_SENDABLE: Final = 2147.0  # External Control carries no larger numbers


@dataclass(frozen=True)
class Quantity:
    """A number, or ``size`` numbers, each from ``low`` to ``high``; a part of them may have another range.

    name, unit: for messages. whole: no fractions. endless: infinity is permitted, too. rest: range from the fourth
    number on, as of rotations.
    """

    name: str
    unit: str
    low: float
    high: float
    size: int = 0
    whole: bool = False
    endless: bool = False
    rest: tuple[float, float] | None = None

    def check(self, value: Any) -> None:
        """Raise LocalProtocolError unless the value is of this quantity."""
        try:
            if self._all_fit(value) if self.size else self._fits(value):
                return
        except (TypeError, ValueError, LookupError):  # not numbers; "abc" <= 1.0 is a TypeError
            pass
        raise LocalProtocolError(f"{self.describe()}, not {quoted(value)}")

    def _fits(self, value: Any) -> bool:
        if self.low <= value <= self.high:
            return not self.whole or bool(value == int(value))
        return self.endless and bool(value == math.inf)

    def _all_fit(self, values: Any) -> bool:
        if len(values) != self.size or type(values) is bytes:
            return False
        if hasattr(values, "tolist"):  # numbers of an array are slow to compare
            values = values.tolist()
        if self.rest is None:
            fit = _within(values, self.low, self.high)
        else:
            fit = _within(values[:3], self.low, self.high) and _within(values[3:], *self.rest)
        return fit and (not self.whole or all(number == int(number) for number in values))

    def describe(self) -> str:
        """What values it has, as the beginning of a sentence."""
        numbers = f"{self.size} numbers " if self.size else "a whole number " if self.whole else ""
        rest = f" (the last three {_range(*self.rest)})" if self.rest else ""
        return f"{self.name}: {numbers}{_range(self.low, self.high)} {self.unit}".rstrip() + rest


def _within(numbers: Sequence[float], low: float, high: float) -> bool:
    """Called for every setpoint. The sum notices what is not a number."""
    return low <= min(numbers) and max(numbers) <= high and math.isfinite(sum(numbers))


def _six(name: str, unit: str, limit: float, rest: float | None = None) -> Quantity:
    return Quantity(name, unit, -limit, limit, 6, rest=None if rest is None else (-rest, rest))


def _pose(limit_m: float) -> Quantity:
    return _six("a pose", "m and a rotation vector in rad", limit_m, 4.0 * math.pi)


# guess: all limits that are not those of a protocol, far beyond any arm
_ANGLES: Final = _six("joint angles", "rad", 200.0 * math.pi)
_SPEEDS: Final = _six("joint speeds", "rad/s", 20.0)
_TORQUES: Final = _six("joint torques", "Nm", _SENDABLE)
_POSE: Final = _pose(10.0)
_VELOCITY: Final = _six("a velocity", "m/s and rad/s", 10.0, 20.0)
_WRENCH: Final = _six("a wrench", "N and Nm", _SENDABLE)
_DIRECTION: Final = _six("a direction", "", _SENDABLE)
_AXES: Final = Quantity("axes", "(1 for each that is meant)", 0, 1, 6, whole=True)
_SCALES: Final = Quantity("shares of the friction", "", 0.0, 1.0, 6)
_POINT: Final = Quantity("a position", "m", -2.0, 2.0, 3)
_PLACE: Final = Quantity("a place", "m", -100.0, 100.0, 3)
_LENGTH: Final = Quantity("a length", "m", _POSITIVE, 100.0)
_JUMP: Final = Quantity("a jump threshold", "", 0.0, 1e9)
_WORD: Final = Quantity("a word", "", 0, 65535, whole=True)
_SPEED: Final = Quantity("a speed", "rad/s or m/s", _POSITIVE, 20.0)
_ACCELERATION: Final = Quantity("an acceleration", "rad/s2 or m/s2", _POSITIVE, _SENDABLE)
_TIME: Final = Quantity("a time", "s", 0.0, 1e9, endless=True)
_MASS: Final = Quantity("a mass", "kg", 0.0, 200.0)
_WHOLE: Final = Quantity("a number", "", -(2**31), 2**31 - 1, whole=True)
_FINITE: Final = Quantity("a number", "", -sys.float_info.max, sys.float_info.max)
_PERIOD: Final = Quantity("a time", "s", _POSITIVE, 1e9, endless=True)
_COUNT: Final = Quantity("a count of the gripper", "", 0, 255, whole=True)
_PORT: Final = Quantity("a port", "", 0, 65535, whole=True)
_LOOKAHEAD: Final = Quantity("the lookahead time of servoj", "s", 0.03, 0.2)
_VOLTS: Final = Quantity("a voltage", "V", 0.0, 24.0)
_GAIN: Final = Quantity("the gain of servoj", "", 100.0, 2000.0)

QUANTITIES: Final[Mapping[str, Quantity]] = {
    "a": _ACCELERATION,
    "acceleration": _ACCELERATION,
    "acceleration_m_s2": _ACCELERATION,
    "acceleration_rad_s2": _ACCELERATION,
    "acceleration_scaling": Quantity("acceleration scaling", "", _POSITIVE, 1.0),
    "address": _WORD,
    "amperes": Quantity("an analog output", "A", 0.004, 0.020),
    "arguments": _six("an argument", "", _SENDABLE),
    "axes": _AXES,
    "blend_radius_m": Quantity("a blend radius", "m", 0.0, 10.0),
    "center": _PLACE,
    "cog_m": _POINT,
    "command_port": _PORT,
    "coulomb": _SCALES,
    "count": Quantity("a number of values", "", 1, 2000, whole=True),
    "damping": Quantity("damping", "", 0.0, 1.0),
    "deceleration_rad_s2": _ACCELERATION,
    "direction_base": _DIRECTION,
    "duration_s": _TIME,
    "end_rad": _ANGLES,
    "force_count": _COUNT,
    "fraction": Quantity("the speed slider", "", 0.01, 1.0),
    "frame_base": _POSE,
    "frequency_hz": Quantity("states per second", "Hz", _POSITIVE, 1000.0),
    "gain": _GAIN,
    "gain_scaling": Quantity("gain scaling", "", 0.0, 2.0),
    "gravity_m_s2": Quantity("gravity", "m/s2", -30.0, 30.0, 3),
    "hang_s": _TIME,
    "interim": _PLACE,
    "inertia_kg_m2": _six("an inertia", "kg m2", 200.0),
    "jerk_rad_s3": Quantity("a jerk", "rad/s3", _POSITIVE, 1e9),
    "jump_threshold": _JUMP,
    "keep_alive_s": _PERIOD,
    "keep_alive_timeout_s": _PERIOD,
    "kind": Quantity("the kind of force mode", "", 1, 3, whole=True),
    "length": _LENGTH,
    "limits": Quantity("the limits of force mode", "m/s or m, rad/s or rad", 0.0, 20.0, 6),
    "longest_s": _TIME,
    "lookahead_s": _LOOKAHEAD,
    "mass_kg": _MASS,
    "max_age_s": _TIME,
    "max_step_m": Quantity("a step", "m", _POSITIVE, 1e9),
    "near_q_rad": _ANGLES,
    "number": _WHOLE,
    "offset_m": _POINT,
    "orientation": Quantity("a rotation vector", "rad", -4.0 * math.pi, 4.0 * math.pi, 3),
    "padding_m": Quantity("the padding", "m", 0.0, 0.999),
    "port": _PORT,
    "pose": _pose(100.0),
    "pose_base_tcp": _POSE,
    "pose_flange_tcp": _POSE,
    "pose_from": _POSE,
    "pose_from_to": _POSE,
    "position_count": _COUNT,
    "q_rad": _ANGLES,
    "qd_rad_s": _SPEEDS,
    "qdd_rad_s2": _six("joint accelerations", "rad/s2", _SENDABLE),
    "radius": _LENGTH,
    "reconnect_s": _TIME,
    "reverse_port": _PORT,
    "revolute_jump_threshold_rad": _JUMP,
    "robot_api_port": _PORT,
    "rotation_rad_s": _SPEED,
    "scale": Quantity("a scale", "", _POSITIVE, 100.0),
    "seed": Quantity("a seed", "", 0, 2**31 - 1, whole=True),
    "selection": _AXES,
    "sender_port": _PORT,
    "sensor_mass_kg": _MASS,
    "servoj_gain": _GAIN,
    "servoj_lookahead_s": _LOOKAHEAD,
    "silence_s": _PERIOD,
    "size": Quantity("edge lengths", "m", _POSITIVE, 100.0, 3),
    "speed_count": _COUNT,
    "speed_m_s": _SPEED,
    "speed_rad_s": _SPEED,
    "start_rad": _ANGLES,
    "start_timeout_s": _TIME,
    "steps": Quantity("control periods", "", 0, 2**31 - 1, whole=True),
    "task_frame_base": _POSE,
    "tcp_offset": _POSE,
    "time_limit_s": Quantity("a time limit", "s", _POSITIVE, 1e9),
    "timeout_s": _TIME,
    "tolerance_rad": Quantity("tolerances about x, y and z", "rad", 0.0, 4.0 * math.pi, 3),
    "tool_voltage": _VOLTS,
    "torque_Nm": _TORQUES,
    "trajectory_port": _PORT,
    "transition_time_s": Quantity("a transition time", "s", 0.0, _SENDABLE),
    "v": _SPEED,
    "velocity": _VELOCITY,
    "velocity_base": _VELOCITY,
    "velocity_m_s": _SPEED,
    "velocity_scaling": Quantity("velocity scaling", "", _POSITIVE, 1.0),
    "via_base_tcp": _POSE,
    "viscous": _SCALES,
    "volts": _VOLTS,
    "waypoints": _POSE,
    "within_s": _TIME,
    "word": _WORD,
    "words": _WORD,
    "wrench": _WRENCH,
}
"""The quantity of each numeric parameter, by its name."""


def checked(kind: type[Checked], *, error: type[URError] = LocalProtocolError) -> type[Checked]:
    """Check the arguments of the constructor and all public methods of a class, which raise ``error`` first of all."""
    for name, member in tuple(vars(kind).items()):
        if name.startswith("_") and name != "__init__":
            continue
        if isinstance(member, staticmethod | classmethod):
            setattr(kind, name, type(member)(checked_call(member.__func__, error)))
        elif inspect.isfunction(member):
            setattr(kind, name, checked_call(member, error))
    kind.__checked__ = True  # type: ignore[attr-defined]
    return kind


def checked_call(function: Function, error: type[URError] = LocalProtocolError) -> Function:
    """Check the arguments of a function, plain or async; see `checked`."""
    if hasattr(function, "__checked__"):
        return function
    parameters = inspect.signature(function).parameters
    checks = {name: check for name, one in parameters.items() if (check := check_of(one)) is not None}
    if not checks:
        return function
    places = [
        (index, one.kind, checks[one.name]) for index, one in enumerate(parameters.values()) if one.name in checks
    ]
    positional = [(index, check) for index, kind, check in places if kind not in (_BY_NAME, _ALL_OTHERS)]
    others = [(index, check) for index, kind, check in places if kind is _ALL_OTHERS]

    def check_all(args: Sequence[Any], kwargs: Mapping[str, Any]) -> None:
        try:
            check_each(args, kwargs)
        except LocalProtocolError as refusal:
            raise error(str(refusal)) from None

    def check_each(args: Sequence[Any], kwargs: Mapping[str, Any]) -> None:
        given = len(args)
        for index, check in positional:
            if index < given:
                check(args[index])
        for name in kwargs:
            if name in checks:
                checks[name](kwargs[name])
        for index, check in others:
            for value in args[index:]:
                check(value)

    if inspect.iscoroutinefunction(function):

        @wraps(function)
        async def call(*args: Any, **kwargs: Any) -> Any:
            check_all(args, kwargs)
            return await function(*args, **kwargs)

        call.__dict__["__checked__"] = True
        return cast(Function, call)

    @wraps(function)
    def call_plain(*args: Any, **kwargs: Any) -> Any:
        check_all(args, kwargs)
        return function(*args, **kwargs)

    call_plain.__dict__["__checked__"] = True
    return cast(Function, call_plain)


def check_fields(instance: Any, error: type[URError] = LocalProtocolError) -> None:
    """Check the fields of a dataclass. Raises ``error``."""
    for one in fields(instance):
        check = check_of(inspect.Parameter(one.name, inspect.Parameter.KEYWORD_ONLY, annotation=one.type))
        if check is not None:
            try:
                check(getattr(instance, one.name))
            except LocalProtocolError as refusal:
                raise error(str(refusal)) from None


def check_of(parameter: inspect.Parameter) -> Check | None:
    """The check of a parameter, from its name and annotation; None for objects that the function itself checks."""
    kinds = _alternatives(parameter.annotation)
    if parameter.kind is parameter.VAR_KEYWORD or Any in kinds:
        return None
    check = _check_of(parameter.name, [kind for kind in kinds if kind is not NoneType])
    if check is None or NoneType not in kinds:
        return check
    return lambda value: value is None or check(value)


def _check_of(name: str, kinds: Sequence[Any]) -> Check | None:
    if name in QUANTITIES and (kinds[0] in (int, float) or get_origin(kinds[0]) is not None):
        return _check_each(QUANTITIES[name]) if _is_list(QUANTITIES[name], kinds[0]) else QUANTITIES[name].check
    if get_origin(kinds[0]) is Literal:
        return partial(_check_word, name, get_args(kinds[0]))
    if kinds == [bool]:
        return lambda value: _require(isinstance(value, int | float) and value in (0, 1), name, "true or false", value)
    if kinds in ([int], [float]):
        return (_WHOLE if kinds == [int] else _FINITE).check
    if get_origin(kinds[0]) is collections.abc.Callable:
        return lambda value: _require(callable(value), name, "a function", value)
    types = tuple(get_origin(kind) or kind for kind in kinds)
    if all(isinstance(kind, type) and kind.__module__ not in ("collections.abc", "inspect") for kind in types):
        text = " or ".join(kind.__name__ for kind in types)
        return lambda value: _require(isinstance(value, types), name, f"of type {text}", value)
    return None


def _is_list(quantity: Quantity, kind: Any) -> bool:
    """Whether an annotation stands for several values of a quantity."""
    return get_origin(kind) is collections.abc.Sequence and (
        not quantity.size or get_origin(get_args(kind)[0]) is collections.abc.Sequence
    )


def _check_each(quantity: Quantity) -> Check:
    def check(values: Any) -> None:
        if isinstance(values, str | bytes) or not hasattr(values, "__iter__"):
            raise LocalProtocolError(f"a list is needed, of {quantity.describe()}, not {quoted(values)}")
        for number, value in enumerate(values, 1):
            try:
                quantity.check(value)
            except LocalProtocolError as error:
                raise LocalProtocolError(f"number {number} of the list: {error}") from None

    return check


def points_of(moves: Iterable[TrajectoryPoint]) -> list[TrajectoryPoint]:
    """The points of a trajectory. Raises LocalProtocolError if they are something else, or cannot be sent."""
    try:
        points = list(moves)
    except TypeError:
        raise LocalProtocolError(f"a trajectory has points of client.points, not {quoted(moves)}") from None
    for point in points:
        if not isinstance(point, TrajectoryPoint):
            raise LocalProtocolError(f"a trajectory has points of client.points, not {quoted(point)}")
        point.encode()
    return points


def _alternatives(annotation: Any) -> tuple[Any, ...]:
    return get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)


def _check_word(name: str, words: Sequence[Any], value: Any) -> None:
    if any(type(value) is type(word) and value == word for word in words):
        return
    if isinstance(value, str):
        raise LocalProtocolError(unknown(name, value, map(str, words)))
    _require(False, name, " or ".join(map(repr, words)), value)


def _require(fits: Any, name: str, what: str, value: Any) -> None:
    if not fits:
        raise LocalProtocolError(f"{name} must be {what}, not {quoted(value)}")


def _range(low: float, high: float) -> str:
    return f"above 0 and up to {high:g}" if low == _POSITIVE else f"from {low:g} to {high:g}"
