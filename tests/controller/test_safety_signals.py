"""Safety inputs, devices and outputs, the pendant's buttons, and the configuration shown by the interfaces."""

import math
from dataclasses import replace

import pytest

from emulator.lifecycle.safety import SafetyEvent
from emulator.safety.signals import SafetyDevice
from emulator.servers.primary_state import robot_state
from tests.commands import Jog, SetSafetyDevice, SetSafetyInput
from tests.rows import each_row
from urproto.modes import ControlMode, RobotMode, RobotStatusBits, RuntimeState, SafetyMode, SafetyStatus
from urproto.robots import load_model
from urproto.signals import CONFIGURABLE
from urscript.polyscope.safety_configuration import SafetyInput, SafetyOutput, factory_configuration

LONG = "def far():\n  movej([1.0, -1.0, 0.5, -1.0, 0.3, 0.2], a=1.0, v=0.5)\nend\n"
WAIT = "def wait():\n  sleep(100)\nend\n"


def wired(make, inputs=None, outputs=None, model="ur5e", **more):
    pins = {SafetyInput(name): pair for name, pair in (inputs or {}).items()}
    changed = {"inputs": pins, "outputs": outputs or {}, **{k: more.pop(k) for k in list(more) if k in _SETTINGS}}
    configuration = replace(factory_configuration(load_model(model)), **changed)
    rig = make(model, running=True, safety=configuration, **more)
    rig.tick()
    return rig


_SETTINGS = ("manual_high_speed", "safe_home")


def level(rig, pin, high):
    rig.controller.signals.set_digital_input(CONFIGURABLE, pin, high)
    return rig.tick()


def press(rig, device, active=True):
    rig.controller.post(SetSafetyDevice(device, active))
    return rig.tick()


def test_wired_inputs_start_in_their_safe_state(make):
    rig = wired(make, {SafetyInput.EMERGENCY_STOP: (0, 1), SafetyInput.REDUCED_MODE: (2, 3)})
    assert rig.now.safety_mode is SafetyMode.NORMAL
    assert rig.now.actual_configurable_digital_input_bits == 0b1111


@pytest.mark.parametrize("channel", [4, 5])
def test_either_channel_triggers_an_emergency_stop(make, channel):
    rig = wired(make, {SafetyInput.EMERGENCY_STOP: (4, 5)})
    rig.script(LONG)
    rig.seconds(0.5)
    assert level(rig, channel, False).safety_mode is SafetyMode.SYSTEM_EMERGENCY_STOP
    rig.until(lambda s: s.robot_mode is RobotMode.POWER_OFF, 1.0)
    assert level(rig, channel, True).safety_mode is SafetyMode.NORMAL


def test_without_a_reset_input_closing_the_safeguard_resumes_the_program(make):
    rig = wired(make)
    rig.script(LONG)
    rig.seconds(0.5)
    assert press(rig, SafetyDevice.SAFEGUARD).safety_mode is SafetyMode.SAFEGUARD_STOP
    rig.seconds(0.5)
    assert rig.now.runtime_state is RuntimeState.PAUSED
    assert press(rig, SafetyDevice.SAFEGUARD, False).safety_mode is SafetyMode.NORMAL
    rig.until(lambda s: s.runtime_state is RuntimeState.STOPPED)
    assert rig.now.actual_q == pytest.approx((1.0, -1.0, 0.5, -1.0, 0.3, 0.2), abs=1e-9)


def test_a_reset_input_that_is_high_already_resets_nothing(make):
    rig = wired(make, {SafetyInput.SAFEGUARD_RESET: (0, 1)})
    rig.controller.post(SetSafetyInput(SafetyInput.SAFEGUARD_RESET, True))
    press(rig, SafetyDevice.SAFEGUARD)
    assert press(rig, SafetyDevice.SAFEGUARD, False).safety_mode is SafetyMode.SAFEGUARD_STOP
    for high in (False, True):
        rig.controller.post(SetSafetyInput(SafetyInput.SAFEGUARD_RESET, high))
        rig.tick()
    assert rig.now.safety_mode is SafetyMode.NORMAL


def test_a_reset_while_the_safeguard_is_open_is_ignored(make):
    rig = wired(make, {SafetyInput.SAFEGUARD_RESET: (0, 1)})
    press(rig, SafetyDevice.SAFEGUARD)
    rig.controller.post(SetSafetyInput(SafetyInput.SAFEGUARD_RESET, True))
    assert rig.tick().safety_mode is SafetyMode.SAFEGUARD_STOP
    assert press(rig, SafetyDevice.SAFEGUARD, False).safety_mode is SafetyMode.SAFEGUARD_STOP


