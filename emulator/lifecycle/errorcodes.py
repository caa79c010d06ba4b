"""Error codes of the controller's log that the emulator can raise, with our wording.

Numbers and meaning: the error table of the vendor's public C++ libraries. Severity and
text are shown to people only; drivers look at the code and the level.
"""

from dataclasses import dataclass
from typing import Final

__all__ = ["BUSY_PROTECTIVE_STOP", "READ_ONLY_SOCKET", "SCRIPT_PROTECTIVE_STOP", "TEXTS", "StopCause", "error_text"]


@dataclass(frozen=True, slots=True)
class StopCause:
    """Why a protective stop happened: ``C<code>A<argument>``, a text of its own, and the joint to blame if one is."""

    code: int
    argument: int = 0
    text: str = ""
    joint: int | None = None


TEXTS: Final[dict[int, str]] = {
    50: "The arm has no 48 V supply",
    57: "The brakes could not be released",
    100: "The robot changed mode",
    102: "No real robot is connected: running in simulation",
    104: "An empty command was sent to the robot",
    150: "The arm is close to a joint limit",
    151: "The arm is close to the tool orientation limit",
    152: "The arm is close to a safety plane",
    153: "The position deviates from the path",
    154: "The position is in a singularity",
    155: "The robot cannot hold its position: check the payload",
    156: "Wrong payload or mounting, or the arm was pushed while freedrive began",
    157: "A collision was detected",
    162: "The protective stop was probably caused by a wrong payload",
    163: "More than 50 protective stops on one joint within eight hours",
    171: "A blend was skipped: the waypoint's radius is too small or overlaps the next",
    172: "Illegal control mode",
    173: "The joint torques are too high",
    191: "A safety limit was violated",
    192: "The safety system found a fault",
    193: "A joint reports a fault",
    197: "Blend radii overlap",
    204: "The path failed its check",
    205: "The target speed does not match the target position",
    206: "The target speed of a joint does not match its target position",
    209: "A protective stop was requested by the program",
    210: "The socket is read-only: scripts need a port that takes them and, on e-Series, remote control",
    218: "A thread used too much time",
    400: "The elbow is close to a safety plane",
    403: "The tool flange is so close to the lower arm that it could clamp",
    271: "The program computes without end: put sync() or sleep() into loops that do not move the robot",
}

SCRIPT_PROTECTIVE_STOP: Final = StopCause(209)
READ_ONLY_SOCKET: Final = 210
BUSY_PROTECTIVE_STOP: Final = StopCause(271, 1)


def error_text(code: int) -> str:
    """Text for an error code; unknown codes get a neutral one."""
    return TEXTS.get(code, f"Error code C{code}")
