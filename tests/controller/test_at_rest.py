"""Reported values of an arm at rest against recordings of simulators and arms, each with its source."""

from pathlib import Path

import pytest

from urproto.primary.framing import PrimaryDecoder
from urproto.primary.state import RobotStateData
from urproto.versions import PolyscopeVersion

GOLDEN = Path(__file__).parents[1] / "golden"
START = (-1.6007003, -1.7271003, -2.2029998, -0.8079999, 1.5951, -0.030999962)


def test_an_early_ur5_simulator(make):
    """hermajul/ur-rtde, exampleOutput.json: the primary interface of a UR5 simulator, by the documents of 3.8."""
    now = make("ur5", "3.8", running=True, initial_q=START).seconds(2.0)
    assert now.actual_current == pytest.approx((0.0, 1.4618257, 0.99084413, 0.1581097, 9.00854e-4, 0.0), abs=1e-5)
    assert now.actual_robot_current == pytest.approx(5.2233605, abs=1e-4)
    assert now.joint_temperatures == (40.0,) * 6
    assert now.board_temperature == 30.0
    assert now.tool_temperature == 0.0
    assert now.actual_robot_voltage == 48.0
    assert now.analog_io_types & 3 == 0
    assert now.tool_analog_input_types == 3
    assert now.standard_analog_output0 == now.standard_analog_output1 == 0.004
    assert now.target_speed_fraction == 1.0
    assert now.speed_scaling == 0.0
    assert now.actual_TCP_pose == pytest.approx(
        (-0.12011317, -0.43176317, 0.14607252, -0.001220983, 3.1162765, 0.038891915), abs=1e-6
    )


def test_an_early_ur10_simulator(make):
    """The official recorder's example, a UR10 simulator at the same pose: 10.6 A of supply current, 40 degC."""
    now = make("ur10", "3.8", running=True, initial_q=START).seconds(2.0)
    assert now.target_moment == pytest.approx((0.0, 42.5836, 30.0011, 2.8869, 0.0144, 0.0), abs=1e-3)
    assert now.actual_robot_current == pytest.approx(10.6, abs=0.05)
    assert now.joint_temperatures == (40.0,) * 6


def test_a_late_ur5e_simulator(make):
    """The golden capture of a 5.24 simulator: currents, analog ranges, box. (It reports no robot current.)"""
    lines = (GOLDEN / "robot_state_full_5.24.hex").read_text().splitlines()
    data = bytes.fromhex("".join(line for line in lines if not line.startswith("#")))
    (state,) = PrimaryDecoder(PolyscopeVersion(5, 24)).feed(data)
    assert isinstance(state, RobotStateData)
    joints, box = state.joints.joints, state.masterboard
    now = make("ur5e", "5.24", running=True, initial_q=tuple(joint.q_actual for joint in joints)).tick()
    assert now.actual_current == pytest.approx([joint.current for joint in joints], abs=2e-3)
    assert now.board_temperature == pytest.approx(box.board_temperature, abs=0.5)
    assert now.actual_robot_voltage == box.robot_voltage_48V
    assert now.analog_io_types & 3 == box.analog_input_range0 | box.analog_input_range1 << 1
    assert now.joint_temperatures == pytest.approx([joint.motor_temperature for joint in joints], abs=1.6)


@pytest.mark.parametrize("model", ["ur10", "ur5e"])
def test_supply_current_is_close_to_recorded_arms(make, model):
    """Recordings of arms at rest: 0.68 A of a UR10, 0.55 to 0.75 A of two e-Series arms, 0.72 A of a CB3 arm."""
    now = make(model, running=True, dynamic=True, initial_q=START).seconds(1.0)
    assert 0.4 < now.actual_robot_current < 0.9
