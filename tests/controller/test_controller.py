"""The tick: time, commands, power, safety and program together."""

import pytest

from emulator.commands.requests import DashboardLine
from emulator.controller import Controller
from emulator.lifecycle.runstate import SCRIPT_PROTECTIVE_STOP
from emulator.lifecycle.safety import SafetyEvent
from emulator.machine import ControllerConfig
from emulator.mailbox import Command
from tests.rows import each_row
from tests.ticking import ticked
from urproto.modes import ControlMode, JointMode, ReportLevel, RobotMode, RobotStatusBits, RuntimeState, SafetyMode
from urproto.primary.messages import ErrorCodeMessage, KeyMessage, RuntimeExceptionMessage, SafetyModeMessage
from urproto.robots import START_Q, load_model

LONG_MOVE = "def far():\n  movej([1.0, -1.0, 0.5, -1.0, 0.3, 0.2], a=1.0, v=0.5)\nend\n"
ZERO6 = (0.0,) * 6


def is_state(state):
    return lambda snapshot: snapshot.runtime_state is state


# time


def test_a_new_controller_needs_only_a_model():
    controller = Controller(ControllerConfig(model=load_model("ur3")))
    assert controller.snapshot.robot_mode is RobotMode.POWER_OFF
    assert controller.snapshot.actual_q == START_Q
    assert ticked(controller) is controller.snapshot


@pytest.mark.parametrize(("model", "period_s"), [("ur3", 0.008), ("ur5e", 0.002)])
def test_time_comes_from_the_step_counter(make, model, period_s):
    rig = make(model)
    first = rig.now
    assert first.timestamp > 40.0
    later = rig.tick(1000)
    assert later.step - first.step == 1000
    assert later.timestamp - first.timestamp == pytest.approx(1000 * period_s, abs=1e-9)
    assert first.target_execution_time == pytest.approx(1000 * period_s)


def test_the_same_history_gives_the_same_snapshots(make):
    def run():
        rig = make(running=True)
        rig.script(LONG_MOVE)
        return [rig.tick() for _ in range(200)]

    assert [a.values() for a in run()] == [b.values() for b in run()]


def test_a_published_snapshot_never_changes(ready):
    ready.script(LONG_MOVE)
    snapshot = ready.seconds(0.5)
    copy = snapshot.values()
    ready.seconds(0.5)
    assert snapshot.values() == copy
    assert ready.now.actual_q != snapshot.actual_q


# commands


class Recorder(Command):
    def __init__(self, log, answer):
        self.log, self.answer = log, answer

    def apply(self, controller):
        self.log.append(self.answer)
        return self.answer


class Slow(Command):
    def apply(self, controller):
        yield
        yield
        return "done"


class Broken(Command):
    failure = "sorry"

    def apply(self, controller):
        raise RuntimeError("on purpose")


class BrokenLater(Broken):
    def apply(self, controller):
        yield
        raise RuntimeError("on purpose")


def test_commands_apply_in_order_at_the_next_tick(rig):
    log, answers = [], []
    for number in range(3):
        rig.controller.post(Recorder(log, number), answers.append)
    assert log == []
    rig.tick()
    assert log == answers == [0, 1, 2]
    rig.tick()
    assert answers == [0, 1, 2]


def test_a_generator_command_is_answered_when_it_returns(rig):
    answers = []
    rig.controller.post(Slow(), answers.append)
    rig.tick(2)
    assert answers == []
    rig.tick()
    assert answers == ["done"]


@pytest.mark.parametrize("command", [Broken(), BrokenLater()])
def test_a_failing_command_is_answered_and_the_tick_continues(rig, command, caplog):
    answers = []
    rig.controller.post(command, answers.append)
    rig.controller.post(DashboardLine("robotmode"), answers.append)
    rig.tick(2)
    assert sorted(answers) == ["Robotmode: POWER_OFF", "sorry"]
    assert "on purpose" in caplog.text


def test_a_failing_listener_does_not_affect_others(rig, caplog):
    seen = []

    def broken(_):
        raise RuntimeError("on purpose")

    rig.controller.subscribe(broken)
    rig.controller.subscribe(seen.append)
    rig.controller.post(DashboardLine("robotmode"), broken)
    rig.tick(2)
    assert [snapshot.step for snapshot in seen] == [rig.now.step - 1, rig.now.step]
    assert "on purpose" in caplog.text


