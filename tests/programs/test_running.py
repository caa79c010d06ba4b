"""What starts, pauses and ends programs, in every state of them; what a program leaves behind; RTDE's watchdogs.

Sources: dashboard and script manuals, and those named in `emulator.programs.runner`.
"""

from typing import Any

import pytest
from tree_rig import Arm, line, main

from emulator.commands.requests import RTDEInputs
from emulator.lifecycle.safety import SafetyEvent
from emulator.safety.causes import Cause
from tests.commands import TripSafety
from tests.rows import each_row
from urproto.modes import RuntimeState, SafetyMode
from urproto.primary.messages import ErrorCodeMessage, KeyMessage
from urscript.work import run_to_end

CLIENT = "def client():\n  movej([1.5, -1.5, 1.5, -1.6, -1.57, 0.0], a=8.0, v=1.0)\n  sleep(9)\nend\n"
FILE = "movej([1.5, -1.5, 1.5, -1.6, -1.57, 0.0], a=8.0, v=1.0)\nsleep(9)"
REPORTS = {"STARTED": "+", "PAUSED": "=", "RESUMED": ">", "STOPPED": "."}


class Cell(Arm):
    """A UR5 of the CB3 series with two programs in its folder; the first is loaded."""

    def __init__(self, folder: Any, model: str = "ur5", **config: Any) -> None:
        super().__init__(folder, model, **config)
        for name in ("moves.urp", "other.urp"):
            self.save(name, main(*map(line, FILE.splitlines())))
        self.programs = self.controller.programs
        self.request("load moves.urp")
        self.messages.clear()

    def keys(self) -> str:
        """Messages about starts and ends since the last call."""
        titles = [m.title.removeprefix("PROGRAM_XXX_") for m in self.messages if isinstance(m, KeyMessage)]
        self.messages.clear()
        return "".join(REPORTS[title] for title in titles)

    def reach(self, state: str) -> "Cell":
        """Bring a client's program into a state, and the moving arm with it, until the state has just begun."""
        if state != "STOPPED":
            self.programs.submit(CLIENT)
            self.seconds(0.5)
        if state in ("PAUSING", "PAUSED", "RESUMING"):
            self.programs.pause()
        if state in ("PAUSED", "RESUMING"):
            self.until(lambda: self.state is RuntimeState.PAUSED, 1.0)
        if state == "RESUMING":
            assert self.programs.resume()
        if state == "STOPPING":
            self.programs.stop()
        assert self.state is RuntimeState[state]
        self.tick()
        assert self.state is RuntimeState[state]
        self.keys()
        return self


@pytest.fixture
def cell(tmp_path: Any) -> Cell:
    return Cell(tmp_path)


REQUESTS: dict[str, Any] = {
    "pause": lambda cell: cell.programs.pause(),
    "resume": lambda cell: cell.programs.resume(),
    "stop": lambda cell: cell.programs.stop(),
    "play": lambda cell: cell.programs.play(),
    "submit": lambda cell: cell.programs.submit(CLIENT.replace("client", "second")),
    "load": lambda cell: run_to_end(cell.programs.load_steps(cell.folder / "other.urp")),
    "protective": lambda cell: cell.controller.post(TripSafety(Cause.PROGRAM)),
}
# Rows: requests. Columns: the state of a client's program. Cells: whether the request was accepted (yes, no or -), the
# state half a second later and the reports of starts and ends until then: + started, = paused, > resumed, . stopped.
RULES = """
            STOPPED        PLAYING         PAUSING         PAUSED          RESUMING        STOPPING
pause       no_STOPPED_    yes_PAUSED_=    no_PAUSED_      no_PAUSED_      yes_PAUSED_=    no_STOPPED_.
resume      no_STOPPED_    no_PLAYING_     yes_PLAYING_>   yes_PLAYING_>   no_PLAYING_     no_STOPPED_.
stop        no_STOPPED_    yes_STOPPED_.   yes_STOPPED_.   yes_STOPPED_.   yes_STOPPED_.   no_STOPPED_.
play        yes_PLAYING_+  yes_PLAYING_    yes_PLAYING_>   yes_PLAYING_>   yes_PLAYING_    yes_PLAYING_.+
submit      yes_PLAYING_+  yes_PLAYING_.+  no_STOPPED_.    no_STOPPED_.    yes_PLAYING_.+  yes_PLAYING_.+
load        -_STOPPED_     -_STOPPED_.     -_STOPPED_.     -_STOPPED_.     -_STOPPED_.     -_STOPPED_.
protective  -_STOPPED_     -_PAUSED_=      -_PAUSED_       -_PAUSED_       -_PAUSED_=      -_STOPPED_.
"""
_STATES, *_ROWS = (row.split() for row in RULES.strip().splitlines())
CASES = [
    pytest.param(request, state, expected, id=f"{request}-{state}")
    for request, *cells in _ROWS
    for state, expected in zip(_STATES, cells, strict=True)
]


