"""A snapshot has every RTDE output field, in a form that field can carry."""

import pytest

from emulator.snapshot import Snapshot
from urproto.rtde.fields import OUTPUT_FIELDS
from urproto.rtde.recipes import Recipe


@pytest.mark.parametrize("name", OUTPUT_FIELDS)
def test_every_output_field_can_be_sent(name):
    field = OUTPUT_FIELDS[name]
    recipe = Recipe([field])
    value = field.read(Snapshot())
    (back,) = recipe.unpack(recipe.pack([value]))
    assert back == value


def test_a_live_snapshot_fills_all_fields_at_once(ready):
    recipe = Recipe(OUTPUT_FIELDS.values())
    snapshot = ready.tick(3)
    assert recipe.packer()(snapshot) == recipe.pack([field.read(snapshot) for field in recipe.fields])


def test_a_successor_is_a_copy(ready):
    first = ready.now
    second = first.successor()
    assert vars(second) == vars(first)
    second.step += 1
    assert second.step == first.step + 1
