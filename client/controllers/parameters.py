"""Parameters of controllers: dataclasses that are filled from a YAML file.

A parameter that exists in ROS 2 but has no meaning here is declared with `without_effect`, which says why; nothing is
reported where its value describes what happens anyway. A field with the metadata `BY_NAME` takes every other key whose
value is a mapping, like `constraints`, which takes one mapping per joint. All other keys are reported as unknown.

Source of which parameters are read-only: the parameter files of ros2_controllers and ur_controllers.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from math import isfinite, isinf
from types import GenericAlias
from typing import Any, Final, TypeVar, cast, get_args, get_origin, get_type_hints

from client.errors import ControllerError
from urproto.text import quoted

BY_NAME: Final[Mapping[str, Any]] = {"by name": True}
"""Metadata of a field that collects all mappings that no other field takes."""

_WHY: Final = "without effect"
_WORDS: Final = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}

Parameters = TypeVar("Parameters")

_READ_ONLY: Final = frozenset(
    (
        "action_monitor_rate",
        "command_interfaces",
        "command_joints",
        "constraints.decelerate_on_cancel",
        "frame_id",
        "initial_scaling_factor",
        "interface_name",
        "interfaces",
        "interpolate_from_desired_state",
        "interpolation_method",
        "joints",
        "max_deceleration_on_cancel",
        "pose_name",
        "sensor_name",
        "speed_scaling.command_interface",
        "speed_scaling.state_interface",
        "speed_scaling_interface_name",
        "state_interfaces",
        "state_publish_rate",
        "tf_prefix",
    )
)


@dataclass(frozen=True, slots=True)
class PrefixParameters:
    """tf_prefix: prefix of the names of all interfaces."""

    tf_prefix: str = ""


@dataclass(slots=True)
class Reading:
    """Keys of a file that were not used: unknown ones, and parameters without effect."""

    unknown: list[str] = field(default_factory=list)
    without_effect: list[str] = field(default_factory=list)


def without_effect(default: Any, why: str, *, unless: Collection[Any] = ()) -> Any:
    """Declare a parameter that is read and ignored; ``why`` is reported to the user.

    Nothing is reported for the default and the values in ``unless``, with which everything happens as it is asked for.
    """
    return field(default=default, metadata={_WHY: (why, (default, *unless))})


def read_parameters(kind: type[Parameters], given: Mapping[str, Any], owner: str, reading: Reading) -> Parameters:
    """Fill the dataclass ``kind`` with the given values; unused keys are added to ``reading``.

    Keys may be written with dots ("constraints.goal_time"). Raises ControllerError, which names ``owner``, for a value
    of the wrong type and for non-finite numbers. Infinity is accepted only where it is the default, as for limits.
    """
    try:
        return cast(Parameters, _build(kind, _nested(given, owner), owner, "", reading))
    except RecursionError:
        raise ControllerError(owner, "its parameters contain themselves") from None


def _nested(given: Mapping[str, Any], owner: str) -> dict[str, Any]:
    """Convert keys with dots to nested mappings."""
    result: dict[str, Any] = {}
    for key, value in given.items():
        *parents, last = str(key).split(".")
        place = result
        for parent in parents:
            place = place.setdefault(parent, {})
            if not isinstance(place, dict):
                raise ControllerError(owner, f"{key} is given, but {parent} is also given as a value")
        inner = _nested(value, owner) if isinstance(value, Mapping) else value
        if isinstance(inner, dict) and isinstance(place.get(last), dict):
            place[last].update(inner)
        else:
            place[last] = inner
    return result


def _build(kind: type[Any], given: Mapping[str, Any], owner: str, path: str, reading: Reading) -> Any:
    hints = get_type_hints(kind)
    known = {entry.name: entry for entry in fields(kind)}
    rest = next((name for name, entry in known.items() if "by name" in entry.metadata), None)
    values: dict[str, Any] = {rest: {}} if rest else {}
    for key, value in given.items():
        place = f"{path}{key}"
        if key in known and key != rest:
            values[key] = found = _value(hints[key], value, owner, place, reading)
            why, harmless = known[key].metadata.get(_WHY, ("", ()))
            if why and found not in harmless:
                reading.without_effect.append(f"{place} ({why})")
            if isinstance(found, float) and not isfinite(found) and not (isinf(found) and _is_limit(known[key])):
                raise ControllerError(owner, f"{place} must be a finite number, not {quoted(value)}")
        elif rest and isinstance(value, Mapping):
            values[rest][key] = _build(get_args(hints[rest])[1], value, owner, f"{place}.", reading)
        else:
            reading.unknown.append(place)
    if missing := [name for name, entry in known.items() if name not in values and _is_required(entry)]:
        raise ControllerError(owner, f"the parameter {path}{missing[0]} is missing")
    return kind(**values)


def _is_required(entry: Any) -> bool:
    return entry.default is MISSING and entry.default_factory is MISSING


def _is_limit(entry: Any) -> bool:
    """True for an optional limit, which is infinite by default."""
    return isinstance(entry.default, float) and isinf(entry.default)


def _value(hint: Any, value: Any, owner: str, place: str, reading: Reading) -> Any:
    if isinstance(hint, GenericAlias) and get_origin(hint) is tuple:
        if not isinstance(value, list | tuple):
            raise ControllerError(owner, f"{place} must be a list, not {quoted(value)}")
        kind = get_args(hint)[0]
        return tuple(_value(kind, item, owner, f"{place}[{n}]", reading) for n, item in enumerate(value))
    if hint in _WORDS:
        return _scalar(hint, value, owner, place)
    if not isinstance(value, Mapping):
        raise ControllerError(owner, f"{place} must be a group of parameters, not {quoted(value)}")
    return _build(hint, value, owner, f"{place}.", reading)


def _scalar(hint: Any, value: Any, owner: str, place: str) -> Any:
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            raise ControllerError(owner, f"{place} must be a finite number, not {quoted(value)}") from None
    if isinstance(value, hint) and (hint is bool or not isinstance(value, bool)):
        return value
    raise ControllerError(owner, f"{place} must be {_WORDS[hint]}, not {quoted(value)}")


def is_read_only(name: str) -> bool:
    """Whether a parameter, named with dots, cannot be changed after its controller is loaded."""
    parts = name.split(".")
    return any(".".join(parts[place:]) in _READ_ONLY for place in range(len(parts)))


def flat(parameters: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield names with dots, type hints and values, with tuples as lists and groups by joint for every joint."""
    return _flat(parameters, getattr(parameters, "joints", ()), "")


