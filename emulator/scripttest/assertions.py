"""The functions that tests can call in addition to the built-ins. An assertion that fails ends the test."""

import math
from dataclasses import dataclass, field
from typing import Any

from emulator.batch import Batch
from emulator.builtins.host import Frames
from emulator.peers.log import Pattern
from emulator.script_run import Setup, stimulus
from urproto.robots.pose import point_dist, pose_sub
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Any_, Num, Pose, Str, cut_text

_LONGEST = 200  # characters of a value in a message


@dataclass
class TestRun:
    """A test that runs. lines: what it has reported."""

    __test__ = False  # not a class of tests for pytest

    setup: Setup
    batch: Batch | None = None
    lines: list[str] = field(default_factory=list)

    def report(self, text: str) -> None:
        self.lines.append(text)

    def logged(self, pattern: str) -> bool:
        """Whether a line matches, without its time."""
        wanted = Pattern.parse(pattern)
        return any(wanted.match(line.partition("] ")[2]) for line in self.lines)


def assertions(run: TestRun) -> Library:
    """The functions for one test."""
    library = Library("tests")

    @library.builtin()
    def assert_true(value: Any_, message: Str = "") -> None:
        """Fail unless the value is True."""
        _check(value is True, f"{_shown(value)} is not True", message)

    @library.builtin()
    def assert_equal(result: Any_, expected: Any_, message: Str = "") -> None:
        """Fail unless the values are equal; 1 and 1.0 are."""
        _check(_equal(result, expected), f"{_shown(result)} is not {_shown(expected)}", message)

    @library.builtin()
    def assert_near(result: Any_, expected: Any_, tolerance: Num = 1e-6, angle: Num = -1, message: Str = "") -> None:
        """Fail unless numbers, or all numbers of lists, differ by at most `tolerance`.

        Of poses, that is the distance [m]; the rotation from one to the other may be at most `angle` [rad], by default
        `tolerance`.
        """
        problem = _difference(result, expected, tolerance, tolerance if angle < 0 else angle)
        _check(not problem, f"{_shown(result)} is not near {_shown(expected)}: {problem}", message)

    @library.builtin()
    def assert_logged(pattern: Str, message: Str = "") -> Frames[None]:
        """Fail unless the program has reported such a text: a message, a popup, a warning. * and ? are wildcards."""
        yield  # what was reported in this period is published at its end
        _check(run.logged(pattern), f'"{pattern}" is not in the log', message)

    @library.builtin()
    def assert_sent(pattern: Str, peer: Str = "", message: Str = "") -> None:
        """Fail unless the program has sent such a message to the peer of that name, by default to any one."""
        logs = [log for log in run.setup.peers.logs if peer in ("", log.name)]
        if not logs:
            raise RuntimeFault(f'there is no peer "{peer}" among the settings of this test')
        wanted = Pattern.parse(pattern)
        summary = "".join(log.summary() for log in logs)
        _check(any(log.contains(wanted) for log in logs), f'"{pattern}" was not sent{summary}', message)

    @library.builtin()
    def set_test_input(name: Str, value: Num) -> None:
        """Set an input or input register now; the names are those of ``urscript run --input`` and ``--register``."""
        try:
            stimulus(f"{name}={value}").apply(run.setup.controller)
        except ValueError as error:
            raise RuntimeFault(f"set_test_input: {error}") from None

    # those of Hirebotics' urscript-tester

    @library.builtin()
    def assertEqual(name: Str, result: Any_, expected: Any_) -> None:  # noqa: N802 - its name
        """Like `assert_equal`."""
        _check(_equal(result, expected), f"{_shown(result)} is not {_shown(expected)}", name)

    @library.builtin()
    def setTestExecutionTimeout(timeout: Num) -> None:  # noqa: N802 - its name
        """Set the time-out of this test, from now [ms of robot time]."""
        if run.batch is not None:
            run.batch.timeout_s = run.batch.time_s + timeout / 1000

    @library.builtin()
    def setIgnoreErrorCode(code: Any_) -> None:  # noqa: N802 - its name
        """Accepted: here, an error code fails a test only if it stops the arm or the program."""

    return library


def _check(holds: bool, problem: str, message: str) -> None:
    if not holds:
        raise RuntimeFault(f"assertion failed: {f'{message}: ' if message else ''}{problem}")


def _shown(value: Any) -> str:
    return f'"{cut_text(value, _LONGEST)}"' if isinstance(value, str) else cut_text(value, _LONGEST)


def _equal(result: Any, expected: Any) -> bool:
    return isinstance(result, bool) == isinstance(expected, bool) and bool(result == expected)


def _difference(result: Any, expected: Any, tolerance: float, angle: float) -> str:
    """How two values differ by more than permitted; empty if they do not."""
    if isinstance(result, Pose) and isinstance(expected, Pose):
        distance, rotation = point_dist(result, expected), math.hypot(*pose_sub(result, expected)[3:])
        if distance > tolerance or rotation > angle:
            return f"{distance:.6g} m and {rotation:.6g} rad apart"
        return ""
    if isinstance(result, list) and isinstance(expected, list):
        if len(result) != len(expected):
            return f"{len(result)} elements instead of {len(expected)}"
        pairs = zip(result, expected, strict=True)
        problems = [_difference(one, other, tolerance, angle) for one, other in pairs]
        return next((f"element {place}: {problem}" for place, problem in enumerate(problems) if problem), "")
    if any(isinstance(value, bool) or not isinstance(value, int | float) for value in (result, expected)):
        return "only numbers, lists of numbers, and poses can be near each other"
    return "" if abs(result - expected) <= tolerance else f"they differ by {abs(result - expected):.6g}"
