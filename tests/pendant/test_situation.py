"""What the arm may do now: every combination of what can be known, and the same as an emulator really does."""

from itertools import product
from typing import Any

import pytest

from client.pendant.situation import STAGES, Action, Known, NotNowError, Situation, situation
from emulator.control.control import VirtualRobot
from emulator.machine import ControllerConfig
from urproto.modes import RobotMode, RuntimeState, SafetyMode
from urproto.robots import load_model

ALL = [
    Known(*row)
    for row in product(
        (False, True), RobotMode, SafetyMode, RuntimeState, (False, True), (None, False, True), (0.0, 2.4)
    )
]
MAY_MOVE = (SafetyMode.NORMAL, SafetyMode.REDUCED)


def known(robot: RobotMode = RobotMode.RUNNING, safety: SafetyMode = SafetyMode.NORMAL, **also: Any) -> Known:
    return Known(True, robot, safety, **also)


def told(one: Known) -> str:
    """Everything that screens show of it."""
    now = situation(one)
    return " ".join((now.title, now.hint, now.safety, now.advice)).lower()


def test_without_a_connection_nothing_is_known_and_nothing_may_be_done() -> None:
    answers = [situation(one) for one in ALL if not one.connected]
    assert len({(now.title, now.tone, now.safety, now.stage, now.program, now.way_out) for now in answers}) == 1
    for now in answers:
        assert (now.title, now.tone, now.stage, now.way_out) == ("Not connected", "unknown", -1, None)
        assert set(now.refusals) == set(Action)
        assert all(why.startswith("Not connected.") for why in now.refusals.values())


def test_every_combination_has_a_title_a_hint_and_a_reason_for_each_refusal() -> None:
    for one in ALL:
        now = situation(one)
        assert now.title, one
        assert now.hint.endswith("."), (one, now.hint)
        assert all(why[0].isupper() and why.endswith(".") for why in now.refusals.values()), (one, now.refusals)
        assert -1 <= now.stage < len(STAGES)


def test_the_arm_moves_only_with_its_brakes_released_no_stop_in_force_and_no_program_of_others() -> None:
    for one in filter(lambda one: one.connected, ALL):
        free = one.robot_mode is RobotMode.RUNNING and one.safety_mode in MAY_MOVE
        idle = one.runtime_state in (RuntimeState.STOPPED, RuntimeState.STOPPING) or one.moved_here
        assert situation(one).may(Action.MOVE) == (free and idle), one


def test_no_text_says_that_the_arm_can_move_when_it_may_not() -> None:
    for one in ALL:
        now = situation(one)
        if not now.may(Action.SEND):  # nothing at all may move it
            assert "can move" not in told(one), one
            assert "nothing keeps" not in told(one), one
            assert now.tone not in ("ready", "busy"), one
        if "emergency" in now.title.lower() or "stop" in now.title.lower():
            assert now.tone == "stopped", one
            assert now.title != "Normal", one


def test_a_stop_is_what_the_title_names_wherever_one_is_in_force() -> None:
    for one in filter(lambda one: one.connected, ALL):
        now = situation(one)
        if one.safety_mode not in MAY_MOVE and now.stage >= 0:
            assert (now.title, now.hint) == (now.safety, now.advice), one


def test_open_and_closed_are_never_said_of_one_safeguard() -> None:
    for one in filter(lambda one: one.connected and one.safety_mode is SafetyMode.SAFEGUARD_STOP, ALL):
        advice = situation(one).advice
        assert ("is open" in advice) == (one.safeguard_open is True), one
        assert ("is closed" in advice) == (one.safeguard_open is False), one
        assert situation(one).may(Action.RESET_SAFEGUARD) == (one.safeguard_open is False), one


