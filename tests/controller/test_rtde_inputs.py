"""RTDE input packages: masks, registers, speed slider, external wrench."""

import math

import pytest

from emulator.fieldbus.rtde_inputs import _SETTERS
from urproto.robots.pose import rotvec_to_matrix
from urproto.rtde.fields import INPUT_FIELDS
from urproto.vectors import rotate


def test_every_input_variable_has_an_effect():
    assert set(_SETTERS) == set(INPUT_FIELDS)


@pytest.mark.parametrize(("group", "first"), [("standard", 0), ("configurable", 8), ("tool", 16)])
def test_masks_select_the_outputs(rig, group, first):
    rig.rtde(**{f"{group}_digital_output_mask": 0b11, f"{group}_digital_output": 0b01})
    assert rig.now.actual_digital_output_bits == 0b01 << first
    rig.rtde(**{f"{group}_digital_output_mask": 0b10, f"{group}_digital_output": 0b10})
    assert rig.now.actual_digital_output_bits == 0b11 << first
    rig.rtde(**{f"{group}_digital_output_mask": 0, f"{group}_digital_output": 0})
    assert rig.now.actual_digital_output_bits == 0b11 << first


def test_levels_apply_only_with_their_mask(rig):
    rig.rtde(standard_digital_output=0b101)
    assert rig.now.actual_digital_output_bits == 0
    rig.rtde(standard_digital_output_mask=0b111)
    assert rig.now.actual_digital_output_bits == 0b101
    rig.rtde(standard_digital_output=0)
    assert rig.now.actual_digital_output_bits == 0b101


def test_speed_slider_needs_its_mask(rig):
    rig.rtde(speed_slider_mask=0, speed_slider_fraction=0.2)
    assert rig.now.target_speed_fraction == 1.0
    rig.rtde(speed_slider_mask=1, speed_slider_fraction=0.2)
    assert rig.now.target_speed_fraction == 0.2
    rig.rtde(speed_slider_mask=1, speed_slider_fraction=7.0)
    assert rig.now.target_speed_fraction == 1.0
    rig.rtde(speed_slider_mask=1, speed_slider_fraction=math.nan)
    assert rig.now.target_speed_fraction == 1.0


def test_analog_outputs_by_mask_and_domain(rig):
    rig.rtde(
        standard_analog_output_mask=0b01,
        standard_analog_output_type=0b11,
        standard_analog_output_0=0.5,
        standard_analog_output_1=0.5,
    )
    assert rig.now.standard_analog_output0 == 5.0
    assert rig.now.standard_analog_output1 == 0.004
    assert rig.now.analog_io_types >> 2 == 0b01
    rig.rtde(
        standard_analog_output_mask=0b10,
        standard_analog_output_type=0b00,
        standard_analog_output_0=0.0,
        standard_analog_output_1=1.0,
    )
    assert rig.now.standard_analog_output0 == 5.0
    assert rig.now.standard_analog_output1 == 0.020


def test_registers_are_read_back_in_the_same_period(rig):
    rig.rtde(
        input_int_register_0=-5,
        input_int_register_47=2**31 - 1,
        input_double_register_24=1.5,
        input_bit_register_64=True,
        input_bit_registers32_to_63=0x8000_0001,
    )
    assert rig.now.input_int_registers[0] == -5
    assert rig.now.input_int_registers[47] == 2**31 - 1
    assert rig.now.input_double_registers[24] == 1.5
    assert rig.now.input_bit_registers == 1 << 64 | 1 << 63 | 1 << 32
    rig.rtde(input_bit_register_64=False)
    assert rig.now.input_bit_registers == 1 << 63 | 1 << 32
    rig.rtde(input_bit_registers32_to_63=0b0110)
    rig.tick()
    assert rig.now.input_bit_registers == 0b0110 << 32, "bits that are now 0 are cleared"


def test_the_time_of_the_last_refresh_is_recorded(rig):
    rig.rtde(input_int_register_3=1)
    at = rig.now.step
    rig.tick(5)
    assert rig.controller.rtde_refreshed["input_int_register_3"] == at


def test_an_unknown_name_changes_nothing(rig, caplog):
    rig.rtde(input_int_register_0=9, no_such_input=1)
    assert rig.now.input_int_registers[0] == 0
    assert "no_such_input" in caplog.text
    rig.rtde(input_int_register_0=9)
    assert rig.now.input_int_registers[0] == 9


def test_an_external_wrench_takes_effect_once_enabled(ready):
    ready.rtde(external_force_torque=(0.0, 0.0, -12.0, 0.0, 0.0, 0.0))
    assert ready.now.actual_TCP_force == (0.0,) * 6
    ready.controller.ft_input.enabled = True
    ready.tick()
    assert math.hypot(*ready.now.actual_TCP_force[:3]) == pytest.approx(12.0)
    assert ready.now.tcp_force_scalar == pytest.approx(12.0)
    ready.controller.ft_input.enabled = False
    assert ready.tick().actual_TCP_force == (0.0,) * 6


def test_an_external_wrench_acts_at_the_sensor_and_counts_at_the_tcp(ready):
    ready.script("set_tcp(p[0, 0, 0.3, 0, 0, 0])")
    ready.rtde(external_force_torque=(10.0, 0.0, 0.0, 0.0, 0.0, 0.0))  # in flange axes
    ready.controller.ft_input.enabled = True
    ready.controller.ft_input.measuring_offset = (0.0, 0.0, 0.1)
    ready.tick(2)
    arm = ready.controller.arm
    assert arm.tcp_offset[2] == 0.3
    x, y, z, tx, ty, tz = ready.controller.ft_input.wrench_base(arm)
    turn = rotvec_to_matrix(*arm.flange_pose[3:])
    assert (x, y, z) == pytest.approx(rotate(turn, (10.0, 0.0, 0.0)))
    # the sensor is 0.2 m behind the TCP: (0, 0, -0.2) x (10, 0, 0)
    assert (tx, ty, tz) == pytest.approx(rotate(turn, (0.0, -2.0, 0.0)))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_non_finite_inputs_are_refused_and_reported_once(ready, bad):
    ready.rtde(input_double_register_24=1.5, speed_slider_fraction=0.5, speed_slider_mask=1)
    ready.rtde(standard_analog_output_mask=1, standard_analog_output_0=0.5)
    before = ready.now.standard_analog_output0
    for _ in range(3):
        ready.rtde(input_double_register_24=bad, speed_slider_fraction=bad, speed_slider_mask=1)
        ready.rtde(standard_analog_output_mask=1, standard_analog_output_0=bad)
        ready.rtde(external_force_torque=(bad,) * 6)
    assert ready.now.input_double_registers[24] == 1.5
    assert ready.now.target_speed_fraction == 0.5
    assert ready.now.standard_analog_output0 == before
    rejections = [line for line in ready.controller.messages.history if "is rejected" in line]
    assert len(rejections) == 4


def test_an_implausible_wrench_is_refused(ready):
    ready.script("ft_rtde_input_enable(True)")
    ready.rtde(external_force_torque=(0.0, 0.0, -12.0, 0.0, 0.0, 0.0))
    ready.rtde(external_force_torque=(1e155, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert math.hypot(*ready.tick(2).actual_TCP_force[:3]) == pytest.approx(12.0)
