"""The guard of the tick: an exception anywhere in a control period is a fault of the robot, not its end."""

import logging
import struct
import zipfile

import pytest

from emulator.commands.requests import ServingFailed
from emulator.guard import Guard
from emulator.servers.primary_state import robot_state
from urproto.modes import ReportLevel, RobotMode, RuntimeState, SafetyMode, SafetyStatus, SafetyStatusBits
from urproto.primary.messages import ErrorCodeMessage, PopupMessage, SafetyModeMessage
from urproto.primary.state import encode_robot_state

pytestmark = pytest.mark.emulator_fails

MOVING = """def moving():
  while True:
    movej([0.5,-1.5,0.3,-1.2,0.2,0.1])
    movej([0,-1.57,0,-1.57,0,0])
  end
end
"""

# where it fails: an attribute of the controller's parts, and whether it is called in every period
STAGES = {
    "a hook": lambda c: (c, "_call_hooks"),
    "commands": lambda c: (c._mailbox, "carry_out"),
    "power's timer": lambda c: (c.power, "advance"),
    "safety's timer": lambda c: (c.safety, "advance"),
    "payload transition": lambda c: (c.installation, "advance"),
    "popups": lambda c: (c.popups, "advance"),
    "safety inputs": lambda c: (c.safety_board, "latch"),
    "input actions": lambda c: (c.freedrive_inputs, "advance"),
    "history": lambda c: (c.programs.history, "record"),
    "Modbus signals": lambda c: (c.programs.modbus, "step"),
    "compiling": lambda c: (c.programs._compiling, "next"),
    "interpreter": lambda c: (c.programs.interpreter, "step"),
    "secondary programs": lambda c: (c.programs._secondary, "run"),
    "the program": lambda c: (c.programs, "_run_main"),
    "the program's end": lambda c: (c.programs, "step"),
    "motion": lambda c: (c.motion, "advance"),
    "the arm": lambda c: (c.arm, "update"),
    "torques": lambda c: (c.arm, "_efforts"),
    "electrics": lambda c: (c.electrics, "advance"),
    "the tool line": lambda c: (c, "_advance_tool"),
    "judging": lambda c: (c.safety_board, "check_arm"),
    "publishing the arm": lambda c: (c.arm, "publish"),
    "publishing safety": lambda c: (c.safety_board, "publish"),
    "publishing programs": lambda c: (c.programs, "publish"),
    "publishing speed": lambda c: (c.speed, "publish"),
    "publishing registers": lambda c: (c.registers, "publish"),
}


def break_once(monkeypatch, target, name):
    """The next call raises, and later calls work as before."""
    own = getattr(target, name)
    broken = []

    def call(*args, **kwargs):
        if not broken:
            broken.append(name)
            raise ZeroDivisionError("on purpose")
        return own(*args, **kwargs)

    monkeypatch.setattr(target, name, call)


def break_for_good(monkeypatch, target, name):
    def call(*args, **kwargs):
        raise ZeroDivisionError("on purpose")

    monkeypatch.setattr(target, name, call)


def moving_rig(make, tmp_path, **config):
    rig = make(running=True, programs_dir=tmp_path, **config)
    rig.script(MOVING)
    rig.until(lambda s: any(s.actual_qd))
    # the stages' methods are bound when the controller is created: bind them again, so that a test can replace them
    controller = rig.controller
    controller._stages = tuple(
        (name, lambda stage=stage: getattr(stage.__self__, stage.__name__)()) for name, stage in controller._stages
    )
    return rig


