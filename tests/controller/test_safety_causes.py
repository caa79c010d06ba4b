"""Every row of the table of causes on both series: reports by dashboard, primary and RTDE, and recovery."""

import math
from dataclasses import replace

import pytest

from emulator.safety.causes import Cause, Recovery
from emulator.safety.signals import SafetyDevice
from emulator.servers.primary_state import robot_state
from tests.commands import ArmSupply, Jog, SetSafetyDevice, SetSafetyInput, TripSafety
from tests.rows import each_row
from urproto.modes import JointMode, ReportLevel, RobotMode, RuntimeState, SafetyMode, SafetyStatusBits
from urproto.primary.messages import ErrorCodeMessage, SafetyModeMessage, decode_robot_message
from urproto.primary.state import decode_robot_state, encode_robot_state
from urproto.realtime import decode_realtime, realtime_packer
from urproto.robots import load_model
from urproto.rtde.fields import OUTPUT_FIELDS
from urproto.rtde.recipes import Recipe
from urproto.versions import Series
from urscript.polyscope.safety_configuration import SafetyInput, factory_configuration

PROGRAM = "def far():\n  movej([1.0, -1.0, 0.5, -1.0, 0.3, 0.2], a=1.0, v=0.5)\nend\n"
START = (0.0, -1.57, 0.0, -1.57, 0.0, 0.0)
JOINT = 2
NAMES = ["robot_mode", "joint_mode", "safety_mode", "safety_status", "safety_status_bits", "runtime_state"]
DEVICES = {
    Cause.ROBOT_EMERGENCY_STOP: SafetyDevice.EMERGENCY_STOP,
    Cause.SYSTEM_EMERGENCY_STOP: SafetyDevice.SYSTEM_EMERGENCY_STOP,
    Cause.SAFEGUARD_STOP: SafetyDevice.SAFEGUARD,
    Cause.AUTOMATIC_MODE_SAFEGUARD_STOP: SafetyDevice.AUTOMATIC_SAFEGUARD,
    Cause.ENABLING_STOP: SafetyDevice.ENABLING_DEVICE,
    Cause.REDUCED_MODE: SafetyDevice.REDUCED_MODE,
}
RESETS = {
    Cause.SAFEGUARD_STOP: SafetyInput.SAFEGUARD_RESET,
    Cause.AUTOMATIC_MODE_SAFEGUARD_STOP: SafetyInput.AUTOMATIC_SAFEGUARD_RESET,
}
BITS = {
    SafetyMode.NORMAL: SafetyStatusBits.NORMAL,
    SafetyMode.REDUCED: SafetyStatusBits.REDUCED,
    SafetyMode.RECOVERY: SafetyStatusBits.RECOVERY,
    SafetyMode.PROTECTIVE_STOP: SafetyStatusBits.PROTECTIVE_STOPPED,
    SafetyMode.SAFEGUARD_STOP: SafetyStatusBits.SAFEGUARD_STOPPED,
    SafetyMode.ROBOT_EMERGENCY_STOP: SafetyStatusBits.ROBOT_EMERGENCY_STOPPED,
    SafetyMode.SYSTEM_EMERGENCY_STOP: SafetyStatusBits.SYSTEM_EMERGENCY_STOPPED,
    SafetyMode.VIOLATION: SafetyStatusBits.VIOLATION,
    SafetyMode.FAULT: SafetyStatusBits.FAULT,
}
ROWS = [
    pytest.param(model, cause, id=f"{model}-{cause.name}")
    for model, series in (("ur5", Series.CB3), ("ur5e", Series.E))
    for cause in Cause
    if cause.value.only in (None, series)
]


def configured(model):
    """The factory configuration, with an input for each reset."""
    configuration = factory_configuration(load_model(model))
    pins = {**configuration.inputs, SafetyInput.AUTOMATIC_SAFEGUARD_RESET: (2, 3)}
    return replace(configuration, inputs=pins)


