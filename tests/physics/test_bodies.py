"""Falling, lying, pushed and carried bodies: mechanics that can be calculated manually."""

import math
from pathlib import Path

import pytest

from tests.ticking import ticked

TABLE = "table: {box: [1.6, 1.6, 0.1], pose: [0, 0, -0.05], friction: 0.6}"
PART = "part: {box: [0.04, 0.04, 0.04], pose: [-0.5, 0, 0.0201], mass: 0.2, friction: 0.8}"
G = 9.82  # m/s2, as the controller has it


def test_a_falling_body_conserves_energy(cell):
    here = cell("ball: {sphere: 0.02, pose: [-0.6, 0, 2.0], mass: 0.3}")
    start, v0 = here.position("ball")[2], here.world.velocity("ball")[2]
    here.seconds(0.4)
    fallen, speed = start - here.position("ball")[2], here.world.velocity("ball")[2]
    assert fallen > 0.7
    assert 0.5 * (speed**2 - v0**2) == pytest.approx(G * fallen, rel=0.01)


def test_colliding_bodies_conserve_momentum(cell):
    here = cell(
        "one: {sphere: 0.03, pose: [-0.6, -0.3, 3.0], mass: 0.3, friction: 0}",
        "other: {sphere: 0.03, pose: [-0.6, -0.1, 3.0], mass: 0.1, friction: 0}",
    )
    dof = here.world.model.joint("one").dofadr[0]
    here.world.data.qvel[dof + 1] = 1.0
    here.until(lambda: here.world.velocity("other")[1] > 0.5, within_s=0.5)
    here.seconds(0.05)
    momentum = 0.3 * here.world.velocity("one")[1] + 0.1 * here.world.velocity("other")[1]
    assert momentum == pytest.approx(0.3, rel=1e-3)
    assert here.world.velocity("one")[1] < 0.8


def test_friction_determines_the_sliding_distance(cell):
    here = cell(TABLE, "part: {box: [0.06, 0.06, 0.03], pose: [-0.6, -0.3, 0.0151], mass: 0.2, friction: 0.4}")
    here.seconds(0.2)
    start = here.position("part")[1]
    here.world.data.qvel[here.world.model.joint("part").dofadr[0] + 1] = 1.0
    here.seconds(1.0)
    assert here.position("part")[1] - start == pytest.approx(1.0 / (2.0 * 0.4 * G), rel=0.05)


@pytest.mark.parametrize("arm", ["ideal", "dynamic"])
def test_the_tool_measures_the_weight_of_its_payload(cell, arm):
    here = cell(
        TABLE,
        "part: {box: [0.05, 0.05, 0.05], pose: [-0.45, -0.2, 0.0251], mass: 0.5, friction: 0.8}",
        more="mounted: {cup: {suction: {output: 0, vacuum: 3}, pose: [0, 0, 0.1]}}\n",
        arm=arm,
    )
    here.program(
        "set_tcp(p[0, 0, 0.1, 0, 0, 0])",
        "movel(p[-0.45, -0.2, 0.1, 0, 3.14159, 0], v=0.5)",
        "movel(p[-0.45, -0.2, 0.0505, 0, 3.14159, 0], v=0.05)",
        "set_standard_digital_out(0, True)",
        "while not get_standard_digital_in(3):",
        "  sync()",
        "end",
        "movel(p[-0.45, -0.2, 0.15, 0, 3.14159, 0], v=0.2)",
        "sleep(0.3)",
    )
    assert here.controller.arm.wrench[2] == pytest.approx(-0.5 * G, rel=0.01)
    # accelerated by 2 m/s2, it weighs more: its carrier provides the momentum and the energy
    rising, work, period_s, low = [], 0.0, here.controller.period_s, here.position("part")[2]
    here.start("movel(p[-0.45, -0.2, 0.35, 0, 3.14159, 0], a=2, v=1)")
    while not here.stopped:
        rising.append(here.controller.arm.wrench[2])
        work -= rising[-1] * here.world.velocity("part")[2] * period_s
        here.robot.step(1)
    assert min(rising) == pytest.approx(-0.5 * (G + 2.0), rel=0.1)
    assert work == pytest.approx(0.5 * G * (here.position("part")[2] - low), rel=0.02)
    assert sum(rising) * here.controller.period_s == pytest.approx(
        -0.5 * G * len(rising) * here.controller.period_s, rel=0.03
    )


