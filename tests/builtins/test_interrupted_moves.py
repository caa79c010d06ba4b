"""Programs whose movements are interrupted, replaced or mixed: what must survive, and what must not happen."""

import pytest

from emulator.safety import SafetyEvent
from urproto.modes import RuntimeState

HOME = (0.0, -1.5, 1.5, -1.6, -1.57, 0.0)
PUSH_DOWN = "force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,-20,0,0,0], 2, [0.1,0.1,0.1,0.3,0.3,0.3])"


@pytest.mark.parametrize("event", [SafetyEvent.PROTECTIVE_STOP, SafetyEvent.ROBOT_EMERGENCY_STOP])
def test_a_stop_between_two_programs_keeps_the_second_from_starting(rig, event):
    """The second waits for the first one's sockets to be gone; the stop comes in that gap."""
    rig.start('socket_open("10.0.0.1", 50001)\nsleep(5)', "first")
    rig.seconds(0.1)
    rig.start("movej([1, -1.5, 1.5, -1.6, -1.57, 0])", "second")
    rig.controller.safety_event(event)
    rig.seconds(1.0)
    assert rig.state is not RuntimeState.PLAYING
    assert rig.q == pytest.approx(HOME, abs=1e-9)
    assert "second was not started" in rig.texts[-1]


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
