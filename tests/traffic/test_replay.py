"""A recording replayed as a robot: clients of every kind receive the recorded data."""

import asyncio
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from traffic_rig import NAMES, VirtualTime, ends, recorded_robot

from client import BlockingDashboardClient, BlockingRTDEClient, dashboard
from client.decoding.states import PRIMARY
from client.errors import ClientError, FileError
from client.traffic.players import (
    Broadcast,
    PlaybackOptions,
    RequestLog,
    SequentialPlayer,
    TimedMessages,
    answer_modbus,
)
from client.traffic.recording import Conversation, Piece, TrafficRecorder, TrafficRecording
from client.traffic.replay import ReplayRobot
from client.traffic.rtde_log import RecordedRecipe
from client.traffic.rtde_player import RTDELibrary
from client.traffic.tracks import tracks_of
from urproto.errors import LocalProtocolError, RobotRefused

HOST = "127.0.0.1"
SPEED = 20.0


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> TrafficRecording:
    return recorded_robot(tmp_path_factory.mktemp("replay") / "file")


def watch(port: int, names: tuple[str, ...], frequency_hz: float | None = None) -> list[dict]:
    """All states until the robot closes the connection."""
    states = []
    with BlockingRTDEClient(HOST, list(names), frequency_hz=frequency_hz, port=port) as robot:
        try:
            while True:
                states.append(dict(robot.receive()))
        except ClientError:
            return states


async def test_the_same_recipe_and_any_subset_of_its_variables(recording):
    (track,) = tracks_of(recording)
    async with ReplayRobot(recording, HOST, speed=SPEED, free_ports=True) as robot:
        whole, part = await asyncio.gather(
            asyncio.to_thread(watch, robot.ports["rtde"], NAMES),
            asyncio.to_thread(watch, robot.ports["rtde"], ("actual_q", "timestamp"), 25.0),
        )
        assert robot.played.is_set()
    assert [state["timestamp"] for state in whole] == list(track.times_s)
    for joint in range(6):
        assert [state["actual_q"][joint] for state in whole] == list(track.columns[f"actual_q[{joint}]"])
    assert [state["timestamp"] for state in part] == list(track.times_s)[::5]
    assert [state["actual_q"] for state in part] == [state["actual_q"] for state in whole[::5]]


async def test_an_unrecorded_variable_is_not_found_and_reported(recording):
    reported: list[str] = []
    async with ReplayRobot(recording, HOST, free_ports=True, report=reported.append) as robot:
        with pytest.raises(RobotRefused, match="actual_TCP_force: NOT_FOUND"):
            await asyncio.to_thread(watch, robot.ports["rtde"], ("timestamp", "actual_TCP_force"))
    assert reported == ["rtde: not in the recording, so NOT_FOUND: actual_TCP_force"]


async def test_the_dashboard_gives_the_recorded_answers(recording):
    def send_request(port: int) -> bool:
        with BlockingDashboardClient(HOST, port) as panel:
            answer = panel.request(dashboard.IS_RUNNING)
            with pytest.raises(RobotRefused, match="could not understand: 'power on'"):
                panel.request(dashboard.POWER_ON)
        return answer

    async with ReplayRobot(recording, HOST, free_ports=True) as robot:
        assert await asyncio.to_thread(send_request, robot.ports["dashboard"]) is False


async def test_looped_states_restart(recording):
    def timestamps(port: int) -> list[float]:
        with BlockingRTDEClient(HOST, ["timestamp"], port=port) as client:
            return [client.receive()["timestamp"] for _ in range(600)]

    (track,) = tracks_of(recording)
    async with ReplayRobot(recording, HOST, speed=200, loop=True, free_ports=True) as robot:
        assert await asyncio.to_thread(timestamps, robot.ports["rtde"]) == (list(track.times_s) * 2)[:600]


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_speeds(recording, speed):
    with pytest.raises(LocalProtocolError, match="cannot be replayed at speed"):
        asyncio.run(_make(recording, speed))


async def _make(recording: TrafficRecording, speed: float) -> None:
    ReplayRobot(recording, speed=speed)


def test_a_recording_without_robot_ports_cannot_be_replayed(tmp_path):
    recorder = TrafficRecorder(tmp_path / "file")
    recorder.connection(*ends(50001)).data(True, b"hello")
    recorder.close()

    async def make() -> None:
        ReplayRobot(TrafficRecording.read(tmp_path / "file"))

    with pytest.raises(FileError, match="has no port of a robot to replay"):
        asyncio.run(make())


# players, in virtual time


def conversation(pieces: list[tuple[int, bool, bytes]]) -> Conversation:
    """From (ms since the one before, whether the server sent it, bytes)."""
    one = Conversation(54321, *ends(54321), begin_ns=VirtualTime().ns)
    time_ns = one.begin_ns
    for wait_ms, from_server, data in pieces:
        time_ns += wait_ms * 1_000_000
        one.pieces.append(Piece(time_ns, from_server, data))
    return one


