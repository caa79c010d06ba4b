"""Valid scenes, and one-line errors for invalid ones."""

import subprocess
import sys

import pytest

from emulator.config import ConfigError, controller_config
from tests.physics.conftest import Cell
from tests.rows import each_row

PART = "box: [0.04, 0.04, 0.04], pose: [-0.5, 0, 0.5]"
MJCF = """<mujoco><worldbody>
  <geom name="floor" type="plane" size="2 2 .1" pos="0 0 -.01"/>
  <body name="part" pos="-.6 0 .3"><freejoint/><geom type="box" size=".02 .02 .02" mass=".1"/></body>
</worldbody></mujoco>"""


@each_row(
    ("text", "message"),
    [
        (f"objects: {{a: {{{PART}, mass: 0}}}}", "a: mass must be a number > 0.0"),
        (f"objects: {{a: {{{PART}, mass: heavy}}}}", "a: mass must be a number, not text"),
        ("objects: {a: {torus: 1}}", "a has 'torus'"),
        (f"objects: {{a: {{{PART}, mass: 1, friction: .nan}}}}", "objects.a.friction must be a finite number"),
        ("objects: {a: {box: [1, 1, 1], pose: [.inf, 0, 0]}}", "objects.a.pose[0] must be a finite number"),
        (f"objects: {{'': {{{PART}}}}}", "an object must have a name"),
        (f"objects: {{a: {{{PART}, conveyor: {{speed: .nan}}}}}}", "objects.a.conveyor.speed must be a finite number"),
        ("barriers: {b: {from: [.nan, 0, 0], to: [0, 0, 1], input: 1}}", "barriers.b.from[0] must be a finite number"),
        ("cameras: {c: {pose: [0, .nan, 1]}}", "cameras.c.pose[1] must be a finite number"),
        ("objects: {a: {box: [0.1, 0, 0.1]}}", "lengths greater than 0"),
        (
            f"objects: {{a: {{{PART}, mass: 1}}, b: {{{PART}, mass: 1}}}}",
            "a and b overlap by 40.0 mm at the start",
        ),
        ("objects: {a: {box: [1, 1, 1], pose: [0, 0, 0.3]}}", "start elsewhere"),
        ("objects: {a: {mesh: none.stl}}", "does not exist"),
        (
            f"objects: {{a: {{{PART}, slide: {{axis: [0, 0, 1], range: [0, 1]}}}}}}",
            "an object with a joint needs a mass",
        ),
        (f"objects: {{a: {{{PART}, mass: 1, slide: {{axis: [0, 0, 0], range: [0, 1]}}}}}}", "axis must not be zero"),
        ("objects: {a: {plane: {}, mass: 1}}", "a plane is infinite"),
        ("barriers: {b: {from: [0, 0, 0], to: [0, 0, 1], input: 18}}", "b: input must be a whole number <= 17"),
        ("scene: other.xml", "cannot read"),
        ("step: 0.01", "step must be a number <= 0.004"),
        ("step: fast", "step must be a number, not text"),
        ("step: .nan", "step must be a finite number"),
        ("step: true", "step must be a number"),
        ("mounted: {m: {}}", "m must have exactly one of"),
        (f"objects: {{a: {{{PART}, coupling: [0, 0, 0]}}}}", "an object with a coupling must be free to move"),
        ("mounted: {m: {suction: {output: 0}, tool: a}}", "m: tool 'a' is not an object with a coupling: none"),
        ("mounted: {m: {changer: {output: 0}, tool: a}}", "m: a tool changer must be on the flange: leave tool out"),
        ("mounted: {m: {changer: {output: 0}, suction: {output: 1}}}", "give parallel, suction or changer"),
        ("cameras: {c: {pose: [0, 0, 1], at: [0, 0, 1]}}", "at is the camera's own position"),
    ],
)
def test_an_invalid_scene_is_a_one_line_error(tmp_path, text, message):
    (scene := tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(ConfigError) as refused:
        controller_config("ur5", world=scene, physics=True)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


@each_row("text", ["<mujoco><worldbody><geom type='egg'/></worldbody></mujoco>", "<mujoco", ""])
def test_an_invalid_mujoco_scene_is_a_one_line_error(tmp_path, text):
    (scene := tmp_path / "bad.xml").write_text(text)
    with pytest.raises(ConfigError, match=r"bad\.xml: \S") as refused:
        controller_config("ur5", world=scene)
    assert "\n" not in str(refused.value)


def test_without_physics_a_world_does_not_move(tmp_path):
    (scene := tmp_path / "cell.yaml").write_text(f"objects: {{a: {{{PART}, mass: 1}}}}")
    with pytest.raises(ConfigError, match="mass of a requires physics: add --physics"):
        controller_config("ur5", world=scene)
    with pytest.raises(ConfigError, match="--physics needs a scene"):
        controller_config("ur5", physics=True)


def test_a_mujoco_scene_surrounds_the_arm_and_can_be_part_of_a_world_file(tmp_path):
    (tmp_path / "scene.xml").write_text(MJCF)
    (tmp_path / "cell.yaml").write_text(
        "scene: scene.xml\nobjects: {ball: {sphere: 0.02, pose: [-0.6, 0.2, 0.3], mass: 1}}"
    )
    here = Cell(tmp_path / "cell.yaml")
    here.seconds(1.0)
    assert here.position("part")[2] == pytest.approx(0.01, abs=1e-3)
    assert here.position("ball")[2] == pytest.approx(0.01, abs=1e-3)
    assert Cell(tmp_path / "scene.xml").robot.objects() == ["part"]


def test_urdf_is_read(tmp_path):
    (tmp_path / "post.urdf").write_text(
        '<robot name="post"><link name="base"><collision><origin xyz="0.6 0 0.5"/>'
        '<geometry><box size="0.1 0.1 1"/></geometry></collision></link></robot>'
    )
    here = Cell(tmp_path / "post.urdf")
    here.seconds(0.1)
    assert not here.world.failure


def test_mujoco_is_loaded_only_for_worlds_with_physics():
    code = "import sys, emulator.app, emulator.config; sys.exit('mujoco' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_scene_objects_can_be_moved_but_not_added_or_removed(tmp_path):
    (scene := tmp_path / "cell.yaml").write_text(
        f"objects: {{a: {{{PART}, mass: 1}}, b: {{box: [0.1, 0.1, 0.1], pose: [-0.5, 0.5, 0]}}}}"
    )
    robot = Cell(scene).robot
    robot.move_object("b", (0.5, 0.5, 0, 0, 0, 0))
    robot.move_object("a", (0.5, 0.5, 0.3, 0, 0, 0))
    robot.step(100)
    assert robot.object_poses()["a"][2] == pytest.approx(0.07, abs=1e-3)
    with pytest.raises(ValueError, match="cannot be added"):
        robot.add_object("c", {"sphere": 0.1})
    with pytest.raises(ValueError, match="cannot be removed"):
        robot.remove_object("a")
    with pytest.raises(ValueError, match="there is no object 'z'; there are: a, b"):
        robot.move_object("z", (0,) * 6)
