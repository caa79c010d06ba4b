"""A snapshot has every RTDE output field, in a form that can be encoded."""

from collections.abc import Callable, Iterator
from enum import Enum
from functools import partial
from typing import Any

import pytest

from emulator.io.signals import Registers, Signals
from emulator.robot.installation import Installation, Payload
from emulator.snapshot import Snapshot
from tests.rows import each_row
from urproto.rtde.fields import OUTPUT_FIELDS
from urproto.rtde.recipes import Recipe


@each_row("name", OUTPUT_FIELDS)
def test_every_output_field_can_be_sent(name):
    field = OUTPUT_FIELDS[name]
    recipe = Recipe([field])
    value = field.read(Snapshot())
    (back,) = recipe.unpack(recipe.pack([value]))
    assert back == value


def test_a_live_snapshot_fills_all_fields(ready):
    recipe = Recipe(OUTPUT_FIELDS.values())
    snapshot = ready.tick(3)
    assert recipe.packer()(snapshot) == recipe.pack([field.read(snapshot) for field in recipe.fields])


def test_a_successor_is_a_copy(ready):
    first = ready.now
    second = first.successor()
    assert vars(second) == vars(first)
    second.step += 1
    assert second.step == first.step + 1


def other(value: Any) -> Any:
    """A different value of the same type."""
    match value:
        case Enum():
            return next(member for member in type(value) if member is not value)
        case Payload():
            return Payload(value.mass + 1.0, other(value.cog), other(value.inertia))
        case tuple():
            return tuple(other(item) for item in value)
        case int():
            return value ^ 0x3FFFF  # all signals
        case float():
            return value + 1.0
    return None


def changes(part: Any) -> Iterator[tuple[str, Callable[[], None]]]:
    """Every way to change a part from outside: items of lists, attributes."""
    for name, value in list(vars(part).items()):
        if isinstance(value, list):
            for index, item in enumerate(value):
                yield f"{name}[{index}]", partial(value.__setitem__, index, other(item))
            yield name, partial(setattr, part, name, [other(other(other(item))) for item in value])
        elif name != "_changed" and (changed := other(value)) is not None:
            yield name, partial(setattr, part, name, changed)


@each_row("part", [Signals, Registers, Installation], ids=lambda part: part.__name__)
def test_any_change_is_in_the_next_snapshot(part):
    """Writing only changed values gives the same snapshot as writing all values."""
    part = part()
    pieces = part.banks if isinstance(part, Registers) else (part,)
    snapshot, shown = Snapshot(), set()
    part.publish(snapshot)
    for piece in pieces:
        for name, change in changes(piece):
            change()
            before, snapshot, anew = vars(snapshot), snapshot.successor(), snapshot.successor()
            part.publish(snapshot)
            piece.mark()
            part.publish(anew)
            assert vars(snapshot) == vars(anew), name
            shown |= {field for field, value in before.items() if vars(anew)[field] != value}
    written = Snapshot()
    for piece in pieces:
        piece.mark()
    vars(written).clear()
    part.publish(written)
    assert shown == vars(written).keys()  # so each field was changed at least once


def test_changes_by_a_hook_end_with_the_hook(ready):
    """A hook changes the published values, never the state at the start of the next period."""
    before = ready.now

    def hook(snapshot):
        snapshot.actual_digital_input_bits, snapshot.joint_temperatures = 0x3FFFF, (99.0,) * 6

    ready.controller.snapshot_hooks.append(hook)
    assert ready.tick().joint_temperatures == (99.0,) * 6
    ready.controller.snapshot_hooks.remove(hook)
    after = ready.tick()
    assert after.joint_temperatures == before.joint_temperatures
    assert after.actual_digital_input_bits == before.actual_digital_input_bits


@pytest.mark.emulator_fails
def test_changes_in_an_unpublished_period_are_in_the_next_snapshot(ready):
    def hook(snapshot):
        raise ZeroDivisionError

    ready.controller.snapshot_hooks.append(hook)
    ready.controller.signals.digital_outputs = 1
    ready.controller.registers.output.set_int(3, 7)
    assert ready.tick().actual_digital_output_bits == 0
    ready.controller.snapshot_hooks.remove(hook)
    after = ready.tick()
    assert after.actual_digital_output_bits == 1
    assert after.output_int_registers[3] == 7
