"""A real browser on a pendant of its own, which is connected to an emulator of its own.

One emulator and one pendant serve all tests of a worker, one browser those of a module; each test has a page of its
own, and finds the robot as it leaves ``Rig.reset``. Who opens a second page has a second browser for it. What a test
that failed has left behind, in the robot, in the pendant or in their files, nobody finds: the next test has new ones.
"""

import math
import os
import shutil
import sys
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, BrowserContext, Locator, Page, Playwright, expect, sync_playwright

from tests.conftest import IN_REAL_TIME
from tests.pendant.pendants import pendant
from urproto.testing.process import EmulatorProcess

HERE = Path(__file__).resolve().parent
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    *("--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update"),
    *("--disable-sync", "--use-gl=angle", "--use-angle=swiftshader-webgl", "--enable-unsafe-swiftshader"),
    *(["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []),
]
# A picture every 0.2 s and not 30 a second: without graphics it is the processor that draws the arm.
SLOW_FRAMES = """
window.requestAnimationFrame = callback => setTimeout(() => callback(performance.now()), 200);
window.cancelAnimationFrame = clearTimeout;
"""
VIEWPORT = {"width": 1280, "height": 800}
POLICY = "Content Security Policy"  # is in what a browser says when a page does what that forbids
TIMEOUT_S = 45.0  # a busy machine's
TEST_TIMEOUT_S = 300.0  # of a test and the starts of robot, pendant and browser before it

if CHROMIUM is None or sys.platform != "linux":
    collect_ignore_glob = ["test_browser_*"]

expect.set_options(timeout=TIMEOUT_S * 1000)


def eventually(condition: Callable[[], object], within_s: float = TIMEOUT_S) -> None:
    """Wait until it holds."""
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The tests of a browser have one worker, since they have one robot, and more time than others."""
    for item in items:
        if item.path.parent == HERE and item.path.name.startswith("test_browser_"):
            item.add_marker(pytest.mark.xdist_group(IN_REAL_TIME))
            item.add_marker(pytest.mark.timeout(TEST_TIMEOUT_S))


def number(field: Locator) -> float:
    """What is in a box for numbers; NaN while there is none."""
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
        """Arm on, brakes released, no stop, no program, no fault, full speed, time as ours."""
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
        """What the robot has in this RTDE field."""
        return self.control.state([name])[name]

    def close(self) -> None:
        self._opened.close()


@pytest.fixture(scope="module")
def playwright() -> Iterator[Playwright]:
    """An event loop is running as long as it is there: no asynchronous test can run then."""
    with sync_playwright() as running:
        yield running


@pytest.fixture(scope="module")
def browser(playwright: Playwright) -> Iterator[Browser]:
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
    yield browser
    browser.close()


class SharedRig:
    """A rig that is made when it is first wanted, and again after it was discarded."""

    def __init__(self, folders: pytest.TempPathFactory) -> None:
        self._folders = folders
        self._rig: Rig | None = None

    def clean(self) -> Rig:
        """As every test finds it."""
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
    """Note which test failed, for its fixtures."""
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
    """A browser that has been here before, as most have: it need not fetch the pages' libraries for each test."""
    context = browser.new_context(viewport=VIEWPORT)
    context.add_init_script(SLOW_FRAMES)
    yield context
    context.close()


@pytest.fixture
def open_page(rig: Rig, browser: Browser, user_context: BrowserContext) -> Iterator[Callable[[str], Page]]:
    """Opens a screen in a page of its own; nothing may go wrong in it."""
    stack = []

    def open_(screen: str) -> Page:
        context = user_context
        if stack:  # somebody else
            context = browser.new_context(viewport=VIEWPORT)
            context.add_init_script(SLOW_FRAMES)
        page = context.new_page()
        errors = list[str]()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda said: errors.append(said.text) if POLICY in said.text else None)
        stack.append((page if context is user_context else context, errors))
        page.goto(f"{rig.url}/{screen}")
        expect(page.locator(".robot-name")).to_contain_text("UR3")
        return page

    yield open_
    for page_or_context, errors in stack:
        page_or_context.close()
        assert not errors
    user_context.clear_cookies()
