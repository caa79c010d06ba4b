"""Force mode, free driving, and contact that a force sensor reports through RTDE."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from raw_rtde import ForceSensor, Sample
from rig import START_Q, Rig
from rtde_control import RTDEControlInterface

from tests.budget import subset

both_series = pytest.mark.parametrize("rig", subset(["ur3", "ur3e"], now=["ur3"]), indirect=True)
e_series = pytest.mark.parametrize("rig", ["ur3e"], indirect=True)  # ur_rtde's script leaves these out on CB3

BASE = [0.0] * 6
ALONG_Z = [0, 0, 1, 0, 0, 0]
LIMITS = [0.05, 0.05, 0.05, 0.2, 0.2, 0.2]  # of speed along and about compliant axes
NO_FORCE = (0.0, 0.0, 0.0)
PUSH_N = 25.0
# A watchdog ends what has heard nothing of the sensor for 0.1 s, which this makes 0.4 s on a busy machine.
patient = pytest.mark.robot_speed(0.25)


def no_force(_: Sample) -> Sequence[float]:
    return NO_FORCE


def table_at(height: float) -> Callable[[Sample], Sequence[float]]:
    """A surface that pushes the tool up while it is below a height [m]."""
    return lambda sample: (0.0, 0.0, PUSH_N) if sample["actual_TCP_pose"][2] < height else NO_FORCE


@both_series
def test_force_mode_moves_only_along_its_compliant_axis(rig: Rig, control: RTDEControlInterface) -> None:
    assert control.forceModeSetDamping(0.1)
    with rig.watch() as state:
        start = list(state.next()["actual_TCP_pose"])
        assert control.forceMode(BASE, ALONG_Z, [0, 0, 10, 0, 0, 0], 2, LIMITS)
        state.wait_until(lambda sample: sample["actual_TCP_pose"][2] > start[2] + 0.03, timeout_s=10)
        assert control.forceModeStop()
        still = state.wait_until_still(timeout_s=2)
        assert state.wait_for(0.5)["actual_TCP_pose"] == still["actual_TCP_pose"]
        track = state.track
    assert track.off_line(start, [start[0], start[1], start[2] + 1]) < 5e-4
    assert np.abs(track.twist[:, 2]).max() <= LIMITS[2] + 1e-3


@both_series
def test_force_mode_without_a_push_holds_the_arm(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        assert control.forceMode(BASE, [1, 1, 1, 0, 0, 0], [0.0] * 6, 2, LIMITS)
        state.wait_for(0.5)
        assert control.forceModeStop()
        track = state.track
    np.testing.assert_allclose(track.pose, np.tile(track.pose[0], (len(track.t), 1)), atol=1e-4)


def test_teach_mode_starts_and_ends(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        assert control.teachMode()
        state.wait_for(0.3)
        assert not control.isSteady()
        assert control.endTeachMode()
        assert control.moveJ([START_Q[0] + 0.1, *START_Q[1:]], 2.0, 8.0)
        assert state.settled()["actual_q"][0] == pytest.approx(START_Q[0] + 0.1, abs=1e-5)


def test_teach_mode_yields_to_a_push(rig: Rig, control_beside_sensor: RTDEControlInterface) -> None:
    control = control_beside_sensor
    with ForceSensor(rig.host, no_force) as sensor, rig.watch() as state:
        start = state.next()["actual_TCP_pose"]
        assert control.enableExternalFtSensor(True)
        assert control.teachMode()
        state.wait_for(0.2)
        sensor.force_on = lambda _: (0.0, 0.0, PUSH_N)
        state.wait_until(lambda sample: sample["actual_TCP_pose"][2] > start[2] + 0.01)
        sensor.force_on = no_force
        state.wait_until_still(timeout_s=5)
        assert control.endTeachMode()
        assert control.enableExternalFtSensor(False)


@pytest.mark.long
@e_series
def test_freedrive_yields_only_along_its_free_axes(rig: Rig, control_beside_sensor: RTDEControlInterface) -> None:
    control = control_beside_sensor
    with ForceSensor(rig.host, no_force) as sensor, rig.watch() as state:
        start = list(state.next()["actual_TCP_pose"])
        assert control.ftRtdeInputEnable(True)
        assert control.freedriveMode(ALONG_Z, BASE)
        assert control.getFreedriveStatus() == 0
        sensor.force_on = lambda _: (PUSH_N, PUSH_N, PUSH_N)
        state.wait_until(lambda sample: sample["actual_TCP_pose"][2] > start[2] + 0.01)
        sensor.force_on = no_force
        still = state.wait_until_still(timeout_s=5)
        assert control.endFreedriveMode()
        assert control.ftRtdeInputEnable(False)
        track = state.track
    assert track.off_line(start, [start[0], start[1], start[2] + 1]) < 5e-4
    assert track.pose[-1] == pytest.approx(still["actual_TCP_pose"], abs=1e-6)


@e_series
def test_tool_contact(rig: Rig, control_beside_sensor: RTDEControlInterface) -> None:
    control = control_beside_sensor
    with ForceSensor(rig.host, no_force) as sensor, rig.watch() as state:
        assert control.ftRtdeInputEnable(True)
        control.toolContact(BASE)
        state.wait_for(0.1)
        assert control.toolContact(BASE) == 0
        sensor.force_on = lambda _: (0.0, 0.0, PUSH_N)
        state.wait_until(lambda _: control.toolContact(BASE) > 0)
        sensor.force_on = no_force
        state.wait_until(lambda _: control.toolContact(BASE) == 0)
        assert control.ftRtdeInputEnable(False)


@patient
@e_series
def test_move_until_contact_ends_where_the_table_was_touched(
    rig: Rig, control_beside_sensor: RTDEControlInterface
) -> None:
    control = control_beside_sensor
    with rig.watch() as state:
        start = state.next()["actual_TCP_pose"]
        table = start[2] - 0.03
        with ForceSensor(rig.host, table_at(table)):
            assert control.ftRtdeInputEnable(True)
            assert control.moveUntilContact([0, 0, -0.05, 0, 0, 0])
            assert control.ftRtdeInputEnable(False)
        state.wait_until_still()
        track = state.track
    assert track.pose[-1, 2] == pytest.approx(table, abs=0.003)  # sensor and detection take some periods at 0.05 m/s
    assert track.pose[:, 2].min() > table - 0.01
    assert track.off_line(start, [start[0], start[1], start[2] - 1]) < 5e-4


@patient
@e_series
def test_contact_detection_ends_an_asynchronous_move(rig: Rig, control_beside_sensor: RTDEControlInterface) -> None:
    control = control_beside_sensor
    with rig.watch() as state:
        start = list(state.next()["actual_TCP_pose"])
        table = start[2] - 0.03
        with ForceSensor(rig.host, table_at(table)):
            assert control.ftRtdeInputEnable(True)
            assert control.startContactDetection()  # in the direction of motion
            assert control.moveL([start[0], start[1], start[2] - 0.1, *start[3:]], 0.05, 0.5, True)
            assert not control.readContactDetection()
            state.wait_until_moving()  # no calls during the move, over which ur_rtde's script could miss the contact
            state.wait_until_still()
            still = state.wait_for(0.5)
            assert control.readContactDetection()
            assert control.stopContactDetection()
            assert control.ftRtdeInputEnable(False)
        track = state.track
    assert still["actual_TCP_pose"][2] == pytest.approx(table, abs=0.003)
    assert track.pose[:, 2].min() > table - 0.01


@patient
@e_series
def test_a_silent_sensor_pauses_the_program(rig: Rig, control_beside_sensor: RTDEControlInterface) -> None:
    """Without a watchdog in the program, one of 10 Hz guards the sensor and pauses the program."""
    control = control_beside_sensor
    with rig.watch() as state:
        with ForceSensor(rig.host, no_force):
            assert control.ftRtdeInputEnable(True)
            state.wait_for(0.5)
            assert state.newest()["runtime_state"] == 2
        state.wait_until(lambda sample: sample["runtime_state"] == 4, timeout_s=2)
