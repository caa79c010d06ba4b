"""What every test is held to: it leaves no thread and no listening port behind, and no emulator in it fails.

A test has one try. What runs in real time waits for events with a patience that a busy machine does not use up, or
slows the robot's time down; one that cannot is marked ``flaky(reruns=...)`` at its place, and says there why.
"""

import logging
import os
import shutil
import tempfile
from collections.abc import Iterator

import pytest
from hypothesis import settings

from tests.budget import examples
from urproto.testing.leaks import Belongings

# Examples are not timed: a busy machine is no bug. In CI they are the same every time; elsewhere new ones are tried.
settings.register_profile("project", deadline=None, derandomize="CI" in os.environ, max_examples=examples(25))
settings.load_profile("project")

CHUNK = 16  # tests that a worker gets at a time; a share of all that are left, pytest-xdist's own, leaves one idle
# for minutes while the other has most of those in real time
IN_REAL_TIME = "in real time"  # the group of those that have a worker to themselves

RUNTIME: list[str] = []  # where controller managers of these tests are found, and no others


def pytest_configure(config: pytest.Config) -> None:
    RUNTIME.append(tempfile.mkdtemp(prefix="ur"))  # short, as the paths of Unix sockets have to be
    os.environ["XDG_RUNTIME_DIR"] = RUNTIME[0]
    if getattr(config.option, "maxschedchunk", CHUNK) is None:
        config.option.maxschedchunk = CHUNK


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist reads the groups
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Several workers begin with what takes long, so that none has it to do while the others are done.

    What a person does, with robots in real time, is done by one worker, one thing after the other: two browsers, or
    a browser beside a page's programs, are more than two cores carry.
    """
    for item in items:
        if item.get_closest_marker("page") is not None:
            item.add_marker(pytest.mark.xdist_group(IN_REAL_TIME))
    if config.getoption("numprocesses", None) or hasattr(config, "workerinput"):
        items.sort(key=lambda item: not any(map(item.get_closest_marker, ("page", "long"))))


def pytest_unconfigure(config: pytest.Config) -> None:
    while RUNTIME:
        shutil.rmtree(RUNTIME.pop(), ignore_errors=True)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of tests/conformance; they are here because pytest reads them before it looks into folders."""
    group = parser.getgroup("conformance", "which robot tests/conformance talks to")
    group.addoption("--robot-ip", help="address of a real robot or simulator; an emulator is started without it")
    group.addoption("--robot-program", help="program file on that robot, below its programs folder, to load and play")
    group.addoption(
        "--i-know-it-moves", action="store_true", help="let the tests move that robot, switch outputs, end programs"
    )


@pytest.fixture(autouse=True)
def leaves_nothing_behind() -> Iterator[None]:
    """Fail a test that leaves a Python thread or a listening socket of this process behind."""
    allowed = Belongings.now()
    yield
    complaints = allowed.complaints()
    assert not complaints, f"left behind: {complaints}"


@pytest.fixture(autouse=True)
def no_emulator_fails(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail a test in which an emulator of this process failed: its guard makes a fault of the robot of that."""
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
