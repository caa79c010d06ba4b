"""Why the arm stops, as error codes of the controller's log; what they mean: `urproto.errorcodes`."""

from dataclasses import dataclass
from typing import Final

__all__ = ["BUSY_PROTECTIVE_STOP", "READ_ONLY_SOCKET", "SCRIPT_PROTECTIVE_STOP", "StopCause"]


@dataclass(frozen=True, slots=True)
class StopCause:
    """Why a protective stop happened: ``C<code>A<argument>``, a text of its own, and the joint to blame if one is."""

    code: int
    argument: int = 0
    text: str = ""
    joint: int | None = None


SCRIPT_PROTECTIVE_STOP: Final = StopCause(209)
READ_ONLY_SOCKET: Final = 210
BUSY_PROTECTIVE_STOP: Final = StopCause(271, 1)
