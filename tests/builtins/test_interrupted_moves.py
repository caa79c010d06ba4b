"""Programs with interrupted, replaced or mixed moves."""

import pytest

from emulator.lifecycle.power import PowerEvent
from emulator.lifecycle.safety import SafetyEvent
from urproto.modes import RuntimeState, SafetyMode

HOME = (0.0, -1.5, 1.5, -1.6, -1.57, 0.0)
PUSH_DOWN = "force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,-20,0,0,0], 2, [0.1,0.1,0.1,0.3,0.3,0.3])"


@pytest.mark.parametrize("event", [SafetyEvent.PROTECTIVE_STOP, SafetyEvent.ROBOT_EMERGENCY_STOP])
def test_a_stop_between_two_programs_leaves_the_second_paused(rig, event):
    """The second waits until the sockets of the first are closed; the stop comes in this gap."""
    rig.start('socket_open("10.0.0.1", 50001)\nsleep(5)', "first")
    rig.seconds(0.1)
    rig.start("movej([1, -1.5, 1.5, -1.6, -1.57, 0])", "second")
    rig.controller.safety_event(event)
    rig.seconds(1.0)
    assert rig.state is RuntimeState.PAUSED
    assert rig.q == pytest.approx(HOME, abs=1e-9)
    assert any("second waits: " in line for line in rig.controller.messages.history)


@pytest.mark.parametrize(
    ("stream", "stop", "end"),
    [
        ("servoj([0.001 * i, -1.5, 1.5, -1.6, -1.57, 0], t=0.002)", "sleep(2)", (0.599, *HOME[1:])),
        ("speedj([0.2, 0, 0, 0, 0, 0], a=1, t=0.002)", "stopj(2)", None),
        ("speedl([0, 0.05, 0, 0, 0, 0], a=1, t=0.002)", "stopl(2)", None),
        ("servoc(pose_add(p0, p[0, 0.0001 * i, 0, 0, 0, 0]), a=1, v=0.2, r=0.05)", "sleep(1)", None),
    ],
)
def test_a_stream_continues_from_where_force_mode_left_the_arm(rig, stream, stop, end):
    rig.run(
        f"""
        p0 = get_actual_tcp_pose()
        {PUSH_DOWN}
        i = 0
        while i < 600:
          if i == 300:
            end_force_mode()
          end
          {stream}
          i = i + 1
        end
        {stop}
        """
    )
    assert rig.controller.safety.mode is SafetyMode.NORMAL
    if end is not None:
        assert rig.q == pytest.approx(end, abs=1e-6)


def test_reentering_force_mode_during_a_move_continues_from_the_current_pose(rig):
    rig.run(
        f"""
        thread mover():
          movel(pose_add(get_actual_tcp_pose(), p[0, 0.1, 0, 0, 0, 0]), a=1, v=0.05)
        end
        mover_id = run mover()
        {PUSH_DOWN}
        sleep(0.7)
        end_force_mode()
        sleep(0.1)
        {PUSH_DOWN}
        sleep(0.5)
        end_force_mode()
        join mover_id
        """
    )
    assert rig.controller.safety.mode is SafetyMode.NORMAL


def test_switching_off_in_force_mode_leaves_the_arm_where_it_is(rig):
    rig.start(f"{PUSH_DOWN}\nsleep(10)")
    rig.seconds(1.0)
    rig.controller.power_event(PowerEvent.POWER_OFF)
    rig.seconds(0.1)  # the brakes bring it to rest
    stood = rig.q
    rig.controller.power_event(PowerEvent.POWER_ON)
    rig.controller.power_event(PowerEvent.BRAKE_RELEASE)
    rig.until(lambda: rig.controller.power.running)
    rig.tick(5)
    assert rig.controller.safety.mode is SafetyMode.NORMAL
    assert rig.q == stood


def test_a_fault_in_force_mode_ends_the_program(rig):
    rig.start(f"{PUSH_DOWN}\nsleep(10)")
    rig.seconds(1.0)
    rig.controller.safety_event(SafetyEvent.FAULT)
    rig.until(lambda: rig.state is RuntimeState.STOPPED, 1.0)


def test_a_program_paused_by_an_emergency_stop_can_be_stopped_with_the_arm_off(rig):
    rig.start("movej([1, -1.5, 1.5, -1.6, -1.57, 0])")
    rig.seconds(0.5)
    rig.controller.safety_event(SafetyEvent.ROBOT_EMERGENCY_STOP)
    rig.seconds(1.0)
    assert not rig.controller.power.running
    rig.controller.programs.stop()
    rig.until(lambda: rig.state is RuntimeState.STOPPED, 0.1)


