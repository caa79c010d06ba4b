"""Streams: JSON for PlotJuggler, and a server for websocket clients with Foxglove's protocol."""

import json
import math
import queue
import socket
import struct
import sys
import threading

import numpy as np
import pytest
import websockets
from recording_rig import BEGAN_NS, GOAL, HOME, moving_states
from websockets.sync.server import serve

from client.cameras import Shot
from client.commands.scene_drawing import DrawnServer
from client.errors import MissingExtraError, RecordingError
from client.planning import Box, PlanningScene
from client.planning.markers import SceneDrawing
from client.recording.live import FoxgloveServer, PlotJugglerSender, address_of, datagrams, plotjuggler
from tests.rows import each_row
from tests.served_cameras import JPEG, MATRIX, OVERVIEW, POSE
from urproto.compat_asyncio import timeout
from urproto.rtde.fields import OUTPUT_FIELDS

PATIENCE_S = 20.0


def test_a_state_is_a_json_object_with_its_time(states) -> None:
    few = {name: states[5][name] for name in ("timestamp", "actual_q", "robot_mode")}
    (data,) = datagrams(few, BEGAN_NS)
    message = json.loads(data)
    assert message.pop("timestamp") == pytest.approx(BEGAN_NS * 1e-9, abs=1e-6)
    assert message.pop("robot_time") == states[5]["timestamp"]
    assert message == {"actual_q": list(states[5]["actual_q"]), "robot_mode": 7}


def test_no_datagram_exceeds_the_size_receivers_accept() -> None:
    (state,) = moving_states(OUTPUT_FIELDS, 0.002)
    parts = list(datagrams(state, BEGAN_NS))
    assert len(parts) > 1
    assert max(map(len, parts)) <= 1400
    whole = {name: value for part in parts for name, value in json.loads(part).items()}
    assert len(whole) == len(OUTPUT_FIELDS) + 1


def test_values_without_a_json_form_are_left_out() -> None:
    (data,) = datagrams({"speed_scaling": math.nan, "actual_q": (math.inf, 0.0), "robot_mode": 7}, 0)
    assert json.loads(data) == {"timestamp": 0.0, "robot_mode": 7}


def test_plotjuggler_gets_datagrams(states) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(PATIENCE_S)
        sender = PlotJugglerSender(*address_of(f"udp://127.0.0.1:{receiver.getsockname()[1]}", "udp", 9870))
        sender.write(states[0], BEGAN_NS)
        sender.close()
        assert json.loads(receiver.recv(2048))["robot_mode"] == 7


def test_plotjugglers_websocket_server_gets_whole_states(states) -> None:
    got = queue.SimpleQueue()
    with serve(lambda connection: [got.put(message) for message in connection], "127.0.0.1", 0) as server:
        serving = threading.Thread(target=server.serve_forever)
        serving.start()
        sender = plotjuggler(f"ws://127.0.0.1:{server.socket.getsockname()[1]}")
        sender.write(states[5], BEGAN_NS)
        sender.write({"speed_scaling": math.nan}, BEGAN_NS)
        first, second = (json.loads(got.get(timeout=PATIENCE_S)) for _ in range(2))
        sender.close()
        server.shutdown()
        serving.join()
    assert first["timestamp"] == pytest.approx(BEGAN_NS * 1e-9, abs=1e-6)
    assert first["robot_time"] == states[5]["timestamp"]
    assert tuple(first["actual_q"]) == states[5]["actual_q"]
    assert list(second) == ["timestamp"]
    with pytest.raises(RecordingError, match="no longer accepts states"):
        sender.write(states[5], BEGAN_NS)


def test_a_plotjuggler_that_does_not_listen_is_reported() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # without listening
        with pytest.raises(RecordingError, match="first start PlotJuggler's, with protocol json"):
            plotjuggler(f"ws://127.0.0.1:{taken.getsockname()[1]}")


@each_row(
    ("text", "address"),
    [
        ("udp://10.0.0.5:99", ("10.0.0.5", 99)),
        ("10.0.0.5", ("10.0.0.5", 9870)),
        ("lab-pc:1234", ("lab-pc", 1234)),
        ("udp://[::1]:99", ("::1", 99)),
    ],
)
def test_addresses(text: str, address: tuple[str, int]) -> None:
    assert address_of(text, "udp", 9870) == address


@each_row("text", ["tcp://10.0.0.5:99", "", "udp://:7", "udp://a:99999", "udp://a:b"])
def test_invalid_addresses_are_reported(text: str) -> None:
    with pytest.raises(RecordingError, match="is not an address"):
        address_of(text, "udp", 9870)


