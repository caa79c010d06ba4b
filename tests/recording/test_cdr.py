"""Messages against rosbags, which reads and writes CDR by its definitions and by ours."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from client.errors import RecordingError
from client.recording.cdr import MessageType
from client.recording.definitions import message_type, ros_name, rtde_type
from tests.rows import each_row
from urproto.rtde.fields import OUTPUT_FIELDS

STANDARD = (
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/WrenchStamped",
    "geometry_msgs/msg/PoseStamped",
    "std_msgs/msg/Float64",
    "std_msgs/msg/Bool",
    "std_msgs/msg/String",
    "std_msgs/msg/Float64MultiArray",
    "tf2_msgs/msg/TFMessage",
    "trajectory_msgs/msg/JointTrajectory",
    "trajectory_msgs/msg/JointTrajectoryPoint",
    "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
)
MIXED = """bool flag
string[] names
uint8[] bytes
uint64 big
float32[3] three
Inner[] inner
int16 small
Inner one
string<=9 word
int8 CONSTANT=-1
================================================================================
MSG: own_msgs/Inner
uint8 a
float64[] b  # a remark, with 3 [units]
string c
"""
inner = st.fixed_dictionaries(
    {"a": st.integers(0, 255), "b": st.lists(st.floats(allow_nan=False), max_size=3), "c": st.text(max_size=4)}
)
# an encoded text ends with its first zero byte
words = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=5)
inner = inner.map(lambda value: value | {"c": value["c"].replace("\0", "").encode("utf-8", "ignore").decode()})


@each_row("name", STANDARD)
def test_our_definitions_match_ros(name: str) -> None:
    theirs = get_typestore(Stores.ROS2_JAZZY)
    ours = get_types_from_msg(message_type(name).definition, name)
    assert {kind: fields for kind, (_, fields) in ours.items()} == {kind: theirs.fielddefs[kind][1] for kind in ours}


@given(
    st.fixed_dictionaries(
        {
            "flag": st.booleans(),
            "names": st.lists(words, max_size=3),
            "bytes": st.binary(max_size=5).map(list),
            "big": st.integers(0, 2**64 - 1),
            "three": st.lists(st.floats(width=32, allow_nan=False), min_size=3, max_size=3),
            "inner": st.lists(inner, max_size=3),
            "small": st.integers(-(2**15), 2**15 - 1),
            "one": inner,
            "word": words,
        }
    )
)
def test_messages_are_interchangeable_with_rosbags(values: dict) -> None:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(MIXED, "own_msgs/msg/Mixed"))
    ours = MessageType("own_msgs/msg/Mixed", MIXED)
    data = ours.encode(values)
    message = store.deserialize_cdr(data, "own_msgs/msg/Mixed")
    assert (message.flag, message.big, message.small, message.word) == tuple(
        values[name] for name in ("flag", "big", "small", "word")
    )
    assert message.names == values["names"]
    assert [part.c for part in message.inner] == [part["c"] for part in values["inner"]]
    assert np.array_equal(message.one.b, np.array(values["one"]["b"]))
    assert _listed(ours.decode(bytes(store.serialize_cdr(message, "own_msgs/msg/Mixed")))) == values


def _listed(value: object) -> object:
    if isinstance(value, dict):
        return {name: _listed(part) for name, part in value.items()}
    return [_listed(part) for part in value] if isinstance(value, list | tuple) else value


def test_unnamed_fields_are_zero() -> None:
    kind = message_type("control_msgs/msg/JointTrajectoryControllerState")
    message = kind.decode(kind.encode({"joint_names": ["a"], "reference": {"positions": [1.0]}}))
    assert message["joint_names"] == ["a"]
    assert message["reference"]["positions"] == (1.0,)
    assert message["multi_dof_error"]["transforms"] == []
    assert message["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}


@given(st.binary(max_size=200))
def test_any_bytes_decode_or_are_an_error(data: bytes) -> None:
    kind = MessageType("own_msgs/msg/Mixed", MIXED)
    for bytes_ in (data, b"\x00\x01\x00\x00" + data):
        try:
            kind.decode(bytes_)
        except RecordingError:
            continue


@each_row("text", ["float64", "what is this", "Unknown x", "own/A a\n===\nMSG: own/A\nown/A a"])
def test_invalid_definitions_are_refused(text: str) -> None:
    with pytest.raises(RecordingError):
        MessageType("own/msg/Thing", text)


def test_every_rtde_variable_has_a_separate_ros_field() -> None:
    kind = rtde_type(OUTPUT_FIELDS)
    assert len(set(kind.names)) == len(OUTPUT_FIELDS) + 1
    assert not [name for name in kind.names if "__" in name or name.endswith("_") or not name[0].islower()]
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(kind.definition, kind.name))
    message = store.deserialize_cdr(
        kind.encode({"actual_q": (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), "control_step": 7}), kind.name
    )
    assert message.control_step == 7
    assert list(message.actual_q) == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert ros_name("actual_TCP_pose") == "actual_tcp_pose"
