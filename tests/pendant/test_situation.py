"""Permitted actions: every combination of a status, compared with the behaviour of an emulator."""

from collections.abc import Callable
from itertools import product
from typing import Any

import pytest

from client.pendant.situation import STAGES, Action, NotPermittedError, RobotStatus, Situation, situation
from emulator.machine import ControllerConfig
from emulator.virtual import VirtualRobot
from tests.rows import each_row
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
    for result in (situation(status) for status in ALL if not status.connected):
        shown = (
            result.title,
            result.tone,
            result.safety,
            result.advice,
            result.safety_tone,
            result.stage,
            result.program,
        )
        assert shown == ("Not connected", "unknown", "–", "", "unknown", -1, "–")
        assert result.recovery_action is None
        assert set(result.refusals) == set(Action)
        assert all(reason.startswith("Not connected.") for reason in result.refusals.values())


TITLES = {
    RobotMode.POWER_OFF: "Power off",
    RobotMode.BOOTING: "Booting",
    RobotMode.POWER_ON: "Power on",
    RobotMode.IDLE: "Idle",
    RobotMode.BACKDRIVE: "Backdrive",
    RobotMode.RUNNING: "Normal",
    RobotMode.DISCONNECTED: "Arm disconnected",
}


def test_titles() -> None:
    assert {mode: situation(status(mode)).title for mode in TITLES} == TITLES
    assert situation(status(safety=SafetyMode.REDUCED)).title == "Reduced mode"
    assert situation(status(RobotMode.POWER_OFF, SafetyMode.REDUCED)).title == "Power off"
    assert situation(status(safety=SafetyMode.UNDEFINED_SAFETY_MODE)).title == "Safety mode unknown"


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


STOPPED = (RuntimeState.STOPPED, RuntimeState.STOPPING)
PLAYING = (RuntimeState.PLAYING, RuntimeState.RESUMING)
OFF, IDLE = (RobotMode.POWER_OFF,), (RobotMode.IDLE, RobotMode.BACKDRIVE)
POWERED = (RobotMode.BOOTING, RobotMode.POWER_ON, *IDLE, RobotMode.RUNNING)
FAILED = (SafetyMode.VIOLATION, SafetyMode.FAULT)
POWERLESS = (  # whatever ends these, it is not the power
    *FAILED,
    SafetyMode.VALIDATE_JOINT_ID,
    SafetyMode.SYSTEM_EMERGENCY_STOP,
    SafetyMode.ROBOT_EMERGENCY_STOP,
    SafetyMode.IMMI_EMERGENCY_STOP,
    SafetyMode.PROFISAFE_EMERGENCY_STOP,
)


def can_move(now: RobotStatus) -> bool:
    return now.robot_mode is RobotMode.RUNNING and now.safety_mode in MOVABLE


# what each action requires of a connected robot
RULES: dict[Action, Callable[[RobotStatus], bool]] = {
    Action.MOVE: lambda now: can_move(now) and (now.runtime_state in STOPPED or now.moved_by_pendant),
    Action.PLAY: lambda now: can_move(now) and (now.runtime_state not in PLAYING or now.moved_by_pendant),
    Action.SEND: can_move,
    Action.PAUSE: lambda now: now.runtime_state in PLAYING and not now.moved_by_pendant,
    Action.STOP: lambda now: now.runtime_state not in STOPPED,
    Action.POWER_ON: lambda now: now.robot_mode in OFF and now.safety_mode not in POWERLESS,
    Action.RELEASE_BRAKES: lambda now: now.robot_mode in (*OFF, *IDLE) and now.safety_mode not in POWERLESS,
    Action.POWER_OFF: lambda now: now.robot_mode in POWERED,
    Action.UNLOCK: lambda now: now.safety_mode is SafetyMode.PROTECTIVE_STOP and now.unlock_in_s == 0.0,
    Action.RESET_SAFEGUARD: lambda now: now.safety_mode is SafetyMode.SAFEGUARD_STOP and now.safeguard_open is False,
    Action.RESTART_SAFETY: lambda now: now.safety_mode in FAILED,
}


def test_rules() -> None:
    assert set(RULES) == set(Action)
    for now in filter(lambda now: now.connected, ALL):
        result = situation(now)
        assert {action for action in Action if result.permits(action)} == {a for a in Action if RULES[a](now)}, now
        assert all(bool(result.refusal(action)) is not RULES[action](now) for action in Action), now


NO_PROGRAM, RUNS = "No program is running.", "A program is running: stop it first."
PAUSED = "A program is paused: stop it first."
NO_POWER = "Power off. The arm has no power. ON powers it on; START also releases the brakes."
EMERGENCY = "Robot emergency stop. Release the emergency stop button (turn it), then press START."
PROTECTIVE = "Protective stop. Find the cause and remove it, then unlock the stop."