async def test_a_client_of_foxgloves_protocol_gets_messages_it_can_read(states) -> None:
    scene = PlanningScene("ur5e")
    scene.add("post", Box((0.1, 0.1, 0.5)))
    server = FoxgloveServer(tuple(states[0]), "127.0.0.1", 0, "<robot name='ur5e'/>")
    drawn = DrawnServer(server, SceneDrawing(scene, np.array([HOME, GOAL])))
    try:
        address = f"ws://127.0.0.1:{server.port}"
        async with timeout(PATIENCE_S), websockets.connect(address, subprotocols=["foxglove.sdk.v1"]) as client:
            channels = await _channels(client)
            drawn.write(states[0], BEGAN_NS)
            for _ in range(3):  # channels of the description and the markers, each with its first message
                channels |= await _channels(client)
            topics = ("/joint_states", "/robot_description", "/planning_scene", "/planned_path")
            await _subscribe(client, [channels[topic]["id"] for topic in topics])
            got = {}
            number = 0
            while len(got) < len(topics):  # subscriptions are not answered
                number += 1
                drawn.write({**states[300], "timestamp": float(number)}, BEGAN_NS + number * 10**9)
                got |= await _messages(client)
    finally:
        server.close()
    by_topic = {topic: got[channels[topic]["id"]] for topic in topics}
    joints = _decoded(channels["/joint_states"], by_topic["/joint_states"])
    assert tuple(joints.position) == states[300]["actual_q"]
    assert _decoded(channels["/robot_description"], by_topic["/robot_description"]).data == "<robot name='ur5e'/>"
    (post,) = _decoded(channels["/planning_scene"], by_topic["/planning_scene"]).markers
    assert (post.ns, post.type, post.scale.z) == ("post", 1, 0.5)
    (way,) = _decoded(channels["/planned_path"], by_topic["/planned_path"]).markers
    assert (way.points[-1].x, way.points[-1].y) == pytest.approx(scene.kinematics.forward(GOAL)[:2])


async def _channels(client) -> dict[str, dict]:
    while True:
        message = await client.recv()
        if isinstance(message, str) and json.loads(message)["op"] == "advertise":
            return {channel["topic"]: channel for channel in json.loads(message)["channels"]}


async def _subscribe(client, channels: list[int]) -> None:
    subscriptions = [{"id": channel, "channelId": channel} for channel in channels]
    await client.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))


async def _messages(client) -> dict[int, bytes]:
    """All messages until none arrives: subscription -> the newest message."""
    found = {}
    try:
        while True:
            async with timeout(0.1):
                message = await client.recv()
            if isinstance(message, bytes):
                kind, subscription, _ = struct.unpack_from("<BIQ", message)
                assert kind == 1
                found[subscription] = message[13:]
    except TimeoutError:
        return found


def _decoded(channel: dict, data: bytes) -> object:
    from mcap.records import Schema
    from mcap_ros2.decoder import DecoderFactory

    assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
    schema = Schema(id=1, name=channel["schemaName"], encoding="ros2msg", data=channel["schema"].encode())
    return DecoderFactory().decoder_for("cdr", schema)(data)


def test_an_address_in_use_is_reported() -> None:
    server = FoxgloveServer(("timestamp",), "127.0.0.1", 0)
    try:
        with pytest.raises(RecordingError, match="cannot listen on"):
            FoxgloveServer(("timestamp",), "127.0.0.1", server.port)
    finally:
        server.close()


def test_a_missing_package_is_a_one_line_error(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(MissingExtraError, match=r"pip install .*\[live\]'"):
        FoxgloveServer(("timestamp",), "127.0.0.1", 0)


async def test_a_client_of_foxgloves_protocol_gets_pictures_and_camera_poses() -> None:
    server = FoxgloveServer(("timestamp",), "127.0.0.1", 0)
    topics = ("/over_all/image_raw/compressed", "/over_all/camera_info", "/tf_static")
    try:
        address = f"ws://127.0.0.1:{server.port}"
        async with timeout(PATIENCE_S), websockets.connect(address, subprotocols=["foxglove.sdk.v1"]) as client:
            channels = await _channels(client)
            got, number = {}, 0
            while len(got) < len(topics):
                server.write_shot(Shot(OVERVIEW, "rgb.jpg", JPEG, 0.0, POSE), BEGAN_NS + number * 10**9)
                number += 1
                if not set(topics) <= set(channels):  # they are advertised with the first picture
                    channels |= await _channels(client)
                    if set(topics) <= set(channels):
                        await _subscribe(client, [channels[topic]["id"] for topic in topics])
                else:
                    got |= await _messages(client)
    finally:
        server.close()
    picture, info, frames = (_decoded(channels[topic], got[channels[topic]["id"]]) for topic in topics)
    assert bytes(picture.data) == JPEG
    assert picture.header.frame_id == "over_all_optical_frame"
    assert tuple(info.k) == MATRIX
    assert [frame.child_frame_id for frame in frames.transforms] == ["over_all_link", "over_all_optical_frame"]