def test_unsubscribed_listeners_are_no_longer_called(rig):
    seen = []
    end = rig.controller.subscribe(seen.append)
    rig.tick()
    end()
    rig.tick()
    assert len(seen) == 1


# power


def test_power_cycle(rig):
    rig.request("power on")
    assert rig.now.robot_mode is RobotMode.BOOTING
    assert rig.now.robot_status_bits & 1
    rig.until(lambda s: s.robot_mode is RobotMode.IDLE, 1.0)
    assert set(rig.now.joint_mode) == {JointMode.IDLE}
    rig.request("brake release")
    rig.until(lambda s: s.robot_mode is RobotMode.RUNNING, 1.0)
    assert set(rig.now.joint_mode) == {JointMode.RUNNING}
    assert rig.now.actual_current != ZERO6
    rig.request("power off")
    assert rig.now.robot_mode is RobotMode.POWER_OFF
    assert rig.now.actual_current == ZERO6
    assert rig.now.actual_robot_voltage == 0.0
    assert rig.now.robot_status_bits == 0
    assert rig.messages == []  # no message of any kind while nothing runs


def test_default_timings_are_those_of_a_simulator(make):
    controller = Controller(ControllerConfig(model=load_model("ur3")))
    controller.post(DashboardLine("power on"))
    times = {}
    for _ in range(2000):
        snapshot = ticked(controller)
        times.setdefault(snapshot.robot_mode, snapshot.timestamp)
        if snapshot.robot_mode is RobotMode.IDLE:
            controller.post(DashboardLine("brake release"))
    start = times[RobotMode.BOOTING]
    assert 0.4 <= times[RobotMode.IDLE] - start <= 4.0
    assert 0.4 <= times[RobotMode.RUNNING] - times[RobotMode.IDLE] <= 6.0


def test_brakes_are_released_in_the_time_client_test_suites_allow(make):
    """ur_rtde's own suite waits 3 s after brake release of an arm that is off, the official C++ library's 2.3 s."""
    controller = Controller(ControllerConfig(model=load_model("ur5e")))
    controller.post(DashboardLine("brake release"))
    for _ in range(round(2.2 / controller.period_s)):
        controller.tick()
    assert controller.snapshot.robot_mode is RobotMode.RUNNING


def test_power_off_stops_arm_and_program_immediately(ready):
    ready.script(LONG_MOVE)
    ready.seconds(0.5)
    assert ready.now.target_qd != ZERO6
    ready.request("power off")
    assert ready.now.robot_mode is RobotMode.POWER_OFF
    ready.until(lambda s: s.target_qd == ZERO6, 0.1)  # time to release the brakes
    standing = ready.now.actual_q
    ready.until(is_state(RuntimeState.STOPPED), 1.0)
    ready.request("brake release")
    ready.until(lambda s: s.robot_mode is RobotMode.RUNNING, 1.0)
    ready.seconds(0.2)
    assert ready.now.actual_q == standing


# protective stop


def test_a_protective_stop_pauses_the_program_and_unlocking_resumes_it(ready):
    ready.script(LONG_MOVE)
    ready.seconds(0.5)
    ready.controller.protective_stop(SCRIPT_PROTECTIVE_STOP)
    ready.tick()
    assert ready.now.safety_mode is SafetyMode.PROTECTIVE_STOP
    assert ready.now.robot_mode is RobotMode.RUNNING
    assert ready.now.safety_status_bits & 0b100
    ready.until(is_state(RuntimeState.PAUSED), 1.0)
    ready.until(lambda s: s.target_qd == ZERO6, 1.0)
    assert ready.request("play") == "Failed to execute: play"

    ready.script("set unlock protective stop")
    ready.tick()
    assert ready.now.safety_mode is SafetyMode.NORMAL
    ready.seconds(0.2)
    assert ready.now.runtime_state is RuntimeState.PAUSED
    assert ready.request("play") == "Starting program"
    ready.until(is_state(RuntimeState.STOPPED))
    assert ready.now.actual_q == pytest.approx((1.0, -1.0, 0.5, -1.0, 0.3, 0.2), abs=1e-9)