def test_force_mode_presses_a_part_onto_the_table_with_10_N(cell):
    here = cell(
        TABLE,
        "part: {box: [0.06, 0.06, 0.05], pose: [-0.45, -0.2, 0.0251], mass: 0.5, friction: 0.8}",
        more="mounted: {probe: {sphere: 0.01, pose: [0, 0, 0.1]}}\n",
    )
    here.start(
        "set_tcp(p[0, 0, 0.11, 0, 0, 0])",
        "movel(p[-0.45, -0.2, 0.1, 0, 3.14159, 0], v=0.5)",
        "zero_ftsensor()",
        "force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,-10,0,0,0], 2, [0.1,0.1,0.1,1,1,1])",
        "sleep(3)",
        "textmsg(1)",
        "sleep(1)",
    )
    here.seconds(5.0)
    assert here.controller.arm.tcp_force[2] == pytest.approx(10.0, abs=0.2)
    assert here.controller.arm.tcp_pose[2] == pytest.approx(0.05, abs=0.002)
    assert here.controller.safety.mode.name == "NORMAL"


def test_driving_into_a_wall_is_a_collision(cell):
    here = cell(TABLE, "wall: {box: [0.02, 1, 1], pose: [-0.7, 0, 0.5]}")
    here.start("movel(p[-0.5, -0.2, 0.3, 0, 3.14159, 0], v=0.5)", "movel(p[-0.8, -0.2, 0.3, 0, 3.14159, 0], v=0.2)")
    here.until(lambda: here.controller.safety.mode.name == "PROTECTIVE_STOP")
    assert -0.7 < here.controller.arm.tcp_pose[0] < -0.6


def test_runs_and_resumed_saved_states_are_bit_identical(cell):
    objects = [
        TABLE,
        *(f"p{i}: {{box: [0.03, 0.03, 0.03], pose: [-0.5, 0.02, {0.02 + 0.04 * i}], mass: 0.1}}" for i in range(5)),
    ]
    one, other = cell(*objects), cell(*objects)
    for here in (one, other):
        here.seconds(0.5)
    assert one.world.save() == other.world.save()
    saved = one.robot.save()
    one.seconds(0.5)
    later = one.world.poses()
    other.robot.restore(saved)
    other.robot.step(1)  # in which the arm reaches its set position
    other.seconds(0.5)
    assert other.world.poses() == later


def test_bodies_of_the_arm_come_after_all_others(cell):
    """Links, flange, mounted tool: forces on them are found by their index."""
    mounted = "mounted: {jaws: {parallel: {output: 0, stroke: 0.06}}, probe: {sphere: 0.01, pose: [0, 0, 0.1]}}\n"
    here = cell(TABLE, PART, more=mounted)
    model = here.world.model
    names = [model.body(i).name for i in range(model.nbody)]
    first = names.index("ur/shoulder")
    assert [name for name in names if name.startswith("ur/")] == names[first:]
    assert names[first : first + 6] == [
        "ur/shoulder",
        "ur/upper_arm",
        "ur/forearm",
        "ur/wrist_1",
        "ur/wrist_2",
        "ur/flange",
    ]
    assert all(model.body_rootid[i] == first + 5 for i in range(first + 5, model.nbody))


def test_an_arm_without_contact_transmits_no_force(cell):
    here = cell(TABLE, PART)
    here.program("movel(p[-0.3, -0.4, 0.3, 0, 3.14159, 0], v=0.5)")
    assert here.controller.arm.wrench == (0.0,) * 6
    assert here.controller.arm.link_torque == (0.0,) * 6
    assert math.dist(here.position("part"), (-0.5, 0, 0.02)) < 1e-3


@pytest.mark.parametrize("value", [math.nan, 1e9])
def test_diverging_physics_stops_the_robot_with_a_message(cell, value, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    here = cell(TABLE, PART)
    here.seconds(0.1)
    texts = []
    here.start("movel(p[-0.3, -0.4, 0.3, 0, 3.14159, 0], v=0.5)")
    here.controller.registers.output.set_bit(3, True)
    here.world.data.qvel[here.world.model.joint("part").dofadr[0]] = value
    for _ in range(20):
        texts += [getattr(message, "text", "") for message in ticked(here.controller).messages]
    assert here.controller.safety.mode.name == "PROTECTIVE_STOP"
    assert any("the physics of cell.yaml became unstable" in text for text in texts)
    assert here.controller.registers.output.get_bit(3)
    assert here.position("part") == pytest.approx((-0.5, 0, 0.0201))
    here.robot.reset_world()
    here.seconds(0.5)
    assert not here.world.failure
    assert here.position("part")[2] == pytest.approx(0.02, abs=1e-4)
    assert not Path("MUJOCO_LOG.TXT").exists()
