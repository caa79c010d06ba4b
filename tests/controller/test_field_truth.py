"""Every RTDE output is truthful: it follows a described situation, or is constant for a reason.

A situation changes the controller and gives the snapshots before and after; a row says which
fields it must change, and how. ``test_every_field_is_in_a_table`` checks the table against the
registry, ``test_constant_fields_are_constant`` the reasons against every situation.
"""

import math
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest

from emulator.lifecycle.safety import SafetyEvent
from emulator.robot.electrics import ROOM_C, Thermals
from emulator.snapshot import Snapshot
from tests.rows import each_row
from urproto import facts
from urproto.facts import Personality
from urproto.modes import JointMode, RobotMode, RuntimeState, SafetyMode, SafetyStatus, ToolMode
from urproto.rtde.fields import OUTPUT_FIELDS
from urproto.versions import PolyscopeVersion

Make = Callable[..., Any]
Seen = tuple[Snapshot, Snapshot]

MOVE = "def move():\n  movej([0.5, -1.0, 1.2, -1.4, -1.2, 0.7], a=2, v=1)\nend\n"
SETTINGS = """def settings():
  set_tcp(p[0, 0, 0.1, 0, 0, 0])
  set_target_payload(1.5, [0.01, 0.02, 0.05], [0.01, 0.02, 0.03, 0.001, 0.002, 0.003])
  set_gravity([0, 4.0, 8.0])
  set_base_acceleration([0.1, 0.2, 0.3])
  set_tool_voltage(24)
  set_tool_output_mode(1)
  set_tool_digital_output_mode(0, 2)
  set_tool_digital_output_mode(1, 3)
  set_standard_digital_out(3, True)
  set_configurable_digital_out(2, True)
  set_analog_outputdomain(0, 1)
  set_standard_analog_out(0, 0.5)
  set_standard_analog_out(1, 0.25)
  set_tool_analog_input_domain(0, 0)
end
"""
REGISTERS = """def registers():
  i = 0
  while i < 48:
    write_output_integer_register(i, i + 1)
    write_output_float_register(i, i + 0.5)
    i = i + 1
  end
  i = 0
  while i < 128:
    write_output_boolean_register(i, True)
    i = i + 1
  end
end
"""


def a_second_passes(make: Make) -> Seen:
    rig = powered_rig(make)
    before = rig.tick()
    rig.controller.execution_time_ms = 0.25
    return before, rig.seconds(1.0)


def the_arm_is_switched_on(make: Make) -> Seen:
    rig = make("ur5e", "5.26", personality=Personality.ARM)
    before = rig.tick()
    rig.request("brake release")
    return before, rig.until(lambda now: now.robot_mode is RobotMode.RUNNING)


def the_arm_warms_up(make: Make) -> Seen:
    rig = powered_rig(make)
    return rig.tick(), rig.seconds(20.0)


def a_program_moves_the_arm(make: Make) -> Seen:
    rig = powered_rig(make)
    before = rig.tick()
    rig.script(MOVE)
    return before, rig.until(lambda now: min(map(abs, now.actual_qd)) > 0.01 and any(now.target_qdd))


def a_tool_path_is_too_much_for_the_joints(make: Make) -> Seen:
    rig = powered_rig(make, initial_q=(0.0, -1.4, 1.6, -1.7, -0.25, 0.0))
    rig.script(
        "def past():\n  p = get_actual_tcp_pose()\n  p[0] = p[0] + 0.3\n  p[1] = p[1] + 0.15\n"
        "  movel(p, a=3, v=1)\nend\n"
    )
    before = rig.until(lambda now: now.program_running and any(now.actual_qd))
    slowest = before
    while rig.tick().program_running:
        slowest = min(slowest, rig.now, key=lambda now: now.speed_scaling)
    return before, slowest


def the_arm_brakes(make: Make) -> Seen:
    rig = powered_rig(make)
    before = rig.tick()
    rig.script("def drop():\n  movej([0, 0.3, 0, -1.57, 0, 0], a=10, v=3)\nend\n")
    rig.until(lambda now: now.program_running)
    return before, rig.until(lambda now: not now.program_running)


