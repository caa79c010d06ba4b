"""Outputs, registers, TCPs, payload and mounting, with a fake robot."""

import asyncio
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from client.errors import FileError
from client.pendant.events import EventLog
from client.pendant.page import NotAcceptedError
from client.pendant.saved import Tools
from client.pendant.screens.io_registers import Bank, to_word
from client.pendant.settings import (
    analog_range,
    apply_gravity,
    apply_payload,
    apply_tcp,
    set_analog,
    set_digital,
    tilt_of,
)
from tests.rows import each_row
from urproto.errors import RobotRefused
from urproto.modes import AnalogDomain
from urproto.rtde.fields import INPUT_FIELDS, OUTPUT_FIELDS
from urproto.signals import CONFIGURABLE, TOOL
from urproto.versions import PolyscopeVersion
from urscript.polyscope.installation_file import gravity_of

E_5_26 = PolyscopeVersion(5, 26)


class Robot:
    """Records commands and applies what scripts set. busy: another client uses its RTDE inputs."""

    def __init__(self, busy: bool = False, accepts: bool = True, version: PolyscopeVersion = E_5_26):
        self.busy, self.accepts, self.version = busy, accepts, version
        self.statements = list[str]()
        self.written = list[dict[str, Any]]()
        self.values: dict[str, Any] = {"payload": 0.0, "payload_cog": (0.0,) * 3, "tcp_offset": (0.0,) * 6}
        self.unavailable: frozenset[str] = frozenset()
        self.connected = True
        self.core = SimpleNamespace(state=None)
        self.emulator = SimpleNamespace(available=False)
        self.log = EventLog()

    async def write(self, **inputs: Any) -> None:
        if self.busy:
            raise RobotRefused("RTDE recipe", "IN_USE")
        self.written.append(inputs)

    async def run_statements(self, *statements: str) -> None:
        self.statements += statements
        if not self.accepts:
            self.log.note("no such function", "error")
        elif "set_tcp" in statements[0]:
            self.values["tcp_offset"] = tuple(eval(statements[0][len("set_tcp(p") : -1]))
        elif "payload" in statements[0]:
            self.values["payload"], self.values["payload_cog"] = eval(statements[0][statements[0].index("(") :])
        elif "set_gravity" in statements[0]:
            self.values["target_gravity"] = eval(statements[0][len("set_gravity") :])

    async def next_frame(self) -> None:
        await asyncio.sleep(0)


async def test_output_is_switched_over_rtde_with_mask() -> None:
    robot = Robot()
    await set_digital(robot, CONFIGURABLE, 3, True)
    await set_digital(robot, TOOL, 1, False)
    assert robot.written == [
        {"configurable_digital_output_mask": 8, "configurable_digital_output": 8},
        {"tool_digital_output_mask": 2, "tool_digital_output": 0},
    ]
    await set_analog(robot, 1, AnalogDomain.VOLTAGE, 0.25)
    assert robot.written[-1] == {
        "standard_analog_output_mask": 2,
        "standard_analog_output_type": 2,
        "standard_analog_output_1": 0.25,
    }
    assert not robot.statements
    for package in robot.written:
        assert set(package) <= set(INPUT_FIELDS)


async def test_program_switches_output_if_rtde_inputs_are_in_use() -> None:
    robot = Robot(busy=True)
    await set_digital(robot, CONFIGURABLE, 3, True)
    await set_analog(robot, 0, AnalogDomain.CURRENT, 0.5)
    assert robot.statements == [
        "set_configurable_digital_out(3, True)",
        "set_analog_outputdomain(0, 0)",
        "set_standard_analog_out(0, 0.5)",
    ]


def test_analog_ranges() -> None:
    current, voltage = analog_range(AnalogDomain.CURRENT), analog_range(AnalogDomain.VOLTAGE)
    assert (current.ratio(4), current.ratio(12), current.ratio(20), voltage.ratio(2.5)) == (0, 0.5, 1, 0.25)
    with pytest.raises(ValueError, match="3 mA is outside of 4 to 20 mA"):
        current.ratio(3)
    with pytest.raises(ValueError, match="V"):
        voltage.ratio(math.nan)


@each_row("kind", ["bit", "int", "double"])
@each_row("half", ["fieldbus", "clients"])
def test_register_banks_match_rtde_fields(kind: str, half: str) -> None:
    bank = Bank(kind, half)
    for direction in ("input", "output"):
        assert set(bank.fields(direction)) <= set(OUTPUT_FIELDS)
        shown = bank.levels(direction, {}) if kind == "bit" else bank.texts(direction, {})
        assert len(shown) == bank.count
        assert set(shown) == {"-"}
    for index in (0, bank.count - 1):
        assert set(bank.input_values(index, 1, {})) <= set(INPUT_FIELDS)


