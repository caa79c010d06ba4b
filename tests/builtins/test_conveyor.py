"""Programs that track conveyors, read encoders and offset their path."""

import pytest

from emulator.lifecycle.safety import SafetyEvent
from emulator.motion.superposition import OffsetSettings
from tests.rows import each_row
from urproto.modes import RuntimeState, SafetyMode

SETUP = "encoder_enable_pulse_decode(0, 1, 8, 9)\nsleep(0.5)\n"
TRACK = SETUP + "track_conveyor_linear(p[0, 1, 0, 0, 0, 0], 1000)\n"


@pytest.fixture
def belt(rig):
    """A UR5e next to a conveyor at 100 ticks/s, with 1000 ticks/m: 0.1 m/s."""
    rig.controller.encoders[0].simulated_speed = 100.0
    return rig


def y(rig):
    return rig.controller.snapshot.actual_TCP_pose[1]


def test_the_arm_tracks_during_sleep_and_poses_are_absolute_afterwards(belt):
    start = y(belt)
    belt.run(TRACK + "sleep(2)\nstop_conveyor_tracking()\nglobal here = get_actual_tcp_pose()\nsleep(0.1)")
    assert y(belt) == pytest.approx(start + 0.2, abs=4e-3)
    assert belt.controller.motion.idle


def test_path_and_target_differ_by_the_conveyor_travel(belt):
    belt.run(
        "p0 = get_target_tcp_pose()\n"
        + TRACK
        + """movel(pose_add(p0, p[0.05, 0, 0.03, 0, 0, 0]), a=1, v=0.2)
        textmsg(point_dist(get_target_waypoint(), pose_add(p0, p[0.05, 0, 0.03, 0, 0, 0])) < 1e-6)
        textmsg(point_dist(get_target_tcp_pose_along_path(), pose_add(p0, p[0.05, 0, 0.03, 0, 0, 0])) < 1e-6)
        sleep(1)
        speed = get_target_tcp_speed()
        textmsg(norm(speed[1] - 0.1) < 0.002)
        textmsg(norm(get_target_tcp_speed_along_path()) < 1e-9)
        before = encoder_get_tick_count(0)
        q = get_target_tcp_pose()
        sleep(1)
        moved = get_target_tcp_pose()
        ticks = encoder_unwind_delta_tick_count(0, encoder_get_tick_count(0) - before)
        textmsg(norm((moved[1] - q[1]) * 1000 - ticks) < 0.5)
        stop_conveyor_tracking(a=15)
        movel(p0)
        textmsg(point_dist(get_target_tcp_pose(), p0) < 1e-6)"""
    )
    assert belt.texts == ["True"] * 6
    assert belt.controller.safety.mode is SafetyMode.NORMAL


def test_tracking_a_turntable_rotates_the_tool(belt):
    belt.run(
        SETUP
        + """center = get_target_tcp_pose()
        track_conveyor_circular(p[center[0], center[1], center[2], 0, 0, 0], 1000, True)
        sleep(1)
        now = get_target_tcp_pose()
        textmsg(point_dist(now, center) < 1e-6)
        turn = pose_sub(now, center)
        textmsg(norm(turn[5] - 0.1 * 2 * 3.14159) < 0.04)
        stop_conveyor_tracking()"""
    )
    assert belt.texts == ["True"] * 2


def test_the_end_of_a_program_ends_tracking(belt):
    belt.run(TRACK + "sleep(1)")
    at = y(belt)
    belt.seconds(1.0)
    assert y(belt) == at
    belt.run("movej(get_actual_joint_positions())")
    assert y(belt) == pytest.approx(at, abs=1e-9)


def test_pause_and_resume_catch_up_with_the_conveyor(belt):
    start = y(belt)
    belt.start(TRACK + "sleep(4)\nstop_conveyor_tracking()")
    belt.seconds(1.5)
    belt.controller.programs.pause()
    belt.until(lambda: belt.state is RuntimeState.PAUSED, 1.0)
    held = y(belt)
    belt.seconds(1.0)
    assert y(belt) == held
    belt.controller.programs.resume()
    belt.seconds(2.0)
    moved = (belt.controller.snapshot.encoder0_raw - 50) / 1000
    assert y(belt) - start == pytest.approx(moved, abs=2e-3)
    belt.until(lambda: belt.state is RuntimeState.STOPPED)
    assert belt.exceptions == []