def something_pushes_the_tool(make: Make) -> Seen:
    rig = powered_rig(make)
    rig.controller.motion.target.q = (0.3, -1.2, 1.0, -1.4, -1.0, 0.2)
    before = rig.tick()
    rig.controller.external_wrench = (12.0, -7.0, 5.0, 0.3, 0.2, 0.1)
    return before, rig.tick()


def a_protective_stop(make: Make) -> Seen:
    rig = powered_rig(make)
    before = rig.tick()
    rig.controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
    return before, rig.tick()


def the_slider_is_moved(make: Make) -> Seen:
    rig = powered_rig(make)
    return rig.tick(), rig.rtde(speed_slider_mask=1, speed_slider_fraction=0.3)


def a_script_changes_settings(make: Make) -> Seen:
    rig = powered_rig(make)
    before = rig.tick()
    rig.script(SETTINGS)
    return before, rig.until(lambda now: now.analog_io_types != before.analog_io_types and not now.program_running)


def a_script_writes_registers(make: Make) -> Seen:
    rig = powered_rig(make)
    before = rig.tick()
    rig.script(REGISTERS)
    return before, rig.until(lambda now: bool(now.output_bit_registers >> 127))


def a_client_writes_registers(make: Make) -> Seen:
    rig = powered_rig(make)
    before = rig.tick()
    values: dict[str, Any] = {f"input_int_register_{i}": i + 1 for i in range(48)}
    values |= {f"input_double_register_{i}": i + 0.5 for i in range(48)}
    values |= {f"input_bit_register_{i}": True for i in range(64, 128)}
    values |= {"input_bit_registers0_to_31": 0xFFFFFFFF, "input_bit_registers32_to_63": 0xFFFFFFFF}
    return before, rig.rtde(**values)


def signals_come_in(make: Make) -> Seen:
    rig = powered_rig(make, encoder_speeds=(1000.0, -1000.0))
    before = rig.tick()
    signals = rig.controller.signals
    signals.digital_inputs = 0x20F05
    signals.analog_inputs = [1.5, 2.5]
    signals.tool_analog_inputs = [3.5, 4.5]
    pulses = "encoder_enable_pulse_decode({0}, 1, {1}, {2})"
    rig.script(f"def pulses():\n  {pulses.format(0, 8, 9)}\n  {pulses.format(1, 10, 11)}\nend\n")
    return before, rig.seconds(0.2)


def powered_rig(make: Make, **config: Any) -> Any:
    """An arm with the properties of a real one: a simulator measures neither voltages nor temperatures."""
    return make("ur5e", "5.26", running=True, personality=Personality.ARM, **config)


def differs(before: Any, after: Any) -> bool:
    return after != before


def grows(before: Any, after: Any) -> bool:
    if isinstance(before, tuple):
        return all(b < a for b, a in zip(before, after, strict=True))
    return after > before


def becomes(value: Any) -> Callable[[Any, Any], bool]:
    return lambda before, after: before != after == value


def near(value: float | tuple[float, ...]) -> Callable[[Any, Any], bool]:
    return lambda before, after: before != after == pytest.approx(value)


def all_differ(before: Any, after: Any) -> bool:
    return all(b != a for b, a in zip(before, after, strict=True))


def registers(kind: str) -> dict[str, Callable[[Any, Any], bool]]:
    """What each register of one direction must show."""
    rows: dict[str, Callable[[Any, Any], bool]] = {}
    for index in range(48):
        rows[f"{kind}_int_register_{index}"] = becomes(index + 1)
        rows[f"{kind}_double_register_{index}"] = becomes(index + 0.5)
    rows |= {f"{kind}_bit_register_{index}": becomes(True) for index in range(64, 128)}
    return rows | {f"{kind}_bit_registers{bits}": becomes(0xFFFFFFFF) for bits in ("0_to_31", "32_to_63")}