def test_messages_of_a_protective_stop_and_its_release(ready):
    ready.controller.protective_stop(SCRIPT_PROTECTIVE_STOP)
    ready.controller.protective_stop(SCRIPT_PROTECTIVE_STOP)
    ready.tick()
    mode, error = ready.messages
    assert isinstance(mode, SafetyModeMessage)
    assert mode.safety_mode == SafetyMode.PROTECTIVE_STOP
    assert isinstance(error, ErrorCodeMessage)
    assert (error.label, error.level) == ("C209A0", ReportLevel.WARNING)
    assert error.timestamp_us == mode.timestamp_us > 40_000_000
    ready.messages.clear()
    ready.script("set unlock protective stop")
    ready.tick()
    (released,) = ready.messages
    assert released.safety_mode == SafetyMode.NORMAL


def test_the_dashboard_unlocks_only_after_five_seconds(ready):
    ready.controller.protective_stop(SCRIPT_PROTECTIVE_STOP)
    ready.seconds(4.9)
    assert ready.request("unlock protective stop").startswith(
        "Cannot unlock protective stop until 5s after occurrence."
    )
    assert ready.now.safety_mode is SafetyMode.PROTECTIVE_STOP
    ready.seconds(0.2)
    assert ready.request("unlock protective stop") == "Protective stop releasing"
    assert ready.now.safety_mode is SafetyMode.NORMAL


def test_unlocking_does_not_finish_the_move_of_a_stopped_program(ready):
    ready.script(LONG_MOVE)
    ready.seconds(0.5)
    ready.script("stop program")
    ready.tick()
    ready.controller.protective_stop(SCRIPT_PROTECTIVE_STOP)
    ready.tick(2)
    ready.script("set unlock protective stop")
    ready.seconds(0.5)
    assert ready.now.target_qd == ZERO6
    assert ready.now.actual_q[0] < 0.5


@pytest.mark.parametrize("playing", [False, True])
def test_the_arm_moves_again_after_a_protective_stop(ready, playing):
    if playing:
        ready.script(LONG_MOVE)
        ready.seconds(0.5)
    ready.controller.protective_stop(SCRIPT_PROTECTIVE_STOP)
    ready.seconds(0.5)
    ready.script("set unlock protective stop")
    ready.script("stop program")
    ready.tick(20)
    ready.script(LONG_MOVE)
    ready.until(is_state(RuntimeState.PLAYING), 0.5)
    ready.until(is_state(RuntimeState.STOPPED))
    assert ready.now.actual_q == pytest.approx((1.0, -1.0, 0.5, -1.0, 0.3, 0.2), abs=1e-9)


def test_protective_stop_called_by_a_script(ready):
    ready.script("def p():\n  protective_stop()\nend\n")
    ready.seconds(0.5)
    assert [message.label for message in ready.messages_of(ErrorCodeMessage)] == ["C209A0"]
    assert ready.now.safety_mode is SafetyMode.PROTECTIVE_STOP


def test_an_unreachable_line_stops_protectively(ready):
    ready.script("movel(p[10, 0, 0, 0, 0, 0])")
    ready.until(lambda s: s.safety_mode is SafetyMode.PROTECTIVE_STOP, 1.0)
    assert ready.messages_of(RuntimeExceptionMessage) == []
    (error,) = ready.messages_of(ErrorCodeMessage)
    assert error.level >= ReportLevel.WARNING


@pytest.mark.parametrize("model", ["ur5", "ur5e"])
def test_a_program_sent_before_the_brakes_are_released_waits_paused(make, model):
    """Issue 123 of the official client library: "the program state also seems to be paused"."""
    rig = make(model)
    rig.script(LONG_MOVE)
    rig.seconds(0.3)
    assert rig.now.runtime_state is RuntimeState.PAUSED
    assert not rig.now.robot_status_bits & RobotStatusBits.PROGRAM_RUNNING
    rig.request("brake release")
    rig.until(lambda s: s.robot_mode is RobotMode.RUNNING)
    rig.seconds(0.5)
    assert rig.now.runtime_state is RuntimeState.PAUSED
    rig.script(LONG_MOVE)  # ends the paused one
    rig.seconds(0.5)
    assert rig.now.runtime_state is RuntimeState.STOPPED
    rig.script(LONG_MOVE)
    rig.until(lambda s: any(s.target_qd), 1.0)


