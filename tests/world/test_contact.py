"""Effects of a contact on the tool: springs, dampers, friction, and conservation of energy."""

from math import cos, hypot, sin

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from emulator.world.shapes import Box, Plane, Sphere, WorldObject, contacts, force_of
from tests.budget import examples
from tests.rows import each_row
from urproto.vectors import ZERO6

MASS_KG = 20.0  # of the compliant tool


def move_down(rig, depth_m, speed=0.05):
    """Move a position-controlled arm until it is at rest."""
    goal = (rig.pose[0], rig.pose[1], rig.pose[2] - depth_m, *rig.pose[3:])
    rig.motion.commands.movel(goal, v=speed, a=1.0)
    rig.tick()
    rig.until(lambda: rig.motion.idle)
    rig.tick(2)


@pytest.mark.parametrize("stiffness", [1e3, 1e4])
def test_a_position_controlled_tool_feels_a_spring(rig, stiffness):
    """Hooke's law, at rest: 5 mm above the table, moved 8 mm down."""
    rig.table(0.005, stiffness=stiffness)
    move_down(rig, 0.008)
    assert rig.force == pytest.approx((0, 0, 0.003 * stiffness, 0, 0, 0), rel=1e-6, abs=1e-6)
    assert rig.now.tcp_force_scalar == pytest.approx(0.003 * stiffness)


def test_a_contact_force_shows_in_every_field(make):
    """The force at the TCP, 0.1 m from the flange, its torque about the flange, and the joints' torques."""
    rig = make("ur5e")
    rig.controller.set_tcp((0.1, 0.0, 0.0, 0.0, 0.0, 0.0))
    rig.tick()
    rig.table(0.0, stiffness=1e4)
    move_down(rig, 0.002)
    force, torque = rig.now.actual_TCP_force[:3], rig.now.actual_TCP_force[3:]
    assert force == pytest.approx((0, 0, 20), abs=1e-6)
    lever = [t - f for t, f in zip(rig.pose[:3], rig.controller.arm.flange_pose[:3], strict=True)]
    assert torque == pytest.approx((lever[1] * 20, -lever[0] * 20, 0), abs=1e-6)
    assert hypot(*rig.now.ft_raw_wrench[:3]) == pytest.approx(20, abs=1e-6)
    columns = zip(*rig.controller.arm.kinematics.jacobian(rig.now.actual_q, (0.1, 0, 0, 0, 0, 0)), strict=True)
    carried = [column[2] * 20 for column in columns]
    extra = [a - t for a, t in zip(rig.now.actual_current_as_torque, rig.now.target_moment, strict=True)]
    assert extra == pytest.approx([-part for part in carried], abs=1e-6)
    assert rig.now.collision_detection_ratio > 0.0


def test_a_ball_on_a_plane_touches_with_its_lowest_point(rig):
    rig.world.mount(WorldObject(Sphere(0.02)))
    rig.table(0.02, stiffness=1e4)
    move_down(rig, 0.001)
    assert rig.force == pytest.approx((0, 0, 10, 0, 0, 0), abs=1e-6)


def test_a_tip_off_the_top_of_a_ball_is_pushed_along_the_line_of_centres(rig):
    x, y, z, *_ = rig.pose
    slope = 0.3
    centre = (x - 0.05 * sin(slope), y, z - 0.05 * cos(slope), 0.0, 0.0, 0.0)
    rig.world.add("ball", WorldObject(Sphere(0.051), centre, stiffness=1e4))
    rig.tick()
    assert rig.force[:3] == pytest.approx((10 * sin(slope), 0, 10 * cos(slope)), abs=1e-6)


def test_boxes_that_overlap_at_a_corner_touch_with_one_corner_of_each(rig):
    """Half of the stiffness of a face, and a torque about the TCP."""
    x, y, z, *_ = rig.pose
    rig.world.mount(WorldObject(Box((0.2, 0.2, 0.02))))
    rig.world.add("ledge", WorldObject(Box((0.1, 0.1, 0.1)), (x + 0.12, y + 0.12, z - 0.059, 0, 0, 0), stiffness=4e4))
    rig.tick()
    corners = [contact for contact in rig.world.contacts if contact.depth > 0]
    levers = sorted(contact.lever[:2] for contact in corners)
    assert levers == [pytest.approx((0.07, 0.07)), pytest.approx((0.1, 0.1))]
    assert rig.force == pytest.approx((0, 0, 20, 1.7, -1.7, 0), abs=1e-4)


def test_a_block_smaller_than_the_tool_pushes_the_middle_of_the_tool(rig):
    """None of the tool's corners is on the block, but the block's corners are under the tool."""
    x, y, z, *_ = rig.pose
    rig.world.mount(WorldObject(Box((0.2, 0.2, 0.02))))
    rig.world.add("block", WorldObject(Box((0.04, 0.04, 0.1)), (x, y, z - 0.059, 0, 0, 0), stiffness=1e4))
    rig.tick()
    assert rig.force == pytest.approx((0, 0, 10, 0, 0, 0), abs=1e-4)