Situation = Callable[[Make], Seen]
TABLE: dict[Situation, dict[str, Callable[[Any, Any], bool]]] = {
    a_second_passes: {
        "timestamp": lambda before, after: after - before == pytest.approx(1.0),
        "control_step": lambda before, after: after - before == 500,
        "actual_execution_time": becomes(0.25),
        "actual_robot_energy_consumed": lambda before, after: 5.0 < after - before < 200.0,
    },
    the_arm_is_switched_on: {
        "robot_mode": becomes(RobotMode.RUNNING),
        "joint_mode": becomes((JointMode.RUNNING,) * 6),
        "tool_mode": becomes(ToolMode.RUNNING),
        "robot_status_bits": becomes(1),
        "actual_robot_voltage": becomes(48.0),
        "actual_robot_current": lambda before, after: before == 0.0 < 0.2 < after < 3.0,
        "actual_joint_voltage": lambda before, after: not any(before) and all(46.0 < volts < 48.0 for volts in after),
        "actual_current": differs,
        "target_current": differs,
        "target_moment": differs,
        "joint_control_output": differs,
    },
    the_arm_warms_up: {"joint_temperatures": grows, "tool_temperature": grows},
    a_program_moves_the_arm: {
        **dict.fromkeys(("target_q", "actual_q", "target_qd", "actual_qd", "target_qdd"), all_differ),
        **dict.fromkeys(("target_current", "actual_current", "joint_control_output", "target_moment"), all_differ),
        **dict.fromkeys(("actual_TCP_pose", "target_TCP_pose", "actual_TCP_speed", "target_TCP_speed"), all_differ),
        **dict.fromkeys(("actual_TCP_acceleration", "target_TCP_acceleration"), differs),
        **dict.fromkeys(("elbow_position", "elbow_velocity", "actual_tool_accelerometer"), differs),
        "actual_current_as_torque": all_differ,
        "target_base_wrench": differs,
        "actual_momentum": grows,
        "actual_robot_current": differs,
        "actual_joint_voltage": differs,
        "runtime_state": becomes(RuntimeState.PLAYING),
        "script_control_line": becomes(2),
        "speed_scaling": becomes(1.0),
        "robot_status_bits": becomes(3),
    },
    a_tool_path_is_too_much_for_the_joints: {"speed_scaling": lambda before, after: before == 1.0 > after > 0.0},
    the_arm_brakes: {"actual_robot_braking_energy_dissipated": grows},
    something_pushes_the_tool: {
        "actual_TCP_force": becomes((12.0, -7.0, 5.0, 0.3, 0.2, 0.1)),
        "tcp_force_scalar": near(math.sqrt(218.0)),
        "ft_raw_wrench": differs,
        "wrench_calc_from_currents": differs,
        "actual_current": differs,
        "actual_current_as_torque": differs,
        "collision_detection_ratio": lambda before, after: before == 0.0 < after < 1.0,
    },
    a_protective_stop: {
        "safety_mode": becomes(SafetyMode.PROTECTIVE_STOP),
        "safety_status": becomes(SafetyStatus.PROTECTIVE_STOP),
        "safety_status_bits": becomes(1 << 2 | 1 << 10),
    },
    the_slider_is_moved: {"target_speed_fraction": becomes(0.3)},
    a_script_changes_settings: {
        "tcp_offset": becomes((0.0, 0.0, 0.1, 0.0, 0.0, 0.0)),
        "payload": becomes(1.5),
        "payload_cog": becomes((0.01, 0.02, 0.05)),
        "payload_inertia": becomes((0.01, 0.02, 0.03, 0.001, 0.002, 0.003)),
        "target_gravity": becomes((0.0, 4.0, 8.0)),
        "target_base_acceleration": becomes((0.1, 0.2, 0.3, 0.0, 0.0, 0.0)),
        "tool_output_voltage": becomes(24),
        "tool_output_mode": becomes(1),
        "tool_digital_output0_mode": becomes(2),
        "tool_digital_output1_mode": becomes(3),
        "tool_analog_input_types": becomes(0b10),
        "actual_digital_output_bits": becomes(1 << 3 | 1 << 10),
        "actual_configurable_digital_output_bits": becomes(1 << 2),
        "analog_io_types": becomes(0b0111),
        "standard_analog_output0": near(5.0),
        "standard_analog_output1": near(0.008),
        "ft_raw_wrench": differs,
    },
    a_script_writes_registers: registers("output"),
    a_client_writes_registers: registers("input"),
    signals_come_in: {
        "actual_digital_input_bits": becomes(0x20F05),
        "actual_configurable_digital_input_bits": becomes(0x0F),
        "standard_analog_input0": becomes(1.5),
        "standard_analog_input1": becomes(2.5),
        "tool_analog_input0": becomes(3.5),
        "tool_analog_input1": becomes(4.5),
        "encoder0_raw": lambda before, after: after > before,
        "encoder1_raw": lambda before, after: after < before,
    },
}