@pytest.mark.parametrize("secondary", [False, True])
def test_a_program_sent_while_one_is_paused_only_ends_it(ready, secondary):
    """The same issue: "the VNC view only shows it switching to Stopped", and "a second call actually starts it"."""
    ready.script(LONG_MOVE)
    ready.seconds(0.5)
    assert ready.request("pause") == "Pausing program"
    if secondary:
        ready.script("sec set():\n  set_digital_out(0, True)\nend\n")
        ready.seconds(0.3)
        assert ready.now.runtime_state is RuntimeState.PAUSED
        return
    ready.script(LONG_MOVE)
    ready.seconds(0.3)
    assert ready.now.runtime_state is RuntimeState.STOPPED
    assert "was sent while it was paused" in "\n".join(ready.controller.messages.history)
    ready.script(LONG_MOVE)
    ready.until(lambda s: s.runtime_state is RuntimeState.PLAYING, 1.0)


def test_the_dashboard_names_the_loaded_program_only(make, tmp_path):
    """A test suite of a driver against URSim 5.25.2 reads RTDE's runtime_state for a program it has sent."""
    (tmp_path / "own.script").write_text("def own():\n  sleep(9)\nend\n")
    rig = make("ur5e", running=True, programs_dir=tmp_path)
    rig.request("load own.script")
    rig.script(LONG_MOVE)
    rig.seconds(0.5)
    assert rig.now.runtime_state is RuntimeState.PLAYING
    assert (rig.request("programState"), rig.request("running")) == ("STOPPED own.script", "Program running: true")
    rig.request("stop")
    rig.request("play")
    assert rig.request("programState") == "PLAYING own.script"


@each_row(
    ("version", "remote", "answer"),
    [
        ("5.9.4", False, "Starting program"),  # tests of the official C++ client, which say that remote control is off
        ("5.26.0", False, "Failed to execute: play"),  # JimothyJohn/perceptronics
        ("5.26.0", True, "Starting program"),
    ],
)
def test_play_in_local_control(make, tmp_path, version, remote, answer):
    (tmp_path / "own.script").write_text("def own():\n  sleep(9)\nend\n")
    rig = make("ur5e", running=True, programs_dir=tmp_path, version=version, remote_control=remote)
    rig.request("load own.script")
    assert rig.request("is in remote control") == str(remote).lower()
    assert rig.request("play") == answer
    rig.request("stop")
    rig.script(LONG_MOVE)
    rig.until(lambda s: s.runtime_state is RuntimeState.PLAYING, 1.0)


# emergency stop, safeguard, reduced, violation


def test_emergency_stop_works_with_the_speed_slider_at_zero(ready):
    ready.script(LONG_MOVE)
    ready.seconds(0.3)
    ready.controller.speed.set_slider(0.0)
    ready.controller.safety_event(SafetyEvent.ROBOT_EMERGENCY_STOP)
    ready.until(lambda s: s.robot_mode is RobotMode.POWER_OFF, 2.0)


# programs


def test_program_start_and_end(ready):
    ready.script(LONG_MOVE)
    ready.until(is_state(RuntimeState.PLAYING), 0.1)
    assert ready.now.program_name == "far"
    assert ready.now.program_running
    assert ready.now.robot_status_bits == 0b11
    ready.until(is_state(RuntimeState.STOPPED))
    assert ready.now.robot_status_bits == 0b01
    assert ready.now.target_qd == ZERO6
    assert [message.title for message in ready.messages_of(KeyMessage)] == [
        "PROGRAM_XXX_STARTED",
        "PROGRAM_XXX_STOPPED",
    ]
    assert {message.text for message in ready.messages_of(KeyMessage)} == {"far"}
    assert ready.messages_of(ErrorCodeMessage) == []


def test_pause_holds_the_arm_on_its_path_and_play_resumes(ready):
    ready.script(LONG_MOVE)
    ready.seconds(0.5)
    assert ready.request("pause") == "Pausing program"
    assert ready.now.runtime_state is RuntimeState.PAUSED
    assert ready.now.program_paused
    assert ready.now.target_qd == ZERO6
    standing = ready.now.actual_q
    ready.seconds(0.5)
    assert ready.now.actual_q == standing
    assert ready.request("play") == "Starting program"
    ready.until(is_state(RuntimeState.STOPPED))
    assert ready.now.actual_q == pytest.approx((1.0, -1.0, 0.5, -1.0, 0.3, 0.2), abs=1e-9)