@pytest.mark.parametrize(("request_name", "state", "expected"), CASES)
def test_requests(cell: Cell, request_name: str, state: str, expected: str) -> None:
    cell.reach(state)
    answer = REQUESTS[request_name](cell)
    cell.seconds(0.5)
    answer = getattr(answer, "accepted", answer)
    seen = "-" if answer is None else "yes" if answer else "no"
    assert f"{seen}_{cell.state.name}_{cell.keys()}" == expected
    assert any(cell.controller.snapshot.actual_qd) is (cell.state is RuntimeState.PLAYING)


# a program that waits for its start


def test_a_program_that_waits_for_sockets_to_close_is_stopped_and_replaced(cell: Cell) -> None:
    """The gap between two programs is at least 10 ms; of several programs sent in it, the last one runs."""
    cell.programs.submit('def talks():\n  socket_open("10.0.0.1", 50001)\n  sleep(9)\nend\n')
    cell.seconds(0.1)
    cell.programs.submit(CLIENT)
    cell.tick()
    assert (cell.state, cell.programs.busy) == (RuntimeState.STOPPED, True)
    assert cell.programs.stop()
    assert not cell.programs.busy
    assert not cell.programs.stop()
    cell.seconds(0.1)
    assert (cell.state, cell.keys()) == (RuntimeState.STOPPED, "+.")
    cell.programs.submit('def talks():\n  socket_open("10.0.0.1", 50001)\n  sleep(9)\nend\n')
    cell.seconds(0.1)
    cell.programs.submit(CLIENT)
    cell.programs.submit(CLIENT.replace("client", "last"))
    assert cell.programs.play().accepted, "it will play"
    cell.seconds(0.1)
    assert (cell.programs.name, cell.keys()) == ("last", "+.+")


def test_runs_are_numbered_and_named(cell: Cell) -> None:
    programs = cell.programs
    assert (programs.view, programs.name, programs.source, programs.line) == (None, "moves.urp", None, 0)
    for number in (1, 2, 3):
        cell.reach("PLAYING")
        assert (programs.view.number, programs.view.running, programs.name) == (number, True, "client")
        assert (programs.source, programs.line, programs.loaded_ran) == (CLIENT, 2, False)
        programs.stop()
        cell.seconds(0.5)
        assert (programs.view.number, programs.view.running, programs.name) == (number, False, "moves.urp")
        assert (programs.source, programs.line) == (CLIENT, 0)
    assert cell.request("play") == "Starting program"
    assert (programs.view.number, programs.loaded_ran) == (4, True)


@pytest.mark.parametrize(("path", "kept"), [("moves.urp", {1}), ("other.urp", set())])
def test_loading_the_same_program_again_keeps_its_breakpoints(cell: Cell, path: str, kept: set[int]) -> None:
    cell.programs.breakpoints.set({1})
    cell.request(f"load {path}")
    assert cell.programs.breakpoints.numbers == kept


def test_calls_that_will_fail_are_logged_up_to_a_hundred(cell: Cell) -> None:
    for count, rest in ((99, []), (100, []), (101, ["wrong: 1 more calls will fail when they are executed"])):
        cell.programs.submit("def wrong():\n  sleep(9)\n" + "  get_flag()\n" * count + "end\n")
        cell.seconds(1.0)
        noted = [entry for entry in cell.controller.messages.history if "more calls" in entry]
        assert len(noted) == len(rest), count
        assert all(text in entry for text, entry in zip(rest, noted, strict=True))


# errors that pause instead of stopping: pause_on_error_code


@pytest.mark.parametrize(
    ("codes", "before", "expected"),
    [
        ("209", "PLAYING", (RuntimeState.PAUSED, SafetyMode.NORMAL)),
        ("209, 0", "PLAYING", (RuntimeState.PAUSED, SafetyMode.NORMAL)),
        ("209, 1", "PLAYING", (RuntimeState.PAUSED, SafetyMode.PROTECTIVE_STOP)),
        ("210", "PLAYING", (RuntimeState.PAUSED, SafetyMode.PROTECTIVE_STOP)),
        ("209", "PAUSED", (RuntimeState.PAUSED, SafetyMode.PROTECTIVE_STOP)),  # only a playing program is paused
        ("209", "next", (RuntimeState.PAUSED, SafetyMode.PROTECTIVE_STOP)),  # they end with the program
    ],
)
def test_pause_on_error_code(cell: Cell, codes: str, before: str, expected: Any) -> None:
    cell.programs.submit(f"def careful():\n  pause_on_error_code({codes})\n  sleep(9)\nend\n")
    cell.seconds(0.1)
    if before == "PAUSED":
        cell.programs.pause()
    elif before == "next":
        cell.reach("PLAYING")
    cell.controller.post(TripSafety(Cause.PROGRAM))
    cell.seconds(0.5)
    assert (cell.state, cell.controller.safety.mode) == expected
    assert [m.code for m in cell.messages if isinstance(m, ErrorCodeMessage)] == [209]