def test_the_enabling_device_is_effective_only_in_manual_mode(make):
    rig = wired(make, {SafetyInput.ENABLING_DEVICE: (2, 3), SafetyInput.OPERATIONAL_MODE: (4, 5)}, version="5.25.0")
    assert rig.request("get operational mode") == "AUTOMATIC"
    rig.controller.post(SetSafetyInput(SafetyInput.ENABLING_DEVICE, False))
    assert rig.tick().safety_mode is SafetyMode.NORMAL
    rig.controller.post(SetSafetyInput(SafetyInput.OPERATIONAL_MODE, True))
    rig.tick()
    assert rig.request("get operational mode") == "MANUAL"
    assert rig.now.safety_status is SafetyStatus.SYSTEM_THREE_POSITION_ENABLING_STOP
    assert rig.now.safety_status_bits == 1 << 4 | 1 << 10 | 1 << 11
    rig.controller.post(SetSafetyInput(SafetyInput.ENABLING_DEVICE, True))
    assert rig.tick().safety_status_bits == 1


def test_manual_mode_with_an_enabling_device_is_slow_unless_high_speed_is_allowed(make):
    def fastest(high_speed, device=SafetyInput.ENABLING_DEVICE):
        pins = {device: (2, 3), SafetyInput.OPERATIONAL_MODE: (4, 5)}
        rig = wired(make, pins, manual_high_speed=high_speed)
        rig.controller.post(SetSafetyInput(SafetyInput.OPERATIONAL_MODE, True))
        for active in (True, False):  # after any change of the safety mode, too
            press(rig, SafetyDevice.REDUCED_MODE, active)
        rig.script(LONG)
        rig.until(lambda s: s.runtime_state is RuntimeState.PLAYING, 1.0)
        speeds = []
        while rig.now.runtime_state is RuntimeState.PLAYING:
            speeds.append(math.hypot(*rig.tick().actual_TCP_speed[:3]))
        return max(speeds)

    assert fastest(False) == pytest.approx(0.25, rel=0.03)
    assert fastest(True) > 0.4
    assert fastest(False, SafetyInput.SAFEGUARD_RESET) > 0.4


def test_freedrive_by_input_and_button(make):
    rig = wired(make, {SafetyInput.FREEDRIVE: (2, 3)})
    for high in (True, False, True):
        rig.controller.post(SetSafetyInput(SafetyInput.FREEDRIVE, high))
        rig.seconds(1.0)
        assert (rig.now.control_mode is ControlMode.TEACH) is high
        assert bool(rig.now.robot_status_bits & RobotStatusBits.TEACH_BUTTON) is high


def test_the_automatic_mode_safeguard_is_ignored_in_manual_mode(make):
    rig = wired(make, {SafetyInput.AUTOMATIC_SAFEGUARD: (6, 7)})
    rig.request("set operational mode manual")
    assert level(rig, 6, False).safety_mode is SafetyMode.NORMAL
    rig.request("set operational mode automatic")
    rig.tick()
    assert rig.request("safetystatus") == "Safetystatus: AUTOMATIC_MODE_SAFEGUARD_STOP"
    assert rig.request("safetymode") == "Safetymode: SAFEGUARD_STOP"


def test_reduced_mode_by_input(make):
    rig = wired(make, {SafetyInput.REDUCED_MODE: (2, 3)}, model="ur5")
    assert level(rig, 3, False).safety_mode is SafetyMode.REDUCED
    assert level(rig, 3, True).safety_mode is SafetyMode.NORMAL


def test_an_input_without_pins_cannot_be_driven(make):
    rig, answers = wired(make), []
    rig.controller.post(SetSafetyInput(SafetyInput.REDUCED_MODE, False), answers.append)
    rig.tick()
    assert answers == [False]


# outputs

OUTPUTS = {
    SafetyOutput.SYSTEM_EMERGENCY_STOP: (0, 0),
    SafetyOutput.ROBOT_MOVING: (1, 1),
    SafetyOutput.ROBOT_NOT_STOPPING: (2, 2),
    SafetyOutput.REDUCED_MODE: (3, 3),
    SafetyOutput.NOT_REDUCED_MODE: (4, 4),
    SafetyOutput.SAFE_HOME: (5, 5),
}
HOME = (0.0, -1.57, 0.0, -1.57, 0.0, 0.0)