def _flat(parameters: Any, joints: Sequence[str], prefix: str) -> Iterator[tuple[str, Any, Any]]:
    hints = get_type_hints(type(parameters))
    for entry in fields(parameters):
        value, hint = getattr(parameters, entry.name), hints[entry.name]
        name = prefix + entry.name
        if set(BY_NAME) <= set(entry.metadata):
            group = get_args(hint)[1]
            for joint in dict.fromkeys((*joints, *value)):
                yield from _flat(value.get(joint) or group(), joints, f"{prefix}{joint}.")
        elif is_dataclass(value):
            yield from _flat(value, joints, f"{name}.")
        else:
            yield name, hint, list(value) if isinstance(value, tuple) else value


def with_changes(kind: type[Parameters], before: Parameters, values: Mapping[str, Any], owner: str) -> Parameters:
    """Copy parameters with changes ``values``, named with dots.

    Raises ControllerError, which names ``owner``, for a parameter that is unknown or read-only, or has another type.
    """
    whole = {name: value for name, _, value in flat(before)}
    for name in values:
        if name not in whole:
            raise ControllerError(owner, f"it has no parameter {quoted(name)}")
        if is_read_only(name):
            raise ControllerError(owner, f"{name} is read-only: unload the controller and load it with another value")
    return read_parameters(kind, whole | dict(values), owner, Reading())
