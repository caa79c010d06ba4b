"""The robot state of the primary interface, built from snapshots."""

import pytest

from emulator.lifecycle.safety import SafetyEvent
from emulator.reporting.primary_state import configuration_data, kinematics_info, robot_state
from urproto.modes import RobotMode, SafetyMode
from urproto.primary.state import decode_robot_state, encode_robot_state
from urproto.robots import MODELS, load_model


def test_state_of_a_running_arm(ready):
    ready.tick()
    state = robot_state(ready.now, ready.controller.model)
    assert state.mode is not None
    assert state.mode.timestamp_us == ready.now.step * 8000
    assert state.mode.robot_mode == RobotMode.RUNNING
    assert state.mode.robot_power_on
    assert state.mode.real_robot_connected
    assert not state.mode.program_running
    assert state.joints is not None
    assert tuple(joint.q_actual for joint in state.joints.joints) == ready.now.actual_q
    assert state.cartesian is not None
    assert state.cartesian.pose_base_tcp == ready.now.actual_TCP_pose


def test_stops_show_in_the_mode_data(ready):
    ready.controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
    state = robot_state(ready.tick(), ready.controller.model)
    assert state.mode is not None
    assert (state.mode.protective_stopped, state.mode.emergency_stopped) == (True, False)
    assert state.masterboard is not None
    assert state.masterboard.safety_mode == SafetyMode.PROTECTIVE_STOP
    ready.controller.safety_event(SafetyEvent.SYSTEM_EMERGENCY_STOP)
    state = robot_state(ready.tick(), ready.controller.model)
    assert state.mode is not None
    assert (state.mode.protective_stopped, state.mode.emergency_stopped) == (False, True)


@pytest.mark.parametrize("full", [True, False])
def test_encodes_and_decodes(ready, full):
    data = encode_robot_state(robot_state(ready.tick(), ready.controller.model), ready.controller.version, full=full)
    decoded = decode_robot_state(data[5:])
    assert (decoded.configuration is not None) is full
    assert decoded.mode is not None
    assert decoded.mode.robot_mode == RobotMode.RUNNING
    assert len(data) < 4092  # the official client's buffer


@pytest.mark.parametrize("name", MODELS)
def test_every_model_describes_itself(name):
    model = load_model(name)
    configuration = configuration_data(model)
    assert configuration.qd_max == tuple(speed + 0.2 for speed in model.qd_max)
    assert kinematics_info(model).dh_a == model.dh.a
    assert kinematics_info(model).checksum == (0xFFFFFFFF,) * 6
