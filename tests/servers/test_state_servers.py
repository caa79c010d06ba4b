"""The servers that broadcast: RTDE, realtime, primary and secondary, with a fake controller."""

import socket
import struct
from itertools import pairwise
from typing import Any
from unittest.mock import Mock

import pytest
from server_rig import CB3, E_SERIES, FakeController, MemoryClient

from emulator import app
from emulator.commands.requests import RefusedScript, RTDEInputs, ScriptUnit
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from emulator.servers.connection import Connection
from emulator.servers.hooks import Direction
from emulator.servers.port import PortServer
from emulator.servers.primary import PrimaryServer, RealtimeServer
from emulator.servers.primary_state import robot_state
from emulator.servers.rtde import RTDEServer
from emulator.snapshot import Snapshot
from tests.rows import each_row
from urproto.modes import SafetyMode
from urproto.primary.framing import PrimaryDecoder
from urproto.primary.messages import SafetyModeMessage, TextMessage, UnknownMessage, VersionMessage
from urproto.primary.state import RobotStateData, encode_robot_state
from urproto.realtime import RealtimeDecoder
from urproto.robots import load_model
from urproto.rtde.codec import (
    InputData,
    OutputData,
    RequestProtocol,
    RTDEDecoder,
    SetupInputs,
    SetupOutputs,
    SetupOutputsReply,
    Start,
    StartReply,
    decode_reply,
)
from urproto.versions import PolyscopeVersion


def start_outputs(client: MemoryClient, *names: str, frequency_hz: float = 125.0) -> None:
    client.feed(RequestProtocol(2).encode(1) + SetupOutputs(names, frequency_hz).encode(2) + Start().encode(2))
    assert [type(reply) for reply in replies(client)[1:]] == [SetupOutputsReply, StartReply]


def replies(client: MemoryClient) -> list[Any]:
    return [decode_reply(package, 2) for package in RTDEDecoder().feed(client.take())]


@pytest.fixture
def controller() -> FakeController:
    return FakeController()


# RTDE


@pytest.fixture
def rtde(controller: FakeController) -> RTDEServer:
    return RTDEServer(controller)


def test_rtde_timestamps_come_from_the_step_counter(rtde: RTDEServer, controller: FakeController) -> None:
    client = MemoryClient(rtde)
    start_outputs(client, "timestamp", frequency_hz=25.0)
    controller.tick(20)
    stamps = [struct.unpack(">d", reply.data)[0] for reply in replies(client)]
    assert stamps == pytest.approx([41.048, 41.088, 41.128], abs=1e-9)  # the first a period of 25 Hz later


def test_rtde_encodes_equal_recipes_once(rtde: RTDEServer, controller: FakeController) -> None:
    reads: list[str] = []

    class Watched(Snapshot):
        def __getattribute__(self, name: str) -> Any:
            if name.startswith("actual_"):
                reads.append(name)
            return super().__getattribute__(name)

    clients = [MemoryClient(rtde) for _ in range(4)]
    for client in clients[:3]:
        start_outputs(client, "timestamp", "actual_q")
    start_outputs(clients[3], "actual_qd")
    controller.tick()
    controller.snapshot = Watched(step=1)
    controller.tick()
    assert sorted(reads) == ["actual_q", "actual_qd"]
    assert len({bytes(client.take()) for client in clients}) == 2


def test_rtde_inputs_reach_the_controller_in_the_next_period(rtde: RTDEServer, controller: FakeController) -> None:
    client = MemoryClient(rtde)
    client.feed(SetupInputs(("input_int_register_0",)).encode(1), chunk=1)
    for value in (1, 2):
        client.feed(InputData(1, struct.pack(">i", value)).encode(1), chunk=1)
    assert controller.commands == []
    controller.tick()
    assert controller.commands == [RTDEInputs({"input_int_register_0": 1}), RTDEInputs({"input_int_register_0": 2})]


def test_rtde_inputs_are_free_again_when_their_client_vanishes(rtde: RTDEServer) -> None:
    setup = SetupInputs(("input_int_register_0",)).encode(1)
    first, second = MemoryClient(rtde), MemoryClient(rtde)
    first.feed(setup)
    first.take()
    second.feed(setup)
    assert b"IN_USE" in second.take()
    first.vanish()
    second.feed(setup)
    assert second.take() == b"\x00\x09I\x01INT32"


