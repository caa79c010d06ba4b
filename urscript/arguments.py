"""Which argument of a call belongs to which parameter. Decided when the program is compiled."""

from collections.abc import Sequence
from dataclasses import dataclass

from urscript.syntax import Call, Expression


class BindingError(Exception):
    """A call does not fit the parameters. The controller reports it when the call is executed."""


@dataclass(frozen=True, slots=True)
class Slot:
    """A parameter, as far as calls are concerned."""

    names: tuple[str, ...]
    required: bool


def bind_arguments(call: Call, slots: Sequence[Slot]) -> list[Expression | None]:
    """The argument for each parameter, None where it was left out; raises BindingError."""
    given = len(call.arguments) + len(call.keywords)
    if len(call.arguments) > len(slots):
        raise BindingError(_count_error(call.name, slots, given))
    bound: list[Expression | None] = [*call.arguments, *[None] * (len(slots) - len(call.arguments))]
    positions = {name: number for number, slot in enumerate(slots) for name in slot.names}
    for name, value in call.keywords:
        position = positions.get(name)
        if position is None:
            raise BindingError(f"Type error: {call.name} has no argument called '{name}'")
        if bound[position] is not None:
            raise BindingError(f"Type error: {call.name} got more than one value for argument '{name}'")
        bound[position] = value
    if any(value is None and slot.required for value, slot in zip(bound, slots, strict=True)):
        raise BindingError(_count_error(call.name, slots, given))
    return bound


def _count_error(name: str, slots: Sequence[Slot], given: int) -> str:
    # A real controller's log shows "Type error: str_sub takes exact…"; the rest is a guess.
    required = sum(slot.required for slot in slots)
    if required == len(slots):
        count = f"exactly {required}"
    else:
        count = f"at least {required}" if given < required else f"at most {len(slots)}"
    return f"Type error: {name} takes {count} arguments ({given} given)"