@given(
    st.floats(-0.02, 0.05),
    st.floats(10, 1e6),
    st.floats(0, 1e4),
    st.floats(0, 2),
    *[st.floats(-2, 2) for _ in range(3)],
)
def test_a_contact_never_pulls_and_friction_stays_in_its_cone(depth, stiffness, damping, friction, vx, vy, vz):
    (x, y, z), grip = force_of(depth, (0.0, 0.0, 1.0), (stiffness, damping, friction), (vx, vy, vz))
    assert z >= 0.0
    assert hypot(x, y) <= friction * z * (1 + 1e-9) + 1e-300  # where doubles have no precision left
    assert x * vx + y * vy <= 0.0
    assert grip >= 0.0
    if depth <= 0.0:
        assert (x, y, z) == (0.0, 0.0, 0.0)


@each_row(("speed", "push"), [(-0.1, 40.0), (0.0, 20.0), (0.05, 10.0), (0.1, 0.0), (0.2, 0.0)])
def test_a_damper_resists_approach_but_not_separation(speed, push):
    """20 N of the spring; the damper's 200 N s/m increase them on the way in, and never pull on the way out."""
    force, _ = force_of(0.002, (0.0, 0.0, 1.0), (1e4, 200.0, 0.0), (0.0, 0.0, speed))
    assert force == pytest.approx((0.0, 0.0, push))


@pytest.mark.parametrize("ball_is_the_tool", [True, False])
def test_the_force_acts_where_the_ball_is_deepest(ball_is_the_tool):
    """So friction rotates a sliding ball: its lever is the radius, towards the plane or the box."""
    ball = WorldObject(Sphere(0.05), (0.0, 0.0, 0.549, 0.0, 0.0, 0.0))
    block = WorldObject(Box((0.4, 0.4, 1.0)))
    if ball_is_the_tool:
        tcp, tool, obj = ball.pose, ball.at(ZERO6), block
    else:
        tcp, tool, obj = block.pose, block, ball
    touching = [one for one in contacts(tool, [obj], tcp, ZERO6) if one.depth > 0.0]
    assert [one.depth for one in touching] == pytest.approx([0.001])
    where = [t + lever for t, lever in zip(tcp, touching[0].lever, strict=False)]
    assert where == pytest.approx([0.0, 0.0, 0.499])
    assert touching[0].normal == pytest.approx((0.0, 0.0, 1.0 if ball_is_the_tool else -1.0))


def test_coulomb_friction_opposes_sliding(rig):
    """Moved along the table at 0.1 m/s under 30 N: 0.4 of that against the motion."""
    rig.table(0.0, stiffness=1e4, friction=0.4)
    move_down(rig, 0.003)
    x, y, *rest = rig.pose
    rig.motion.commands.movel((x, y + 0.05, *rest), v=0.1, a=1.0)
    rig.seconds(0.3)
    assert rig.force[2] == pytest.approx(30, abs=0.1)
    assert rig.force[1] == pytest.approx(-12, abs=0.1)


def energy(rig, table):
    """Of the compliant tool and the table's spring [J]; along the normal, which is z."""
    depth = max(0.0, table.pose[2] - rig.pose[2])
    return 0.5 * MASS_KG * rig.controller.arm.tcp_speed[2] ** 2 + 0.5 * table.stiffness * depth**2


@settings(max_examples=examples(15))
@given(
    st.sampled_from(["ur3", "ur5e"]),
    st.floats(2.0, 6.0).map(lambda e: 10**e),
    st.floats(0.0, 1000.0),
    st.floats(0.02, 0.5),
    st.floats(0.0, 1.0),
)
@example("ur3", 1e6, 0.0, 0.5, 0.0)
@example("ur5e", 1e5, 0.0, 0.5, 0.0)
def test_a_bounce_creates_no_energy(make, model, stiffness, damping, speed, force_damping):
    """Thrown at a table and released: at any stiffness, the energy after the bounce is no more than before."""
    rig = make(model)
    table = rig.table(0.012, stiffness=stiffness, damping=damping)
    rig.press(1e4, limit=speed, damping=force_damping)
    rig.until(lambda: rig.pose[2] - table.pose[2] < 0.004 + speed * rig.controller.period_s)
    rig.press(0.0, limit=5.0, damping=force_damping)  # only contact and friction from here
    rig.tick()
    before = energy(rig, table)
    for _ in range(round(1.0 / rig.controller.period_s)):
        rig.tick()
        now = energy(rig, table)
        assert now <= before * (1 + 1e-6) + 1e-9
        before = now
    assert not rig.complaints


def test_a_world_out_of_reach_changes_no_output(make):
    """With a world out of reach, every output is the same as without a world."""
    alone, with_world = make(), make()
    with_world.world.add("far", WorldObject(Plane(), (0, 0, -5.0, 0, 0, 0)))
    for rig in (alone, with_world):
        rig.press(20.0)
        rig.seconds(0.5)
        rig.motion.force_control.end()
        rig.motion.commands.movej((0.2, -1.4, 1.4, -1.6, -1.57, 0.1))
        rig.seconds(1.0)
    assert alone.controller.snapshot == with_world.controller.snapshot
