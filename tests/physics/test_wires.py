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


# what each output does, and when each input is high


@pytest.mark.parametrize(
    ("keys", "level", "jammed", "speed", "ticks"),
    [
        ("speed: 0.2", False, False, 0.2, 0),
        ("speed: 0.2, encoder: 0, ticks_per_m: 500", False, False, 0.2, 100),
        ("speed: -0.2, encoder: 0, ticks_per_m: 500", False, False, -0.2, -100),
        ("speed: 0.2, output: 3, encoder: 0, ticks_per_m: 500", False, False, 0.0, 0),
        ("speed: 0.2, output: 3, encoder: 0, ticks_per_m: 500", True, False, 0.2, 100),
        ("speed: 0.2, output: 3, encoder: 0, ticks_per_m: 500", True, True, 0.0, 0),
        ("speed: 0.2, encoder: 0, ticks_per_m: 500", False, True, 0.0, 0),
    ],
)
def test_a_belt_and_its_encoder(cell, keys, level, jammed, speed, ticks):
    here = cell(f"belt: {{box: [1, 0.1, 0.1], pose: [-0.6, 0, 0], conveyor: {{{keys}}}}}")
    here.output(3, level)
    if jammed:
        here.robot.inject_fault("jammed_conveyor", conveyor="belt")
    here.robot.step(2)
    assert here.world.model.geom_surfacevel[here.world.model.geom("belt").id, 0] == speed
    assert [encoder.simulated_speed for encoder in here.controller.encoders] == [ticks, 0.0]


@pytest.mark.parametrize(
    ("at", "high"),
    [(-0.11, False), (-0.09, True), (0.0, True), (0.29, True), (0.31, False)],
)
def test_a_barrier_is_interrupted_between_its_ends_only(cell, at, high):
    here = cell(
        f"part: {{sphere: 0.005, pose: [-0.6, {at}, 0.5]}}",
        more="barriers: {gate: {from: [-0.6, -0.1, 0.5], to: [-0.6, 0.3, 0.5], input: 4}}\n",
    )
    assert here.input(4) is high
    here.controller.signals.digital_inputs |= 1 << 6
    here.robot.step(2)
    assert (here.input(4), here.input(6), here.input(5)) == (high, True, False), "other inputs stay as they are"


@pytest.mark.parametrize(("limits", "far"), [("[-0.01, 0.04]", 0.04), ("[-0.04, 0.01]", -0.04)])
def test_a_button_counts_as_pressed_beyond_half_of_its_stroke(cell, limits, far):
    here = cell(
        f"button: {{box: [0.01, 0.04, 0.04], pose: [-0.6, 0, 0.4], mass: 0.02, "
        f"slide: {{axis: [1, 0, 0], range: {limits}, input: 5}}}}"
    )
    place = here.world.model.joint("button").qposadr[0]
    for share, high in ((0.0, False), (0.47, False), (0.53, True), (0.47, False), (-0.2, False)):
        here.world.data.qpos[place] = share * far
        here.world.data.qvel[:] = 0.0
        here.robot.step(1)
        assert here.input(5) is high, share


@pytest.mark.parametrize(("limits", "far"), [("[0, 0.05]", 0.05), ("[-0.05, 0]", -0.05)])
def test_a_cylinder_travels_to_its_far_end_and_back(cell, limits, far):
    here = cell(
        "rod: {box: [0.1, 0.02, 0.02], pose: [-0.6, 0, 0.2], mass: 0.2, "
        f"slide: {{axis: [1, 0, 0], range: {limits}, output: 1, force: 50, damping: 20}}}}"
    )
    for level, there in ((False, 0.0), (True, far), (False, 0.0)):
        here.output(1, level)
        here.seconds(1.5)
        assert here.position("rod")[0] == pytest.approx(-0.6 + there, abs=0.003)


def test_a_lamp_keeps_its_colour(cell):
    here = cell("lamp: {sphere: 0.02, pose: [-0.6, 0, 0.5], lamp: 7, colour: [0.2, 0.4, 0.8]}")
    colour = here.world.model.geom_rgba[here.world.model.geom("lamp").id]
    for level, share in ((False, 0.25), (True, 1.0), (False, 0.25)):
        here.output(7, level)
        here.robot.step(1)
        assert tuple(colour) == pytest.approx((0.2 * share, 0.4 * share, 0.8 * share, 1.0))


JAWS = "mounted: {jaws: {parallel: {output: 0, holding: 1, closed: 2, stroke: 0.06, speed: 0.1}}}\n"


def test_jaws_close_at_their_speed_and_hold_nothing(cell):
    """Each jaw moves at 0.1 m/s: 60 mm in 0.3 s."""
    here = cell(TABLE, more=JAWS)
    model = here.world.model
    sides = [index for index in range(model.njnt) if model.joint(index).name.endswith(("jaws/left", "jaws/right"))]

    def between():
        return sum(float(here.world.data.qpos[model.joint(index).qposadr[0]]) for index in sides)

    assert between() == pytest.approx(0.06, abs=1e-3)
    here.output(0, True)
    here.seconds(0.15)
    assert between() == pytest.approx(0.03, abs=0.006)
    assert not here.input(2)
    here.until(lambda: here.input(2), within_s=0.4)
    assert between() < 0.002
    here.seconds(0.2)
    assert not here.input(1)
    here.output(0, False)
    here.until(lambda: not here.input(2), within_s=0.1)
    here.seconds(0.5)
    assert between() == pytest.approx(0.06, abs=1e-3)
    assert not here.input(1)
