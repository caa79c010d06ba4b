"""Requirements on every test: it leaves no thread and no listening port behind, and no emulator in it fails.

A test has one attempt. Tests in real time wait for events with timeouts that suffice under load, or slow the robot's
time down. A test that cannot is marked ``flaky(reruns=...)`` with the reason.
"""

import gc
import logging
import os
import shutil
import signal
import tempfile
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tests.budget import examples
from urproto.testing.leaks import Resources

# Examples have no deadline, since load is not a bug. In CI they are the same every time, elsewhere they are random.
settings.register_profile("project", deadline=None, derandomize="CI" in os.environ, max_examples=examples(25))
settings.load_profile("project")

CHUNK = 16  # tests that a worker gets at a time; pytest-xdist's default, a share of all remaining tests, leaves one
# worker idle for minutes while the other one runs most of those in real time
IN_REAL_TIME = "in real time"  # the group of tests that share one worker

RUNTIME: list[str] = []  # folder for runtime and temporary files: tests find only their own controller managers, and
# the reports and programs that emulators would leave for their users go with it


def pytest_configure(config: pytest.Config) -> None:
    RUNTIME.append(tempfile.mkdtemp(prefix="ur"))  # short, as the paths of Unix sockets have to be
    os.environ["XDG_RUNTIME_DIR"] = RUNTIME[0]
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", tempfile.gettempdir())  # pytest keeps the last three tmp_paths
    os.environ["TMPDIR"] = tempfile.tempdir = RUNTIME[0]
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in a shell's background, which processes inherit
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if getattr(config.option, "maxschedchunk", CHUNK) is None:
        config.option.maxschedchunk = CHUNK


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is collected stays, so looking for garbage meanwhile takes a fifth of the time and finds nothing."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist reads the groups
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Workers begin with the longest tests, so that none is left with them when the others are done.

    Tests of documentation pages with robots in real time run one after the other on a single worker: two browsers, or a
    browser and a page's programs at the same time, are too much for two cores. Tests that share a robot, or whatever
    else serves a whole module or folder, run on one worker too, so that there is one of it instead of one per worker.
    """
    if not (config.getoption("numprocesses", None) or hasattr(config, "workerinput")):
        return
    for item in items:
        if item.get_closest_marker("page") is not None:
            item.add_marker(pytest.mark.xdist_group(IN_REAL_TIME))
        elif item.get_closest_marker("xdist_group") is None and (shared := _shared(item)):
            item.add_marker(pytest.mark.xdist_group(shared))
    items.sort(key=lambda item: not any(map(item.get_closest_marker, ("page", "long"))))


def _shared(item: pytest.Item) -> str | None:
    """The module or folder with a fixture that serves all of its tests and this one; None if there is none."""
    found = getattr(item, "_fixtureinfo", None)
    used = [fixtures[-1] for fixtures in found.name2fixturedefs.values()] if found else []
    return next((Path(one.baseid).stem for one in used if one.baseid and one.scope in ("module", "package")), None)


def pytest_unconfigure(config: pytest.Config) -> None:
    while RUNTIME:
        shutil.rmtree(RUNTIME.pop(), ignore_errors=True)
    tempfile.tempdir = None
    os.environ.pop("TMPDIR", None)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of tests/conformance; they are here because pytest reads them before it collects folders."""
    group = parser.getgroup("conformance", "the robot that tests/conformance connects to")
    group.addoption("--robot-ip", help="address of a real robot or simulator; without it, an emulator is started")
    group.addoption("--robot-program", help="program file on that robot, below its programs folder, to load and play")
    group.addoption(
        "--i-know-it-moves", action="store_true", help="let the tests move that robot, switch outputs, end programs"
    )


@pytest.fixture(autouse=True)
def leaves_nothing_behind() -> Iterator[None]:
    """Fail a test that leaves a Python thread or a listening socket of this process behind."""
    allowed = Resources.now()
    yield
    leaks = allowed.leaks()
    assert not leaks, f"left behind: {leaks}"


@pytest.fixture(autouse=True)
def no_emulator_fails(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail a test in which an emulator of this process failed, which its guard turns into a fault of the robot."""
    failures = _Failures()
    logger = logging.getLogger("emulator.guard")
    logger.addHandler(failures)
    yield
    logger.removeHandler(failures)
    if request.node.get_closest_marker("emulator_fails") is None:
        assert not failures.texts, "\n".join(failures.texts)


class _Failures(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.CRITICAL)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(record.getMessage())
