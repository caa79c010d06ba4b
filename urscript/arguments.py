"""Match the arguments of a call with the parameters of the function, when the program is compiled."""

from collections.abc import Sequence
from dataclasses import dataclass

from urscript.syntax import Call, Expression


class BindingError(Exception):
    """The arguments of a call do not match the parameters. The controller reports this when the call is executed."""


@dataclass(frozen=True, slots=True)
class Slot:
    """A parameter, as calls see it."""

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
    # The log of a real controller shows "Type error: str_sub takes exact…"; the rest of the text is a guess.
    required = sum(slot.required for slot in slots)
    if required == len(slots):
        count = f"exactly {required}"
    else:
        count = f"at least {required}" if given < required else f"at most {len(slots)}"
    return f"Type error: {name} takes {count} arguments ({given} given)"
