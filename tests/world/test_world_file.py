"""World files, and the command line that reads them."""

from pathlib import Path

import pytest
import yaml

from emulator.config import ConfigError, read_surroundings
from emulator.world.file import read_world
from emulator.world.shapes import Box, Plane, Sphere, WorldObject
from emulator.world.world import POINT
from tests.rows import each_row
from urproto.robots import load_model
from urproto.worldfile import WorldFileError

EXAMPLE = """
tool: {sphere: 0.005, pose: [0, 0, 0.01]}
links: true
objects:
  table: {plane: {}, pose: [0, 0, -0.02], stiffness: 30000, damping: 100, friction: 0.3}
  block: {box: [0.1, 0.2, 0.3], pose: [0.3, 0.1, 0.0, 0, 0, 1.5]}
  ball: {sphere: 0.04}
"""


def written(tmp_path, text):
    path = tmp_path / "world.yaml"
    path.write_text(text)
    return path


def test_a_file_with_every_setting(tmp_path):
    plan = read_world(written(tmp_path, EXAMPLE))
    assert plan.tool == WorldObject(Sphere(0.005), (0, 0, 0.01, 0, 0, 0))
    assert plan.links
    assert dict(plan.objects) == {
        "table": WorldObject(Plane(), (0, 0, -0.02, 0, 0, 0), 30000, 100, 0.3),
        "block": WorldObject(Box((0.1, 0.2, 0.3)), (0.3, 0.1, 0, 0, 0, 1.5)),
        "ball": WorldObject(Sphere(0.04)),
    }


def test_each_controller_gets_a_separate_world(tmp_path):
    plan = read_world(written(tmp_path, EXAMPLE))
    one, other = plan.build(load_model("ur3"), 0.008), plan.build(load_model("ur3"), 0.008)
    one.remove("ball")
    assert set(other.objects) == {"table", "block", "ball"}


def test_an_empty_file_is_an_empty_world(tmp_path):
    plan = read_world(written(tmp_path, ""))
    assert not plan.objects
    assert plan.tool == POINT


def test_the_example_file_is_valid():
    with open("examples/table.yaml", encoding="utf-8") as file:
        names = set(yaml.safe_load(file)["objects"])
    plan = read_surroundings(Path("examples/table.yaml"))
    assert plan is not None
    assert set(plan.objects) == names


@each_row(
    ("text", "message"),
    [
        ("a: [", "not YAML"),
        ("[1, 2]", "it must be a mapping, not a list"),
        ("object: {}", "unknown 'object'; allowed are tool, links, objects"),
        ("links: 1", "links must be true or false"),
        ("objects: [1]", "objects must be a mapping"),
        ("objects: {a: {}}", "a must have exactly one of plane, box, sphere"),
        ("objects: {a: {plane: {}, sphere: 1}}", "a must have exactly one"),
        ("objects: {a: {plane: {}, color: red}}", "a has 'color'"),
        ("objects: {a: {plane: 3}}", "a: plane must be a mapping, not a whole number"),
        ("objects: {a: {box: [1, 2]}}", "a: box must be a list of length 3, not 2"),
        ("objects: {a: {box: [1, 2, -3]}}", "a: a box's size"),
        ("objects: {a: {sphere: big}}", "a: sphere must be a number"),
        ("objects: {a: {sphere: 0}}", "without a radius"),
        ("objects: {a: {plane: {}, pose: [1, 2]}}", "a: pose must be x, y, z"),
        ("objects: {a: {plane: {}, pose: [1, 2, .nan]}}", "objects.a.pose.2. must be a finite number"),
        ("objects: {a: {plane: {}, stiffness: soft}}", "a: stiffness must be a number"),
        ("objects: {a: {plane: {}, friction: -1}}", "a: the friction"),
        ("tool: {plane: {}}", "cannot be a tool"),
        ("tool: {sphere: 0.1, friction: 1}", "tool has 'friction'"),
        ("objects: {" + ", ".join(f"o{i}: {{plane: {{}}}}" for i in range(33)) + "}", "at most 32"),
    ],
)
def test_errors_name_the_file_and_the_place(tmp_path, text, message):
    path = written(tmp_path, text)
    with pytest.raises(WorldFileError, match=message) as caught:
        read_world(path)
    assert str(path) in str(caught.value)
    with pytest.raises(ConfigError):
        read_surroundings(path)


def test_a_missing_file(tmp_path):
    with pytest.raises(ConfigError, match="cannot read"):
        read_surroundings(tmp_path / "none.yaml")


def test_without_a_file_there_is_no_world():
    assert read_surroundings(None) is None