def assert_fault_everywhere(rig):
    """On every port: RTDE and realtime (the snapshot), primary messages and state, dashboard."""
    now = rig.now
    assert now.safety_mode is SafetyMode.FAULT
    assert now.safety_status is SafetyStatus.FAULT
    assert now.safety_status_bits & SafetyStatusBits.FAULT
    assert now.runtime_state is RuntimeState.STOPPED
    assert not now.program_running
    assert now.robot_mode is RobotMode.POWER_OFF
    encode_robot_state(robot_state(now, rig.controller.model), rig.controller.version, full=True)
    assert rig.request("safetymode") == "Safetymode: FAULT"
    assert rig.request("safetystatus") == "Safetystatus: FAULT"
    assert rig.request("running") == "Program running: false"
    assert SafetyMode.FAULT in [message.safety_mode for message in rig.messages_of(SafetyModeMessage)]
    (error,) = [message for message in rig.messages_of(ErrorCodeMessage) if message.code == 116]
    assert error.level is ReportLevel.FAULT
    assert "on purpose" in error.text
    assert "on purpose" in rig.messages_of(PopupMessage)[-1].text
    assert "the emulator failed" in "\n".join(rig.controller.messages.history)


def recover(rig):
    rig.request("restart safety")
    rig.request("close popup")
    rig.request("brake release")
    rig.until(lambda s: s.robot_mode is RobotMode.RUNNING)
    assert rig.now.safety_mode is SafetyMode.NORMAL
    before = len(rig.messages)
    rig.script("def again():\n  movej([0.1,-1.4,0.1,-1.5,0.1,0.1], a=5, v=2)\nend\n")
    rig.until(lambda s: s.program_running)
    rig.until(lambda s: not s.program_running)
    assert rig.now.actual_q == pytest.approx((0.1, -1.4, 0.1, -1.5, 0.1, 0.1), abs=5e-3)
    assert not [message for message in rig.messages[before:] if isinstance(message, ErrorCodeMessage)]


@pytest.mark.parametrize(
    ("stage", "dynamic"),
    [*((stage, False) for stage in STAGES), *((stage, True) for stage in ("the program", "motion", "the arm"))],
)
def test_a_failure_in_any_stage_is_a_fault_that_can_be_recovered_from(
    make, tmp_path, monkeypatch, caplog, stage, dynamic
):
    rig = moving_rig(make, tmp_path, dynamic=dynamic)
    break_once(monkeypatch, *STAGES[stage](rig.controller))
    step = rig.now.step
    rig.tick(1 if stage != "compiling" else 2)
    rig.seconds(0.8)
    assert rig.now.step > step + 50
    assert_fault_everywhere(rig)
    assert caplog.text.count("Traceback") == 1
    recover(rig)


@pytest.mark.parametrize("stage", [stage for stage in STAGES if stage not in ("commands",)])
def test_a_failure_in_every_period_is_reported_once_and_the_ports_stay_up(make, tmp_path, monkeypatch, caplog, stage):
    rig = moving_rig(make, tmp_path)
    rig.controller.subscribe(lambda _: None)  # otherwise, what is published is not computed until it is read
    with monkeypatch.context() as broken:
        break_for_good(broken, *STAGES[stage](rig.controller))
        rig.seconds(4.0)
        assert_fault_everywhere(rig)
        assert caplog.text.count("Traceback") == 1
        assert len(caplog.text) < 20_000
        assert len(list(tmp_path.glob("crash_*.zip"))) == 1
    recover(rig)


def test_a_persistent_fault_returns_after_the_restart_and_is_logged_in_one_line(make, tmp_path, monkeypatch, caplog):
    rig = moving_rig(make, tmp_path)
    break_for_good(monkeypatch, rig.controller.electrics, "advance")
    rig.tick(3)
    for _ in range(5):
        rig.request("restart safety")
        rig.tick(2)
        assert rig.now.safety_mode is SafetyMode.FAULT
    assert caplog.text.count("Traceback") == 1
    assert caplog.text.count("failed again") == 5


def test_the_bundle_contains_what_a_bug_report_needs(make, tmp_path, monkeypatch):
    rig = moving_rig(make, tmp_path, dynamic=True, seed=1234)
    break_once(monkeypatch, rig.controller.motion, "advance")
    rig.tick()
    (path,) = tmp_path.glob("crash_*.zip")
    with zipfile.ZipFile(path) as bundle:
        texts = {name: bundle.read(name).decode() for name in bundle.namelist()}
    assert "ZeroDivisionError: on purpose" in texts["traceback.txt"]
    assert "while moving the arm" in texts["traceback.txt"]
    assert "seed 1234" in texts["about.txt"]
    assert "PolyScope 3.15" in texts["about.txt"]
    assert texts["program.script"].strip() == MOVING.strip()
    assert "actual_q" in texts["state.txt"]
    assert "PROGRAM_XXX_STARTED moving" in texts["log_history.txt"]