def test_lower_booleans_are_bits_of_words() -> None:
    bank = Bank("bit", "fieldbus")
    values = {"input_bit_registers0_to_31": 0b101, "input_bit_registers32_to_63": 1 << 31}
    assert bank.levels("input", values) == "101" + "0" * 60 + "1"
    assert bank.input_values(1, True, values) == {"input_bit_registers0_to_31": 0b111}
    assert bank.input_values(63, False, values) == {"input_bit_registers32_to_63": 0}


def test_unfitting_register_values_are_rejected() -> None:
    for value in (1.5, 2.0**31, -(2.0**31) - 1):
        with pytest.raises(ValueError, match="32 bits"):
            Bank("int").input_values(0, value, {})
    assert Bank("int").input_values(2, -5.0, {}) == {"input_int_register_26": -5}
    assert [to_word(value) for value in (0, 65535, -1, -32768)] == [0, 65535, 65535, 32768]
    for value in (0.5, 65536, -32769):
        with pytest.raises(ValueError, match="whole numbers"):
            to_word(value)


async def test_tcp_is_applied_and_confirmed() -> None:
    robot: Any = Robot()
    await apply_tcp(robot, (0.0, 0.0, 0.1525, 0.0, 0.0, 1.5))
    assert robot.statements == ["set_tcp(p[0.0, 0.0, 0.1525, 0.0, 0.0, 1.5])"]


async def test_unaccepted_command_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("client.pendant.page._ACCEPT_TIMEOUT_S", 0.01)
    robot: Any = Robot(accepts=False)
    with pytest.raises(NotAcceptedError, match="did not accept this TCP: it says: no such function"):
        await apply_tcp(robot, (0.0, 0.0, 0.1, 0.0, 0.0, 0.0))


@each_row(("version", "function"), [((3, 15), "set_payload"), ((5, 9), "set_payload"), ((5, 10), "set_target_payload")])
async def test_payload_function_depends_on_version(version: tuple[int, int], function: str) -> None:
    robot: Any = Robot(version=PolyscopeVersion(*version))
    assert await apply_payload(robot, 1.5, (0.0, 0.01, 0.04))
    robot.unavailable = frozenset({"payload", "payload_cog"})
    assert not await apply_payload(robot, 1.5, (0.0, 0.01, 0.04))
    assert robot.statements == [f"{function}(1.5, [0.0, 0.01, 0.04])"] * 2


async def test_mounting_is_confirmed_if_version_reports_it() -> None:
    robot: Any = Robot()
    assert await apply_gravity(robot, (0.0, 9.82, 0.0))
    robot.unavailable = frozenset({"target_gravity"})
    assert not await apply_gravity(robot, (0.0, 0.0, 9.82))
    assert robot.statements[-1] == "set_gravity([0.0, 0.0, 9.82])"


def test_gravity_of_common_mountings() -> None:
    assert gravity_of(0.0, 0.0) == (0.0, 0.0, 9.82)
    assert gravity_of(math.pi, 0.0) == pytest.approx((0.0, 0.0, -9.82))
    assert gravity_of(math.pi / 2, 0.0) == pytest.approx((0.0, -9.82, 0.0))  # as programs of PolyScope have it
    for tilt, turn in ((0.3, -2.0), (3.0, 1.0), (0.0, 0.0), (math.pi / 2, 0.5)):
        assert tilt_of(gravity_of(tilt, turn)) == pytest.approx((tilt, turn))


def test_tcps_are_saved_to_file(tmp_path: Path) -> None:
    path = tmp_path / "new folder" / "tools.json"
    tools = Tools(path)
    tools.save(" my   gripper ", (0.0, 0.0, 0.15, 0.0, 0.0, 0.0))
    tools.save("b", [1, 2, 3, 4, 5, 6])
    tools.delete("not there")
    assert dict(Tools(path).content) == {"b": (1, 2, 3, 4, 5, 6), "my gripper": (0.0, 0.0, 0.15, 0.0, 0.0, 0.0)}
    tools.delete("b")
    assert list(Tools(path).content) == ["my gripper"]
    assert tools.version == 4
    for name, tcp in (("", (0,) * 6), ("x" * 61, (0,) * 6), ("a", (0,) * 5), ("a", (0, 0, math.nan, 0, 0, 0))):
        with pytest.raises(ValueError, match="TCP"):
            tools.save(name, tcp)


@each_row("content", ["nonsense", "[]", '{"a": [1, 2]}', '{"a": "b"}'])
def test_invalid_file_is_not_overwritten(tmp_path: Path, content: str) -> None:
    path = tmp_path / "tools.json"
    path.write_text(content)
    tools = Tools(path)
    assert tools.loaded == {}
    with pytest.raises(FileError, match="does not contain TCPs"):
        tools.save("a", (0.0,) * 6)
    assert path.read_text() == content
