"""Registers both ways, outputs by mask, the speed slider."""

import pytest
from waiting import wait_until

from client.primary import STOP_PROGRAM

DIGITAL = ["standard_digital_output_mask", "standard_digital_output"]
ANALOG = [
    "standard_analog_output_mask",
    "standard_analog_output_type",
    "standard_analog_output_0",
    "standard_analog_output_1",
]
SLIDER = ["speed_slider_mask", "speed_slider_fraction"]
VOLTAGE = 1  # domain of an analog output: bit 0 is output 0


@pytest.mark.moves
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("input_int_register_25", -(2**31)),
        ("input_int_register_25", 7),
        ("input_double_register_25", -0.125),
        ("input_bit_register_65", True),
    ],
)
def test_input_registers_are_read_back(robot, name, value):
    with robot.rtde(["timestamp", name], [[name]]) as rtde:
        rtde.write(**{name: value})
        wait_until(rtde, lambda state: state[name] == value, 1.0)


@pytest.mark.moves
def test_a_program_reads_input_and_writes_output_registers(running):
    lines = (
        "i = read_input_integer_register(26)",
        "d = read_input_float_register(26)",
        "b = read_input_boolean_register(66)",
        "write_output_integer_register(26, i + 1)",
        "write_output_float_register(26, d * 2)",
        "write_output_boolean_register(66, not b)",
    )
    outputs = ["output_int_register_26", "output_double_register_26", "output_bit_register_66"]
    inputs = [name.replace("output", "input") for name in outputs]
    with running.rtde(["timestamp", *outputs, *inputs], [inputs]) as rtde, running.primary() as primary:
        values = {"input_int_register_26": 41, "input_double_register_26": 0.25, "input_bit_register_66": False}
        rtde.write(**values)
        wait_until(rtde, lambda state: all(state[name] == value for name, value in values.items()), 1.0)
        primary.run(primary.core.execute("\n".join(lines)))
        state = wait_until(rtde, lambda state: state["output_int_register_26"] == 42, 1.0)
    assert state["output_double_register_26"] == 0.5
    assert bool(state["output_bit_register_66"]) is True


@pytest.mark.moves
def test_only_masked_outputs_change(running):
    with running.rtde(["timestamp", "actual_digital_output_bits"], [DIGITAL]) as rtde:
        before = rtde.latest()["actual_digital_output_bits"]
        others = before & ~0b11
        for pattern in (0b01, 0b10, before & 0b11):
            rtde.write(standard_digital_output_mask=0b11, standard_digital_output=pattern)
            state = wait_until(rtde, lambda state: state["actual_digital_output_bits"] & 0b11 == pattern, 1.0)  # noqa: B023 - waited for at once
            assert state["actual_digital_output_bits"] & ~0b11 == others
        rtde.write(standard_digital_output=0xFF ^ (before & 0xFF))  # no mask: nothing happens
        rtde.write(standard_digital_output_mask=0b1, standard_digital_output=before & 0xFF)
        for _ in range(5):
            assert rtde.receive()["actual_digital_output_bits"] == before


@pytest.mark.moves
def test_a_program_switches_outputs(running):
    with running.rtde(["timestamp", "actual_digital_output_bits"]) as rtde, running.primary() as primary:
        before = bool(rtde.latest()["actual_digital_output_bits"] & 1)
        for level in (not before, before):
            primary.run(primary.core.send_script(f"set_standard_digital_out(0, {level})"))
            wait_until(rtde, lambda state: bool(state["actual_digital_output_bits"] & 1) is level, 1.0)  # noqa: B023


@pytest.mark.moves
def test_an_analog_output_as_a_fraction_of_ten_volts(running):
    outputs = ["timestamp", "standard_analog_output0", "analog_io_types"]
    with running.rtde(outputs, [ANALOG]) as rtde:
        for share in (0.5, 0.0):
            rtde.write(
                standard_analog_output_mask=1, standard_analog_output_type=VOLTAGE, standard_analog_output_0=share
            )
            wait_until(rtde, lambda state: abs(state["standard_analog_output0"] - 10 * share) < 0.05, 1.0)  # noqa: B023
        assert rtde.latest()["analog_io_types"] & 0b100  # AO0 is a voltage


@pytest.mark.moves
def test_the_speed_slider(running):
    with running.rtde(["timestamp", "target_speed_fraction"], [SLIDER]) as rtde:
        before = rtde.latest()["target_speed_fraction"]
        for fraction in (0.5, before):
            rtde.write(speed_slider_mask=1, speed_slider_fraction=fraction)
            wait_until(rtde, lambda state: state["target_speed_fraction"] == pytest.approx(fraction, abs=1e-6), 1.0)  # noqa: B023


@pytest.mark.moves
def test_registers_outlive_a_program(running):
    with running.rtde(["timestamp", "output_int_register_27"]) as rtde, running.primary() as primary:
        primary.run(primary.core.execute("write_output_integer_register(27, 5)"))
        wait_until(rtde, lambda state: state["output_int_register_27"] == 5, 1.0)
        primary.run(primary.core.execute("write_output_integer_register(27, 0)"))
        primary.run(primary.core.command(STOP_PROGRAM))
        wait_until(rtde, lambda state: state["output_int_register_27"] == 0, 1.0)
