"""Tracking of a controller by the joints: read from files, and the deviation from the path."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap_ros2.writer import Writer as RosWriter
from recording_rig import BEGAN_NS, controller_state, recording
from rosbags.highlevel import AnyReader

from client.errors import RecordingError
from client.recording import Recorder, Tracking, deviations, read
from client.recording.definitions import message_type
from client.recording.tracking import TrackingBuilder
from urproto.joints import JOINT_NAMES

NAME = "scaled_joint_trajectory_controller"
TIME_S = np.arange(1001) * 0.008
RATE_RAD_S = 0.6
LAG_S = 0.05


def circle(phase):
    """Two joints on a circle, the others at rest."""
    angles = np.zeros((len(phase), 6))
    angles[:, 0], angles[:, 1] = np.cos(phase), np.sin(phase)
    return angles


def tracking(desired, actual, time_s=TIME_S) -> Tracking:
    nothing = np.full_like(desired, np.nan)
    return Tracking("controller", JOINT_NAMES, time_s, desired, actual, nothing, nothing)


@given(st.floats(0.0, 0.5), st.floats(0.0, 0.1))
def test_a_lag_is_not_a_deviation_from_the_path(lag_s: float, off_rad: float) -> None:
    phase = RATE_RAD_S * TIME_S
    actual = circle(np.maximum(phase - RATE_RAD_S * lag_s, 0.0)) * (1.0 + off_rad)
    found = tracking(circle(phase), actual).path_deviation()
    assert found == pytest.approx(np.full(len(TIME_S), off_rad), abs=1e-5)


def test_waiting_on_the_path_is_no_deviation() -> None:
    phase = RATE_RAD_S * np.clip(TIME_S, None, 2.0)  # and 6 s of waiting
    behind = circle(np.clip(RATE_RAD_S * (TIME_S - LAG_S), 0.0, RATE_RAD_S * (2.0 - LAG_S)))
    waits = tracking(circle(phase), behind)
    assert waits.largest_path_deviation < 1e-4
    assert np.max(np.abs(waits.desired_q - waits.actual_q)) > 0.02


def test_there_is_no_path_in_gaps() -> None:
    phase = RATE_RAD_S * TIME_S
    known = np.r_[0:400, 600:1001]  # 1.6 s are missing
    actual = circle(phase)[known]
    chord = (circle(phase)[399] + circle(phase)[600]) / 2.0
    actual[400] = chord  # on the straight line across the gap
    far = np.linalg.norm(circle(phase)[600] - chord)
    assert tracking(circle(phase)[known], actual, TIME_S[known]).path_deviation()[400] == pytest.approx(far, rel=1e-3)


@pytest.mark.parametrize("count", [1, 2])
def test_short_recordings_have_a_path(count: int) -> None:
    few = tracking(circle(TIME_S[:count]), circle(TIME_S[:count]) + 0.1, TIME_S[:count])
    assert few.path_deviation() == pytest.approx([0.1 * math.sqrt(6.0)] * count, rel=0.05)


def test_joints_are_matched_by_name_in_every_message() -> None:
    builder = TrackingBuilder("controller")
    for time_s, order in enumerate(([0, 1, 2, 3, 4, 5], [5, 0, 4, 1, 3, 2])):
        numbers = [float(joint) for joint in order]
        point = {"positions": numbers, "velocities": numbers}
        names = [JOINT_NAMES[joint] for joint in order]
        builder.add(float(time_s), {"joint_names": names, "reference": point, "feedback": point})
    found = builder.build(0.0)
    assert found.joints == JOINT_NAMES
    for columns in (found.desired_q, found.actual_q, found.actual_qd):
        assert columns.tolist() == [[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]] * 2


@pytest.fixture
def recorded(states, tmp_path: Path) -> Path:
    """A robot, and a controller that commands 0.5 rad/s, which the robot follows with a lag of 0.02 rad."""
    file = tmp_path / "run.mcap"
    with Recorder(file, states[0], now_ns=lambda: BEGAN_NS) as recorder:
        for state in states:
            recorder.write(state)
            if state["timestamp"] > states[0]["timestamp"] + 0.5:
                desired = 0.5 * state["timestamp"]
                recorder.write_controller(NAME, controller_state(state["timestamp"], desired - 0.02, desired))
    return file


def test_controllers_are_read_together_with_the_robot(states, recorded: Path) -> None:
    found = read(recorded)
    assert list(found.controllers) == [NAME]  # and not the tracking of the robot's own controller
    wanted = found.tracking()
    assert (wanted.source, wanted.joints) == (NAME, JOINT_NAMES)
    assert wanted.time_s[0] == pytest.approx(0.502, abs=1e-5)
    assert wanted.time_s[-1] == pytest.approx(found.time_s[-1], abs=1e-5)
    assert wanted.desired_q - wanted.actual_q == pytest.approx(0.02)
    assert wanted.desired_qd[1:-1] == pytest.approx(0.5, abs=1e-3)  # by the clock, regardless of the trajectory's time
    assert wanted.actual_qd == pytest.approx(9.0)
    assert [row.largest for row in deviations(found)] == pytest.approx([0.02] * 6)
    assert [row.joint for row in deviations(found)][:2] == ["base", "shoulder"]
    robot = found.tracking("robot")
    assert robot.desired_q.tolist() == [list(state["target_q"]) for state in states]
    with pytest.raises(
        RecordingError, match=f"other is not a controller in the recording: choose one of {NAME}, robot"
    ):
        found.tracking("other")


def test_rosbags_reads_the_controllers_states(recorded: Path) -> None:
    with AnyReader([recorded]) as reader:
        (connection,) = [one for one in reader.connections if one.topic == f"/{NAME}/controller_state"]
        messages = [reader.deserialize(data, connection.msgtype) for _, _, data in reader.messages([connection])]
    assert connection.msgtype == "control_msgs/msg/JointTrajectoryControllerState"
    last = messages[-1]
    assert tuple(last.joint_names) == JOINT_NAMES
    assert last.reference.positions - last.feedback.positions == pytest.approx(0.02)
    assert last.error.positions == pytest.approx(0.02)
    assert last.output.positions.tolist() == last.reference.positions.tolist()


def test_a_recording_without_controllers_shows_the_robots_own_tracking() -> None:
    own = recording(TIME_S, circle(TIME_S), actual_q=circle(TIME_S) + 0.01)
    assert own.tracking().source == "robot"
    assert own.tracking().compared
    measured = recording(TIME_S, circle(TIME_S))
    values = {"timestamp": measured["timestamp"], "actual_q": measured["target_q"]}
    assert not type(measured)(values).tracking().compared


@pytest.mark.parametrize(("desired", "actual"), [("reference", "feedback"), ("desired", "actual")])
def test_bags_of_ros_have_joints_in_any_order_and_older_names(tmp_path: Path, desired: str, actual: str) -> None:
    name = "control_msgs/msg/JointTrajectoryControllerState"
    definition = message_type(name).definition.replace("Point reference", f"Point {desired}")
    definition = definition.replace("Point feedback", f"Point {actual}")
    order = (2, 1, 0, 3, 4, 5)
    with (tmp_path / "bag.mcap").open("wb") as file:
        writer = RosWriter(file)
        joints = writer.register_msgdef(
            "sensor_msgs/msg/JointState", message_type("sensor_msgs/msg/JointState").definition
        )
        states = writer.register_msgdef(name, definition)
        for number in range(20):
            stamp = {"stamp": {"sec": 7, "nanosec": 10_000_000 * number}, "frame_id": ""}
            names, q = [f"left_{JOINT_NAMES[joint]}" for joint in order], [0.1 * joint for joint in order]
            content = {"header": stamp, "name": list(JOINT_NAMES), "position": [0.0] * 6, "velocity": [], "effort": []}
            writer.write_message("/joint_states", joints, content, number, number)
            point = {"positions": q, "velocities": [], "accelerations": [], "effort": []}
            content = {"header": stamp, "joint_names": names, desired: point, actual: point}
            writer.write_message("/left/jtc/controller_state", states, content, number, number)
        writer.finish()
    found = read(tmp_path / "bag.mcap").tracking()
    assert (found.source, found.joints[0]) == ("left/jtc", "left_shoulder_pan_joint")
    assert found.actual_q[3] == pytest.approx([0.1 * joint for joint in range(6)])
    assert found.time_s[:3] == pytest.approx([0.0, 0.01, 0.02])
    assert np.isnan(found.actual_qd).all()
