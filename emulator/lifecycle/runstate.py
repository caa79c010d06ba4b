"""State of the running program as a table.

PAUSING and STOPPING are passed through while the arm comes to rest or the script's sockets
close, RESUMING for a tenth of a second while the arm gains speed; SETTLED ends each of them.
Names and numbers: runtime-state enumeration of RTDE. Which events a state ignores is a guess, chosen so that pressing a
button twice does no harm.
"""

from enum import Enum, auto

from urproto.modes import RuntimeState

__all__ = ["RUN_TABLE", "RunEvent", "is_running", "next_run_state"]


class RunEvent(Enum):
    """What can happen to a program."""

    START = auto()  # a program begins
    PAUSE = auto()  # operator, watchdog or safety asks for a pause
    RESUME = auto()  # a paused program shall go on
    STOP = auto()  # stop, halt, error, or another program takes over
    FINISH = auto()  # the program came to its end
    SETTLED = auto()  # the transition under way is complete


RUN_TABLE: dict[tuple[RuntimeState, RunEvent], RuntimeState] = {
    (RuntimeState.STOPPED, RunEvent.START): RuntimeState.PLAYING,
    (RuntimeState.PLAYING, RunEvent.PAUSE): RuntimeState.PAUSING,
    (RuntimeState.PLAYING, RunEvent.STOP): RuntimeState.STOPPING,
    (RuntimeState.PLAYING, RunEvent.FINISH): RuntimeState.STOPPING,
    (RuntimeState.PAUSING, RunEvent.SETTLED): RuntimeState.PAUSED,
    (RuntimeState.PAUSING, RunEvent.RESUME): RuntimeState.RESUMING,
    (RuntimeState.PAUSING, RunEvent.STOP): RuntimeState.STOPPING,
    (RuntimeState.PAUSING, RunEvent.FINISH): RuntimeState.STOPPING,
    (RuntimeState.PAUSED, RunEvent.RESUME): RuntimeState.RESUMING,
    (RuntimeState.PAUSED, RunEvent.STOP): RuntimeState.STOPPING,
    (RuntimeState.RESUMING, RunEvent.SETTLED): RuntimeState.PLAYING,
    (RuntimeState.RESUMING, RunEvent.PAUSE): RuntimeState.PAUSING,
    (RuntimeState.RESUMING, RunEvent.STOP): RuntimeState.STOPPING,
    (RuntimeState.RESUMING, RunEvent.FINISH): RuntimeState.STOPPING,
    (RuntimeState.STOPPING, RunEvent.SETTLED): RuntimeState.STOPPED,
}


def next_run_state(state: RuntimeState, event: RunEvent) -> RuntimeState:
    """The state after the event; a pair that is not in the table changes nothing."""
    return RUN_TABLE.get((state, event), state)


def is_running(state: RuntimeState) -> bool:
    """True while a program is loaded into the interpreter and not paused or over."""
    return state in (RuntimeState.PLAYING, RuntimeState.PAUSING, RuntimeState.RESUMING)