# watchdogs: 10 control periods each. In the history of writes, w: the input is written in this period, o: another one


SECONDS = {"ur5": 0.008, "ur5e": 0.002}


def watched(folder: Any, calls: str, model: str = "ur5") -> Cell:
    cell = Cell(folder, model)
    hz = 1.0 / (10 * SECONDS[model])
    lines = "".join(f"  rtde_set_watchdog({call})\n" for call in calls.format(hz=hz).split("; "))
    cell.programs.submit(f"def watched():\n{lines}  while True:\n    sync()\n  end\nend\n")
    cell.tick()
    assert cell.state is RuntimeState.PLAYING
    return cell


def history(cell: Cell, periods: str) -> Cell:
    for letter in periods:
        names = {"w": "input_int_register_0", "o": "input_int_register_1"}
        if letter != ".":
            cell.controller.post(RTDEInputs({names[letter]: 1}))
        cell.tick()
    return cell


REGISTER = '"input_int_register_0", {hz}'


@each_row("model", SECONDS)
@each_row(
    ("calls", "writes", "acts"),
    [
        (REGISTER, "." * 10, False),
        (REGISTER, "." * 11, True),
        (REGISTER, "w" + "." * 10, False),
        (REGISTER, "w" + "." * 11, True),
        (REGISTER, "....w" + "." * 10, False),
        (REGISTER, "....w" + "." * 11, True),
        (REGISTER, ("w" + "." * 9) * 3, False),
        (REGISTER, "o" * 11, True),
        (f"{REGISTER}; {REGISTER}", "w" * 40, False),
        (f'{REGISTER}; "input_int_register_1", {{hz}}', "w" * 11, True),
        (f'{REGISTER}; "input_int_register_1", {{hz}}', "wo" * 20, False),
        (f'{REGISTER}; "input_int_register_0", 0', "." * 40, False),
        (f'{REGISTER}, "ignore"', "." * 40, False),
        (f'{REGISTER}, "ignore"; {REGISTER}', "." * 11, True),
        (f'{REGISTER}; {REGISTER}, "ignore"', "." * 11, False),
    ],
)
def test_a_watchdog_pauses_in_the_period_after_its_interval(
    tmp_path: Any, model: str, calls: str, writes: str, acts: bool
) -> None:
    cell = history(watched(tmp_path, calls, model), writes[:-1])
    assert cell.state is RuntimeState.PLAYING
    history(cell, writes[-1])
    assert cell.programs.paused is acts
    assert cell.controller.safety.mode is SafetyMode.NORMAL


def test_a_watchdog_counts_again_after_a_pause_and_acts_each_time(tmp_path: Any) -> None:
    cell = history(watched(tmp_path, REGISTER), ".....")
    cell.programs.pause()
    history(cell, "." * 40)
    assert cell.state is RuntimeState.PAUSED
    for _ in range(2):
        cell.programs.resume()
        cell.until(lambda: cell.state is RuntimeState.PLAYING, 0.2)
        history(cell, "." * 10)
        assert cell.state is RuntimeState.PLAYING
        history(cell, "." * 2)
        assert cell.state is RuntimeState.PAUSED
    assert cell.keys() == "+=>=>="


def test_a_watchdog_that_stops_ends_with_its_program(tmp_path: Any) -> None:
    """C207A0 and a protective stop; the next program is not watched."""
    cell = history(watched(tmp_path, REGISTER + ', "stop"'), "." * 12)
    assert (cell.state, cell.controller.safety.mode) == (RuntimeState.STOPPED, SafetyMode.PROTECTIVE_STOP)
    assert [(m.code, m.argument) for m in cell.messages if isinstance(m, ErrorCodeMessage)] == [(207, 0)]
    cell.controller.safety_event(SafetyEvent.UNLOCK)
    cell.reach("PLAYING")
    cell.seconds(1.0)
    assert cell.state is RuntimeState.PLAYING
