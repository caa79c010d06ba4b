"""Decides which actions the arm permits now, and why not: one answer for all screens.

`situation` is a function only of what is known about the robot, so screens cannot contradict each other. It checks in
the order in which a person would: does the robot answer, is the arm stopped, how far is it switched on, is a program
running.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto
from functools import lru_cache
from math import ceil
from typing import Final, Literal, NamedTuple

from client.errors import ClientError
from urproto.modes import RobotMode, RuntimeState, SafetyMode

Tone = Literal["unknown", "off", "stopped", "waiting", "ready", "busy"]
"""Colours of the lamps: grey, red, red, yellow, green, blue."""

STAGES: Final = ("Power off", "Booting", "Idle", "Brakes released")
"""The stages from an arm without power to one that can move."""
_OFF, _BOOTING, _IDLE, _RELEASED = range(len(STAGES))

_ESTOP_ADVICE: Final = "Release the emergency stop button (turn it), then press START."
_NO_STOP: Final = (SafetyMode.NORMAL, SafetyMode.REDUCED)
_ENABLING_STOPS: Final = (SafetyMode.SYSTEM_THREE_POSITION_ENABLING_STOP, SafetyMode.TP_THREE_POSITION_ENABLING_STOP)
_SAFEGUARD_STOPS: Final = tuple(mode for mode in SafetyMode if mode.name.endswith("SAFEGUARD_STOP"))
_FAILURES: Final = (SafetyMode.VIOLATION, SafetyMode.FAULT)
_POWER_FORBIDDEN: Final = (
    *_FAILURES,
    *(mode for mode in SafetyMode if mode.name.endswith("EMERGENCY_STOP")),
    SafetyMode.VALIDATE_JOINT_ID,
)
_STOPPED: Final = (RuntimeState.STOPPED, RuntimeState.STOPPING)
_PROGRAM_HINTS: Final = {
    RuntimeState.PLAYING: "A program is running.",
    RuntimeState.RESUMING: "A program is running.",
    RuntimeState.PAUSING: "A program is paused. PLAY resumes it.",
    RuntimeState.PAUSED: "A program is paused. PLAY resumes it.",
}


class Action(Enum):
    """An action that a user may request."""

    MOVE = auto()  # jog, go to a target, freedrive
    PLAY = auto()
    SEND = auto()  # a script, which replaces the program that runs
    PAUSE = auto()
    STOP = auto()
    POWER_ON = auto()
    RELEASE_BRAKES = auto()
    POWER_OFF = auto()
    UNLOCK = auto()
    RESET_SAFEGUARD = auto()
    RESTART_SAFETY = auto()


class NotPermittedError(ClientError):
    """The arm does not permit the action now; the text says why, and what to do about it."""


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """What is known about a robot.

    safety_mode: the most specific one that it reports. moved_by_pendant: the running program is the one with which the
    pendant moves the arm. safeguard_open: whether the safeguard itself is open, or the enabling device is not pressed;
    None if unknown, as with real robots. unlock_in_s: time until a protective stop can be unlocked.
    """

    connected: bool = False
    robot_mode: RobotMode = RobotMode.NO_CONTROLLER
    safety_mode: SafetyMode = SafetyMode.UNDEFINED_SAFETY_MODE
    runtime_state: RuntimeState = RuntimeState.STOPPED
    moved_by_pendant: bool = False
    safeguard_open: bool | None = None
    unlock_in_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Situation:
    """The state of the arm in words. title: in two words. hint: its meaning, and the next step. tone: of the lamps.

    safety, advice, safety_tone: the same for the safety mode alone. recovery_action: the action that ends a stop,
    even if it is not permitted yet. stage: index of `STAGES`, -1 while nothing can be switched on. program: its state.
    refusals: the reason for each action that is not permitted.
    """

    title: str
    hint: str
    tone: Tone
    safety: str
    advice: str
    safety_tone: Tone
    recovery_action: Action | None
    stage: int
    program: str
    refusals: Mapping[Action, str]

    def permits(self, action: Action) -> bool:
        return action not in self.refusals

    def refusal(self, action: Action) -> str:
        """Why an action is not permitted, "" if it is."""
        return self.refusals.get(action, "")

    @property
    def play_refusal(self) -> str:
        """Why no program can be played, "" if one can be or is running."""
        return "" if self.permits(Action.PAUSE) else self.refusal(Action.PLAY)

    def require(self, action: Action) -> None:
        """Raises NotPermittedError if an action is not permitted."""
        if not self.permits(action):
            raise NotPermittedError(self.refusal(action))


class _Safety(NamedTuple):
    title: str
    advice: str


_SAFETY: Final = {
    SafetyMode.NORMAL: _Safety("Normal", "Nothing keeps the arm from moving."),
    SafetyMode.REDUCED: _Safety("Reduced mode", "The limits of reduced mode are in force."),
    SafetyMode.PROTECTIVE_STOP: _Safety("Protective stop", "Find the cause and remove it, then unlock the stop."),
    SafetyMode.RECOVERY: _Safety(
        "Recovery", "The arm is outside its safety limits: move it back with the robot's own pendant."
    ),
    SafetyMode.SAFEGUARD_STOP: _Safety("Safeguard stop", ""),
    SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP: _Safety("Automatic mode safeguard stop", ""),
    SafetyMode.IMMI_SAFEGUARD_STOP: _Safety("IMMI safeguard stop", ""),
    SafetyMode.PROFISAFE_SAFEGUARD_STOP: _Safety("PROFIsafe safeguard stop", ""),
    SafetyMode.PROFISAFE_AUTOMATIC_MODE_SAFEGUARD_STOP: _Safety("PROFIsafe automatic mode safeguard stop", ""),
    SafetyMode.SAFETY_API_SAFEGUARD_STOP: _Safety("Safety API safeguard stop", ""),
    SafetyMode.SYSTEM_THREE_POSITION_ENABLING_STOP: _Safety("Enabling device stop", ""),
    SafetyMode.TP_THREE_POSITION_ENABLING_STOP: _Safety("Enabling device stop (teach pendant)", ""),
    SafetyMode.PROFISAFE_WAITING_FOR_PARAMETERS: _Safety(
        "Waiting for PROFIsafe", "The PROFIsafe controller has not sent its parameters yet."
    ),
    SafetyMode.ROBOT_EMERGENCY_STOP: _Safety("Robot emergency stop", _ESTOP_ADVICE),
    SafetyMode.IMMI_EMERGENCY_STOP: _Safety("IMMI emergency stop", _ESTOP_ADVICE),
    SafetyMode.PROFISAFE_EMERGENCY_STOP: _Safety("PROFIsafe emergency stop", _ESTOP_ADVICE),
    SafetyMode.SYSTEM_EMERGENCY_STOP: _Safety(
        "System emergency stop", "Release the emergency stop of the other machine, then press START."
    ),
    SafetyMode.VIOLATION: _Safety(
        "Violation", "A safety limit was exceeded. Find out why, restart the safety system, then press START."
    ),
    SafetyMode.FAULT: _Safety(
        "Fault", "The robot has detected a fault. Remove its cause, restart the safety system, then press START."
    ),
    SafetyMode.VALIDATE_JOINT_ID: _Safety("Joint exchanged", "Confirm the new joint on the robot's own pendant."),
    SafetyMode.UNDEFINED_SAFETY_MODE: _Safety("Safety mode unknown", "This pendant does not know the safety mode."),
}


_RECOVERY_ACTIONS: Final = {
    SafetyMode.PROTECTIVE_STOP: Action.UNLOCK,
    SafetyMode.SAFEGUARD_STOP: Action.RESET_SAFEGUARD,
    SafetyMode.VIOLATION: Action.RESTART_SAFETY,
    SafetyMode.FAULT: Action.RESTART_SAFETY,
}


class _Mode(NamedTuple):
    title: str
    hint: str
    stage: int
    tone: Tone


_MODES: Final = {
    RobotMode.NO_CONTROLLER: _Mode("No controller", "The controller is not ready yet.", -1, "unknown"),
    RobotMode.DISCONNECTED: _Mode("Arm disconnected", "The controller is not connected to the arm.", -1, "off"),
    RobotMode.CONFIRM_SAFETY: _Mode(
        "Safety not confirmed",
        "The safety configuration has to be confirmed on the robot's own pendant.",
        -1,
        "off",
    ),
    RobotMode.POWER_OFF: _Mode(
        "Power off", "The arm has no power. ON powers it on; START also releases the brakes.", _OFF, "off"
    ),
    RobotMode.BOOTING: _Mode("Booting", "The joints are starting.", _BOOTING, "waiting"),
    RobotMode.POWER_ON: _Mode("Power on", "The arm has power; its joints are about to start.", _BOOTING, "waiting"),
    RobotMode.IDLE: _Mode(
        "Idle", "The brakes hold the arm. START releases them; make sure that nobody is near.", _IDLE, "waiting"
    ),
    RobotMode.BACKDRIVE: _Mode("Backdrive", "The arm can be pushed by hand.", _IDLE, "waiting"),
    RobotMode.RUNNING: _Mode("Normal", "The brakes are released: the arm can move.", _RELEASED, "ready"),
    RobotMode.UPDATING_FIRMWARE: _Mode(
        "Updating firmware", "The joints' firmware is being updated: leave the power on.", -1, "waiting"
    ),
}
_NOT_CONNECTED: Final = _Mode(
    "Not connected", "The robot does not answer. The pendant keeps trying to reach it.", -1, "unknown"
)


@lru_cache(maxsize=512)
def situation(status: RobotStatus) -> Situation:
    mode = _MODES[status.robot_mode] if status.connected else _NOT_CONNECTED
    safety, advice = (_SAFETY[status.safety_mode].title, _advice(status)) if status.connected else ("–", "")
    title, hint, tone = _headline(status, mode, safety, advice)
    blocked = "" if _can_move(status) else f"{title}. {hint}"
    refusals = {
        Action.MOVE: blocked or _program_refusal(status),
        Action.PLAY: blocked or ("" if _can_play(status) else "The program is already running."),
        Action.SEND: blocked,
        Action.PAUSE: _connection_refusal(status) or ("" if _is_playing(status) else "No program is running."),
        Action.STOP: _connection_refusal(status)
        or ("No program is running." if status.runtime_state in _STOPPED else ""),
        Action.POWER_ON: _power_refusal(status, mode, (_OFF,), "The arm already has power."),
        Action.RELEASE_BRAKES: _power_refusal(status, mode, (_OFF, _IDLE), "The brakes are released, or about to be."),
        Action.POWER_OFF: _connection_refusal(status) or ("" if mode.stage > _OFF else "The arm has no power."),
        Action.UNLOCK: _connection_refusal(status) or _unlock_refusal(status),
        Action.RESET_SAFEGUARD: _connection_refusal(status) or _reset_refusal(status),
        Action.RESTART_SAFETY: _connection_refusal(status)
        or ("" if status.safety_mode in _FAILURES else "There is no violation and no fault."),
    }
    refused = {action: reason for action, reason in refusals.items() if reason}
    return Situation(
        title,
        hint,
        tone,
        safety,
        advice,
        _safety_tone(status),
        _recovery_action(status),
        mode.stage,
        _program(status),
        refused,
    )


def _headline(status: RobotStatus, mode: _Mode, safety: str, advice: str) -> tuple[str, str, Tone]:
    if not status.connected or mode.stage < _OFF:
        return mode.title, mode.hint, mode.tone
    if status.safety_mode not in _NO_STOP:
        return safety, advice, _safety_tone(status)
    if mode.stage < _RELEASED:
        return mode.title, mode.hint, mode.tone
    title = mode.title if status.safety_mode is SafetyMode.NORMAL else safety
    if status.moved_by_pendant:
        return title, "The pendant's own program is running, which moves the arm from here.", "busy"
    if status.runtime_state in _STOPPED:
        return title, mode.hint, "ready"
    return title, _PROGRAM_HINTS[status.runtime_state], "busy" if _is_playing(status) else "ready"


def _advice(status: RobotStatus) -> str:
    mode = status.safety_mode
    if mode in _ENABLING_STOPS:
        return "Hold the enabling device in its middle position." + _continuation(status)
    if mode in _SAFEGUARD_STOPS:
        return _safeguard_advice(status) + _continuation(status)
    if mode is SafetyMode.PROTECTIVE_STOP and status.runtime_state is RuntimeState.PAUSED:
        return f"{_SAFETY[mode].advice} The program stays paused."
    if mode is SafetyMode.NORMAL and status.robot_mode is not RobotMode.RUNNING:
        return "No stop is in force."
    return _SAFETY[mode].advice


def _safeguard_advice(status: RobotStatus) -> str:
    if status.safeguard_open is None:
        return "Close the safeguard; where a reset button is wired, press it."
    return "The safeguard is open: close it." if status.safeguard_open else "The safeguard is closed: reset it."


def _continuation(status: RobotStatus) -> str:
    return " The program then continues." if status.runtime_state in (RuntimeState.PAUSED, RuntimeState.PAUSING) else ""


def _safety_tone(status: RobotStatus) -> Tone:
    if not status.connected or status.safety_mode is SafetyMode.UNDEFINED_SAFETY_MODE:
        return "unknown"
    return "ready" if status.safety_mode in _NO_STOP else "stopped"


def _recovery_action(status: RobotStatus) -> Action | None:
    if status.safety_mode is SafetyMode.SAFEGUARD_STOP and status.safeguard_open is None:
        return None
    return _RECOVERY_ACTIONS.get(status.safety_mode) if status.connected else None


def _program(status: RobotStatus) -> str:
    if not status.connected:
        return "–"
    return "Pendant control" if status.moved_by_pendant else status.runtime_state.name.capitalize()


# reasons for refusals


def _connection_refusal(status: RobotStatus) -> str:
    return "" if status.connected else f"{_NOT_CONNECTED.title}. {_NOT_CONNECTED.hint}"


def _can_move(status: RobotStatus) -> bool:
    """Whether the brakes are released and no stop is in force."""
    return status.connected and status.robot_mode is RobotMode.RUNNING and status.safety_mode in _NO_STOP


def _is_playing(status: RobotStatus) -> bool:
    return status.runtime_state in (RuntimeState.PLAYING, RuntimeState.RESUMING) and not status.moved_by_pendant


def _can_play(status: RobotStatus) -> bool:
    return status.moved_by_pendant or status.runtime_state not in (RuntimeState.PLAYING, RuntimeState.RESUMING)


def _program_refusal(status: RobotStatus) -> str:
    if status.moved_by_pendant or status.runtime_state in _STOPPED:
        return ""
    return f"{_PROGRAM_HINTS[status.runtime_state].partition('.')[0]}: stop it first."


def _power_refusal(status: RobotStatus, mode: _Mode, stages: tuple[int, ...], otherwise: str) -> str:
    if not status.connected or mode.stage < _OFF:
        return f"{mode.title}. {mode.hint}"
    if status.safety_mode in _POWER_FORBIDDEN:
        return f"{_SAFETY[status.safety_mode].title}. {_advice(status)}"
    return "" if mode.stage in stages else otherwise


def _unlock_refusal(status: RobotStatus) -> str:
    if status.safety_mode is not SafetyMode.PROTECTIVE_STOP:
        return "There is no protective stop."
    return f"It can be unlocked in {ceil(status.unlock_in_s)} s." if status.unlock_in_s > 0.0 else ""


def _reset_refusal(status: RobotStatus) -> str:
    if status.safety_mode is not SafetyMode.SAFEGUARD_STOP:
        return "There is no safeguard stop."
    if status.safeguard_open is None:
        return "Only the button that is wired to the robot resets its safeguard."
    return "The safeguard is open: close it first." if status.safeguard_open else ""
