"""Recording files are read back by our readers and by independent ones."""

import csv
import sys
import zipfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer as RosWriter
from recording_rig import BEGAN_NS, INFO, array, moving_states, record
from rosbags.highlevel import AnyReader

from client.errors import MissingExtraError, RecordingError
from client.recording import DEFAULT_FIELDS, Recorder, convert, read
from client.recording.definitions import message_type
from client.recording.topics import Topics
from tests.budget import examples
from tests.rows import each_row
from urproto.joints import JOINT_NAMES
from urproto.robots.pose import rotvec_to_matrix
from urproto.rtde.fields import OUTPUT_FIELDS

FORMATS = (".mcap", ".csv", ".npz")


def decoded(path: Path) -> dict[str, list]:
    """Messages by topic, decoded by the MCAP project's reader."""
    found: dict[str, list] = {}
    with path.open("rb") as file:
        for message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            found.setdefault(message.channel.topic, []).append(message.decoded_message)
    return found


@pytest.mark.parametrize("suffix", FORMATS)
def test_recordings_round_trip(states, tmp_path: Path, suffix: str) -> None:
    recording = read(record(tmp_path / f"run{suffix}", states))
    assert set(recording.values) == set(DEFAULT_FIELDS)
    for name in DEFAULT_FIELDS:
        assert np.array_equal(recording[name], array(states, name)), name
    assert recording.time_s[-1] == pytest.approx(states[-1]["timestamp"] - states[0]["timestamp"])
    assert list(recording.states())[77] == states[77]


@pytest.mark.parametrize("suffix", [".mcap", ".npz"])
def test_a_file_stores_its_origin(states, tmp_path: Path, suffix: str) -> None:
    recording = read(record(tmp_path / f"run{suffix}", states[:5]))
    assert recording.info == INFO | {"began_ns": str(BEGAN_NS)}
    assert recording.times_ns[0] == BEGAN_NS
    assert recording.times_ns[4] - BEGAN_NS == pytest.approx(8e6, abs=10)


@pytest.mark.parametrize("source", FORMATS)
@pytest.mark.parametrize("target", FORMATS)
def test_every_format_converts_to_every_other(states, tmp_path: Path, source: str, target: str) -> None:
    first = record(tmp_path / f"one{source}", states[:50])
    convert(first, tmp_path / f"two{target}")
    again = read(tmp_path / f"two{target}")
    assert list(again.states()) == states[:50]


@each_row("suffix", FORMATS)
def test_every_kind_of_variable_can_be_recorded(tmp_path: Path, suffix: str) -> None:
    states = moving_states(OUTPUT_FIELDS, 0.02)
    assert list(read(record(tmp_path / f"all{suffix}", states)).states()) == states


def test_the_mcap_reader_finds_the_ros_topics(states, tmp_path: Path) -> None:
    topics = decoded(record(tmp_path / "run.mcap", states))
    state, last = states[300], states[-1]
    joints = topics["/joint_states"][300]
    assert joints.name == list(JOINT_NAMES)
    assert tuple(joints.position) == state["actual_q"]
    assert tuple(joints.velocity) == state["actual_qd"]
    control = topics["/robot/controller_state"][300]
    assert tuple(control.reference.positions) == state["target_q"]
    assert tuple(control.feedback.positions) == state["actual_q"]
    assert control.error.positions == [a - b for a, b in zip(state["target_q"], state["actual_q"], strict=True)]
    assert topics["/speed_scaling_state_broadcaster/speed_scaling"][300].data == 100.0
    assert topics["/io_and_status_controller/robot_mode"][0].mode == 7
    assert topics["/io_and_status_controller/safety_mode"][0].mode == 1
    running = [message.data for message in topics["/io_and_status_controller/robot_program_running"]]
    assert (running[0], running[-1]) == (True, False)
    stamp = topics["/rtde"][-1].header.stamp
    expected = BEGAN_NS + round((last["timestamp"] - states[0]["timestamp"]) * 1e9)
    assert abs(stamp.sec * 10**9 + stamp.nanosec - expected) <= 1


def test_pose_and_wrench_are_in_the_frames_of_the_ros_driver(states, tmp_path: Path) -> None:
    state = states[300] | {"actual_TCP_force": (1.0, 2.0, 3.0, 0.1, 0.2, 0.3)}
    topics = decoded(record(tmp_path / "run.mcap", [state]))
    pose = topics["/tcp_pose_broadcaster/pose"][0]
    wrench = topics["/force_torque_sensor_broadcaster/wrench"][0]
    rotation = np.array(rotvec_to_matrix(*state["actual_TCP_pose"][3:])).reshape(3, 3)
    o = pose.pose.orientation
    back = 2.0 * np.array([o.x * o.z + o.w * o.y, o.y * o.z - o.w * o.x])  # of the third column
    assert back == pytest.approx(rotation[:2, 2])
    assert (pose.header.frame_id, wrench.header.frame_id) == ("base", "tool0_controller")
    force, torque = wrench.wrench.force, wrench.wrench.torque
    assert [force.x, force.y, force.z] == pytest.approx(rotation.T @ [1.0, 2.0, 3.0])
    assert [torque.x, torque.y, torque.z] == pytest.approx(rotation.T @ [0.1, 0.2, 0.3])


