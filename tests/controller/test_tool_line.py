"""The serial line at the tool, in virtual time."""

import pytest

from emulator.commands.requests import ToolBytes
from emulator.controller import Controller
from emulator.devices.tool_line import AS_DELIVERED, EchoDevice, SerialSettings, ToolLine
from emulator.machine import ControllerConfig
from emulator.servers.primary_state import robot_state
from tests.rows import each_row
from tests.ticking import ticked
from urproto.robots import load_model

PERIOD_S = 0.002


def echoing(**settings: int) -> ToolLine:
    line = ToolLine(PERIOD_S)
    line.connect(EchoDevice())
    line.settings = SerialSettings(True, **settings)
    line.advance(powered=True)
    return line


def echoed(line: ToolLine, periods: int = 1, *, powered: bool = True) -> bytes:
    got = b""
    for _ in range(periods):
        line.advance(powered=powered)
        got += line.received
    return got


@each_row(
    ("settings", "expected"),
    [
        ({"baud_rate": 9600}, 960),
        ({"baud_rate": 115200}, 11520),
        ({"baud_rate": 9600, "parity": 2}, 9600 / 11),
        ({"baud_rate": 9600, "parity": 1, "stop_bits": 2}, 800),
    ],
)
def test_bytes_arrive_at_the_baud_rate(settings: dict[str, int], expected: float) -> None:
    line = echoing(**settings)
    sent = 4000
    line.send(bytes(sent))
    periods = 0
    got = b""
    while len(got) < sent:
        got += echoed(line)
        periods += 1
        assert periods < 5000
    assert sent / (periods * PERIOD_S) == pytest.approx(expected, rel=0.03)


def test_the_line_is_dead_unless_enabled_and_powered() -> None:
    line = echoing()
    line.send(b"one")
    assert echoed(line) == b"one"
    assert echoed(line, powered=False) == b""
    line.send(b"two")
    assert echoed(line, 5) == b"", "lost, not late"
    line.settings = AS_DELIVERED
    echoed(line)
    line.send(b"three")
    assert echoed(line, 5) == b""
    line.settings = SerialSettings(True)
    echoed(line)
    line.send(b"four")
    assert echoed(line) == b"four"


@pytest.fixture
def controller() -> Controller:
    controller = Controller(ControllerConfig(model=load_model("ur5e"), running=True))
    controller.tool_line.connect(EchoDevice())
    controller.tick()
    return controller


def run(controller: Controller, body: str) -> None:
    controller.programs.submit(f"def setup():\n{body}\nend\n")
    for _ in range(20):
        controller.tick()


def exchange(controller: Controller, data: bytes) -> bytes:
    controller.post(ToolBytes(data))
    return b"".join(ticked(controller).tool_bytes for _ in range(500))


def test_a_program_enables_the_line(controller: Controller) -> None:
    assert exchange(controller, b"nobody") == b""
    run(controller, "  set_tool_communication(True, 9600, 2, 2, 1.5, 3.5)")
    assert exchange(controller, b"no voltage") == b""
    run(controller, "  set_tool_voltage(24)")
    assert exchange(controller, b"hello") == b"hello"
    assert exchange(controller, b"") == b"", "once"
    run(controller, "  set_tool_communication(False, 9600, 2, 2, 1.5, 3.5)")
    assert exchange(controller, b"hello") == b""


def test_the_primary_interface_shows_the_line(controller: Controller) -> None:
    run(controller, "  set_tool_communication(True, 1000000, 1, 2, 2.5, 4.5)")
    state = robot_state(controller.snapshot, controller.model).tool_communication
    assert state is not None
    assert (state.enabled, state.baud_rate, state.parity, state.stop_bits) == (True, 1_000_000, 1, 2)
    assert (state.rx_idle_chars, state.tx_idle_chars) == (2.5, 4.5)


def test_excess_data_waits(controller: Controller) -> None:
    run(controller, "  set_tool_voltage(12)\n  set_tool_communication(True, 9600, 0, 1, 1.5, 3.5)")
    done: list[None] = []
    for _ in range(4):
        controller.post(ToolBytes(bytes(4096)), done.append)
    got = len(ticked(controller).tool_bytes)
    assert len(done) < 4
    got += sum(len(ticked(controller).tool_bytes) for _ in range(9000))
    assert len(done) == 4
    assert got == 4 * 4096
