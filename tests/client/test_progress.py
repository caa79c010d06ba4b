"""How far a motion is, in terminals of any width and where there is none."""

import io
import re

from rich.console import Console

from client.commands.following import ProgressBar
from tests.rows import each_row


def shown(width: int, terminal: bool, shares: int = 21) -> str:
    """A motion of 20 s, looked at every second."""
    clock = iter(range(100))
    text = io.StringIO()
    console = Console(file=text, width=width, force_terminal=terminal, color_system=None)
    with ProgressBar("bend (2/3)", console, lambda: float(next(clock))) as progress:
        for number in range(shares):
            if number == 10:
                progress.print_line("the arm waits: its safety mode is PROTECTIVE_STOP")
            progress.update(number / 20.0, "slider 30 %" if number > 10 else "")
    return text.getvalue()


def test_without_a_terminal_there_is_a_line_now_and_then() -> None:
    assert shown(80, terminal=False).splitlines() == [
        "bend (2/3): 20 % after 5 s",
        "bend (2/3): 45 % after 10 s",
        "the arm waits: its safety mode is PROTECTIVE_STOP",
        "bend (2/3): 70 % after 15 s, slider 30 %",
        "bend (2/3): 95 % after 20 s, slider 30 %",
    ]
    assert shown(80, terminal=False, shares=4) == ""  # short ones say nothing


@each_row("width", [40, 80, 200])
def test_a_bar_fits_the_terminal(width: int) -> None:
    lines = re.sub(r"\x1b\[[?\d]*[A-Za-z]", "", shown(width, terminal=True)).replace("\r", "\n").splitlines()
    bars = [line for line in lines if "bend (2/3)" in line]
    assert bars
    assert "100 %" in bars[-1]
    assert "21 s, slider 30 %" in bars[-1]
    assert max(map(len, bars)) <= width
    assert "PROTECTIVE_STOP" in "".join(lines)