@each_row(
    ("action", "now", "reason"),
    [
        (Action.MOVE, {"robot": RobotMode.POWER_OFF}, NO_POWER),
        (Action.MOVE, {"safety": SafetyMode.PROTECTIVE_STOP}, PROTECTIVE),
        (Action.MOVE, {"runtime_state": RuntimeState.RESUMING}, RUNS),
        (Action.MOVE, {"runtime_state": RuntimeState.PAUSED}, PAUSED),
        (Action.MOVE, {"runtime_state": RuntimeState.PAUSING}, PAUSED),
        (Action.PLAY, {"runtime_state": RuntimeState.PLAYING}, "The program is already running."),
        (Action.PAUSE, {"runtime_state": RuntimeState.PAUSED}, NO_PROGRAM),
        (Action.STOP, {"runtime_state": RuntimeState.STOPPING}, NO_PROGRAM),
        (Action.POWER_ON, {}, "The arm already has power."),
        (Action.POWER_ON, {"robot": RobotMode.POWER_OFF, "safety": SafetyMode.ROBOT_EMERGENCY_STOP}, EMERGENCY),
        (Action.RELEASE_BRAKES, {}, "The brakes are released, or about to be."),
        (Action.RELEASE_BRAKES, {"robot": RobotMode.IDLE, "safety": SafetyMode.ROBOT_EMERGENCY_STOP}, EMERGENCY),
        (Action.POWER_OFF, {"robot": RobotMode.POWER_OFF}, "The arm has no power."),
        (Action.UNLOCK, {}, "There is no protective stop."),
        (Action.UNLOCK, {"safety": SafetyMode.PROTECTIVE_STOP, "unlock_in_s": 2.4}, "It can be unlocked in 3 s."),
        (Action.UNLOCK, {"safety": SafetyMode.PROTECTIVE_STOP, "unlock_in_s": 3.0}, "It can be unlocked in 3 s."),
        (Action.RESET_SAFEGUARD, {}, "There is no safeguard stop."),
        (
            Action.RESET_SAFEGUARD,
            {"safety": SafetyMode.SAFEGUARD_STOP, "safeguard_open": True},
            "The safeguard is open: close it first.",
        ),
        (
            Action.RESET_SAFEGUARD,
            {"safety": SafetyMode.SAFEGUARD_STOP},
            "Only the button that is wired to the robot resets its safeguard.",
        ),
        (Action.RESTART_SAFETY, {}, "There is no violation and no fault."),
    ],
)
def test_reasons(action: Action, now: dict[str, Any], reason: str) -> None:
    assert situation(status(**now)).refusal(action) == reason


CONTINUES = " The program then continues."


@each_row(
    ("now", "advice"),
    [
        ({}, "Nothing keeps the arm from moving."),
        ({"robot": RobotMode.IDLE}, "No stop is in force."),
        ({"safety": SafetyMode.PROTECTIVE_STOP}, "Find the cause and remove it, then unlock the stop."),
        (
            {"safety": SafetyMode.PROTECTIVE_STOP, "runtime_state": RuntimeState.PAUSED},
            "Find the cause and remove it, then unlock the stop. The program stays paused.",
        ),
        *(
            ({"safety": SafetyMode.SAFEGUARD_STOP, "runtime_state": state, **opened}, advice + continues)
            for state, continues in (
                (RuntimeState.PAUSED, CONTINUES),
                (RuntimeState.PAUSING, CONTINUES),
                (RuntimeState.STOPPED, ""),
            )
            for opened, advice in (
                ({}, "Close the safeguard; where a reset button is wired, press it."),
                ({"safeguard_open": True}, "The safeguard is open: close it."),
                ({"safeguard_open": False}, "The safeguard is closed: reset it."),
            )
        ),
        (
            {"safety": SafetyMode.TP_THREE_POSITION_ENABLING_STOP, "runtime_state": RuntimeState.PAUSED},
            "Hold the enabling device in its middle position." + CONTINUES,
        ),
    ],
)
def test_advice(now: dict[str, Any], advice: str) -> None:
    assert situation(status(**now)).advice == advice


STAGE = {
    **dict.fromkeys(RobotMode, -1),
    RobotMode.POWER_OFF: 0,
    RobotMode.BOOTING: 1,
    RobotMode.POWER_ON: 1,
    RobotMode.IDLE: 2,
    RobotMode.BACKDRIVE: 2,
    RobotMode.RUNNING: 3,
}
RECOVERY = {
    SafetyMode.PROTECTIVE_STOP: Action.UNLOCK,
    SafetyMode.VIOLATION: Action.RESTART_SAFETY,
    SafetyMode.FAULT: Action.RESTART_SAFETY,
}


def test_lamps_stages_and_programs() -> None:
    """A stop is red, the arm's own state yellow until it can move; then green, and blue while a program moves it."""
    for now in filter(lambda now: now.connected, ALL):
        result, stage = situation(now), STAGE[now.robot_mode]
        unknown = now.safety_mode is SafetyMode.UNDEFINED_SAFETY_MODE
        safety = "unknown" if unknown else "ready" if now.safety_mode in MOVABLE else "stopped"
        assert (result.stage, result.safety_tone) == (stage, safety), now
        if stage >= 0:
            busy = now.moved_by_pendant or now.runtime_state in PLAYING
            free = "off" if stage == 0 else "waiting" if stage < 3 else "busy" if busy else "ready"
            assert result.tone == (safety if safety != "ready" else free), now
        known = now.safety_mode is SafetyMode.SAFEGUARD_STOP and now.safeguard_open is not None
        assert result.recovery_action is (Action.RESET_SAFEGUARD if known else RECOVERY.get(now.safety_mode)), now
        program = "Pendant control" if now.moved_by_pendant else now.runtime_state.name.capitalize()
        assert result.program == program, now


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


@each_row("state", STATES)
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
