"""Permitted actions: every combination of a status, compared with the behaviour of an emulator."""

from itertools import product
from typing import Any

import pytest

from client.pendant.situation import STAGES, Action, NotPermittedError, RobotStatus, Situation, situation
from emulator.control.control import VirtualRobot
from emulator.machine import ControllerConfig
from urproto.modes import RobotMode, RuntimeState, SafetyMode
from urproto.robots import load_model

ALL = [
    RobotStatus(*row)
    for row in product(
        (False, True), RobotMode, SafetyMode, RuntimeState, (False, True), (None, False, True), (0.0, 2.4)
    )
]
MOVABLE = (SafetyMode.NORMAL, SafetyMode.REDUCED)


def status(robot: RobotMode = RobotMode.RUNNING, safety: SafetyMode = SafetyMode.NORMAL, **also: Any) -> RobotStatus:
    return RobotStatus(True, robot, safety, **also)


def shown_text(status: RobotStatus) -> str:
    """All texts that screens show for a status."""
    result = situation(status)
    return " ".join((result.title, result.hint, result.safety, result.advice)).lower()


def test_nothing_is_permitted_without_connection() -> None:
    answers = [situation(status) for status in ALL if not status.connected]
    assert (
        len(
            {
                (
                    result.title,
                    result.tone,
                    result.safety,
                    result.stage,
                    result.program,
                    result.recovery_action,
                )
                for result in answers
            }
        )
        == 1
    )
    for result in answers:
        assert (result.title, result.tone, result.stage, result.recovery_action) == (
            "Not connected",
            "unknown",
            -1,
            None,
        )
        assert set(result.refusals) == set(Action)
        assert all(reason.startswith("Not connected.") for reason in result.refusals.values())


def test_every_status_has_title_hint_and_refusal_reasons() -> None:
    for status in ALL:
        result = situation(status)
        assert result.title, status
        assert result.hint.endswith("."), (status, result.hint)
        assert all(reason[0].isupper() and reason.endswith(".") for reason in result.refusals.values()), (
            status,
            result.refusals,
        )
        assert -1 <= result.stage < len(STAGES)


def test_motion_requires_released_brakes_no_stop_and_no_other_program() -> None:
    for status in filter(lambda status: status.connected, ALL):
        free = status.robot_mode is RobotMode.RUNNING and status.safety_mode in MOVABLE
        idle = status.runtime_state in (RuntimeState.STOPPED, RuntimeState.STOPPING) or status.moved_by_pendant
        assert situation(status).permits(Action.MOVE) == (free and idle), status


def test_texts_never_claim_forbidden_motion() -> None:
    for status in ALL:
        result = situation(status)
        if not result.permits(Action.SEND):  # nothing at all may move it
            assert "can move" not in shown_text(status), status
            assert "nothing keeps" not in shown_text(status), status
            assert result.tone not in ("ready", "busy"), status
        if "emergency" in result.title.lower() or "stop" in result.title.lower():
            assert result.tone == "stopped", status
            assert result.title != "Normal", status


def test_title_names_stop_in_force() -> None:
    for status in filter(lambda status: status.connected, ALL):
        result = situation(status)
        if status.safety_mode not in MOVABLE and result.stage >= 0:
            assert (result.title, result.hint) == (result.safety, result.advice), status


def test_safeguard_advice_is_consistent() -> None:
    for status in filter(lambda status: status.connected and status.safety_mode is SafetyMode.SAFEGUARD_STOP, ALL):
        advice = situation(status).advice
        assert ("is open" in advice) == (status.safeguard_open is True), status
        assert ("is closed" in advice) == (status.safeguard_open is False), status
        assert situation(status).permits(Action.RESET_SAFEGUARD) == (status.safeguard_open is False), status