def test_inputs_and_outputs_are_published_when_they_change(states, tmp_path: Path) -> None:
    changes = [dict(state) for state in states[:20]]
    for state in changes[10:]:
        state["actual_digital_output_bits"] = 0b100
    io = decoded(record(tmp_path / "run.mcap", changes))["/io_and_status_controller/io_states"]
    assert [[signal.pin for signal in message.digital_out_states if signal.state] for message in io] == [[], [2]]


def test_analog_signals_are_published_with_their_domains() -> None:
    values = {
        "timestamp": 1.0,
        "actual_digital_input_bits": 0,
        "actual_digital_output_bits": 0,
        "analog_io_types": 0b0110,  # AI0, AI1, AO0, AO1; 1 is voltage
        "standard_analog_input0": 0.004,
        "standard_analog_input1": 5.0,
        "standard_analog_output0": 7.5,
        "standard_analog_output1": 0.02,
        "tool_analog_input_types": 0b01,
        "tool_analog_input0": 2.5,
        "tool_analog_input1": 0.01,
    }
    by_topic = {topic: kind.decode(data) for topic, kind, data in Topics(values).encoded(values, 0)}
    message = by_topic["/io_and_status_controller/io_states"]
    found = {
        kind: [(one["pin"], one["domain"], pytest.approx(one["state"])) for one in message[f"analog_{kind}_states"]]
        for kind in ("in", "out")
    }
    assert found["in"] == [(0, 0, 0.004), (1, 1, 5.0), (2, 1, 2.5), (3, 0, 0.01)]
    assert found["out"] == [(0, 1, 7.5), (1, 0, 0.02)]


def test_rosbags_opens_it_as_a_bag(states, tmp_path: Path) -> None:
    with AnyReader([record(tmp_path / "run.mcap", states)]) as bag:
        counts = {connection.topic: connection.msgcount for connection in bag.connections}
        messages = [
            bag.deserialize(data, connection.msgtype)
            for connection, _, data in bag.messages()
            if connection.topic in ("/joint_states", "/rtde")
        ]
    assert counts["/rtde"] == counts["/joint_states"] == len(states)
    assert len(messages) == 2 * len(states)
    rtde = next(message for message in messages if hasattr(message, "actual_tcp_pose"))
    assert tuple(rtde.actual_tcp_pose) == states[0]["actual_TCP_pose"]


def test_controller_states_of_the_recording_program_are_included(states, tmp_path: Path) -> None:
    point = SimpleNamespace(positions=(0.5,) * 6, velocities=(), accelerations=(), effort=())
    state = SimpleNamespace(
        time_s=states[0]["timestamp"],
        joint_names=JOINT_NAMES,
        reference=point,
        feedback=point,
        error=point,
        output=point,
    )
    with Recorder(tmp_path / "run.mcap", states[0], now_ns=lambda: BEGAN_NS) as recorder:
        recorder.write(states[0])
        recorder.write_controller("scaled_joint_trajectory_controller", state)
    (message,) = decoded(tmp_path / "run.mcap")["/scaled_joint_trajectory_controller/controller_state"]
    assert message.feedback.positions == [0.5] * 6
    with (
        Recorder(tmp_path / "run.csv", states[0]) as recorder,
        pytest.raises(RecordingError, match=r"only \.mcap files can contain"),
    ):
        recorder.write_controller("any", state)


def test_a_ros_bag_is_read_as_a_recording(states, tmp_path: Path) -> None:
    order = (2, 1, 0, 5, 3, 4)  # ROS has joints in any order, UR's driver has the elbow first
    with (tmp_path / "bag.mcap").open("wb") as file:
        writer = RosWriter(file)
        kind = message_type("sensor_msgs/msg/JointState")
        schema = writer.register_msgdef(kind.name, kind.definition)
        for number, state in enumerate(states[:30]):
            message = {
                "header": {"stamp": {"sec": 5, "nanosec": number * 2_000_000}, "frame_id": ""},
                "name": [JOINT_NAMES[joint] for joint in order],
                "position": [state["actual_q"][joint] for joint in order],
                "velocity": [state["actual_qd"][joint] for joint in order],
                "effort": [],
            }
            writer.write_message("/joint_states", schema, message, log_time=number, publish_time=number)
        writer.finish()
    recording = read(tmp_path / "bag.mcap")
    assert np.array_equal(recording["actual_q"], array(states[:30], "actual_q"))
    assert recording.time_s[-1] == pytest.approx(0.058)