def test_a_protective_stop_holds_the_arm_until_it_is_released(belt):
    belt.start(TRACK + "sleep(4)\nstop_conveyor_tracking()")
    belt.seconds(1.5)
    belt.controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
    belt.seconds(0.3)
    held = y(belt)
    belt.seconds(1.0)
    assert y(belt) == held


def test_a_conveyor_out_of_reach_causes_a_protective_stop(belt):
    belt.start(SETUP + "track_conveyor_linear(p[-1, 0, 0, 0, 0, 0], 500)\nsleep(20)")
    belt.until(lambda: belt.controller.safety.mode is SafetyMode.PROTECTIVE_STOP, 15.0)


def test_a_program_resumed_after_losing_tracking_does_not_move_the_arm(belt):
    belt.start(
        SETUP + "track_conveyor_linear(p[-1, 0, 0, 0, 0, 0], 500)\nsleep(8)\nmovej([0, -1.5, 1.5, -1.6, -1.57, 0])"
    )
    belt.until(lambda: belt.controller.safety.mode is SafetyMode.PROTECTIVE_STOP, 15.0)
    belt.seconds(6.0)
    stopped = belt.q
    assert belt.controller.safety_event(SafetyEvent.UNLOCK)
    assert belt.controller.programs.resume()
    belt.until(lambda: belt.state is RuntimeState.STOPPED)
    assert "path offset, conveyor or frame tracking ended: C" in belt.exceptions[-1].text
    assert belt.q == stopped
    belt.run("movej([0, -1.5, 1.5, -1.6, -1.57, 0])")


def test_an_absolute_encoder_is_fed_by_the_program(rig):
    start = y(rig)
    rig.run(
        """
        thread feeder():
          count = 65000
          while True:
            encoder_set_tick_count(1, count % 65536)
            count = count + 1
            sync()
          end
        end
        encoder_enable_set_tick_count(1, 2)
        t = run feeder()
        sleep(0.5)
        track_conveyor_linear(p[0, 1, 0, 0, 0, 0], 5000, 1)
        sleep(2)
        stop_conveyor_tracking()
        kill t
        textmsg(encoder_get_tick_count(1, "raw"))
        """
    )
    assert y(rig) == pytest.approx(start + 0.2, abs=4e-3)
    assert 66200 < int(rig.texts[0]) < 66300


def test_the_old_names_address_encoder_0(cb3):
    cb3.controller.encoders[0].simulated_speed = 200.0
    cb3.run(
        """
        conveyor_pulse_decode(1, 0, 1)
        sleep(1)
        textmsg(norm(get_conveyor_tick_count() - 200) < 3)
        set_conveyor_tick_count(250, 1)
        set_conveyor_tick_count(4, 1)
        sleep(1)
        textmsg(get_conveyor_tick_count())
        textmsg(encoder_get_tick_count(0))
        """
    )
    assert cb3.texts == ["True", "4", "4"]


@each_row(
    ("call", "complaint"),
    [
        ("encoder_enable_pulse_decode(2, 1, 8, 9)", "there is no encoder 2"),
        ("encoder_enable_pulse_decode(0, 5, 8, 9)", "the decoder type must be 0 to 4, not 5"),
        ("encoder_enable_pulse_decode(0, 1, 8, 12)", "A and B must be digital inputs"),
        ("encoder_enable_pulse_decode(0, 1, 8)", "needs two inputs"),
        ("encoder_enable_set_tick_count(0, 7)", "there is no encoder range 7"),
        ("encoder_set_tick_count(0, 1)", "does not expect counts"),
        ("encoder_get_tick_count(-1)", "there is no encoder -1"),
        ('encoder_get_tick_count(0, "rough")', "opt must be"),
        ("set_conveyor_tick_count(1.5)", "must be a whole number"),
        ("track_conveyor_linear(p[0, 0, 0, 1, 0, 0], 1000)", "direction must not be zero"),
        ("track_conveyor_linear(p[1, 0, 0, 0, 0, 0], 0)", "finite and other than 0"),
        ("track_conveyor_circular(p[1, 0, 0, 0, 0, 0], 100, False, 3)", "there is no encoder 3"),
        (TRACK + "track_conveyor_linear(p[1, 0, 0, 0, 0, 0], 1000)", "already being tracked"),
        ("stop_conveyor_tracking(0)", "a must be greater than 0"),
        ("path_offset_set(p[0, 0, 0, 0, 0, 0], 5)", "type must be 1"),
        ("path_offset_get(0)", "type must be 1"),
        ("path_offset_set_alpha_filter(1.5)", "alpha must be 0 to 1"),
        ("path_offset_set_max_offset(-1, 0)", "must be 0 or more"),
        ("path_offset_disable(0)", "a must be greater than 0"),
    ],
)
def test_invalid_calls_end_the_program_with_their_reason(rig, call, complaint):
    assert complaint in rig.fault(call)


