"""Outputs that act on a scene, and inputs that sense it."""

import pytest

TABLE = "table: {box: [1.6, 1.6, 0.1], pose: [0, 0, -0.05], friction: 0.6}"


def test_a_belt_carries_a_part_through_a_light_barrier_and_counts(cell):
    here = cell(
        "belt: {box: [1, 0.1, 0.1], pose: [-0.6, 0, 0, 0, 0, 1.5708], "
        "conveyor: {speed: 0.2, output: 2, encoder: 1, ticks_per_m: 1000}}",
        "part: {box: [0.03, 0.03, 0.03], pose: [-0.6, -0.3, 0.0651], mass: 0.1}",
        more="barriers: {end: {from: [-0.7, 0.1, 0.065], to: [-0.5, 0.1, 0.065], input: 4}}\n",
    )
    here.start("encoder_enable_pulse_decode(1, 1, 0, 1)", "sleep(60)")
    here.seconds(0.5)
    assert here.position("part")[1] == pytest.approx(-0.3, abs=1e-3)
    here.output(2, True)
    here.seconds(1.0)
    assert here.world.velocity("part")[1] == pytest.approx(0.2, rel=0.02)
    assert not here.input(4)
    here.until(lambda: here.input(4), within_s=2)
    assert here.position("part")[1] == pytest.approx(0.1 - 0.015, abs=0.005)
    travelled = here.position("part")[1] + 0.3
    assert here.controller.encoders[1].raw == pytest.approx(1000 * travelled, rel=0.05)
    here.output(2, False)
    here.seconds(0.2)
    still = here.position("part")[1]
    here.seconds(0.5)
    assert here.position("part")[1] == pytest.approx(still, abs=1e-4)


def test_a_cylinder_pushes_a_button_and_a_spring_returns_it(cell):
    here = cell(
        "rod: {box: [0.1, 0.02, 0.02], pose: [-0.6, 0, 0.2], mass: 0.2, "
        "slide: {axis: [1, 0, 0], range: [0, 0.05], output: 1, force: 50, damping: 20}}",
        "button: {box: [0.01, 0.04, 0.04], pose: [-0.53, 0, 0.2], mass: 0.02, "
        "slide: {axis: [1, 0, 0], range: [-0.001, 0.03], stiffness: 100, input: 5}}",
    )
    here.seconds(0.2)
    assert not here.input(5)
    here.output(1, True)
    here.until(lambda: here.input(5), within_s=2)
    here.seconds(0.5)
    assert here.position("rod")[0] == pytest.approx(-0.55, abs=0.005)
    here.output(1, False)
    here.until(lambda: not here.input(5), within_s=2)


def test_a_door_turns_about_its_edge_when_the_arm_pushes_it(cell):
    here = cell(
        TABLE,
        "door: {box: [0.02, 0.4, 0.4], pose: [-0.6, -0.2, 0.3], mass: 1, "
        "hinge: {axis: [0, 0, 1], at: [0, -0.2, 0], range: [0, 1.5], input: 6}}",
        more="mounted: {probe: {sphere: 0.01, pose: [0, 0, 0.1]}}\n",
    )
    here.program(
        "movel(p[-0.4, -0.05, 0.3, 0, 3.14159, 0], v=0.5)", "movel(p[-0.65, -0.05, 0.3, 0, 3.14159, 0], v=0.2)"
    )
    assert here.controller.safety.mode.name == "NORMAL"
    angle = float(here.world.data.qpos[here.world.model.joint("door").qposadr[0]])
    assert angle > 0.2
    assert here.position("door")[0] < -0.63


def test_a_lamp_is_lit_while_its_output_is_high(cell):
    here = cell("lamp: {sphere: 0.02, pose: [-0.6, 0, 0.5], lamp: 7, colour: [1, 0, 0]}")
    geom = here.world.model.geom("lamp").id
    assert here.world.model.geom_rgba[geom][0] == pytest.approx(0.25)
    here.output(7, True)
    here.robot.step(1)
    assert here.world.model.geom_rgba[geom][0] == pytest.approx(1.0)
