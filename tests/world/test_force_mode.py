"""Force mode and freedrive against solid objects, as in the Script Manual, in virtual time."""

from math import pi

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.world.shapes import Box, Plane, Push, Sphere, WorldObject
from tests.budget import examples
from tests.commands import PushTool, ReleaseTool
from urproto.modes import ControlMode

CLOSE_N = 0.1
LIMITS = "[0.2, 0.2, 0.2, 1, 1, 1]"
BASE = "p[0, 0, 0, 0, 0, 0]"
both_series = pytest.mark.parametrize("model", ["ur3", "ur5e"])


def settles(rig, newton, within_s=10.0):
    """The force along base z reaches this value within CLOSE_N, and stays for a second."""
    rig.seconds(within_s)
    for _ in range(round(1.0 / rig.controller.period_s)):
        rig.tick()
        assert rig.force[2] == pytest.approx(newton, abs=CLOSE_N)
    assert not rig.complaints


@both_series
@pytest.mark.parametrize(("damping", "gain"), [(0.0, 0.5), (0.0, 2.0), (0.005, 1.0), (1.0, 0.5), (1.0, 2.0)])
@pytest.mark.parametrize("stiffness", [1e4, pytest.param(1e5, marks=pytest.mark.long)])
def test_pressing_on_a_plane_with_10_N_settles_at_10_N(make, model, damping, gain, stiffness):
    rig = make(model)
    rig.table(0.002, stiffness=stiffness)
    rig.press(10.0, damping=damping, gain=gain)
    settles(rig, 10.0, 3.0 if damping < 1.0 else 6.0)


@both_series
def test_every_type_of_force_mode_reaches_its_force(make, model):
    """Tool frame, and types 1 (towards a point), 2 (as it is) and 3 (along the motion)."""
    rig = make(model)
    rig.table(0.002)
    x, y, z, *_ = rig.pose
    ways = {
        "tool": f"force_mode(tool_pose(), [0, 0, 1, 0, 0, 0], [0, 0, 10, 0, 0, 0], 2, {LIMITS})",
        "point": f"force_mode(p[{x}, {y}, {z - 0.2}, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 10, 0, 0, 0, 0], 1, {LIMITS})",
        "frame": f"force_mode({BASE}, [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], 2, {LIMITS})",
        "motion": f"force_mode({BASE}, [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], 3, {LIMITS})",
    }
    for way, call in ways.items():
        move = "movel(pose_add(get_actual_tcp_pose(), p[0, 0.02, 0, 0, 0, 0]), v=0.05)" if way == "motion" else ""
        rig.program(call, move, "sleep(30)")
        rig.until(lambda: rig.motion.control_mode is ControlMode.FORCE)
        settles(rig, 10.0, 3.0)
        rig.controller.programs.stop("next")
        rig.until(lambda: rig.motion.idle)
        rig.world.move("table", (x, y, rig.pose[2] - 0.0001, 0, 0, 0))
        rig.tick()


@pytest.mark.long
@settings(max_examples=examples(15))
@given(
    st.sampled_from(["ur3", "ur3", "ur5e"]),
    st.floats(3.5, 5.0).map(lambda e: 10**e),
    st.floats(0.0, 1000.0),
    st.floats(0.0, 0.2),
    st.floats(0.5, 2.0),
    st.floats(0.02, 0.5),
    st.floats(5.0, 40.0),
)
def test_force_mode_settles_for_any_material_and_settings(
    make, model, stiffness, table_damping, damping, gain, limit, newton
):
    rig = make(model)
    rig.table(0.002, stiffness=stiffness, damping=table_damping)
    rig.press(newton, limit=limit, damping=damping, gain=gain)
    settles(rig, newton, 5.0)


@both_series
def test_a_flat_tool_aligns_with_the_surface(make, model):
    """Compliant about x and y, it is rotated by its corners until all four carry the same load."""
    rig = make(model)
    x, y, z, *_ = rig.pose
    rig.world.mount(WorldObject(Box((0.06, 0.06, 0.02))))
    rig.world.add("slope", WorldObject(Plane(), (x, y, z - 0.02, 0.05, 0.03, 0.0)))
    rig.press(10.0, (0, 0, 1, 1, 1, 0))
    settles(rig, 10.0, 5.0)
    depths = [contact.depth for contact in rig.world.contacts if contact.depth > 0]
    assert len(depths) == 4
    assert max(depths) == pytest.approx(min(depths), rel=0.02)