def test_an_rtde_client_that_pauses_reading_gets_the_newest_state(rtde: RTDEServer, controller: FakeController) -> None:
    slow, quick = MemoryClient(rtde), MemoryClient(rtde)
    for client in (slow, quick):
        start_outputs(client, "timestamp")
    controller.tick()
    slow.transport.stalled = True
    controller.tick(50)
    slow.transport.unstall()
    controller.tick()
    assert len(replies(quick)) == 51
    assert [struct.unpack(">d", reply.data)[0] for reply in replies(slow)] == pytest.approx([41.016, 41.416])


def test_an_rtde_client_that_never_reads_is_disconnected(
    rtde: RTDEServer, controller: FakeController, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Issue 6 of the RTDE Python client: after 11 s without reading, the controller has closed the connection."""
    now_s = 100.0
    monkeypatch.setattr("emulator.servers.rtde.time.monotonic", lambda: now_s)
    slow, pausing, quick = MemoryClient(rtde), MemoryClient(rtde), MemoryClient(rtde)
    for client in (slow, pausing, quick):
        start_outputs(client, "timestamp")
    controller.tick()
    slow.transport.stalled = pausing.transport.stalled = True
    for _ in range(6):
        controller.tick(10)
        now_s += 1.0
        if now_s == 104.0:
            pausing.transport.unstall()
            controller.tick()
            pausing.transport.stalled = True
    controller.tick()
    assert not slow.connected
    assert pausing.connected
    assert quick.connected
    assert len(replies(quick)) == 62  # the first period is that of the answer


@pytest.mark.skipif(not hasattr(socket, "TCP_QUICKACK"), reason="only Linux can acknowledge immediately")
def test_rtde_inputs_are_acknowledged_immediately(rtde: RTDEServer) -> None:
    """Without TCP_NODELAY, a client's next input waits for that, and would be late for good after one stall."""
    client = MemoryClient(rtde)
    own = Mock(spec=socket.socket)
    client.transport._extra["socket"] = own
    client.feed(SetupInputs(("input_int_register_0",)).encode(1))
    own.setsockopt.assert_called_with(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)


def test_rtde_impossible_size_ends_the_connection(rtde: RTDEServer) -> None:
    client, other = MemoryClient(rtde), MemoryClient(rtde)
    client.feed(RequestProtocol(2).encode(1) + b"\x00\x02V")
    assert client.take() == b"\x00\x04V\x01"
    assert not client.connected
    assert other.connected


def test_rtde_hooks_see_and_change_messages(rtde: RTDEServer, controller: FakeController) -> None:
    seen: list[tuple[Direction, str]] = []

    def hook(connection: Connection, direction: Direction, message: Any) -> Any:
        seen.append((direction, type(message).__name__))
        return None if isinstance(message, Start) else message

    rtde.hooks.on_message.append(hook)
    client = MemoryClient(rtde)
    client.feed(RequestProtocol(2).encode(1) + Start().encode(2))
    assert [type(reply).__name__ for reply in replies(client)] == ["ProtocolReply"]
    assert seen == [
        (Direction.RECEIVED, "RequestProtocol"),
        (Direction.SENT, "ProtocolReply"),
        (Direction.RECEIVED, "Start"),
    ]


def test_rtde_package_has_a_recipe_id(rtde: RTDEServer, controller: FakeController) -> None:
    client = MemoryClient(rtde)
    start_outputs(client, "robot_mode")
    assert replies(client) == []
    controller.tick(2)
    assert replies(client) == [OutputData(struct.pack(">i", 3), 1)]


# realtime


@pytest.mark.parametrize(("version", "size"), [(CB3, 1108), (E_SERIES, 1220)])
def test_realtime_packet_every_period(version: Any, size: int) -> None:
    controller = FakeController(version)
    client = MemoryClient(RealtimeServer("realtime", controller, read_only=False))
    controller.tick(3, actual_q=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    data = client.take()
    assert len(data) == 3 * size
    states = RealtimeDecoder().feed(data)
    assert [state["timestamp"] for state in states] == pytest.approx(
        [(5125 + n) * version.series.period_s for n in (1, 2, 3)]
    )
    assert states[0]["actual_q"] == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)


# primary and secondary


def encode(snapshot: Snapshot, full: bool) -> bytes:
    return encode_robot_state(robot_state(snapshot, load_model("ur3")), CB3, full=full)


def primary_server(controller: FakeController, *, messages: bool = True, read_only: bool = False) -> PrimaryServer:
    return PrimaryServer("primary", controller, encode, messages=messages, read_only=read_only)


def received(client: MemoryClient) -> list[Any]:
    return list(PrimaryDecoder(CB3).feed(client.take()))


def test_version_message_comes_first_and_alone(controller: FakeController) -> None:
    client = MemoryClient(primary_server(controller))
    version, twelve = received(client)
    assert isinstance(version, VersionMessage)
    assert isinstance(twelve, UnknownMessage)
    assert (version.major, version.minor, version.bugfix) == (3, 15, 8)


# as dumped in the vendor's forum, threads 21643 (5.11) and 27359 (5.13), and from a 5.4 simulator in connect_5.4.hex;
# its size on CB3: forum thread 380 (3.3.1), python-urx issue 65 (3.5.3), connect_3.10.hex
AFTER_VERSION = bytes.fromhex("00000018 14 ffffffffffffffff fe 0c 00000000 00000000 01")


@each_row(
    ("version", "behind"),
    [("3.2", b""), ("3.15.8", AFTER_VERSION), ("5.0.5", AFTER_VERSION), ("5.11.11", AFTER_VERSION)],
)
def test_messages_after_the_version_message(version: str, behind: bytes) -> None:
    greeting = MemoryClient(primary_server(FakeController(PolyscopeVersion.parse(version)))).take()
    size = 56 if version == "3.2" else 55  # the older form of the date is a byte longer
    assert greeting[:5] == bytes([0, 0, 0, size, 0x14])
    assert greeting[size:] == behind


def test_states_at_10_hz_starting_with_a_full_one(controller: FakeController) -> None:
    server = primary_server(controller)
    early = MemoryClient(server)
    received(early)
    controller.tick(60)
    late = MemoryClient(server)
    received(late)
    controller.tick(65)
    states = received(early)
    assert [state.configuration is not None for state in states] == [True] + [False] * 8
    gaps = {b.mode.timestamp_us - a.mode.timestamp_us for a, b in pairwise(states)}
    assert gaps == {96_000, 104_000}
    assert [state.configuration is not None for state in received(late)] == [True] + [False] * 4


@pytest.mark.parametrize("version", [CB3, E_SERIES])
def test_states_follow_the_connection_by_tenths_of_a_second(version: PolyscopeVersion) -> None:
    """As 692 programs of a real UR10e show: their last message came 0 to 20 ms after a multiple of 100 ms."""
    controller = FakeController(version)
    server = primary_server(controller)
    for pause in range(60):
        client = MemoryClient(server)
        received(client)
        began = controller.snapshot.step
        while not (states := received(client)):
            controller.tick()
        assert 0.1 <= (controller.snapshot.step - began) * version.series.period_s < 0.12
        assert isinstance(states[0], RobotStateData)
        client.vanish()
        controller.tick(pause % 7)


def test_messages_follow_the_state_of_their_period(controller: FakeController) -> None:
    server = primary_server(controller)
    client = MemoryClient(server)
    received(client)  # the version
    while not received(client):
        controller.tick()
    sent = [TextMessage(timestamp_us=n, text="hello") for n in range(15)]
    for message in sent:
        controller.tick(messages=(message, message))
        if got := received(client):
            break
    count = len(got) // 2
    assert count in (12, 13)
    assert isinstance(got[0], RobotStateData)
    assert got[1:] == [message for message in sent[:count] for _ in range(2)]


def test_a_new_client_gets_the_messages_since_it_connected(controller: FakeController) -> None:
    server = primary_server(controller)
    before, after = TextMessage(timestamp_us=1, text="before"), TextMessage(timestamp_us=2, text="after")
    controller.tick(messages=(before,))
    client = MemoryClient(server)
    received(client)
    controller.tick(messages=(after,))
    controller.tick(14)
    assert [m for m in received(client) if isinstance(m, TextMessage)] == [after]


def test_a_new_safety_mode_comes_with_a_state_that_shows_it(controller: FakeController) -> None:
    """The official client library unlocks a protective stop only after a state has reported one."""
    server = primary_server(controller)
    client = MemoryClient(server)
    controller.tick(14)
    received(client)
    stop = SafetyModeMessage(timestamp_us=1, safety_mode=SafetyMode.PROTECTIVE_STOP)
    controller.tick(messages=(stop,), safety_mode=SafetyMode.PROTECTIVE_STOP)
    while not (got := received(client)):
        controller.tick(safety_mode=SafetyMode.PROTECTIVE_STOP)
    assert [type(message) for message in got] == [RobotStateData, SafetyModeMessage]
    assert got[0].masterboard.safety_mode == SafetyMode.PROTECTIVE_STOP


def test_secondary_clients_get_no_messages(controller: FakeController) -> None:
    client = MemoryClient(primary_server(controller, messages=False))
    controller.tick(14, messages=(TextMessage(timestamp_us=1, text="hello"),))
    assert [type(message) for message in received(client)] == [VersionMessage, UnknownMessage, RobotStateData]


def test_unread_messages_but_not_states_drop_a_primary_client(controller: FakeController) -> None:
    server = primary_server(controller)
    slow, quick = MemoryClient(server), MemoryClient(server)
    slow.transport.stalled = True
    controller.tick(10_000)
    assert slow.connected
    big = TextMessage(timestamp_us=1, text="x" * 60_000)
    for _ in range(20):
        controller.tick(messages=(big,))
        controller.tick(12)
        quick.take()
    assert not slow.connected
    assert quick.connected


# scripts on all of them


def script_servers(controller: FakeController, *, read_only: bool) -> list[PortServer]:
    return [
        primary_server(controller, read_only=read_only),
        RealtimeServer("realtime", controller, read_only=read_only),
    ]


@pytest.mark.parametrize("kind", [0, 1])
@pytest.mark.parametrize("chunk", [1, 7, 4096])
def test_scripts_are_submitted_one_per_period(controller: FakeController, kind: int, chunk: int) -> None:
    client = MemoryClient(script_servers(controller, read_only=False)[kind])
    client.feed(b"stop program\ndef f():\r\n  x = 1\r\nend\r\n\nsec g():\nend\n", chunk)
    seen = []
    for _ in range(4):
        controller.tick()
        seen.append(len(controller.commands))
    assert seen == [1, 2, 3, 3]
    first, second, third = controller.commands
    assert first == ScriptUnit("stop program", "line")
    assert isinstance(second, ScriptUnit)
    assert second.kind == "block"
    assert second.text.split() == ["def", "f():", "x", "=", "1", "end"]
    assert isinstance(third, ScriptUnit)
    assert third.text == "sec g():\nend"


def test_a_program_without_a_final_newline_runs_when_its_client_closes(controller: FakeController) -> None:
    client = MemoryClient(script_servers(controller, read_only=False)[0])
    client.feed(b"def f():\nend")
    client.end()
    assert not client.connected
    controller.tick(2)
    assert controller.commands == [ScriptUnit("def f():\nend", "block")]


def test_an_incomplete_program_does_not_run(controller: FakeController, caplog: pytest.LogCaptureFixture) -> None:
    client = MemoryClient(script_servers(controller, read_only=False)[0])
    client.feed(b"def f():\n  movej([0,0,0,0,0,0])\n")
    client.end()
    controller.tick(2)
    assert controller.commands == []
    assert "ends in the middle" in caplog.text


@pytest.mark.parametrize("kind", [0, 1])
def test_read_only_ports_refuse_scripts(controller: FakeController, kind: int) -> None:
    client = MemoryClient(script_servers(controller, read_only=True)[kind])
    client.feed(b"power off\ndef f():\nend\n")
    controller.tick(3)
    assert controller.commands == [RefusedScript("power off"), RefusedScript("def f():\nend")]
    assert client.connected


@pytest.mark.parametrize("kind", [0, 1])
def test_connections_opened_in_local_control_stay_read_only(controller: FakeController, kind: int) -> None:
    server = script_servers(controller, read_only=False)[kind]
    controller.tick(local_control=True)
    early = MemoryClient(server)
    controller.tick(local_control=False)
    late = MemoryClient(server)
    early.feed(b"stop program\n")
    late.feed(b"stop program\n")
    controller.tick(2)
    assert controller.commands == [RefusedScript("stop program"), ScriptUnit("stop program", "line")]


def test_a_state_is_encoded_once_for_all_four_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    """They send it in the same control period, and encoding takes a twentieth of a period of the e-Series."""
    encoded = []

    def encode(state: RobotStateData, version: PolyscopeVersion, *, full: bool) -> bytes:
        encoded.append(full)
        return encode_robot_state(state, version, full=full)

    monkeypatch.setattr(app, "encode_robot_state", encode)
    controller = Controller(ControllerConfig(model=load_model("ur5e")))
    ports = [port for port in app.make_servers(controller) if isinstance(port, PrimaryServer)]
    clients = [MemoryClient(port) for port in ports]
    first, second = [[] for _ in ports], [[] for _ in ports]
    for states, periods in ((first, 60), (second, 50)):
        encoded.clear()
        for _ in range(periods):
            controller.tick()
        for client, state in zip(clients, states, strict=True):
            state += PrimaryDecoder(controller.version).feed(client.take())
    assert encoded == [False]
    assert len(ports) == 4
    assert len({repr([m for m in state if isinstance(m, RobotStateData)]) for state in second}) == 1
    assert all(isinstance(state[-1], RobotStateData) for state in (*first, *second))
    assert second[0][-1] != first[0][-1]
