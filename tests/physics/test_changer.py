"""Tools that an arm picks up by a tool changer, uses, and puts back."""

import math

import pytest

G = 9.82
DOWN = "0, 3.14159265, 0"
TABLE = "table: {box: [1.6, 1.6, 0.1], pose: [0, 0, -0.05], friction: 0.6}"
PROBE = (
    "probe: {box: [0.06, 0.06, 0.1], pose: [-0.45, -0.2, 0.0501], mass: 1.0, coupling: [0, 0, 0.05, 0, 3.14159265, 0]}"
)
RACK = [f"post{x}: {{box: [0.02, 0.06, 0.1], pose: [{-0.45 + x}, 0.1, 0.05]}}" for x in (-0.05, 0.05)]
HEAD = (
    "head: {box: [0.12, 0.06, 0.04], pose: [-0.45, 0.1, 0.1201], mass: 0.5, coupling: [0, 0, 0.02, 0, 3.14159265, 0]}"
)
PART = "part: {box: [0.05, 0.05, 0.03], pose: [-0.3, -0.35, 0.0151], mass: 0.3}"
CHANGER = "mounted:\n  changer: {changer: {output: 4, locked: 5}, pose: [0, 0, 0.05]}\n"
CUP = "  cup: {suction: {output: 0, vacuum: 2}, pose: [0, 0, -0.06, 0, 3.14159265, 0], tool: head}\n"
TOP = 0.1001  # position of the probe in its stand [m]


def go(here, x, y, z):
    """Move the changer's face to a position, pointing down."""
    here.program("set_tcp(p[0, 0, 0.05, 0, 0, 0])", f"movel(p[{x}, {y}, {z}, {DOWN}], v=0.5)")
    here.seconds(0.2)  # the spring of the flange comes to rest


def take(here, x, y, top):
    go(here, x, y, top + 0.1)
    go(here, x, y, top + 0.0005)
    here.output(4, True)
    here.until(lambda: here.input(5), within_s=1)


def test_a_tool_is_picked_up_weighed_and_put_back(cell):
    here = cell(TABLE, PROBE, more=CHANGER)
    take(here, -0.45, -0.2, TOP)
    go(here, -0.45, -0.2, 0.4)
    assert here.controller.arm.wrench[2] == pytest.approx(-1.0 * G, rel=0.01)
    assert here.position("probe")[2] == pytest.approx(0.35, abs=5e-4)
    here.program("movel(p[-0.3, -0.4, 0.3, 0.6, 2.8, 0.3], v=1.0, a=3)")
    face = here.controller.arm.tcp_pose[:3]
    assert math.dist(face, here.position("probe")) == pytest.approx(0.05, abs=5e-4)
    go(here, -0.45, -0.2, TOP)
    here.output(4, False)
    here.seconds(0.1)
    assert not here.input(5)
    go(here, -0.45, -0.2, 0.3)
    assert here.position("probe") == pytest.approx((-0.45, -0.2, 0.05), abs=2e-3)
    assert here.controller.arm.wrench == (0.0,) * 6


def test_a_changer_takes_only_a_tool_present_when_it_locks(cell):
    here = cell(TABLE, PROBE, more=CHANGER)
    go(here, -0.45, -0.2, TOP + 0.01)
    here.output(4, True)
    here.seconds(0.1)
    assert not here.input(5)
    go(here, -0.45, -0.2, TOP + 0.0005)  # already locked, the balls are out
    assert not here.input(5)
    here.output(4, False)
    here.seconds(0.05)
    here.output(4, True)
    here.until(lambda: here.input(5), within_s=1)


def test_a_gripper_on_a_tool_works_while_mounted(cell):
    here = cell(TABLE, *RACK, HEAD, PART, more=CHANGER + CUP)
    take(here, -0.45, 0.1, 0.1401)
    go(here, -0.45, 0.1, 0.3)
    go(here, -0.3, -0.35, 0.03 + 0.08 + 0.05)
    go(here, -0.3, -0.35, 0.03 + 0.08 + 0.0005)
    here.output(0, True)
    here.until(lambda: here.input(2), within_s=1)
    go(here, -0.3, -0.35, 0.4)
    assert here.controller.arm.wrench[2] == pytest.approx(-0.8 * G, rel=0.02)
    assert here.position("part")[2] == pytest.approx(0.4 - 0.08 - 0.015, abs=3e-3)


def test_a_removed_tool_is_not_held_and_a_saved_one_is(cell):
    here = cell(TABLE, PROBE, more=CHANGER)
    take(here, -0.45, -0.2, TOP)
    go(here, -0.45, -0.2, 0.4)
    saved = here.robot.save()
    fault = here.robot.inject_fault("missing_part", part="probe")
    here.seconds(0.1)
    assert not here.input(5)
    here.robot.clear_fault(fault)
    here.seconds(0.05)
    here.robot.restore(saved)
    here.seconds(0.1)
    assert here.input(5)
    here.robot.move_object("probe", (0.5, 0.5, 0.0501, 0, 0, 0))
    here.seconds(0.2)
    assert not here.input(5)
    assert here.position("probe") == pytest.approx((0.5, 0.5, 0.05), abs=1e-3)
    assert not here.world.failure
    assert here.controller.safety.mode.name == "NORMAL"