CONSTANT = {
    "actual_main_voltage": "the supply of the box holds its voltage",
    "actual_current_window": "the windows of collision detection are not published: a guess that does not move",
    "target_execution_time": "the control period",
    "io_current": "nothing is connected to the inputs and outputs",
    "tool_output_current": "nothing is connected to the tool",
    "tool_output_current_2": "e-Series flanges have one supply",
    "tool_output_voltage_2": "e-Series flanges have one supply",
    "euromap67_input_bits": "there is no Euromap 67 interface",
    "euromap67_output_bits": "there is no Euromap 67 interface",
    "euromap67_24V_voltage": "there is no Euromap 67 interface",
    "euromap67_24V_current": "there is no Euromap 67 interface",
    "joint_position_deviation_ratio": "the arm is ideal: it is where it is told to be",
    "time_scale_source": "the numbering of the limiters is not published",
}

ROWS = [(situation, name) for situation, rows in TABLE.items() for name in rows]
seen = cache(lambda situation, make: situation(make))


@each_row(("situation", "name"), ROWS, ids=[f"{s.__name__}-{name}" for s, name in ROWS])
def test_field_follows_the_situation(situation: Situation, name: str, make: Make) -> None:
    before, after = (OUTPUT_FIELDS[name].read(snapshot) for snapshot in seen(situation, make))
    assert TABLE[situation][name](before, after), f"{before} became {after}"


def test_every_field_is_in_a_table() -> None:
    live = {name for _, name in ROWS}
    assert not live & set(CONSTANT)
    assert live | set(CONSTANT) == set(OUTPUT_FIELDS)


@each_row("name", CONSTANT)
def test_constant_fields_are_constant(name: str, make: Make) -> None:
    values = [OUTPUT_FIELDS[name].read(snapshot) for situation in TABLE for snapshot in seen(situation, make)]
    assert all(a == b for a, b in pairwise(values)), CONSTANT[name]


def test_the_base_carries_the_weight_of_arm_and_payload(make: Make) -> None:
    rig = powered_rig(make)
    rig.script("sec load():\n  set_target_payload(2, [0, 0, 0])\nend\n")
    before, after = rig.now, rig.tick(3)
    masses = sum(link.mass_kg for link in rig.controller.model.links)
    assert before.target_base_wrench[:3] == pytest.approx((0.0, 0.0, -9.82 * masses), abs=1e-9)
    assert after.target_base_wrench[2] == pytest.approx(-9.82 * (masses + 2.0))


def test_joints_warm_up_to_recorded_temperatures_and_cool_down_when_off() -> None:
    thermals = Thermals(facts.Situation(PolyscopeVersion(3, 15), "ur5", Personality.ARM))
    holding = (0.30, 6.02, 3.92, 0.41, -0.10, 0.08)  # A, of the captured arm
    for _ in range(6 * 3600):
        thermals.advance(SimpleNamespace(actual_current=holding), 1.0, powered=True)
    captured = (32.4, 33.5, 35.2, 37.4, 39.8, 41.3)
    assert thermals.joints == pytest.approx(captured, abs=1.5)
    assert thermals.box == pytest.approx(37.3, abs=0.5)
    for _ in range(6 * 3600):
        thermals.advance(SimpleNamespace(actual_current=(0.0,) * 6), 1.0, powered=False)
    assert thermals.joints == pytest.approx((ROOM_C,) * 6, abs=0.1)
