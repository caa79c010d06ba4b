"""The robot state of the primary interface, created from snapshots."""

from pathlib import Path

import pytest

from emulator.lifecycle.safety import SafetyEvent
from emulator.motion.reach import dexterity
from emulator.servers.primary_state import configuration_data, kinematics_info, robot_state
from tests.rows import each_row
from urproto.facts import Personality
from urproto.modes import ControlMode, RobotMode, SafetyMode
from urproto.primary.state import decode_robot_state, encode_robot_state
from urproto.robots import MODELS, load_model
from urproto.signals import STANDARD

GOLDEN = Path(__file__).resolve().parents[1] / "golden"


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
def test_the_state_survives_encoding_and_decoding(ready, full):
    data = encode_robot_state(robot_state(ready.tick(), ready.controller.model), ready.controller.version, full=full)
    decoded = decode_robot_state(data[5:])
    assert (decoded.configuration is not None) is full
    assert decoded.mode is not None
    assert decoded.mode.robot_mode == RobotMode.RUNNING
    assert len(data) < 4092  # the official client's buffer


@each_row("name", MODELS)
def test_configuration_data_of_every_model(name):
    model = load_model(name)
    configuration = configuration_data(model)
    assert configuration.qd_max == tuple(speed + 0.2 for speed in model.qd_max)
    assert kinematics_info(model).dh_a == model.dh.a
    assert kinematics_info(model).checksum == (0xFFFFFFFF,) * 6


GOLDEN_DEXTERITY = [
    # model, joint angles and dexterity of recorded states: simulators of a UR5e and a UR3e, a UR10 arm
    ("ur5e", "robot_state_full_5.24"),
    ("ur3e", "robot_state_steady_5.x"),
    ("ur10", "robot_state_steady_cb3"),
]


@each_row(("model", "name"), GOLDEN_DEXTERITY)
def test_dexterity_matches_recorded_states(model, name):
    lines = (GOLDEN / f"{name}.hex").read_text().splitlines()
    recorded = decode_robot_state(bytes.fromhex("".join(line for line in lines if not line.startswith("#")))[5:])
    q = tuple(joint.q_actual for joint in recorded.joints.joints)
    assert dexterity(load_model(model).dh, q) == pytest.approx(recorded.force_mode.dexterity, rel=1e-6)


def test_limits_of_a_ur5e_match_a_recording():
    lines = (GOLDEN / "robot_state_full_5.24.hex").read_text().splitlines()
    recorded = decode_robot_state(bytes.fromhex("".join(line for line in lines if not line.startswith("#")))[5:])
    ours = configuration_data(load_model("ur5e"))
    for name in ("qd_max", "qdd_max", "q_min", "q_max"):
        assert getattr(ours, name) == pytest.approx(getattr(recorded.configuration, name), abs=1e-9)
    same = ("v_joint_default", "a_joint_default", "v_tool_default", "a_tool_default", "eq_radius")
    same += ("masterboard_version", "controller_box", "robot_type", "sub_type")
    assert [getattr(ours, name) for name in same] == [getattr(recorded.configuration, name) for name in same]


def test_force_mode_shows_its_task_frame(make):
    rig = make("ur5e", running=True)
    assert robot_state(rig.tick(), rig.controller.model).force_mode.frame == (0.0,) * 6
    frame = "p[0.1, 0.2, 0.3, 0, 0, 0.5]"
    limits = "[0.1, 0.1, 0.1, 0.2, 0.2, 0.2]"
    rig.script(f"def press():\n  force_mode({frame}, [0,0,1,0,0,0], [0,0,5,0,0,0], 2, {limits})\n  sleep(1)\nend\n")
    now = rig.until(lambda now: now.control_mode == ControlMode.FORCE)
    assert robot_state(now, rig.controller.model).force_mode.frame == (0.1, 0.2, 0.3, 0.0, 0.0, 0.5)
    now = rig.until(lambda now: now.control_mode == ControlMode.POSITION)
    assert robot_state(now, rig.controller.model).force_mode.frame == (0.0,) * 6


def test_the_tools_serial_line_is_shown_as_set(make):
    rig = make("ur5e", running=True)
    rig.script("def serial():\n  set_tool_communication(True, 9600, 2, 2, 1.0, 3.0)\nend\n")
    now = rig.until(lambda now: now.tool_communication[0])
    shown = robot_state(now, rig.controller.model).tool_communication
    assert (shown.enabled, shown.baud_rate, shown.parity, shown.stop_bits) == (True, 9600, 2, 2)
    assert (shown.rx_idle_chars, shown.tx_idle_chars) == (1.0, 3.0)


def test_an_input_in_freedrive_is_shown(make):
    rig = make("ur5e", running=True)
    rig.controller.freedrive_inputs.watch_digital(STANDARD, 2)
    assert not robot_state(rig.tick(), rig.controller.model).additional.io_enabled_freedrive
    rig.controller.signals.set_digital_input(STANDARD, 2, True)
    assert robot_state(rig.tick(), rig.controller.model).additional.io_enabled_freedrive


@pytest.mark.parametrize(("model", "shown"), [("ur3", 0), ("ur5e", 1)])
def test_selector_and_enabling_device_match_recordings_of_each_series(make, model, shown):
    rig = make(model)
    board = robot_state(rig.tick(), rig.controller.model).masterboard
    assert (board.operational_mode_selector, board.three_position_device) == (shown, shown)


def test_temperatures_are_in_the_state(make):
    rig = make("ur3", running=True, personality=Personality.ARM)
    state = robot_state(rig.seconds(30.0), rig.controller.model)
    assert tuple(joint.motor_temperature for joint in state.joints.joints) == rig.now.joint_temperatures
    assert state.tool.tool_temperature == rig.now.tool_temperature > 24.0
    assert state.masterboard.board_temperature == rig.now.board_temperature > 24.0
