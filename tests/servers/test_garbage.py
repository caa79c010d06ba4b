"""Any bytes on any port, whole and byte by byte, leave the server, other clients and the arm undisturbed."""

import struct

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from server_rig import MemoryClient

from emulator.app import make_servers
from emulator.controller import Controller
from emulator.devices.tool_line import EchoDevice, SerialSettings
from emulator.machine import ControllerConfig
from emulator.servers.port import PortServer
from tests.budget import examples
from urproto.primary.framing import PrimaryDecoder
from urproto.primary.state import RobotStateData
from urproto.realtime import RealtimeDecoder
from urproto.robotiq import MODELS
from urproto.robots import load_model
from urproto.rtde.codec import RequestProtocol, RTDEDecoder, SetupInputs, SetupOutputs, Start

PORTS = [
    "modbus",
    "dashboard",
    "primary",
    "secondary",
    "realtime",
    "rtde",
    "primary read-only",
    "secondary read-only",
    "realtime read-only",
    "interpreter",
    "gripper",
    "tool line",
]
MODBUS = bytes.fromhex("0001 0000 0006 ff 03 0080 007d")  # 125 registers
PERIODS = 13  # at least one primary state

rtde_package = st.builds(
    lambda kind, payload: struct.pack(">HB", 3 + len(payload), kind) + payload,
    st.sampled_from(b"VvOISPUM") | st.integers(0, 255),
    st.binary(max_size=40)
    | st.text("abc_0123,", max_size=30).map(str.encode)
    | st.sampled_from([b"\0\1", b"\0\2", b"timestamp,actual_q,", struct.pack(">d", 0.001) + b"actual_q"])
    | st.sampled_from([b"input_int_register_1", b"speed_slider_mask,speed_slider_fraction", b"\1" + b"\xff" * 12]),
)
script_piece = st.sampled_from(
    [
        b"def ",
        b"f",
        b"():",
        b"\n",
        b"end",
        b"if ",
        b"while ",
        b"True",
        b":",
        b'"',
        b"#",
        b"(",
        b"]",
        b"p[",
        b" ",
        b"1e999",
    ]
)
modbus_frame = st.builds(
    lambda function, data: struct.pack(">HHHBB", 1, 0, len(data) + 2, 255, function) + data,
    st.sampled_from([1, 2, 3, 4]) | st.integers(0, 255),
    st.builds(struct.pack, st.just(">HH"), st.integers(0, 700), st.integers(0, 130)) | st.binary(max_size=20),
)
gripper_piece = st.sampled_from(
    [b"SET", b"GET", b" ", b"ACT 1", b"POS", b"SID", b" 1e99", b" -0", b"\n", b" nan", b"FLT"]
)
line_piece = st.sampled_from([b"load ", b"popup ", b"\xc3(", b"robotmode", b" ", b"\r", b"\n", b"\0", b"addToLog x"])
garbage = (
    st.binary(max_size=300)
    | st.lists(rtde_package, max_size=12).map(b"".join)
    | st.lists(modbus_frame, max_size=8).map(b"".join)
    | st.lists(script_piece, max_size=30).map(b"".join)
    | st.lists(gripper_piece, max_size=12).map(b"".join)
    | st.lists(line_piece, max_size=20).map(b"".join)
)


class Witnesses:
    """A running arm, and one well-behaved client on each port."""

    def __init__(self) -> None:
        gripper = MODELS["robotiq-2f-85"]
        self.controller = Controller(ControllerConfig(model=load_model("ur3"), running=True, gripper=gripper))
        self.controller.tool_line.connect(EchoDevice())
        self.controller.tool_line.settings = SerialSettings(True)
        self.controller.signals.set_tool_voltage(24)
        servers = make_servers(self.controller, tool_line=True)
        self.servers: dict[str, PortServer] = {server.name: server for server in servers}
        self.clients = {name: MemoryClient(server) for name, server in self.servers.items()}
        rtde = self.clients["rtde"]
        rtde.feed(RequestProtocol(2).encode(1) + SetupOutputs(("timestamp", "actual_q"), 125.0).encode(2))
        rtde.feed(SetupInputs(("input_int_register_0",)).encode(2) + Start().encode(2))
        self.tick(2 * PERIODS)

    def tick(self, periods: int = PERIODS) -> dict[str, bytes]:
        for _ in range(periods):
            self.controller.tick()
        return {name: client.take() for name, client in self.clients.items()}

    def check(self) -> None:
        """Every client gets its answers, and the arm has not moved."""
        before = self.controller.snapshot
        self.clients["dashboard"].feed(b"robotmode\n")
        self.clients["gripper"].feed(b"GET DST\n")
        self.clients["modbus"].feed(bytes.fromhex("0001 0000 0006 ff 03 0100 0001"))
        got = self.tick()
        assert got["dashboard"] == b"Robotmode: RUNNING\n"
        assert got["gripper"] == b"DST 4\n"
        assert got["modbus"] == bytes.fromhex("0001 0000 0005 ff 03 02 0003"), "register 256: version 3"
        packages = RTDEDecoder().feed(got["rtde"])
        assert [len(package.payload) for package in packages] == [1 + 8 + 48] * PERIODS
        for name in ("realtime", "realtime read-only"):
            assert len(RealtimeDecoder().feed(got[name])) == PERIODS
        for name in ("primary", "secondary", "primary read-only", "secondary read-only"):
            messages = PrimaryDecoder(self.controller.version).feed(got[name])
            assert any(isinstance(message, RobotStateData) for message in messages)
        after = self.controller.snapshot
        assert after.actual_q == before.actual_q
        assert after.robot_mode == before.robot_mode
        assert after.safety_mode == before.safety_mode


@pytest.fixture(scope="module")
def witnesses() -> Witnesses:
    return Witnesses()


@pytest.mark.parametrize("port", PORTS)
@settings(max_examples=examples(20), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=garbage, chunk=st.sampled_from([1, 4096]))
def test_garbage(witnesses: Witnesses, port: str, data: bytes, chunk: int, caplog: pytest.LogCaptureFixture) -> None:
    caplog.clear()
    client = MemoryClient(witnesses.servers[port])
    client.feed(data, chunk)
    witnesses.tick(3)
    client.end()
    witnesses.tick(PERIODS)
    client.vanish()
    witnesses.check()
    crashes = [record for record in caplog.records if record.exc_info]
    assert not crashes, caplog.text


def test_a_flood_of_requests(witnesses: Witnesses) -> None:
    """More than one period can execute; no other client waits for it."""
    for port, data in (
        ("dashboard", b"robotmode\n"),
        ("secondary", b"x = 1\n"),
        ("rtde", b"\0\5V\0\2"),
        ("modbus", MODBUS),
        ("gripper", b"SET ACT 0\n"),
        ("tool line", b"0123456789"),
    ):
        client = MemoryClient(witnesses.servers[port])
        client.feed(data * 5_000)
        witnesses.check()
        client.vanish()
