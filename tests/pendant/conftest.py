"""A real browser on a separate pendant, which is connected to a separate emulator.

One emulator and one pendant serve all tests of a worker, one browser those of a module; each test has its own
page, and finds the robot as ``Rig.reset`` leaves it. A second page of a test has a second browser. After a failed test,
robot, pendant and their files are replaced, so that the next test does not find what the failed one left behind.
"""

import math
import sys
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, BrowserContext, Locator, Page, Playwright, expect, sync_playwright

from tests.browser import CHROMIUM, FLAGS
from tests.conftest import IN_REAL_TIME
from tests.pendant.pendants import pendant
from urproto.testing.process import EmulatorProcess

HERE = Path(__file__).resolve().parent
# One frame every 0.2 s instead of 30 per second: without a GPU, the processor draws the arm.
SLOW_FRAMES = """
window.requestAnimationFrame = callback => setTimeout(() => callback(performance.now()), 200);
window.cancelAnimationFrame = clearTimeout;
"""
VIEWPORT = {"width": 1280, "height": 800}
POLICY = "Content Security Policy"  # part of the browser's message about a violation
TIMEOUT_S = 45.0  # long enough under load
TEST_TIMEOUT_S = 300.0  # includes the start of robot, pendant and browser

if CHROMIUM is None or sys.platform != "linux":
    collect_ignore_glob = ["test_browser_*"]

expect.set_options(timeout=TIMEOUT_S * 1000)


def eventually(condition: Callable[[], object], within_s: float = TIMEOUT_S) -> None:
    """Wait until a condition holds."""
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run all browser tests in one worker, since they share a robot, and with a longer timeout."""
    for item in items:
        if item.path.parent == HERE and item.path.name.startswith("test_browser_"):
            item.add_marker(pytest.mark.xdist_group(IN_REAL_TIME))
            item.add_marker(pytest.mark.timeout(TEST_TIMEOUT_S))


def number(field: Locator) -> float:
    """The content of a number field; NaN if it is empty."""
    try:
        return float(field.input_value())
    except ValueError:
        return math.nan


class Rig:
    """An emulator and the pendant for it."""

    def __init__(self, model: str, folder: Path, *options: str) -> None:
        self.robot = EmulatorProcess(["--model", model, "--running", "--programs", str(folder), *options])
        with ExitStack() as stack:
            stack.callback(self.robot.dispose)
            self.robot.start()
            stack.callback(self.robot.stop)
            self._open(folder, stack)
            self._opened = stack.pop_all()

    def _open(self, folder: Path, stack: ExitStack) -> None:
        self.host = self.robot.host
        self.control: Any = self.robot.control
        self.programs = folder
        self.url = f"http://{self.host}:6080"
        options = ("--modbus-port", str(self.robot.ports["modbus"]), "--tools", str(folder / "tools.json"))
        options += ("--poses", str(folder / "poses.json"), "--drafts", str(folder / "drafts"))
        self._pendant = stack.enter_context(pendant(self.host, *options))

    @property
    def pendant_pid(self) -> int:
        return self._pendant.pid

    def reset(self) -> None:
        """Arm on, brakes released, no stop, no program, no fault, full speed, real time."""
        control = self.control
        control.set_speed(1.0)
        control.clear_faults()
        control.dashboard("stop")
        control.release_emergency_stop()
        for popup in control.popups():
            control.answer_popup(popup["id"])
        if control.state(["safety_mode"])["safety_mode"] == "PROTECTIVE_STOP":
            control.unlock_protective_stop()
        control.run_until("runtime_state == STOPPED")
        control.set_simulation(False)
        control.release_brakes()
        control.run_until("robot_mode == RUNNING")
        control.set_speed_slider(1.0)

    def state(self, name: str) -> object:
        """The value of an RTDE field."""
        return self.control.state([name])[name]

    def close(self) -> None:
        self._opened.close()


@pytest.fixture(scope="module")
def playwright() -> Iterator[Playwright]:
    """Playwright, which runs an event loop: no asynchronous test can run in the meantime."""
    with sync_playwright() as running:
        yield running


@pytest.fixture(scope="module")
def browser(playwright: Playwright) -> Iterator[Browser]:
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
    yield browser
    browser.close()


class SharedRig:
    """A rig that is created on first use, and again after it was discarded."""

    def __init__(self, folders: pytest.TempPathFactory) -> None:
        self._folders = folders
        self._rig: Rig | None = None

    def clean(self) -> Rig:
        """The rig in its initial state."""
        if self._rig is None:
            self._rig = Rig("ur3", self._folders.mktemp("programs"))
        try:
            self._rig.reset()
        except BaseException:
            self.discard()
            raise
        return self._rig

    def discard(self) -> None:
        rig, self._rig = self._rig, None
        if rig is not None:
            rig.close()


@pytest.fixture(scope="package")
def shared_rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedRig]:
    shared = SharedRig(tmp_path_factory)
    yield shared
    shared.discard()


FAILED = pytest.StashKey[bool]()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Record for the fixtures whether a test failed."""
    report = yield
    item.stash[FAILED] = report.failed
    return report


@pytest.fixture
def rig(shared_rig: SharedRig, request: pytest.FixtureRequest) -> Iterator[Rig]:
    yield shared_rig.clean()
    if request.node.stash.get(FAILED, False):
        shared_rig.discard()


@pytest.fixture(scope="module")
def user_context(browser: Browser) -> Iterator[BrowserContext]:
    """A browser context with a warm cache, which need not fetch the libraries of the pages for each test."""
    context = browser.new_context(viewport=VIEWPORT)
    context.add_init_script(SLOW_FRAMES)
    yield context
    context.close()


@pytest.fixture
def open_page(rig: Rig, browser: Browser, user_context: BrowserContext) -> Iterator[Callable[[str], Page]]:
    """Opens a screen in a new page, in which no errors may occur."""
    stack = []

    def open_(screen: str) -> Page:
        context = user_context
        if stack:  # another user
            context = browser.new_context(viewport=VIEWPORT)
            context.add_init_script(SLOW_FRAMES)
        page = context.new_page()
        errors = list[str]()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda message: errors.append(message.text) if POLICY in message.text else None)
        stack.append((page if context is user_context else context, errors))
        page.goto(f"{rig.url}/{screen}")
        expect(page.locator(".robot-name")).to_contain_text("UR3")
        return page

    yield open_
    for page_or_context, errors in stack:
        page_or_context.close()
        assert not errors
    user_context.clear_cookies()