def test_an_unwritable_report_folder_is_tolerated(make, tmp_path, monkeypatch, caplog):
    rig = moving_rig(make, tmp_path / "gone")
    break_once(monkeypatch, rig.controller.motion, "advance")
    rig.seconds(0.5)
    assert_fault_everywhere(rig)
    assert "not saved" in caplog.text


def test_the_guard_survives_its_own_failure(make, tmp_path, monkeypatch):
    """Even when the safety board cannot execute the fault, the arm is off and clients see it."""
    rig = moving_rig(make, tmp_path)
    break_for_good(monkeypatch, rig.controller.safety_board, "trip")
    break_for_good(monkeypatch, rig.controller.programs, "step")
    rig.tick(3)
    assert rig.now.safety_mode is SafetyMode.FAULT
    assert rig.now.robot_mode is RobotMode.POWER_OFF
    assert rig.now.runtime_state is RuntimeState.STOPPED


@pytest.mark.parametrize("dynamic", [False, True], ids=["ideal", "dynamic"])
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1e155])
def test_impossible_states_are_never_published(make, tmp_path, monkeypatch, bad, dynamic):
    rig = moving_rig(make, tmp_path, dynamic=dynamic)
    good = rig.now.actual_q
    own = rig.controller.motion.advance

    def advance(fraction):
        fault = own(fraction)
        rig.controller.motion.target.q = (bad,) * 6
        return fault

    with monkeypatch.context() as broken:
        broken.setattr(rig.controller.motion, "advance", advance)
        for _ in range(50):
            snapshot = rig.tick()
            assert snapshot.actual_q == pytest.approx(good, abs=0.05)
            assert snapshot.target_q == pytest.approx(good, abs=0.05)
            assert max(map(abs, snapshot.actual_current)) < 100.0
            encode_robot_state(robot_state(snapshot, rig.controller.model), rig.controller.version, full=True)
    assert rig.now.safety_mode is SafetyMode.FAULT
    recover(rig)


def test_a_server_that_cannot_publish_is_a_fault_shown_on_the_other_ports(make, tmp_path):
    rig = moving_rig(make, tmp_path)
    for _ in range(20):
        rig.controller.post(ServingFailed("rtde", struct.error("on purpose")))
        rig.tick()
    rig.seconds(0.8)
    assert_fault_everywhere(rig)
    recover(rig)


def test_waiting_clients_are_answered(make, tmp_path, monkeypatch):
    """A client that waits for the answer to play or to its script gets an answer."""
    rig = moving_rig(make, tmp_path)
    submission = rig.controller.programs.submit("def other():\n" + "  sleep(1)\n" * 5000 + "end\n")
    break_once(monkeypatch, rig.controller.programs, "step")
    rig.tick(2)
    assert submission.accepted is False


def test_repeated_failures_of_listeners_and_commands_do_not_flood_the_log(make, tmp_path, caplog):
    rig = moving_rig(make, tmp_path)

    def broken(_):
        raise RuntimeError("on purpose")

    rig.controller.subscribe(broken)
    for _ in range(100):
        rig.rtde(output_bit_registers0_to_31=1)  # not an input
    assert caplog.text.count("on purpose") <= 3
    assert caplog.text.count("Traceback") == 2
    assert rig.now.program_running


def test_a_known_failure_is_logged_in_one_line(make, tmp_path, caplog):
    rig = moving_rig(make, tmp_path)
    guard: Guard = rig.controller.guard
    with caplog.at_level(logging.ERROR):
        for _ in range(3):
            guard.caught("testing", ValueError("x"))
            guard.restarted()
    assert caplog.text.count("failed while testing, which is a bug") == 1
    assert caplog.text.count("failed again while testing") == 2
