"""Clock, base light, analog ranges and shutdown."""

import math

import pytest

from emulator.controller import Controller
from emulator.io.signals import BaseLight
from emulator.machine import ControllerConfig
from tests.rows import each_row
from urproto.modes import AnalogDomain, RobotMode
from urproto.robots import load_model


def test_uptime_and_wall_clock_advance_together(rig):
    rig.start("global a = time(0)\nglobal b = time(2)\nsleep(1.5)\nglobal c = time()\nglobal d = time(2)\nsleep(1)")
    rig.seconds(2)
    found = {name: rig.controller.programs.variables[name].members for name in "abcd"}
    moments = {name: value["sec"] * 10**9 + value["nanosec"] for name, value in found.items()}
    assert moments["c"] - moments["a"] == moments["d"] - moments["b"] == 1_500_000_000
    assert all(0 <= value["nanosec"] < 10**9 for value in found.values())
    started = moments["b"] - moments["a"] + 41 * 10**9
    assert started == 1_704_067_200 * 10**9  # the default: 2024-01-01 00:00:00 GMT


def test_the_wall_clock_starts_at_the_configured_time():
    controller = Controller(ControllerConfig(model=load_model("ur5e"), wall_clock_s=1_800_000_000.25))
    for _ in range(500):
        controller.tick()
    assert controller.wall_clock_ns == 1_800_000_001_250_000_000
    assert controller.uptime_ns == 42 * 10**9


def test_the_reserved_clock_is_refused(rig):
    assert "mode must be 0" in rig.fault("time(1)")


@pytest.mark.parametrize(
    ("setter", "getter", "first", "then"),
    [
        ("force_mode_set_damping", "force_mode_get_damping", 0.005, 0.5),
        ("force_mode_set_gain_scaling", "force_mode_get_gain_scaling", 1.0, 1.5),
        ("motion_version_set", "motion_version_get", None, 2),
    ],
)
def test_a_getter_returns_the_value_that_was_set(rig, setter, getter, first, then):
    assert first is None or rig.value(f"{getter}()") == first
    rig.run(f"{setter}({then})\ntextmsg({getter}() == {then})")
    assert rig.texts == ["True"]


@pytest.mark.parametrize(("model", "after"), [("ur3", 6.0 - 2 * math.pi), ("ur5e", 6.0)])
def test_the_revolution_counter_of_an_unlimited_wrist_is_reset(make_rig, model, after):
    rig = make_rig(model, None)
    rig.run("movej([0, -1.5, 1.5, -1.6, -1.57, 6], a=10, v=3)\nsleep(0.1)")
    rig.run("reset_revolution_counter()")
    assert rig.value("get_actual_joint_positions()")[5] == pytest.approx(after)
    rig.run("reset_revolution_counter([0, 0, 0, 0, 0, 6])")
    assert rig.value("get_actual_joint_positions()")[5] == pytest.approx(6.0)


def test_the_base_light_of_a_large_arm(make_rig):
    rig = make_rig("ur20", "5.20")
    assert rig.controller.base_light == BaseLight("iec")
    rig.run("set_baselight_solid(255, 128, 0)")
    assert rig.controller.base_light == BaseLight("solid", (255, 128, 0))
    rig.run("set_baselight_off()")
    assert rig.controller.base_light == BaseLight("off")
    rig.run("set_baselight_iec()")
    assert rig.controller.base_light == BaseLight("iec")
    assert "0 to 255" in rig.fault("set_baselight_solid(256, 0, 0)")


def test_an_arm_without_a_base_light_refuses_the_command(rig):
    rig.run("set_baselight_solid(255, 0, 0)")
    assert rig.controller.base_light == BaseLight("iec")
    assert any("UR5e has no base light" in line for line in rig.controller.messages.history)


@pytest.mark.parametrize(
    ("port", "range_", "domain"),
    [
        (0, 0, AnalogDomain.VOLTAGE),
        (1, 2, AnalogDomain.VOLTAGE),
        (2, 1, AnalogDomain.VOLTAGE),
        (3, 0, AnalogDomain.VOLTAGE),
        (2, 2, AnalogDomain.CURRENT),
        (3, 2, AnalogDomain.CURRENT),
    ],
)
def test_an_analog_range_chooses_the_domain(rig, port, range_, domain):
    signals = rig.controller.signals
    domains = signals.tool_analog_input_domains if port > 1 else signals.analog_input_domains
    domains[port % 2] = AnalogDomain(1 - domain)
    rig.run(f"set_analog_inputrange({port}, {range_})")
    assert domains[port % 2] is domain


@each_row(("port", "range_"), [(0, 1), (1, 3), (2, 3), (4, 0), (-1, 0)])
def test_removed_analog_ranges_stop_the_program(rig, port, range_):
    assert rig.fault(f"set_analog_inputrange({port}, {range_})")


def test_powerdown_shuts_the_controller_down(rig):
    rig.start("powerdown()\nsleep(1)")
    rig.seconds(0.1)
    assert rig.controller.shutdown_requested
    assert rig.controller.snapshot.robot_mode is RobotMode.POWER_OFF


def test_safety_limits_are_checked_for_the_requested_solution(rig):
    assert rig.value("is_within_safety_limits(get_actual_tcp_pose())") is True
    assert rig.value("is_within_safety_limits(position=get_actual_tcp_pose(), qNear=[0,-1,1,-1,-1,0])") is True
    assert rig.value("is_within_safety_limits(p[3, 0, 0, 0, 0, 0])") is False
    assert rig.value("is_within_safety_limits([7, 0, 0, 0, 0, 0])") is False