def test_outputs_follow_the_state(make):
    """Levels of the user manual's table of safety outputs."""
    rig = wired(make, outputs=OUTPUTS, safe_home=(math.tau, *HOME[1:]), initial_q=HOME)

    def high():
        word = rig.now.actual_configurable_digital_output_bits
        return {function.name for function, (pin, _) in OUTPUTS.items() if word >> pin & 1}

    rest = {"SYSTEM_EMERGENCY_STOP", "ROBOT_MOVING", "REDUCED_MODE"}
    assert high() == rest | {"SAFE_HOME"}
    rig.script(LONG)
    rig.until(lambda s: abs(s.actual_qd[0]) > 0.2)
    rig.seconds(0.2)
    assert high() == rest - {"ROBOT_MOVING"}
    press(rig, SafetyDevice.REDUCED_MODE)
    assert high() == rest - {"ROBOT_MOVING", "REDUCED_MODE"} | {"NOT_REDUCED_MODE"}
    press(rig, SafetyDevice.REDUCED_MODE, False)
    press(rig, SafetyDevice.EMERGENCY_STOP)
    rig.seconds(0.5)
    assert high() == {"ROBOT_MOVING", "ROBOT_NOT_STOPPING", "REDUCED_MODE"}


@each_row("speed", [0.3, -0.3])
@each_row("joint", [0, 5])
def test_the_robot_moving_output_is_low_for_either_direction_of_motion(make, joint, speed):
    rig = wired(make, outputs=OUTPUTS)
    speeds = [speed if index == joint else 0.0 for index in range(6)]
    rig.script(f"def turn():\n  speedj({speeds}, a=2, t=1)\nend\n")
    rig.seconds(0.5)
    assert not rig.now.actual_configurable_digital_output_bits >> OUTPUTS[SafetyOutput.ROBOT_MOVING][0] & 1


def test_programs_cannot_change_safety_outputs(make):
    rig = wired(make, outputs={SafetyOutput.ROBOT_MOVING: (1, 2)})
    rig.script("sec out():\n  set_configurable_digital_out(1, False)\n  set_configurable_digital_out(6, True)\nend\n")
    rig.seconds(0.2)
    assert rig.now.actual_configurable_digital_output_bits == 0b0100_0110


def test_a_violation_switches_every_output_low(make):
    rig = wired(make, outputs=OUTPUTS)
    rig.controller.safety_event(SafetyEvent.VIOLATION)
    rig.tick()
    assert rig.now.actual_configurable_digital_output_bits == 0


# the pendant


def test_jogging_waits_for_programs_to_end(make):
    rig, answers = wired(make), []
    rig.script(WAIT)
    rig.seconds(0.2)
    rig.controller.post(Jog((0.1, 0.0, 0.0, 0.0, 0.0, 0.0)), answers.append)
    rig.tick()
    rig.request("stop")
    rig.controller.post(Jog((0.1, 0.0, 0.0, 0.0, 0.0, 0.0)), answers.append)
    rig.seconds(0.5)
    assert answers == [False, True]
    assert rig.now.actual_qd[0] == pytest.approx(0.1)
    rig.controller.post(Jog((0.0,) * 6), answers.append)
    rig.seconds(0.5)
    assert rig.now.actual_qd == (0.0,) * 6


def test_the_dialogue_of_a_stop_closes_with_the_stop_or_earlier(make):
    rig = wired(make)
    board = rig.controller.safety_board
    press(rig, SafetyDevice.SAFEGUARD)
    assert board.safety_popup == "SAFEGUARD_STOP"
    rig.request("close safety popup")
    assert board.safety_popup == ""
    press(rig, SafetyDevice.SAFEGUARD, False)
    press(rig, SafetyDevice.SAFEGUARD)
    press(rig, SafetyDevice.SAFEGUARD, False)
    assert board.safety_popup == ""


# the configuration on the interfaces


@pytest.mark.parametrize(("model", "checksum", "radius"), [("ur5", 2588156642, 0.0), ("ur5e", 1475618907, 0.13)])
def test_the_primary_interface_shows_the_checksum(make, model, checksum, radius):
    rig = make(model)
    state = robot_state(rig.tick(), rig.controller.model)
    assert (state.safety.checksum, state.masterboard.safety_checksum) == (checksum, checksum)
    assert state.safety.elbow_radius == radius
    other = wired(make, model=model, outputs={SafetyOutput.ROBOT_MOVING: (0, 1)})
    own = replace(other.controller.safety_board.configuration, crc=None)
    assert own.checksum != checksum