class Robot:
    """One controller and its three interfaces, accessed through their codecs."""

    def __init__(self, make, model, **config):
        config.setdefault("safety", configured(model))
        self.rig = make(model, running=True, initial_q=START, **config)
        self.controller = self.rig.controller

    def post(self, command):
        self.controller.post(command)
        self.rig.tick()

    def words(self):
        """Robot mode, safety mode and safety status as reported by the dashboard, and RTDE's runtime state."""
        lines = [self.rig.request(line) for line in ("robotmode", "safetymode", "safetystatus")]
        return [*(line.split(": ")[-1] for line in lines), self.rig.now.runtime_state.name]

    def rtde(self):
        recipe = Recipe.of(NAMES, OUTPUT_FIELDS)
        return dict(zip(NAMES, recipe.unpack(recipe.packer()(self.rig.now)), strict=True))

    def primary(self):
        state = robot_state(self.rig.now, self.controller.model)
        return decode_robot_state(encode_robot_state(state, self.controller.version, full=True)[5:])

    def messages_of(self, kind):
        """Messages of this kind after encoding and decoding."""
        version = self.controller.version
        decoded = (
            decode_robot_message(m.encode(version)[5:], version) for m in self.rig.messages if hasattr(m, "kind")
        )
        return [message for message in decoded if isinstance(message, kind)]

    def provoke(self, cause):
        if cause is Cause.AUTOMATIC_MODE_SAFEGUARD_STOP:
            self.controller.operational_mode = "AUTOMATIC"
        if cause is Cause.ENABLING_STOP:
            self.controller.operational_mode = "MANUAL"
        if cause is Cause.POWER_LOSS:
            self.post(ArmSupply(False))
        elif cause in DEVICES:
            self.post(SetSafetyDevice(DEVICES[cause], True))
        else:
            self.post(TripSafety(cause, JOINT))

    def recover(self, cause, step):
        if step is Recovery.RELEASE:
            self.post(SetSafetyDevice(DEVICES[cause], False))
        elif step is Recovery.RESET:
            assert self.rig.now.safety_mode is cause.value.mode, "closing alone is not enough"
            self.post(SetSafetyInput(RESETS[cause], True))
            self.post(SetSafetyInput(RESETS[cause], False))
        elif step is Recovery.UNLOCK:
            assert self.rig.request("unlock protective stop").startswith("Cannot unlock protective stop until 5s")
            self.rig.seconds(5.0)
            assert self.rig.request("unlock protective stop") == "Protective stop releasing"
        elif step is Recovery.RESTART:
            if cause is Cause.POWER_LOSS:
                self.rig.request("restart safety")
                assert self.rig.now.safety_mode is SafetyMode.FAULT, "without a supply it returns"
                self.post(ArmSupply(True))
            assert self.rig.request("restart safety") == "Restarting safety"
        elif step is Recovery.POWER_UP:
            assert self.rig.request("power on") == "Powering on"
            assert self.rig.request("brake release") == "Brake releasing"
            self.rig.until(lambda s: s.robot_mode is RobotMode.RUNNING)
        elif step is Recovery.PLAY:
            assert self.rig.request("play") == "Starting program"


@pytest.mark.parametrize(("model", "cause"), [row for row in ROWS if row.values[1] is not Cause.OUTSIDE_LIMITS])
def test_every_cause_is_consistent_on_all_ports_and_can_be_recovered_from(make, model, cause):
    robot, row = Robot(make, model), cause.value
    rig = robot.rig
    rig.script(PROGRAM)
    rig.seconds(0.6)
    assert robot.rtde()["runtime_state"] == RuntimeState.PLAYING
    fastest = max(map(abs, rig.now.actual_qd))
    assert fastest > 0.3

    robot.provoke(cause)
    rig.seconds(0.3)
    stopped = row.category is not None
    assert not (stopped and any(rig.now.actual_qd))
    assert robot.words() == [row.robot_mode.name, row.mode.name, row.status.name, row.program.name]
    seen = robot.rtde()
    assert seen["robot_mode"] == row.robot_mode
    assert (seen["safety_mode"], seen["safety_status"]) == (row.mode, row.status)
    assert SafetyStatusBits(seen["safety_status_bits"]) & BITS[row.mode]
    assert bool(seen["safety_status_bits"] & SafetyStatusBits.STOPPED_DUE_TO_SAFETY) is stopped
    assert seen["runtime_state"] == row.program
    state = robot.primary()
    assert (state.mode.robot_mode, state.masterboard.safety_mode) == (row.robot_mode, row.mode)
    assert state.mode.protective_stopped is (row.mode is SafetyMode.PROTECTIVE_STOP)
    assert state.mode.emergency_stopped is ("EMERGENCY" in row.mode.name)
    assert state.mode.program_paused is (row.program is RuntimeState.PAUSED)
    real_time = decode_realtime(realtime_packer(robot.controller.version)(rig.now))
    assert (real_time["robot_mode"], real_time["safety_mode"]) == (row.robot_mode, row.mode)
    assert [message.safety_mode for message in robot.messages_of(SafetyModeMessage)] == [row.mode]
    joint = JOINT if row.per_joint else None
    labels = [] if row.code is None else [(row.code, row.argument + (joint or 0), row.level)]
    assert [(m.code, m.argument, m.level) for m in robot.messages_of(ErrorCodeMessage)] == labels
    if row.level is ReportLevel.FAULT and row.per_joint:
        assert seen["joint_mode"][JOINT] == JointMode.FAULT
        assert set(seen["joint_mode"][:JOINT]) == {JointMode.POWER_OFF}

    for step in row.recovery:
        robot.recover(cause, step)
    rig.seconds(0.1)
    assert robot.words()[:3] == ["RUNNING", "NORMAL", "NORMAL"]
    assert rig.now.joint_mode == (JointMode.RUNNING,) * 6
    if row.program is not RuntimeState.STOPPED:  # it continues from there
        rig.until(lambda s: s.runtime_state is RuntimeState.STOPPED)
        assert rig.now.actual_q == pytest.approx((1.0, -1.0, 0.5, -1.0, 0.3, 0.2), abs=1e-9)