def test_stop_brings_the_arm_to_rest(ready):
    ready.script(LONG_MOVE)
    ready.seconds(0.5)
    assert ready.request("stop") == "Stopped"
    assert ready.now.runtime_state is RuntimeState.STOPPED
    ready.seconds(0.5)
    assert ready.now.target_qd == ZERO6


@pytest.mark.parametrize(
    ("call", "mode"),
    [
        ("freedrive_mode()", ControlMode.TEACH),
        ("force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,0,0,0,0], 2, [1,1,1,1,1,1])", ControlMode.FORCE),
    ],
)
def test_control_mode_shows_freedrive_and_force_mode(ready, call, mode):
    ready.script(f"def give():\n  {call}\n  sleep(0.5)\nend\n")
    ready.seconds(0.2)
    assert ready.now.control_mode is mode
    ready.until(is_state(RuntimeState.STOPPED), 2.0)
    ready.seconds(0.3)
    assert ready.now.control_mode is ControlMode.POSITION


def test_a_contact_force_moves_the_arm_in_freedrive(ready):
    ready.script("def bend():\n  movej([0,-1.2,1.2,-1.5,-1.5,0], t=1)\nend\n")
    ready.until(is_state(RuntimeState.STOPPED), 3.0)
    ready.script("def give():\n  freedrive_mode()\n  sleep(60)\nend\n")
    ready.seconds(0.1)
    height = ready.now.actual_TCP_pose[2]
    ready.controller.external_wrench = (0.0, 0.0, -40.0, 0.0, 0.0, 0.0)
    ready.seconds(0.5)
    assert ready.now.actual_TCP_pose[2] < height - 0.005


def test_speed_slider_stretches_a_move(make):
    def duration(slider):
        rig = make(running=True)
        rig.rtde(speed_slider_mask=1, speed_slider_fraction=slider)
        assert rig.now.target_speed_fraction == slider
        assert rig.now.speed_scaling == 0.0
        rig.script(LONG_MOVE)
        rig.until(is_state(RuntimeState.PLAYING), 1.0)
        assert rig.now.speed_scaling == 1.0
        start = rig.now.timestamp
        return rig.until(is_state(RuntimeState.STOPPED), 30.0).timestamp - start

    assert duration(0.25) == pytest.approx(4 * duration(1.0), rel=0.05)


SLOWLY = {"joint_temperatures", "tool_temperature", "board_temperature"}  # once a second


def test_at_rest_everything_but_time_and_temperature_is_bit_stable(ready):
    ready.script(LONG_MOVE)
    ready.until(is_state(RuntimeState.PLAYING), 1.0)
    ready.until(is_state(RuntimeState.STOPPED))
    ready.seconds(0.1)
    first = ready.now.values()
    for _ in range(50):
        ready.tick()
        changed = {name for name, value in ready.now.values().items() if value != first[name]}
        assert changed - SLOWLY == {"step", "timestamp"}


@pytest.mark.parametrize("model", ["ur3", "ur5e"])
def test_every_interface_can_see_that_a_program_resumes(make, model):
    """Also one that reports ten states per second; program and arm continue immediately."""
    rig = make(model, running=True)
    rig.script(LONG_MOVE)
    rig.until(is_state(RuntimeState.PLAYING))
    rig.seconds(0.3)
    rig.controller.programs.pause()
    rig.until(is_state(RuntimeState.PAUSED))
    rig.controller.programs.resume()
    states = [rig.tick() for _ in range(round(0.3 / rig.controller.period_s))]
    resuming = [state for state in states if state.runtime_state is RuntimeState.RESUMING]
    assert len(resuming) * rig.controller.period_s == pytest.approx(0.1, abs=2 * rig.controller.period_s)
    assert len(resuming) >= 0.1 / rig.controller.period_s - 1
    assert resuming[0] is states[0]
    assert all(state.program_running and not state.program_paused for state in states)
    assert any(resuming[-1].actual_qd)
    assert states[-1].runtime_state is RuntimeState.PLAYING