def test_encoder_pins_depend_on_the_series(cb3):
    assert "0, 1, 2, 3, not 8 and 9" in cb3.fault("encoder_enable_pulse_decode(0, 1, 8, 9)")


def test_unwinding_without_a_configured_encoder_returns_nothing(rig):
    assert rig.value("encoder_unwind_delta_tick_count(0, 5)") is None


def test_a_secondary_program_neither_tracks_nor_offsets(rig):
    for call in ("track_conveyor_linear(p[1, 0, 0, 0, 0, 0], 1000)", "path_offset_enable()"):
        rig.submit(f"sec prog():\n  {call}\nend\n")
        rig.tick(5)
        assert "a secondary program cannot control the robot" in rig.keys[-1][1]
    assert rig.controller.motion.idle


def test_weaving_as_in_the_manual(rig):
    """A 2 Hz wave of 5 mm about z from a thread, on top of a line."""
    heights = []
    rig.start(
        """
        thread weave():
          x = 0
          while True:
            path_offset_set([0, 0, 0.005 * (cos(x) - 1), 0, 0, 0], 1)
            x = x + 4 * 3.14159 / 500
            sync()
          end
        end
        path_offset_enable()
        t = run weave()
        movel(pose_add(get_target_tcp_pose(), p[0, 0.2, 0, 0, 0, 0]), a=1, v=0.1)
        textmsg(point_dist(get_target_tcp_pose_along_path(), get_target_tcp_pose()) < 0.0101)
        kill t
        path_offset_disable()
        textmsg(norm(path_offset_get(1)) < 1e-12)
        """
    )
    start = rig.controller.snapshot.actual_TCP_pose
    rig.until(lambda: rig.state is RuntimeState.PLAYING)
    while rig.state is not RuntimeState.STOPPED:
        rig.tick()
        heights.append(rig.controller.snapshot.actual_TCP_pose[2])
    assert rig.exceptions == []
    assert rig.texts == ["True", "True"]
    assert min(heights) == pytest.approx(start[2] - 0.01, abs=1e-5)
    assert max(heights) == pytest.approx(start[2], abs=1e-5)
    assert y(rig) == pytest.approx(start[1] + 0.2, abs=1e-4)


def test_path_offset_settings_survive_disabling_and_end_with_the_program(rig):
    rig.start(
        """
        path_offset_set_alpha_filter(0.05)
        path_offset_set_max_offset(0.003, 0.2)
        path_offset_enable()
        path_offset_disable()
        path_offset_enable()
        path_offset_set(p[0.02, 0, 0, 0, 0, 0], 1)
        sleep(1)
        global applied = path_offset_get(1)
        sleep(1)
        """
    )
    rig.until(lambda: "applied" in rig.controller.programs.variables)
    applied = rig.controller.programs.variables["applied"]
    assert list(applied) == pytest.approx([0.003, 0, 0, 0, 0, 0])
    rig.until(lambda: rig.state is RuntimeState.STOPPED)
    assert rig.controller.motion.superposition.settings == OffsetSettings()


def test_path_offsets_do_not_exist_on_cb3(cb3):
    cb3.start("path_offset_enable()")
    cb3.until(lambda: bool(cb3.exceptions), 1.0)
    assert "path_offset_enable" in cb3.exceptions[-1].text
