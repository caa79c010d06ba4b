"""Gripping, holding, losing and missing parts follow from the physics of the scene."""

import pytest

TABLE = "table: {box: [1.6, 1.6, 0.1], pose: [0, 0, -0.05], friction: 0.6}"
DOWN = "0, 3.14159, 0"


def part(mass=0.2, friction=0.8, edge=0.04):
    place, material = f"[-0.45, -0.2, {edge / 2 + 0.0001}]", f"mass: {mass}, friction: {friction}"
    return f"part: {{box: [{edge}, {edge}, {edge}], pose: {place}, {material}}}"


def activated(here):
    gripper = here.controller.gripper
    gripper.set("ACT", 1)
    here.until(lambda: gripper.status == 3)
    return gripper


def close(gripper, position=255, force=150):
    for name, value in (("FOR", force), ("POS", position), ("GTO", 1)):
        gripper.set(name, value)


def above(here, height, tip=0.163):
    here.program(f"set_tcp(p[0, 0, {tip}, 0, 0, 0])", f"movel(p[-0.45, -0.2, {height}, {DOWN}], v=0.5)")


def at_the_part(make, *objects, gripper="robotiq-2f-85"):
    here = make(TABLE, *objects, gripper=gripper)
    robotiq = activated(here)
    above(here, 0.2)
    above(here, 0.02)
    return here, robotiq


@pytest.mark.parametrize("gripper", ["robotiq-2f-85", "robotiq-hand-e"])
def test_a_part_is_detected_carried_and_put_down(cell, gripper):
    here, robotiq = at_the_part(cell, part(), gripper=gripper)
    close(robotiq)
    here.until(lambda: robotiq.get("OBJ") == "2")
    assert robotiq.model.width_mm(robotiq.position) == pytest.approx(40.0, abs=1.0)
    above(here, 0.25)
    assert here.position("part")[2] == pytest.approx(0.25, abs=0.005)
    assert here.controller.arm.wrench[2] == pytest.approx(-0.2 * 9.82, rel=0.05)
    above(here, 0.021)
    close(robotiq, position=0)
    here.until(lambda: robotiq.get("OBJ") == "3")
    here.seconds(0.3)
    assert here.position("part") == pytest.approx((-0.45, -0.2, 0.02), abs=0.005)


def test_without_a_part_the_fingers_close_completely(cell):
    here, robotiq = at_the_part(cell, "elsewhere: {box: [0.04, 0.04, 0.04], pose: [0.5, 0, 0.021], mass: 0.2}")
    close(robotiq)
    here.until(lambda: robotiq.get("OBJ") != "0")
    assert robotiq.get("OBJ") == "3"
    assert robotiq.get("POS") == "230"


def test_a_slippery_heavy_part_stays_in_place_and_the_gripper_notices(cell):
    here, robotiq = at_the_part(cell, part(mass=3.0, friction=0.05))
    close(robotiq, force=0)
    here.until(lambda: robotiq.get("OBJ") == "2")
    above(here, 0.25)
    here.until(lambda: robotiq.get("OBJ") == "3")
    assert here.position("part")[2] < 0.05


def test_a_removed_part_is_lost(cell):
    here, robotiq = at_the_part(cell, part())
    close(robotiq)
    here.until(lambda: robotiq.get("OBJ") == "2")
    here.robot.move_object("part", (0.5, 0.5, 0.3, 0, 0, 0))
    here.until(lambda: robotiq.get("OBJ") == "3", within_s=3)


def test_jaws_on_an_output_report_their_grip_by_inputs(cell):
    mounted = "mounted: {jaws: {parallel: {output: 0, holding: 1, closed: 2, stroke: 0.06}}}\n"
    here = cell(TABLE, part(), more=mounted)
    above(here, 0.1, tip=0.11)
    above(here, 0.02, tip=0.11)
    here.output(0, True)
    here.until(lambda: here.input(1))
    assert not here.input(2)
    above(here, 0.1, tip=0.11)
    assert here.position("part")[2] > 0.09
    here.robot.move_object("part", (0.5, 0.5, 0.3, 0, 0, 0))
    here.until(lambda: here.input(2))
    assert not here.input(1)


def test_a_suction_cup_drops_a_part_that_is_too_heavy(cell):
    mounted = "mounted: {cup: {suction: {output: 16, vacuum: 17, force: 20}, pose: [0, 0, 0.1]}}\n"
    here = cell(TABLE, part(mass=1.0), more=mounted)
    above(here, 0.2, tip=0.1)
    here.output(16, True)
    here.seconds(0.2)
    assert not here.input(17)
    here.output(16, False)
    above(here, 0.0405, tip=0.1)
    here.output(16, True)
    here.until(lambda: here.input(17), within_s=1)
    above(here, 0.2, tip=0.1)
    assert here.position("part")[2] == pytest.approx(0.18, abs=0.01)
    here.world.data.xfrc_applied[here.world.model.body("part").id, 2] = -15.0  # an external pull
    here.until(lambda: not here.input(17), within_s=1)
