"""How long the control program waits for the driver's next message."""

from functools import lru_cache
from typing import Final

from urproto.errors import LocalProtocolError
from urproto.external_control import ControlMode

__all__ = ["KEEP_ALIVE_TIMEOUT_S", "LONGEST_REAL_TIME_S", "SETPOINT_TIMEOUT_S", "read_timeout_ms"]

LONGEST_REAL_TIME_S: Final = 0.2  # the client library's: an arm in motion is not left alone for longer
SETPOINT_TIMEOUT_S: Final = 0.02  # its default for a setpoint
KEEP_ALIVE_TIMEOUT_S: Final = 1.0  # its default for a keep-alive
_STOP_MS: Final = 100
_LONGEST_MS: Final = 2**31 - 1


@lru_cache(maxsize=64)  # asked for with every setpoint
def read_timeout_ms(mode: ControlMode, timeout_s: float, period_s: float) -> int:
    """The timeout [ms] that is sent for `timeout_s` in this mode.

    At least one control period `period_s` [s]; in real-time modes at most 0.2 s. 0 waits for
    ever, except in real-time modes, where it is one period. Raises LocalProtocolError for a
    negative timeout.
    """
    if not timeout_s >= 0.0:
        raise LocalProtocolError(f"a timeout is 0 s or more, not {timeout_s}")
    if mode is ControlMode.STOPPED:
        return _STOP_MS
    if timeout_s == 0.0 and not mode.real_time:
        return 0
    longest = LONGEST_REAL_TIME_S if mode.real_time else _LONGEST_MS / 1000.0
    return max(1, round(1000.0 * min(max(timeout_s, period_s), longest)))
