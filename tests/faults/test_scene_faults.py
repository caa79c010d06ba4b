"""Faults of a scene: missing or slipping parts, stopped belts, covered cameras."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the extra physics")  # not packaged for Python 3.10

from emulator.physics import open_cameras
from emulator.physics.cameras import CameraError
from emulator.virtual import virtual_robot
from urproto.controlapi import BadArguments, NotPossible

SCENE = """
objects:
  table: {box: [1.6, 1.6, 0.1], pose: [0, 0, -0.05], friction: 0.6}
  belt: {box: [0.2, 0.2, 0.1], pose: [-0.6, 0.3, 0.05], conveyor: {speed: 0.1, encoder: 0, ticks_per_m: 1000}}
  part: {box: [0.04, 0.04, 0.04], pose: [-0.45, -0.15, 0.0201], mass: 0.1, friction: 0.8}
barriers:
  here: {from: [-0.55, -0.15, 0.02], to: [-0.35, -0.15, 0.02], input: 4}
mounted:
  jaws: {parallel: {stroke: 0.06, output: 0, holding: 1, force: 30, speed: 0.1}}
cameras:
  above: {pose: [-0.45, -0.15, 0.6], at: [-0.45, -0.15, 0]}
"""
HOME = (0.0, -1.5, 1.5, -1.5708, -1.5708, 0.0)
GRIP = """def grip():
  set_tcp(p[0, 0, 0.11, 0, 0, 0])
  movel(p[-0.45, -0.15, 0.1, 0, 3.14159, 0], v=0.5)
  movel(p[-0.45, -0.15, 0.02, 0, 3.14159, 0], v=0.2)
  set_standard_digital_out(0, True)
  sleep(1)
end
"""
LIFT = "def lift():\n  movel(p[-0.45, -0.15, 0.15, 0, 3.14159, 0], v=0.2)\nend\n"


@pytest.fixture
def robot(tmp_path: Path):
    (scene := tmp_path / "cell.yaml").write_text(SCENE)
    robot = virtual_robot("ur5", world=scene, physics=True, running=True, initial_q=HOME)
    robot.step(20)
    return robot


def run(robot, script):
    robot.send_script(script)
    robot.step(2)
    robot.run_until("runtime_state == STOPPED")


def lit(robot, number):
    return bool(robot.state(["actual_digital_input_bits"])["actual_digital_input_bits"] >> number & 1)


def height(robot):
    return robot.object_poses()["part"][2]


def test_a_missing_part_is_neither_seen_nor_held_and_returns(robot):
    before = robot.object_poses()["part"]
    assert lit(robot, 4)
    fault = robot.inject_fault("missing_part", part="part")
    robot.step(2)
    assert not lit(robot, 4)
    run(robot, GRIP)
    assert not lit(robot, 1)
    robot.reset_world()  # it cannot be put back meanwhile
    robot.step(3)
    assert height(robot) < -1.0
    robot.set_digital_output(0, False)
    robot.step(60)
    robot.clear_fault(fault)
    robot.step(60)
    assert lit(robot, 4)
    assert robot.object_poses()["part"] == pytest.approx(before, abs=1e-3)


def test_a_part_removed_from_the_fingers_is_lost(robot):
    run(robot, GRIP)
    run(robot, LIFT)
    assert lit(robot, 1)
    robot.inject_fault("missing_part", part="part", lasting=0.5)
    robot.step(50)
    assert not lit(robot, 1)
    robot.step(50)
    assert height(robot) == pytest.approx(0.02, abs=1e-3)  # it is back in its place
    assert robot.controller.safety.mode.name == "NORMAL"


def test_a_slippery_part_stays_on_the_table(robot):
    run(robot, GRIP)
    fault = robot.inject_fault("slippery_part", part="part")
    run(robot, LIFT)
    assert height(robot) < 0.03
    robot.clear_fault(fault)
    model = robot.controller.world.model
    assert model.geom_friction[model.geom("part").id][0] == pytest.approx(0.8)


def test_the_same_part_is_lifted_without_the_fault(robot):
    run(robot, GRIP)
    run(robot, LIFT)
    assert height(robot) > 0.1


def test_a_belt_jams_and_resumes(robot):
    ticks = robot.controller.encoders[0]
    run(robot, "def go():\n  encoder_enable_pulse_decode(0, 1, 0, 1)\nend\n")
    fault = robot.inject_fault("jammed_conveyor", conveyor="belt")
    robot.step(2)
    stands = ticks.raw
    robot.step(60)
    assert ticks.raw == stands
    robot.clear_fault(fault)
    robot.step(60)
    assert ticks.raw > stands


def test_a_camera_is_temporarily_covered(robot):
    robot.inject_fault("covered_camera", camera="above", lasting=0.1)
    robot.step(2)
    assert robot.controller.world.covered == {"above"}
    robot.step(20)
    assert robot.controller.world.covered == set()


def test_a_covered_camera_gives_black_pictures_until_uncovered(robot):
    try:
        cameras = open_cameras(robot.controller.world)
    except CameraError as error:
        pytest.skip(str(error))
    with cameras:
        before = cameras.rgb("above")
        fault = robot.inject_fault("covered_camera", camera="above")
        robot.step(2)
        assert not cameras.rgb("above").any()
        assert not cameras.depth("above").any()
        robot.clear_fault(fault)
        robot.step(2)
        assert np.array_equal(cameras.rgb("above"), before)
        assert before.any()


@pytest.mark.parametrize(
    ("kind", "arguments", "complaint"),
    [
        ("missing_part", {"part": "table"}, "there is no part 'table': choose from part"),
        ("slippery_part", {"part": "none"}, "there is no part 'none'"),
        ("jammed_conveyor", {"conveyor": "part"}, "there is no conveyor 'part': choose from belt"),
        ("covered_camera", {"camera": "wrist"}, "there is no camera 'wrist': choose from above"),
    ],
)
def test_faults_of_unknown_objects_are_refused(robot, kind, arguments, complaint):
    with pytest.raises(NotPossible, match=complaint):
        robot.inject_fault(kind, **arguments)


def test_conflicting_and_out_of_range_scene_faults_are_refused(robot):
    robot.inject_fault("missing_part", part="part")
    with pytest.raises(BadArguments, match="occupies the part part"):
        robot.inject_fault("slippery_part", part="part")
    with pytest.raises(BadArguments, match="<= 1"):
        robot.inject_fault("slippery_part", part="part", friction=2.0)


def test_a_robot_without_a_scene_has_no_scene_faults():
    with pytest.raises(NotPossible, match="no scene with physics"):
        virtual_robot("ur5").inject_fault("missing_part", part="part")