def test_a_truncated_file_is_read_as_far_as_possible(states, tmp_path: Path) -> None:
    whole = record(tmp_path / "run.mcap", states)
    content = whole.read_bytes()
    whole.write_bytes(content[: int(len(content) * 0.9)])
    recording = read(whole)
    assert recording.info["cut_off"]
    assert 0 < len(recording) <= len(states)
    table = record(tmp_path / "run.csv", states)
    table.write_text(table.read_text()[:-20])
    recording = read(table)
    assert len(recording) == len(states) - 1
    assert f"line {len(states) + 1}" in recording.info["cut_off"]


def test_csv_and_npz_are_readable_by_other_tools(states, tmp_path: Path) -> None:
    with record(tmp_path / "run.csv", states[:9]).open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[8]["actual_q_5"]) == states[8]["actual_q"][5]
    with np.load(record(tmp_path / "run.npz", states[:9])) as arrays:
        assert arrays["actual_q"].shape == (9, 6)


def test_time_continues_after_a_reboot_of_the_robot(states, tmp_path: Path) -> None:
    path, now_ns = tmp_path / "run.mcap", iter((10**18, 2 * 10**18))
    booted = [state | {"timestamp": state["timestamp"] - 30.0} for state in states[:10]]
    with Recorder(path, states[0], now_ns=lambda: next(now_ns)) as recorder:
        for state in (*states[100:110], *booted):
            recorder.write(state)
    with path.open("rb") as file:
        times = [message.log_time for _, _, message in make_reader(file).iter_messages(topics=["/rtde"])]
    assert times == sorted(times)
    assert times[10] == 2 * 10**18
    assert np.all(np.diff(read(path).time_s) >= 0.0)


@pytest.mark.parametrize(
    ("name", "module"), [("run.mcap", "mcap.writer"), ("run.mcap", "mcap")], ids=["part", "package"]
)
def test_a_missing_package_is_a_one_line_error(states, tmp_path: Path, monkeypatch, name: str, module: str) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(MissingExtraError, match=r"pip install .*\[record\]'"):
        Recorder(tmp_path / name, states[0])
    assert not (tmp_path / name).exists()


def test_unwritable_and_unreadable_files_are_reported(states, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"not a format of recordings: choose one of \.mcap, \.csv, \.npz"):
        Recorder(tmp_path / "run.txt")
    with pytest.raises(RecordingError, match="cannot write"):
        Recorder(tmp_path / "nowhere" / "run.npz")
    with pytest.raises(RecordingError, match="did you mean actual_q"):
        Recorder(tmp_path / "run.csv", ["actual_qq"])
    with pytest.raises(RecordingError, match="cannot read"):
        read(tmp_path / "nothing.csv")
    Recorder(tmp_path / "empty.csv").close()
    with pytest.raises(RecordingError, match="without any states"):
        read(tmp_path / "empty.csv")
    record(tmp_path / "one.csv", states[:1])
    with pytest.raises(RecordingError, match="overwritten while it is read"):
        convert(tmp_path / "one.csv", tmp_path / "one.csv")
    with pytest.raises(RecordingError, match=r"payload was not recorded.*--fields default,payload"):
        read(tmp_path / "one.csv")["payload"]


@each_row(
    ("head", "why"),
    [
        (b'{"names": [], "info": {}}', "it has no variable"),
        (b'{"names": ["actual_q", "actual_q"], "info": {}}', "one twice"),
        (b"[" * 5000, "nested too deeply"),
        (b"[]", "damaged"),
    ],
    ids=["none", "twice", "brackets", "list"],
)
def test_an_unfinished_recording_whose_beginning_is_damaged(tmp_path: Path, head: bytes, why: str) -> None:
    path = tmp_path / "run.npz"
    path.write_bytes(b"ur-client recording, not finished\n" + head + b"\n" + bytes(96))
    with pytest.raises(
        RecordingError, match=f"start of the recording is damaged: .*{why}" if why != "damaged" else why
    ):
        read(path)


def test_an_array_without_its_magic_bytes(tmp_path: Path) -> None:
    """numpy then returns its bytes without an error."""
    path = tmp_path / "run.npz"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("actual_q.npy", b"not an array")
    with pytest.raises(RecordingError, match=r"actual_q has the shape"):
        read(path)


def test_a_bag_without_known_rtde_variables(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = RosWriter(file)
        schema = writer.register_msgdef("other/msg/State", "float64 voltage\n")
        writer.write_message("/rtde", schema, {"voltage": 1.0}, log_time=1, publish_time=1)
        writer.finish()
    with pytest.raises(RecordingError, match="has neither messages on /rtde"):
        read(path)


@pytest.mark.parametrize("suffix", FORMATS)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=examples(20))
@given(data=st.data())
def test_any_bytes_are_read_or_are_an_error(states, tmp_path: Path, suffix: str, data) -> None:
    path = tmp_path / f"any{suffix}"
    content = bytearray(record(tmp_path / f"good{suffix}", states[:3]).read_bytes())
    for place in data.draw(st.lists(st.integers(0, len(content) - 1), max_size=4)):
        content[place] = data.draw(st.integers(0, 255))
    path.write_bytes(data.draw(st.one_of(st.binary(max_size=300), st.just(bytes(content)))))
    try:
        read(path)
    except RecordingError:
        return
