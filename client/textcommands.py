"""The controller's own text commands on the script ports, and how to see that they took effect.

A controller does not answer them: the state it sends shows what became of them. Which exist
and what they lead to: the official C++ client.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from urproto.modes import RobotMode
from urproto.primary.state import ModeData

__all__ = [
    "BRAKE_RELEASE",
    "PAUSE_PROGRAM",
    "POWER_OFF",
    "POWER_ON",
    "RESUME_PROGRAM",
    "STOP_PROGRAM",
    "UNLOCK_PROTECTIVE_STOP",
    "TextCommand",
]

_BOOT_S: Final = 60.0  # guess: switching an arm on takes up to half a minute
_SOON_S: Final = 5.0


@dataclass(frozen=True, slots=True)
class TextCommand:
    """A line to send, what tells that it took effect, and what to do when it did not in time."""

    line: str
    done: Callable[[ModeData], bool]
    timeout_s: float
    advice: str


def _mode(*modes: RobotMode) -> Callable[[ModeData], bool]:
    return lambda state: state.robot_mode in modes


_SAFETY: Final = "look at the safety mode, and on e-Series switch to Remote Control and connect again"
_PROGRAM: Final = "on e-Series switch to Remote Control and connect again"

POWER_ON = TextCommand("power on", _mode(RobotMode.IDLE, RobotMode.RUNNING), _BOOT_S, _SAFETY)
POWER_OFF = TextCommand("power off", _mode(RobotMode.POWER_OFF), _SOON_S, _PROGRAM)
BRAKE_RELEASE = TextCommand("set robotmode run", _mode(RobotMode.RUNNING), _BOOT_S, _SAFETY)
UNLOCK_PROTECTIVE_STOP = TextCommand(
    "set unlock protective stop",
    lambda state: not state.protective_stopped,
    _SOON_S,
    "wait until 5 s after the stop and look for its cause; then as for any other command: " + _PROGRAM,
)
STOP_PROGRAM = TextCommand("stop program", lambda state: not state.program_running, _SOON_S, _PROGRAM)
PAUSE_PROGRAM = TextCommand(
    "pause program", lambda state: state.program_paused or not state.program_running, _SOON_S, _PROGRAM
)
RESUME_PROGRAM = TextCommand("resume program", lambda state: not state.program_paused, _SOON_S, _SAFETY)
