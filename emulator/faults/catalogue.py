"""All kinds of faults, and faults from JSON or a command line."""

from collections.abc import Mapping
from dataclasses import MISSING, asdict, fields
from typing import Any, Final, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from emulator.faults import arm, line, machine, network, program, rtde, scene
from emulator.faults.fault import KINDS, Fault, FaultError
from urproto.text import unknown

SUBJECTS: Final = (network, line, rtde, arm, scene, program, machine)
_F = TypeVar("_F", bound=Fault)
_TIMING: Final = tuple(field.name for field in fields(Fault))
_CHANCE: Final = ("once", "probability", "seed")


def make_fault(kind: str, arguments: Mapping[str, Any], *, typed: bool = True) -> Fault:
    """Create a fault by the name of its kind. Raises FaultError.

    typed: numbers are numbers, as in JSON; otherwise they may be text.
    """
    form = KINDS.get(kind)
    if form is None:
        raise FaultError(unknown("fault", kind, KINDS))
    names = [field.name for field in fields(form)]
    foreign = [name for name in arguments if name not in names]
    if foreign:
        raise FaultError(f"{kind} has no argument {', '.join(foreign)}: choose from {', '.join(names)}")
    try:
        return msgspec.convert(dict(arguments), form, strict=typed)
    except msgspec.ValidationError as error:
        raise FaultError(f"{kind}: {error}") from error


def checked(fault: _F) -> _F:
    """Return the fault if its values are within the bounds of their types. Raises FaultError."""
    make_fault(fault.kind, asdict(fault))
    return fault


def parse_fault(text: str) -> Fault:
    """Create a fault from its text on the command line: ``drop_connection,port=rtde,after=5``. Raises FaultError."""
    kind, *words = text.split(",")
    arguments = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not equals:
            raise FaultError(f"{text!r}: {word!r} is not NAME=VALUE")
        arguments[name.strip()] = value
    return make_fault(kind.strip(), arguments, typed=False)


def describe(fault: Fault) -> dict[str, Any]:
    """The arguments of a fault that differ from their defaults."""
    return {
        field.name: getattr(fault, field.name)
        for field in fields(fault)
        if field.default is MISSING or getattr(fault, field.name) != field.default
    }


def kinds() -> list[dict[str, Any]]:
    """List all kinds: name, subject, text, occasion, and arguments with type and, if they have one, default."""
    return [
        {
            "kind": name,
            "subject": form.__module__.rpartition(".")[2],
            "text": form.__doc__ or "",
            "occasion": form.occasion,
            "arguments": [
                argument for argument in _arguments(form) if form.occasion or argument["name"] not in _CHANCE
            ],
        }
        for name, form in KINDS.items()
    ]


def _arguments(form: type[Fault]) -> list[dict[str, Any]]:
    hints = get_type_hints(form)
    own_first = sorted(fields(form), key=lambda field: field.name in _TIMING)
    return [
        {"name": field.name, "type": _type_name(hints[field.name])}
        | ({} if field.default is MISSING else {"default": field.default})
        for field in own_first
    ]


def _type_name(hint: Any) -> str:
    if get_origin(hint) is not None and get_args(hint) and isinstance(get_args(hint)[0], str):
        return " or ".join(get_args(hint))
    parts = [part for part in get_args(hint) if part is not type(None)] or [hint]
    return str(getattr(parts[0], "__name__", parts[0]))
