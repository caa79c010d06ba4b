"""The memory of the robot's own Modbus server, as programs see it."""

import pytest

from emulator.fieldbus.modbus_io import PortError
from emulator.fieldbus.modbus_map import COILS, REGISTERS, read_coil, read_register
from emulator.lifecycle.safety import SafetyEvent
from tests.rows import each_row
from urproto.signals import CONFIGURABLE, STANDARD, TOOL


def word(rig, address: int) -> int:
    return read_register(rig.controller, address)


@each_row(("written", "read"), [("0", 0), ("32767", 32767), ("-2", -2), ("65535", -1), ("40000", -25536), ("12.9", 12)])
def test_general_purpose_registers(rig, written, read):
    rig.run(f"write_port_register(128, 5)\nwrite_port_register(255, {written})")
    assert rig.value("read_port_register(255)") == read
    assert rig.value("read_port_register(128)") == 5, "they outlive the program"


@pytest.mark.parametrize("call", ["write_port_register(128, 65536)", "write_port_register(128, -32769)"])
def test_words_out_of_range(rig, call):
    assert "-32768 to 65535" in rig.fault(call)


def test_outputs_as_words_and_masks(rig):
    signals = rig.controller.signals
    signals.set_digital_output(CONFIGURABLE, 3, True)
    rig.run("write_port_register(1, 774)")  # bits 1, 2, 8, 9
    assert signals.digital_outputs == 0b11_0000_1000_0000_0110
    rig.run("write_port_register(2, 257)\nwrite_port_register(3, 2)")
    assert word(rig, 1) == 0b01_0000_0101 | 1 << 9
    assert word(rig, 22) == 3
    rig.run("write_port_register(22, 2)\nwrite_port_register(31, 129)\nwrite_port_register(33, 1)")
    assert (word(rig, 22), word(rig, 31), word(rig, 1) & 0xFF) == (2, 128, 5)
    rig.run("write_port_register(32, 6)")
    assert word(rig, 31) == 0b10000110


def test_inputs(rig):
    for group, index in ((STANDARD, 4), (STANDARD, 5), (TOOL, 1), (CONFIGURABLE, 7)):
        rig.controller.signals.set_digital_input(group, index, True)
    assert (word(rig, 0), word(rig, 21), word(rig, 30)) == (48 | 1 << 9, 2, 128)
    assert [rig.value(f"read_port_bit({address})") for address in (3, 4, 9, 128, 135)] == [
        False,
        True,
        True,
        False,
        True,
    ]


def test_coils_of_outputs(rig):
    rig.run("write_port_bit(17, True)\nwrite_port_bit(40, True)\nwrite_port_bit(143, True)\nwrite_port_bit(144, True)")
    assert (word(rig, 1), word(rig, 31)) == (0b1_0000_0010, 0b1000_0001)
    rig.run("write_port_bit(32, False)\nwrite_port_bit(49, True)\nwrite_port_bit(50, False)\nwrite_port_bit(159, True)")
    assert (word(rig, 1), word(rig, 31)) == (0b1_0000_0000, 1)


def test_coils_shared_with_rtde_registers(rig):
    rig.run("write_port_bit(300, True)\nwrite_port_bit(427, True)\nwrite_output_boolean_register(5, True)")
    bank = rig.controller.registers.input
    assert [bank.get_bit(index) for index in (0, 1, 127)] == [True, False, True]
    assert rig.value("read_port_bit(505)")
    assert not rig.value("read_port_bit(627)")


def test_analog_signals(rig):
    signals = rig.controller.signals
    signals.analog_inputs[0] = 5.0
    rig.run("write_port_register(16, 65535)\nwrite_port_register(17, 1)\nwrite_port_register(7, 0)")
    signals.analog_inputs[1] = 0.012
    signals.tool_analog_inputs[0] = 12.0
    assert [word(rig, address) for address in (4, 5, 6, 7, 8, 16, 17, 18, 19)] == [
        32768, 1, 32768, 0, 65535, 65535, 1, 0, 0,
    ]  # fmt: skip
    assert signals.analog_output(0) == 10.0
    rig.run("write_port_register(20, 24)")
    assert (signals.tool_voltage, word(rig, 20)) == (24, 24)