@pytest.mark.parametrize(("first", "second"), [("movel", "movel"), ("movel", "movep"), ("movep", "movep")])
def test_the_tcp_may_be_set_between_blended_moves(rig, first, second):
    rig.run(
        f"""
        corner = pose_add(get_actual_tcp_pose(), p[0.05, 0.1, 0, 0, 0, 0])
        {first}(corner, a=1, v=0.2, r=0.03)
        set_tcp(p[0, 0.05, 0.1, 0, 0.3, 0])
        goal = pose_add(corner, p[0.05, 0, 0.05, 0, 0, 0.1])
        {second}(goal, a=1, v=0.2)
        textmsg(pose_dist(get_actual_tcp_pose(), goal) < 1e-6)
        """
    )
    assert rig.texts == ["True"]


def test_servoc_uses_the_tcp_at_the_time_of_the_call(rig):
    rig.run(
        """
        goal = pose_add(get_actual_tcp_pose(), p[0, 0.1, 0, 0, 0, 0])
        servoc(goal, a=1, v=0.2, r=0.05)
        set_tcp(p[0, 0, 0.1, 0, 0, 0])
        servoc(goal, a=1, v=0.2)
        textmsg(pose_dist(get_actual_tcp_pose(), goal) < 1e-6)
        """
    )
    assert rig.texts == ["True"]


@pytest.mark.parametrize("leave", ["end_force_mode()", "halt"])
def test_entering_and_leaving_force_mode_in_motion_never_jerks_the_arm(rig, leave):
    """A direction initially keeps its speed when it becomes compliant, and when it stops being compliant."""
    rig.start(
        f"""
        p0 = get_actual_tcp_pose()
        movel(pose_add(p0, p[0, 0.05, -0.1, 0, 0, 0]), a=0.5, v=0.2, r=0.05)
        {PUSH_DOWN}
        sleep(0.05)
        {leave}
        sleep(2)
        """
    )
    rig.tick(3)
    worst = 0.0
    while rig.state is not RuntimeState.STOPPED:
        rig.tick()
        worst = max(worst, *(abs(qdd) for qdd in rig.controller.snapshot.target_qdd))
    assert worst < 20.0  # rad/s2; dropping the tool's speed within a period takes several hundred


@pytest.mark.parametrize("event", [SafetyEvent.PROTECTIVE_STOP, SafetyEvent.FAULT])
def test_a_stop_ends_the_motion_of_force_mode_quickly(rig, event):
    rig.start(f"{PUSH_DOWN}\nsleep(10)")
    rig.seconds(1.0)
    rig.controller.safety_event(event)
    rig.seconds(0.5)
    assert rig.controller.snapshot.target_qd == (0.0,) * 6
    assert rig.state in (RuntimeState.PAUSED, RuntimeState.STOPPED)


@pytest.mark.parametrize("call", ["speedj([1, 0, 0, 0, 0, 0], -1, 0.5)", "speedl([0, 0.1, 0, 0, 0, 0], -1, 0.5)"])
def test_a_negative_acceleration_is_an_error(rig, call):
    assert "a must be 0 or more" in rig.fault(call)
    assert rig.q == pytest.approx(HOME, abs=1e-9)


@pytest.mark.parametrize("stop", ["stopj(0.2)", "stopl(0.02)"])
@pytest.mark.parametrize("event", [SafetyEvent.PROTECTIVE_STOP, SafetyEvent.ROBOT_EMERGENCY_STOP, SafetyEvent.FAULT])
def test_a_safety_stop_does_not_wait_for_a_programs_gentle_stop(rig, stop, event):
    rig.start(f"speedj([0.8, 0, 0, 0, 0, 0], 4, 0.5)\n{stop}\nstopped = True\nsleep(1)")
    rig.seconds(0.8)
    assert max(rig.controller.snapshot.target_qd) > 0.5
    rig.controller.safety_event(event)
    rig.seconds(0.1)
    assert rig.controller.snapshot.target_qd == (0.0,) * 6
    if event is SafetyEvent.PROTECTIVE_STOP:
        rig.controller.safety_event(SafetyEvent.UNLOCK)
        rig.controller.programs.resume()
        rig.seconds(0.2)
        assert max(rig.controller.snapshot.target_qd) > 0.5  # the stop continues where it was held
        rig.until(lambda: "stopped" in rig.controller.programs.variables, 60.0)
        assert rig.controller.snapshot.target_qd == (0.0,) * 6


def test_stopping_a_program_does_not_wait_for_its_gentle_stop(rig):
    rig.start("speedj([0.8, 0, 0, 0, 0, 0], 4, 0.5)\nstopj(0.2)")
    rig.seconds(0.8)
    rig.controller.programs.stop()
    rig.until(lambda: rig.state is RuntimeState.STOPPED, 0.2)
