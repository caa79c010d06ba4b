"""Runs one test on a new robot, in virtual time."""

import re
import time
from argparse import Namespace
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from emulator.builtins import LIBRARIES
from emulator.peers.connection import Peers
from emulator.peers.file import parse_peers, read_peers
from emulator.script_options import parsed
from emulator.script_run import INTERRUPTED, Setup
from emulator.scripttest.assertions import TestRun, assertions
from emulator.scripttest.coverage import Coverage, StepCounter, coverage_of
from emulator.scripttest.profile import Profiler, ThreadProfile
from urproto.compat import StrEnum
from urscript.builtins import LibrarySet
from urscript.compiler import compile_script
from urscript.errors import CompileError, ScriptError
from urscript.scripttest.program import PlacedError, TestProgram
from urscript.scripttest.suite import Settings, SuiteError, Test

_DEFAULTS: Final = {"script-network": "none", "timeout": 300}  # s of robot time


class Status(StrEnum):
    """How a test ended. ERROR: it could not run."""

    PASSED = "passed"
    FAILED = "failed"
    ERROR = "error"


@dataclass(frozen=True)
class Observation:
    """What to observe in addition."""

    coverage: bool = False
    profile: bool = False


@dataclass
class Result:
    """The result of a test. failure: the reason, with its place. lines: what it reported. robot_s, wall_s: its time."""

    title: str
    status: Status
    failure: str = ""
    lines: list[str] = field(default_factory=list)
    robot_s: float = 0.0
    wall_s: float = 0.0
    coverage: Coverage = field(default_factory=dict)
    profile: dict[str, ThreadProfile] = field(default_factory=dict)

    @property
    def summary(self) -> str:
        """The reason in one line."""
        return self.failure.split("\n", 1)[0]


def run_options(settings: Settings, defaults: Mapping[str, Any]) -> Namespace:
    """The options of ``urscript run`` for a test. Raises SuiteError."""
    words = ["-"]
    for name, value in {**_DEFAULTS, **defaults, **settings.options}.items():
        words += _words(name, value, settings.where.parent)
    try:
        return parsed(words)
    except ValueError as error:
        raise SuiteError(f"{settings.where}: {error}") from error


def _words(name: str, value: Any, folder: Path) -> list[str]:
    """An option as on the command line: a mapping and a list repeat it, and files are relative to `folder`."""
    match value:
        case Mapping():
            return [word for key, one in value.items() for word in (f"--{name}", f"{key}={_word(one)}")]
        case list() if name == "joints":
            return [f"--{name}", *map(_word, value)]
        case list():
            return [word for one in value for word in (f"--{name}", _word(one))]
    file = folder / _word(value)
    return [f"--{name}", str(file) if file.is_file() else _word(value)]


def _word(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _peers(settings: Settings) -> Peers:
    """New peers. Raises PeersError or OSError."""
    folder = settings.where.parent
    if isinstance(settings.peers, str):
        return read_peers(folder / settings.peers)
    return parse_peers(settings.peers or {}, "peers", folder)


def run_test(test: Test, defaults: Mapping[str, Any], observation: Observation = Observation()) -> Result:
    """Run a test. defaults: options of ``urscript run`` for tests whose settings do not give them."""
    began = time.perf_counter()
    try:
        result = _run(test, defaults, observation)
    except ScriptError as error:
        result = Result(test.title, Status.ERROR, error.render(str(test.path)))
    except (OSError, ValueError) as error:  # of options and peers
        result = Result(test.title, Status.ERROR, f"{test.path}: {error}")
    result.wall_s = time.perf_counter() - began
    return result


def _run(test: Test, defaults: Mapping[str, Any], observation: Observation) -> Result:
    settings = test.settings
    options = run_options(settings, defaults)
    setup = Setup.of(options, _peers(settings))
    run, program = TestRun(setup), test.make_program()
    programs = setup.controller.programs
    programs.texts.libraries = LibrarySet([*LIBRARIES, assertions(run)])
    steps = StepCounter() if observation.coverage else None
    _compile(program, programs.texts.libraries, setup, stepped=steps is not None)
    run.batch = batch = setup.batch(program, run.report, options)
    programs.step_hook = steps
    profiler = Profiler(program) if observation.profile else None
    setup.play(batch, options, (lambda: profiler.sample(programs.host)) if profiler else lambda: None)
    if batch.failure == INTERRUPTED:
        raise KeyboardInterrupt
    failure = batch.error.render() if isinstance(batch.error, PlacedError) else batch.failure
    status, failure = _judged(settings, run, failure)
    return Result(
        test.title,
        status,
        failure,
        run.lines,
        batch.time_s,
        coverage=coverage_of(program, settings.program, steps) if steps else {},
        profile=profiler.threads if profiler else {},
    )


def _compile(program: TestProgram, libraries: LibrarySet, setup: Setup, *, stepped: bool) -> None:
    """Raise CompileError, with the position in a file; the run does not compile the program again."""
    unit = program.units[0]
    try:
        compile_script(unit.text, libraries, setup.controller.version, stepped=stepped)
    except CompileError as error:
        raise program.located(error.at_its_cause(), unit) from error


def _judged(settings: Settings, run: TestRun, failure: str) -> tuple[Status, str]:
    """Whether the test has passed, and why not. A test that is expected to fail passes if it fails in this way."""
    if settings.fails:
        if not failure:
            failure = f"it did not fail with {settings.fails!r}"
        elif re.search(settings.fails, failure):
            failure = ""
    missing = [text for text in settings.logs if not run.logged(text)]
    if missing and not failure:
        failure = f"{missing[0]!r} is not in the log"
    return (Status.FAILED if failure else Status.PASSED), failure