@pytest.mark.parametrize("model", ["ur5", "ur5e"])
def test_an_arm_outside_its_limits_recovers_by_being_moved_back(make, model):
    configuration = configured(model)
    high = (0.5, *configuration.normal.joint_max[1:])
    narrow = replace(configuration, normal=replace(configuration.normal, joint_max=high))
    rig = make(model, initial_q=(0.6, *START[1:]), safety=narrow)
    assert rig.now.safety_mode is SafetyMode.NORMAL  # off: not supervised
    rig.request("brake release")
    rig.until(lambda s: s.robot_mode is RobotMode.RUNNING)
    assert rig.request("safetymode") == "Safetymode: RECOVERY"
    assert rig.now.safety_status_bits == SafetyStatusBits.RECOVERY
    rig.script(PROGRAM)
    rig.seconds(0.2)
    assert rig.now.runtime_state is RuntimeState.PAUSED
    assert rig.now.target_qd == (0.0,) * 6
    assert rig.request("stop") == "Stopped"
    rig.controller.post(Jog((-3.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    speeds = []
    while rig.tick().safety_mode is SafetyMode.RECOVERY:
        speeds.append(abs(rig.now.actual_qd[0]))
    assert rig.now.actual_q[0] == pytest.approx(0.5, abs=0.01)
    assert 0.2 < max(speeds) <= math.radians(30.0)
    rig.controller.post(Jog((0.0,) * 6))
    rig.seconds(0.5)
    rig.script("def back():\n  movej([0.2, -1.5, 0.1, -1.5, 0.1, 0.1])\nend\n")
    rig.until(lambda s: s.runtime_state is RuntimeState.PLAYING, 1.0)
    rig.until(lambda s: s.runtime_state is RuntimeState.STOPPED)
    assert rig.now.actual_q[0] == pytest.approx(0.2, abs=1e-9)


@each_row("cause", DEVICES)
def test_lasting_conditions_cannot_be_tripped(make, cause):
    rig = make("ur5e", running=True)
    answers = []
    rig.controller.post(TripSafety(cause), answers.append)
    rig.tick()
    assert answers == [False]
    assert rig.now.safety_mode is SafetyMode.NORMAL


def stop_fifty_times(rig, joint):
    for _ in range(50):
        rig.controller.post(TripSafety(Cause.COLLISION, joint))
        rig.tick()
        rig.script("set unlock protective stop")
        rig.tick()
        assert rig.now.safety_mode is SafetyMode.NORMAL


@pytest.mark.parametrize(("hours", "mode"), [(7.99, SafetyMode.FAULT), (8.01, SafetyMode.PROTECTIVE_STOP)])
def test_protective_stops_are_counted_for_eight_hours(make, hours, mode):
    rig = make("ur5e", running=True)
    stop_fifty_times(rig, 3)
    rig.controller.step_count += round(hours * 3600.0 / rig.controller.period_s)  # nothing happens meanwhile
    rig.controller.post(TripSafety(Cause.COLLISION, 3))
    rig.tick()
    assert rig.now.safety_mode is mode


def test_fifty_stops_of_one_joint_are_allowed_and_one_more_is_a_fault(make):
    rig = make("ur5e", running=True)
    stop_fifty_times(rig, 3)
    rig.controller.post(TripSafety(Cause.COLLISION, 4))  # each joint is counted separately
    rig.tick()
    rig.script("set unlock protective stop")
    rig.tick()
    rig.controller.post(TripSafety(Cause.COLLISION, 3))
    rig.tick()
    assert rig.now.safety_mode is SafetyMode.FAULT
    assert (rig.messages_of(ErrorCodeMessage)[-1].code, rig.messages_of(ErrorCodeMessage)[-1].argument) == (163, 3)
    assert rig.now.joint_mode[3] is JointMode.FAULT