def test_in_order_replay_waits_for_the_same_number_of_bytes_and_the_same_time():
    player = SequentialPlayer(
        conversation([(5, True, b"hi"), (1, False, b"abc"), (20, True, b"there")]), PlaybackOptions()
    )
    player.begin(100.0)
    assert (player.due(100.0), player.next_s) == (b"", pytest.approx(100.005))
    assert player.due(100.005) == b"hi"
    assert (player.next_s, player.finished) == (None, False)
    player.take(b"xy", 101.0)
    assert player.due(200.0) == b""
    player.take(b"z", 200.0)
    assert (player.due(200.0), player.next_s) == (b"", pytest.approx(200.020))
    assert player.due(200.021) == b"there"
    assert player.finished


@given(
    st.lists(st.tuples(st.integers(0, 50), st.booleans(), st.binary(min_size=1, max_size=9)), max_size=12),
    st.lists(st.integers(1, 5), min_size=1),
)
def test_in_order_replay_is_complete_for_a_client_that_sends_everything(pieces, sizes):
    one = conversation(pieces)
    player, now_s, received = SequentialPlayer(one, PlaybackOptions(2.0)), 0.0, b""
    sent = one.sent(from_server=False)
    player.begin(now_s)
    for turn in range(2000):
        now_s += 0.01
        size = sizes[turn % len(sizes)]
        player.take(sent[:size], now_s)
        sent = sent[size:]
        received += player.due(now_s)
    assert received == one.sent(from_server=True)
    assert player.finished


def test_a_broadcast_sends_whole_messages_at_their_times():
    message = b"\0\0\0\x07\x14ab"
    cut_off = conversation([(0, True, message + message[:3]), (10, True, message[3:] + message[:4])])
    player = Broadcast(TimedMessages.of(cut_off, PRIMARY), PlaybackOptions(speed=2.0))
    player.begin(50.0)
    assert (player.due(50.0), player.next_s) == (message, pytest.approx(50.005))
    assert player.take(b"def prog():\n", 50.001) == b""
    assert player.due(50.0049) == b""
    assert player.due(50.0051) == message
    assert player.finished


def test_answers_follow_the_recording_and_repeat_the_last_one():
    requests = RequestLog()
    for request, answer in ((b"mode", b"off"), (b"on", b"ok"), (b"mode", b"idle")):
        requests.add(request, answer)
    assert [requests.answer(text) for text in (b"mode", b"on", b"mode", b"mode", b"what")] == [
        b"off", b"ok", b"idle", b"idle", None,
    ]  # fmt: skip


def test_modbus_answers_any_transaction_id_and_refuses_unrecorded_reads():
    requests = RequestLog()
    requests.add(bytes.fromhex("0000 0006 01 03 0080 0001"), bytes.fromhex("0000 0005 01 03 02 002a"))
    request = bytes.fromhex("1234 0000 0006 01 03 0080 0001")
    assert answer_modbus(requests, request) == bytes.fromhex("1234 0000 0005 01 03 02 002a")
    other = bytes.fromhex("1235 0000 0006 01 03 0081 0001")
    assert answer_modbus(requests, other) == bytes.fromhex("1235 0000 0003 01 83 02")


# an independent client


# in a separate process, since the library holds Python's lock while it waits
UR_RTDE = """
import json, sys
from rtde_receive import RTDEReceiveInterface
client = RTDEReceiveInterface(sys.argv[1], 125.0, sys.argv[2:])
seen = 0
while seen < 30:
    began = client.initPeriod()
    before, q, after = client.getTimestamp(), client.getActualQ(), client.getTimestamp()
    if before == after > 0:  # 0: nothing came yet
        print(json.dumps([before, q]))
        seen += 1
    client.waitPeriod(began)
client.disconnect()
"""


@pytest.mark.real_client
@pytest.mark.skipif(sys.platform != "linux", reason="ur_rtde has a fixed port number: it needs a separate address")
async def test_ur_rtde_receives_the_recorded_values(tmp_path: Path):
    host = f"127.79.{os.getpid() >> 8 & 255}.{os.getpid() & 255}"
    names = ("timestamp", "actual_q", "robot_mode")
    recording = recorded_robot(tmp_path / "file", names=names, model="ur3")
    (track,) = tracks_of(recording)
    async with ReplayRobot(recording, host) as robot:
        assert robot.ports["rtde"] == 30004
        call = [sys.executable, "-c", UR_RTDE, host, *names]
        client = await asyncio.to_thread(subprocess.run, call, capture_output=True, check=True, timeout=60)
    seen = [json.loads(line) for line in client.stdout.splitlines()]
    assert len(seen) > 20
    for time_s, q in seen:
        index = track.times_s.index(time_s)
        assert q == [track.columns[f"actual_q[{joint}]"][index] for joint in range(6)]


def test_recipes_are_played_in_turn_and_then_from_the_first_again():
    both = [RecordedRecipe(("timestamp",), ("DOUBLE",), None, ["a row"]) for _ in range(2)]
    library = RTDELibrary([SimpleNamespace(version=None, exchanges=[], outputs=both)])
    played = [library.outputs(("timestamp",)) for _ in range(5)]
    assert [one is both[1] for one in played] == [False, True, False, True, False]
