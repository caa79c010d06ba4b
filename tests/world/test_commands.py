"""Changes of the world by a user while the controller runs."""

import pytest

from emulator.controller import Controller
from emulator.machine import ControllerConfig
from emulator.world.shapes import Frame, Plane, Push, Sphere, WorldObject
from emulator.world.world import MAX_OBJECTS, POINT
from tests.commands import AddObject, MountTool, MoveObject, PushTool, ReleaseTool, RemoveObject
from tests.rows import each_row
from urproto.robots import load_model

PUSH = (5.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def test_a_push_acts_until_it_is_released(rig):
    assert rig.post(PushTool(Push(PUSH))) == ""
    rig.seconds(1.0)
    assert rig.force == PUSH
    assert rig.post(ReleaseTool()) == ""
    assert rig.force == (0.0,) * 6
    assert "no push of the tool is named 'hand'" in rig.post(ReleaseTool())


def test_a_push_of_a_quarter_second_lasts_a_quarter_second(rig):
    push = PushTool(Push(PUSH, duration_s=0.25))
    rig.post(push)
    assert rig.until(lambda: rig.force == (0.0,) * 6, 1.0) == pytest.approx(0.25, abs=rig.controller.period_s)
    rig.post(push)
    assert rig.force == PUSH  # the same command again pushes again


def test_a_push_in_the_tool_frame_rotates_with_the_tool(rig):
    rig.post(PushTool(Push((0.0, 0.0, 7.0, 0.0, 0.0, 0.0), Frame.TOOL)))
    assert rig.force[:3] == pytest.approx((0, 0, -7))  # the tool points down


def test_pushes_of_different_names_add_up(rig):
    rig.post(PushTool(Push(PUSH), "left"))
    rig.post(PushTool(Push((-5.0, 2.0, 0.0, 0.0, 0.0, 0.0)), "right"))
    assert rig.force == (0.0, 2.0, 0.0, 0.0, 0.0, 1.0)


def test_the_number_of_pushes_is_limited(rig):
    for number in range(MAX_OBJECTS):
        assert rig.post(PushTool(Push(PUSH), f"hand {number}")) == ""
    assert "release one" in rig.post(PushTool(Push(PUSH), "one more"))
    assert rig.post(PushTool(Push((0.0,) * 6), "hand 0")) == ""
    assert rig.force[0] == pytest.approx(5.0 * (MAX_OBJECTS - 1))


def test_world_forces_are_added_to_a_sensor_over_rtde(rig):
    sensor = rig.controller.ft_input
    sensor.enabled, sensor.wrench_flange = True, (0.0, 0.0, -3.0, 0.0, 0.0, 0.0)
    rig.post(PushTool(Push((0.0, 0.0, 4.0, 0.0, 0.0, 0.0))))
    assert rig.force[2] == pytest.approx(7.0)


def test_objects_are_added_moved_and_removed(rig):
    x, y, z, *_ = rig.pose
    obj = WorldObject(Plane(), (x, y, z + 0.001, 0, 0, 0), stiffness=1e4)
    assert rig.post(AddObject("table", obj)) == ""
    assert rig.force[2] == pytest.approx(10)
    assert rig.post(MoveObject("table", (x, y, z + 0.002, 0.0, 0.0, 0.0))) == ""
    assert rig.force[2] == pytest.approx(20)
    assert "already" in rig.post(AddObject("table", obj))
    assert rig.post(RemoveObject("table")) == ""
    assert rig.force[2] == 0.0
    assert "there is no object 'table'" in rig.post(RemoveObject("table"))
    assert "there is no object 'table'" in rig.post(MoveObject("table", (0.0,) * 6))


def test_an_invalid_pose_leaves_the_object_in_place(rig):
    table = rig.table()
    assert "pose" in rig.post(MoveObject("table", (0.0, 0.0, float("nan"), 0.0, 0.0, 0.0)))
    assert rig.world.objects["table"] == table


def test_changing_the_tool_and_changing_back(rig):
    rig.table(0.01, stiffness=1e4)
    assert rig.post(MountTool(WorldObject(Sphere(0.011)))) == ""
    assert rig.force[2] == pytest.approx(10)
    assert "cannot be a tool" in rig.post(MountTool(WorldObject(Plane())))
    assert rig.post(MountTool(POINT)) == ""
    assert rig.force[2] == 0.0


def test_the_first_command_creates_the_world():
    controller = Controller(ControllerConfig(model=load_model("ur3"), running=True))
    assert controller.world is None
    controller.post(PushTool(Push(PUSH)))
    controller.tick()
    assert controller.world is not None
    assert controller.arm.tcp_force == PUSH


@each_row(
    ("wrong", "message"),
    [
        (lambda: Push((1.0, 2.0, 3.0)), "six"),
        (lambda: Push((float("nan"),) * 6), "finite"),
        (lambda: Push(PUSH, duration_s=0.0), "longer"),
        (lambda: Push(PUSH, duration_s=float("inf")), "longer"),
    ],
)
def test_invalid_pushes(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong()