@pytest.mark.parametrize("call", ["write_port_register(20, 13)", "write_port_register(17, 2)"])
def test_values_the_hardware_does_not_support(rig, call):
    assert "not" in rig.fault(call)


def test_state_of_the_arm(rig):
    snapshot = rig.controller.snapshot
    signed = [value - 0x10000 if value & 0x8000 else value for value in (word(rig, at) for at in range(400, 406))]
    for value, exact in zip(signed[:3], snapshot.actual_TCP_pose[:3], strict=True):
        assert value / 10000.0 == pytest.approx(exact, abs=6e-5)
    for value, exact in zip(signed[3:], snapshot.actual_TCP_pose[3:], strict=True):
        assert value / 1000.0 == pytest.approx(exact, abs=6e-4)
    for joint in range(6):
        turns = word(rig, 320 + joint)
        turns -= 0x10000 if turns & 0x8000 else 0
        angle = word(rig, 270 + joint) / 1000.0 + turns * 6.283185307
        assert angle == pytest.approx(snapshot.actual_q[joint], abs=1.1e-3)
    assert word(rig, 321) == 0xFFFF, "-1.5 rad is one turn below"
    assert (word(rig, 256), word(rig, 258), word(rig, 260), word(rig, 310)) == (5, 7, 1, 253)


def test_speeds_are_signed(rig):
    rig.start("speedj([0.5, -0.25, 0, 0, 0, 0], 2, 2)")
    rig.seconds(1.0)
    assert word(rig, 280) == pytest.approx(500, abs=2)
    assert word(rig, 281) == pytest.approx(0x10000 - 250, abs=2)


def test_flags_follow_the_safety_mode(rig):
    assert [word(rig, at) for at in (261, 262, 265, 266)] == [0, 0, 0, 1]
    rig.controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
    rig.tick()
    assert [word(rig, at) for at in (261, 262, 265, 266)] == [1, 0, 1, 3]


def test_uptime_is_latched(rig):
    assert word(rig, 2050) == 0
    rig.controller.step_count = 500 * (86400 + 2 * 3600 + 3 * 60 + 4)
    rig.run("write_port_register(2048, 1)")
    rig.seconds(0.5)
    assert [word(rig, at) for at in range(2050, 2054)] == [4, 3, 2, 1]
    assert 0 < word(rig, 2049) < 100


@each_row(
    ("call", "message"),
    [
        ("read_port_register(34)", "no register 34"),
        ("read_port_register(-1)", "no register -1"),
        ("read_port_register(2)", "register 2 of the Modbus server can only be written"),
        ("write_port_register(0, 1)", "register 0 of the Modbus server can only be read"),
        ("write_port_register(400, 1)", "can only be read"),
        ("read_port_bit(200)", "no coil 200"),
        ("write_port_bit(3, True)", "coil 3 of the Modbus server can only be read"),
        ("write_port_bit(500, True)", "can only be read"),
        ("read_port_bit(48)", "can only be written"),
    ],
)
def test_addresses_that_do_not_support_the_access(rig, call, message):
    assert message in rig.fault(call)


@pytest.mark.parametrize("model", ["ur3", "ur10e"])
def test_every_address_returns_a_word_in_any_state_of_the_arm(make_rig, model):
    rig = make_rig(model, None, False)
    assert all(cell.read or cell.write for cell in (*REGISTERS.values(), *COILS.values()))
    words = [word(rig, address) for address, cell in REGISTERS.items() if cell.read]
    assert len(words) > 200
    assert all(0 <= value <= 0xFFFF for value in words)
    assert {read_coil(rig.controller, address) for address, cell in COILS.items() if cell.read} == {False}


def test_errors_carry_a_modbus_exception_code(rig):
    with pytest.raises(PortError) as error:
        word(rig, 34)
    assert error.value.code == 2
