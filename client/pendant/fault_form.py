"""Faults as a form: the fields of a kind are created from its description by the verb ``fault_kinds``."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from urproto.joints import JOINT_LABELS

TIMING: Final = ("at", "after", "until", "lasting", "once", "probability", "seed")
"""Arguments of every kind, or of every kind that strikes on an occasion."""

_HINTS: Final = {
    "at": "uptime, s",
    "after": "s from now",
    "until": "uptime, s",
    "lasting": "s",
    "peer": "address or address:port; all",
    "probability": "of a strike, 0 to 1",
    "delay_s": "s",
    "stop_above_rad": "rad; 0: no stop",
}
_ALL_PORTS: Final = "all ports"
_SCRIPTS: Final = "scripts"  # the connections that programs open: docs/faults.md
JOINTS: Final = dict(enumerate(JOINT_LABELS))


@dataclass(frozen=True, slots=True)
class FaultField:
    """One argument of a fault. choices: value -> text, empty for a typed value. required: it has no default."""

    name: str
    type: Literal["text", "int", "float", "bool"]
    default: Any
    required: bool
    choices: Mapping[Any, str]
    hint: str = ""

    @property
    def is_timing(self) -> bool:
        """Whether the argument says when the fault strikes."""
        return self.name in TIMING

    def parse(self, value: Any) -> Any:
        """Convert the content of the field, None if it is empty. Raises ValueError if it is invalid."""
        if value is None or value == "":
            return None
        if self.type == "bool" or self.choices:
            return value
        try:
            return _PARSERS[self.type](value)
        except (TypeError, ValueError) as error:
            expected = "a whole number" if self.type == "int" else "a number"
            raise ValueError(f"{self.name} must be {expected}, not {value!r}.") from error


@dataclass(frozen=True, slots=True)
class FaultKind:
    """A kind of fault. occasion: the event at which it strikes, empty for a fault that lasts."""

    name: str
    subject: str
    text: str
    occasion: str
    fields: tuple[FaultField, ...]

    @property
    def title(self) -> str:
        """The name as shown to users."""
        return self.name.replace("_", " ").capitalize().replace("rtde", "RTDE")


def fault_kinds(listed: Sequence[Mapping[str, Any]], ports: Sequence[str]) -> dict[str, FaultKind]:
    """The kinds of faults by name, from the results of the verbs ``fault_kinds`` and ``ports``."""
    return {
        kind["kind"]: FaultKind(
            kind["kind"],
            kind["subject"],
            " ".join(kind["text"].replace("``", "").split()),
            kind["occasion"],
            tuple(_field(argument, ports) for argument in kind["arguments"]),
        )
        for kind in listed
    }


def fault_arguments(kind: FaultKind, values: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments for ``inject_fault`` from the content of the fields, without empty ones and defaults.

    Raises ValueError if one is missing or invalid.
    """
    parsed = {field.name: field.parse(values.get(field.name)) for field in kind.fields}
    missing = [field.name for field in kind.fields if field.required and parsed[field.name] is None]
    if missing:
        raise ValueError(f"{kind.title} needs {', '.join(missing)}.")
    return {
        field.name: parsed[field.name]
        for field in kind.fields
        if parsed[field.name] is not None and (field.required or parsed[field.name] != field.default)
    }


def _field(argument: Mapping[str, Any], ports: Sequence[str]) -> FaultField:
    name, kind = argument["name"], argument["type"]
    default, required = argument.get("default"), "default" not in argument
    hint = _HINTS.get(name, "")
    if name == "port" and kind == "str":
        names = [*(port for port in ports if port != "control"), _SCRIPTS]
        all_ports = {} if required else {"": _ALL_PORTS}
        return FaultField(name, "text", default, required, {**all_ports, **{port: port for port in names}}, hint)
    if name == "joint":
        return FaultField(name, "int", default, required, JOINTS, hint)
    if " or " in kind or kind not in ("str", "int", "float", "bool"):
        return FaultField(name, "text", default, required, {word: word for word in kind.split(" or ")}, hint)
    return FaultField(name, "text" if kind == "str" else kind, default, required, {}, hint)


def _whole_number(value: Any) -> int:
    if float(value) != int(float(value)):
        raise ValueError(value)
    return int(float(value))


_PARSERS: Final[Mapping[str, Callable[[Any], Any]]] = {"int": _whole_number, "float": float, "text": str}