@pytest.mark.parametrize(
    ("one", "title", "tone", "way_out"),
    [
        (known(RobotMode.POWER_OFF), "Power off", "off", None),
        (known(RobotMode.BOOTING), "Booting", "waiting", None),
        (known(RobotMode.IDLE), "Idle", "waiting", None),
        (known(), "Normal", "ready", None),
        (known(runtime_state=RuntimeState.PLAYING), "Normal", "busy", None),
        (known(runtime_state=RuntimeState.PAUSED), "Normal", "ready", None),
        (known(safety=SafetyMode.REDUCED), "Reduced mode", "ready", None),
        (known(RobotMode.POWER_OFF, SafetyMode.REDUCED), "Power off", "off", None),
        (known(safety=SafetyMode.PROTECTIVE_STOP), "Protective stop", "stopped", Action.UNLOCK),
        (known(RobotMode.POWER_OFF, SafetyMode.PROTECTIVE_STOP), "Protective stop", "stopped", Action.UNLOCK),
        (known(safety=SafetyMode.SAFEGUARD_STOP), "Safeguard stop", "stopped", None),
        (
            known(safety=SafetyMode.SAFEGUARD_STOP, safeguard_open=False),
            "Safeguard stop",
            "stopped",
            Action.RESET_SAFEGUARD,
        ),
        (known(RobotMode.POWER_OFF, SafetyMode.ROBOT_EMERGENCY_STOP), "Robot emergency stop", "stopped", None),
        (known(RobotMode.POWER_OFF, SafetyMode.FAULT), "Fault", "stopped", Action.RESTART_SAFETY),
        (known(RobotMode.DISCONNECTED), "Arm disconnected", "off", None),
        (known(safety=SafetyMode.UNDEFINED_SAFETY_MODE), "Safety mode unknown", "unknown", None),
    ],
)
def test_what_a_person_reads(one: Known, title: str, tone: str, way_out: Action | None) -> None:
    now = situation(one)
    assert (now.title, now.tone, now.way_out) == (title, tone, way_out)


def test_the_unlocking_is_counted_down() -> None:
    now = situation(known(safety=SafetyMode.PROTECTIVE_STOP, unlock_in_s=2.4))
    assert now.why_not(Action.UNLOCK) == "It can be unlocked in 3 s."
    assert situation(known(safety=SafetyMode.PROTECTIVE_STOP)).may(Action.UNLOCK)


def test_what_is_refused_is_raised_with_its_reason() -> None:
    situation(known()).require(Action.MOVE)
    with pytest.raises(NotNowError, match="A program is running: stop it first"):
        situation(known(runtime_state=RuntimeState.PLAYING)).require(Action.MOVE)


# as an emulator does

MOVING = "def far():\n  while True:\n    movej([1, -1, 0.5, -1, 0, 0])\n    movej([0, -1, 1, 0, 0, 0])\n  end\nend\n"
LINES = {
    Action.PLAY: "play",
    Action.PAUSE: "pause",
    Action.POWER_ON: "power on",
    Action.RELEASE_BRAKES: "brake release",
    Action.UNLOCK: "unlock protective stop",
}
REFUSED = ("failed", "cannot", "not allowed", "could not")
STATES = {
    "power off": lambda robot: robot.power_off(),
    "idle": lambda robot: (robot.power_off(), robot.power_on()),
    "stopped": lambda robot: robot.dashboard("stop"),
    "playing": lambda robot: None,
    "paused": lambda robot: robot.dashboard("pause"),
    "reduced": lambda robot: robot.set_safety_device("reduced_mode", True),
    "safeguard open": lambda robot: robot.open_safeguard(),
    "safeguard closed": lambda robot: (robot.open_safeguard(), robot.step(50), robot.close_safeguard()),
    "protective stop": lambda robot: robot.protective_stop(),
    "protective stop, a while ago": lambda robot: (robot.protective_stop(), robot.step(700)),
    "emergency stop": lambda robot: robot.press_emergency_stop(),
    "fault": lambda robot: robot.trip_safety("joint_speed_violation", 3),
}


@pytest.mark.parametrize("state", STATES)
def test_an_emulator_takes_what_may_be_done_and_refuses_what_may_not(state: str, tmp_path: Any) -> None:
    (tmp_path / "far.script").write_text(MOVING)
    robot = VirtualRobot(ControllerConfig(model=load_model("ur3"), running=True, programs_dir=tmp_path))
    robot.dashboard("load far.script")
    robot.dashboard("play")
    STATES[state](robot)
    robot.step(200)
    now = seen(robot)
    for action, line in LINES.items():
        if now.may(action):
            continue
        before = robot.state(["robot_mode", "safety_mode", "runtime_state"])
        robot.dashboard(line)
        robot.step(5)
        assert robot.state(["robot_mode", "safety_mode", "runtime_state"]) == before, (state, line)
    for action, line in LINES.items():
        if seen(robot).may(action):
            answer = str(robot.dashboard(line))
            assert not any(word in answer.lower() for word in REFUSED), (state, line, answer)
            robot.step(200)


def seen(robot: VirtualRobot) -> Situation:
    state = robot.state(["robot_mode", "safety_mode", "runtime_state"])
    age_s = robot.controller.safety.mode_age_s
    return situation(
        Known(
            True,
            RobotMode[state["robot_mode"]],
            SafetyMode[state["safety_mode"]],
            RuntimeState[state["runtime_state"]],
            safeguard_open=robot.safety_devices()["safeguard"],
            unlock_in_s=max(0.0, 5.0 - age_s),
        )
    )
