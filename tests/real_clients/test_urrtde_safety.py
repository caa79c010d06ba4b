"""Watchdog, protective stop, and programs that are stopped, paused and resumed from outside."""

import pytest
from dashboard_client import DashboardClient
from rig import NORMAL, PAUSED, PLAYING, PROTECTIVE_STOP, START_Q, STOPPED, Rig
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface
from track import profile_time

from tests.budget import subset

pytestmark = pytest.mark.robot_speed(4)

both_series = pytest.mark.parametrize("rig", subset(["ur3", "ur3e"], now=["ur3"]), indirect=True)

UNLOCK_AFTER_S = 5.0
FAR_Q = [START_Q[0] + 1.2, *START_Q[1:]]


@both_series
def test_the_watchdog_stops_only_a_program_that_is_not_kicked(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        assert control.setWatchdog(2.0)
        for _ in range(20):
            assert control.kickWatchdog()
            state.wait_for(0.05)
            assert control.isProgramRunning()
        last_kick = state.newest()["timestamp"]
        stopped = state.wait_until(lambda sample: sample["runtime_state"] == STOPPED, timeout_s=5)
    assert 0.4 < stopped["timestamp"] - last_kick < 0.8  # one period of 2 Hz, and the stop
    rig.eventually(lambda: not control.isProgramRunning())
    assert not control.moveJ(FAR_Q)


def test_the_watchdog_stops_arm_and_program(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        assert control.setWatchdog(10.0)
        assert control.speedJ([0.3, 0, 0, 0, 0, 0], 2.0)
        state.wait_until_moving()
        state.wait_until(lambda sample: sample["runtime_state"] == STOPPED, timeout_s=3)
        state.wait_until_still(timeout_s=2)


@both_series
def test_a_protective_stop_is_reported_and_locked_for_five_seconds(
    rig: Rig, control: RTDEControlInterface, receive: RTDEReceiveInterface
) -> None:
    dashboard = DashboardClient(rig.host)
    dashboard.connect()
    with rig.watch() as state:
        control.triggerProtectiveStop()
        stopped = state.wait_until(lambda sample: sample["safety_mode"] == PROTECTIVE_STOP)
        rig.eventually(receive.isProtectiveStopped)
        assert not receive.isEmergencyStopped()
        assert receive.getSafetyMode() == PROTECTIVE_STOP
        assert not control.moveJ(FAR_Q)
        assert dashboard.safetymode() == "Safetymode: PROTECTIVE_STOP"
        with pytest.raises(RuntimeError, match="Cannot unlock protective stop until 5s after occurrence"):
            dashboard.unlockProtectiveStop()
        state.wait_until(lambda sample: sample["timestamp"] > stopped["timestamp"] + UNLOCK_AFTER_S + 0.1)
        dashboard.closeSafetyPopup()
        dashboard.unlockProtectiveStop()
        state.wait_until(lambda sample: sample["safety_mode"] == NORMAL)
    rig.eventually(lambda: not receive.isProtectiveStopped())
    dashboard.disconnect()
    assert control.reuploadScript()
    rig.eventually(control.isProgramRunning)
    assert control.moveJ(FAR_Q, 3.0, 10.0)
    rig.eventually(lambda: receive.getActualQ() == pytest.approx(FAR_Q, abs=1e-5))


def test_protective_stop_brakes_a_moving_arm(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        assert control.moveJ(FAR_Q, 1.0, 4.0, True)
        state.wait_until(lambda sample: sample["target_qd"][0] > 0.99)
        control.triggerProtectiveStop()
        still = state.wait_until_still(timeout_s=2)
        assert state.newest()["safety_mode"] == PROTECTIVE_STOP
        assert still["actual_q"][0] < FAR_Q[0] - 0.1
        assert state.wait_for(0.2)["actual_q"] == still["actual_q"]


@both_series
def test_a_program_continues_after_pause_and_play(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        assert control.moveJ(FAR_Q, 1.0, 4.0, True)
        state.wait_until(lambda sample: sample["target_qd"][0] > 0.99)
        assert rig.process.dashboard("pause") == ["Pausing program"]
        state.wait_until(lambda sample: sample["runtime_state"] == PAUSED)
        still = state.wait_until_still()
        assert START_Q[0] < still["actual_q"][0] < FAR_Q[0]
        assert state.wait_for(0.3)["actual_q"] == still["actual_q"]
        assert rig.process.dashboard("play") == ["Starting program"]
        state.wait_until(lambda sample: sample["runtime_state"] == PLAYING)
        state.wait_until(lambda sample: sample["actual_q"] == pytest.approx(FAR_Q, abs=1e-5))
    rig.eventually(control.isProgramRunning)
    assert control.moveJ(list(START_Q), 3.0, 10.0)


@both_series
def test_reupload_restarts_a_stopped_program(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        assert control.moveJ(FAR_Q, 1.0, 4.0, True)
        state.wait_until(lambda sample: sample["target_qd"][0] > 0.99)
        assert rig.process.dashboard("stop") == ["Stopped"]
        state.wait_until(lambda sample: sample["runtime_state"] == STOPPED)
        still = state.wait_until_still(timeout_s=2)
        assert still["actual_q"][0] < FAR_Q[0] - 0.1
    rig.eventually(lambda: not control.isProgramRunning())
    assert not control.moveJ(FAR_Q)
    assert control.reuploadScript()
    rig.eventually(control.isProgramRunning)
    with rig.watch() as state:
        assert control.moveJ(list(START_Q), 2.0, 8.0)
        track = state.track
    assert track.q[-1] == pytest.approx(START_Q, abs=1e-5)
    assert track.moving_time == pytest.approx(profile_time(still["actual_q"][0] - START_Q[0], 2.0, 8.0), abs=0.03)


def test_an_unreachable_linear_target_causes_a_protective_stop(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        assert not control.moveL([2.0, 0.0, 0.3, 0.0, 3.14, 0.0], 0.25, 1.2)
        state.wait_until(lambda sample: sample["safety_mode"] == PROTECTIVE_STOP)
        assert state.settled()["actual_q"] == pytest.approx(START_Q, abs=1e-5)