@both_series
def test_pressing_and_sliding_keeps_the_force(make, model):
    """A movement along a slope under force: the compliant axis yields as the surface rises."""
    rig = make(model)
    x, y, z, *_ = rig.pose
    rig.world.add("slope", WorldObject(Plane(), (x, y, z, 0.1, 0.0, 0.0)))
    rig.press(10.0, damping=0.05)
    rig.seconds(2.0)
    rig.motion.commands.movel((x, y + 0.06, z, *rig.pose[3:]), v=0.02, a=0.5)
    rig.seconds(2.0)
    assert rig.motion.qd != (0.0,) * 6
    assert rig.force[2] == pytest.approx(10.0, abs=0.8)  # friction of the force loop against the climb: 0.6 N
    settles(rig, 10.0, 3.0)
    assert rig.pose[2] == pytest.approx(z + 0.06 * 0.1, abs=1e-3)


@both_series
def test_speed_limits_apply_in_free_motion_and_in_contact(make, model):
    rig = make(model)
    rig.table(0.01)
    rig.press(50.0, limit=0.02)
    speeds = []
    for _ in range(round(3.0 / rig.controller.period_s)):
        rig.tick()
        speeds.append(abs(rig.controller.arm.tcp_speed[2]))
    assert max(speeds) <= 0.02 * (1 + 1e-6)
    settles(rig, 50.0, 1.0)


def test_position_control_against_a_table_presses_harder_and_harder(rig):
    """No force mode: the table's stiffness determines the force, until a joint current deviates from the model by its
    limit."""
    rig.table(0.002, stiffness=5e4)
    x, y, z, *turn = rig.pose
    rig.motion.commands.movel((x, y, z - 0.02, *turn), v=0.01, a=1.0)
    ratios = []
    for _ in range(round(1.0 / rig.controller.period_s)):
        rig.tick()
        ratios.append(rig.now.collision_detection_ratio)
    assert ratios == sorted(ratios)
    assert ratios[0] == 0.0
    assert ratios[-1] == 1.0


@both_series
def test_a_push_moves_the_arm_in_freedrive_down_to_the_table(make, model):
    rig = make(model)
    table = rig.table(0.01)
    rig.motion.commands.freedrive()
    rig.post(PushTool(Push((0.0, 0.0, -20.0, 0.0, 0.0, 0.0))))
    rig.seconds(4.0)
    assert rig.pose[2] == pytest.approx(table.pose[2] - 20.0 / table.stiffness, abs=1e-5)
    assert rig.force[2] == pytest.approx(0.0, abs=CLOSE_N)  # the hand and the table cancel
    assert rig.post(ReleaseTool()) == ""
    rig.seconds(4.0)
    assert rig.force[2] == 0.0  # the table has pushed it away
    assert 0.0 < rig.pose[2] - table.pose[2] < 0.003
    assert rig.motion.qd == (0.0,) * 6
    assert not rig.complaints


def test_the_tool_slides_off_a_ball(rig):
    """Free in all directions, a tool pressed on a ball slides off it and continues."""
    x, y, z, *_ = rig.pose
    rig.world.mount(WorldObject(Sphere(0.01)))
    rig.world.add("ball", WorldObject(Sphere(0.03), (x + 0.005, y, z - 0.05, 0, 0, 0)))
    rig.press(20.0, (1, 1, 1, 0, 0, 0), damping=0.1)
    rig.until(lambda: rig.pose[2] < z - 0.05)
    assert rig.pose[0] < x - 0.03
    assert rig.pose[1] == pytest.approx(y, abs=1e-6)


def test_screw_driving_presses_along_the_tool(make):
    rig = make("ur5e")
    rig.table(0.003)
    rig.program("screw_driving(30, 0.05)", "sleep(20)")
    settles(rig, 30.0, 5.0)


@both_series
def test_pausing_stops_the_arm_and_resuming_presses_again(make, model):
    rig = make(model)
    rig.table(0.002)
    rig.press(10.0)
    rig.seconds(3.0)
    rig.motion.pause()
    rig.seconds(1.0)
    assert rig.motion.qd == (0.0,) * 6
    assert rig.force[2] == pytest.approx(10.0, abs=CLOSE_N)
    rig.motion.resume()
    settles(rig, 10.0, 1.0)


def test_a_stretched_arm_can_press(make):
    """Straight up, pushing sideways against a wall: the arm cannot leave its singularity, and stays stable."""
    rig = make("ur5e", initial_q=(0.0, -pi / 2, 0.0, -pi / 2, 0.0, 0.0))
    x, y, z, *_ = rig.pose
    rig.world.add("wall", WorldObject(Plane(), (x + 0.01, y, z, 0.0, -pi / 2, 0.0)))
    rig.motion.commands.freedrive()
    rig.post(PushTool(Push((15.0, 0.0, 0.0, 0.0, 0.0, 0.0))))
    rig.seconds(4.0)
    assert rig.force[0] == pytest.approx(0.0, abs=1.0)
    assert not rig.complaints