@pytest.mark.parametrize(
    ("status", "title", "tone", "recovery_action"),
    [
        (status(RobotMode.POWER_OFF), "Power off", "off", None),
        (status(RobotMode.BOOTING), "Booting", "waiting", None),
        (status(RobotMode.IDLE), "Idle", "waiting", None),
        (status(), "Normal", "ready", None),
        (status(runtime_state=RuntimeState.PLAYING), "Normal", "busy", None),
        (status(runtime_state=RuntimeState.PAUSED), "Normal", "ready", None),
        (status(safety=SafetyMode.REDUCED), "Reduced mode", "ready", None),
        (status(RobotMode.POWER_OFF, SafetyMode.REDUCED), "Power off", "off", None),
        (status(safety=SafetyMode.PROTECTIVE_STOP), "Protective stop", "stopped", Action.UNLOCK),
        (status(RobotMode.POWER_OFF, SafetyMode.PROTECTIVE_STOP), "Protective stop", "stopped", Action.UNLOCK),
        (status(safety=SafetyMode.SAFEGUARD_STOP), "Safeguard stop", "stopped", None),
        (
            status(safety=SafetyMode.SAFEGUARD_STOP, safeguard_open=False),
            "Safeguard stop",
            "stopped",
            Action.RESET_SAFEGUARD,
        ),
        (status(RobotMode.POWER_OFF, SafetyMode.ROBOT_EMERGENCY_STOP), "Robot emergency stop", "stopped", None),
        (status(RobotMode.POWER_OFF, SafetyMode.FAULT), "Fault", "stopped", Action.RESTART_SAFETY),
        (status(RobotMode.DISCONNECTED), "Arm disconnected", "off", None),
        (status(safety=SafetyMode.UNDEFINED_SAFETY_MODE), "Safety mode unknown", "unknown", None),
    ],
)
def test_titles_tones_and_recovery_actions(
    status: RobotStatus, title: str, tone: str, recovery_action: Action | None
) -> None:
    result = situation(status)
    assert (result.title, result.tone, result.recovery_action) == (title, tone, recovery_action)


def test_unlock_countdown_is_shown() -> None:
    result = situation(status(safety=SafetyMode.PROTECTIVE_STOP, unlock_in_s=2.4))
    assert result.refusal(Action.UNLOCK) == "It can be unlocked in 3 s."
    assert situation(status(safety=SafetyMode.PROTECTIVE_STOP)).permits(Action.UNLOCK)


def test_require_raises_refusal_reason() -> None:
    situation(status()).require(Action.MOVE)
    with pytest.raises(NotPermittedError, match="A program is running: stop it first"):
        situation(status(runtime_state=RuntimeState.PLAYING)).require(Action.MOVE)


# compared with an emulator

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
def test_emulator_agrees_with_permitted_actions(state: str, tmp_path: Any) -> None:
    (tmp_path / "far.script").write_text(MOVING)
    robot = VirtualRobot(ControllerConfig(model=load_model("ur3"), running=True, programs_dir=tmp_path))
    robot.dashboard("load far.script")
    robot.dashboard("play")
    STATES[state](robot)
    robot.step(200)
    result = observed_situation(robot)
    for action, line in LINES.items():
        if result.permits(action):
            continue
        before = robot.state(["robot_mode", "safety_mode", "runtime_state"])
        robot.dashboard(line)
        robot.step(5)
        assert robot.state(["robot_mode", "safety_mode", "runtime_state"]) == before, (state, line)
    for action, line in LINES.items():
        if observed_situation(robot).permits(action):
            answer = str(robot.dashboard(line))
            assert not any(word in answer.lower() for word in REFUSED), (state, line, answer)
            robot.step(200)


def observed_situation(robot: VirtualRobot) -> Situation:
    state = robot.state(["robot_mode", "safety_mode", "runtime_state"])
    age_s = robot.controller.safety.mode_age_s
    return situation(
        RobotStatus(
            True,
            RobotMode[state["robot_mode"]],
            SafetyMode[state["safety_mode"]],
            RuntimeState[state["runtime_state"]],
            safeguard_open=robot.safety_devices()["safeguard"],
            unlock_in_s=max(0.0, 5.0 - age_s),
        )
    )
