"""Programs that track frames of the world model."""

import pytest

from emulator.lifecycle.safety import SafetyEvent
from urproto.modes import RuntimeState, SafetyMode

PART = 'add_frame("part", p[0.4, -0.2, 0.1, 0, 0, 0])\n'
TRACK = PART + 'frame_tracking_enable("part")\n'
# 0.05 m/s along base y, set in each period of 2 ms
DRIFT = """thread drift():
  while True:
    move_frame("part", p[0, 0.0001, 0, 0, 0, 0], "part")
    sync()
  end
end
"""


def y(rig):
    return rig.controller.snapshot.actual_TCP_pose[1]


def test_moves_are_relative_to_a_frame_moved_by_a_thread(rig):
    rig.run(
        DRIFT
        + TRACK
        + """p0 = get_target_tcp_pose()
        goal = pose_add(p0, p[0.05, 0, 0.03, 0, 0, 0])
        before = get_pose("part", "base")
        handle = run drift()
        sleep(1.2)
        movel(goal, a=1, v=0.2)
        seen = pose_trans(get_pose("part", "base"), pose_trans(pose_inv(before), goal))
        textmsg(point_dist(get_target_tcp_pose(), seen) < 2e-4)
        textmsg(point_dist(get_target_waypoint(), goal) < 1e-6)
        textmsg(point_dist(get_target_tcp_pose_along_path(), goal) < 1e-6)
        speed = get_target_tcp_speed()
        textmsg(norm(speed[1] - 0.05) < 1e-4)
        kill handle
        frame_tracking_disable()
        movel(p0)
        textmsg(point_dist(get_target_tcp_pose(), p0) < 1e-6)"""
    )
    assert rig.texts == ["True"] * 5
    assert rig.controller.safety.mode is SafetyMode.NORMAL


def test_a_frame_follows_its_parent(rig):
    start = y(rig)
    rig.run(
        PART
        + """add_frame("table", p[0, 0, 0, 0, 0, 0])
        attach_frame("part", "table")
        frame_tracking_enable("part")
        move_frame("table", p[0, 0.1, 0, 0, 0, 0])
        sleep(2)
        frame_tracking_disable()"""
    )
    assert y(rig) == pytest.approx(start + 0.1, abs=1e-6)


def test_moving_the_base_keeps_the_tool_in_place_in_the_world(rig):
    start = y(rig)
    rig.run('frame_tracking_enable("world")\nmove_frame("base", p[0, 0.1, 0, 0, 0, 0], "world")\nsleep(2)')
    assert y(rig) == pytest.approx(start - 0.1, abs=1e-6)


@pytest.mark.parametrize("frame", ["flange", "tcp", "part"])
def test_frames_attached_to_the_arm_cannot_be_tracked(rig, frame):
    problem = rig.fault(PART + f'attach_frame("part", "tcp")\nframe_tracking_enable("{frame}")')
    assert f'the frame "{frame}" moves with the arm itself' in problem


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        ('frame_tracking_enable("nowhere")', 'there is no frame "nowhere"'),
        (
            TRACK + 'frame_tracking_enable("part")',
            "a frame is already being tracked: call frame_tracking_disable() first",
        ),
    ],
)
def test_invalid_calls_end_the_program(rig, body, problem):
    assert problem in rig.fault(body)


def test_disabling_without_enabling_only_stops_the_arm(rig):
    rig.run("frame_tracking_disable()")
    assert rig.controller.motion.idle


def test_a_secondary_program_cannot_track(rig):
    rig.submit('sec s():\n  frame_tracking_enable("base")\nend\n')
    rig.tick(5)
    assert "a secondary program cannot control the robot" in rig.keys[-1][1]


@pytest.mark.parametrize(
    ("loss", "problem"),
    [
        ('delete_frame("part")', 'there is no frame "part"'),
        ("reset_world_model()", 'there is no frame "part"'),
        ('attach_frame("part", "flange")', 'the frame "part" moves with the arm itself'),
    ],
)
def test_a_lost_frame_stops_the_arm_and_ends_the_program_at_its_next_move(rig, loss, problem):
    rig.start(TRACK + f"sleep(0.1)\n{loss}\nsleep(1)\nmovej(get_actual_joint_positions())")
    rig.until(lambda: rig.controller.safety.mode is SafetyMode.PROTECTIVE_STOP)
    assert rig.controller.motion.fault is not None
    assert problem in rig.controller.motion.fault.text
    rig.seconds(6.0)
    assert rig.controller.safety_event(SafetyEvent.UNLOCK)
    assert rig.controller.programs.resume()
    rig.until(lambda: rig.state is RuntimeState.STOPPED)
    assert "frame tracking ended: C204A5" in rig.exceptions[-1].text


def test_the_end_of_a_program_ends_tracking_and_leaves_the_frame(rig):
    rig.run(TRACK + "sleep(0.1)")
    at = y(rig)
    rig.run('move_frame("part", p[0, 0.3, 0, 0, 0, 0])\nsleep(1)')
    assert y(rig) == at
    assert rig.value('is_frame("part")') is True


def test_pause_and_resume_catch_up(rig):
    start = y(rig)
    rig.start(DRIFT + TRACK + 'run drift()\nsleep(1)\nmove_frame("part", p[0, 0.01, 0, 0, 0, 0], "part")\nsleep(5)')
    rig.seconds(1.0)
    rig.controller.programs.pause("test")
    rig.seconds(0.5)
    at = y(rig)
    rig.seconds(0.5)
    assert y(rig) == at  # its thread is paused as well
    rig.controller.programs.resume()
    rig.seconds(2.0)
    assert y(rig) > start + 0.05 * 2.8
    assert rig.exceptions == []


def test_frame_tracking_does_not_exist_on_cb3(cb3):
    cb3.start('frame_tracking_enable("base")')
    cb3.tick(5)
    assert "compile_error_name_not_found:frame_tracking_enable:" in cb3.exceptions[-1].text
