"""Program, in a browser: programs are made from nothing, saved, played, edited by two people, and kept."""

import asyncio
import gzip
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from client.driver import DriverConfig, URDriver, points
from tests.pendant.conftest import FEW_FRAMES, SIZE, Rig, eventually
from tests.pendant.pendants import pendant

Open = Callable[[str], Page]
ABOVE = (0.3, -1.3, 1.4, -1.7, -1.57, 0.3)
DOWN = (0.3, -1.1, 1.6, -2.1, -1.57, 0.3)
BIN = (-0.6, -1.2, 1.2, -1.6, -1.57, 0.0)
BY_HAND = """def by_hand():
  movej([0.3, -1.3, 1.4, -1.7, -1.57, 0.3], a=1.4, v=1.05)
  movel([0.3, -1.1, 1.6, -2.1, -1.57, 0.3], a=1.2, v=0.25)
  set_standard_digital_out(2, True)
  sleep(0.2)
  movel([0.3, -1.3, 1.4, -1.7, -1.57, 0.3], a=1.2, v=0.25)
  movej([-0.6, -1.2, 1.2, -1.6, -1.57, 0.0], a=1.4, v=1.05)
  set_standard_digital_out(2, False)
end
"""


def row(page: Page, text: str):
    return page.locator(".program-row", has_text=text).last


def insert(page: Page, kind: str) -> None:
    page.get_by_test_id(f"insert-{kind}").click()


def field(page: Page, key: str, value: str) -> None:
    box = page.get_by_test_id(f"field-{key}")
    box.fill(value)
    box.press("Enter")


def new_program(page: Page) -> None:
    page.get_by_test_id("program-new").click()
    agree = page.get_by_test_id("agree")
    eventually(lambda: agree.is_visible() or page.get_by_test_id("program-title").inner_text() == "unnamed")
    if agree.is_visible():
        agree.click()
    expect(page.get_by_test_id("program-title")).to_have_text("unnamed")


def save_as(page: Page, name: str) -> None:
    page.get_by_test_id("program-save-as").click()
    page.get_by_test_id("program-name").fill(name)
    page.get_by_test_id("program-save-it").click()
    agree = page.get_by_test_id("agree")
    eventually(lambda: agree.is_visible() or page.get_by_text(f"{name}.urp is saved").is_visible())
    if agree.is_visible():
        agree.click()
    expect(page.get_by_test_id("program-title")).to_have_text(f"{name}.urp")


class Driver(threading.Thread):
    """A driver that waits for its External Control node, and moves the arm then; a thread of its own, since the
    browser's library has the loop of this one."""

    def __init__(self, host: str, joints: tuple[float, ...]) -> None:
        super().__init__(daemon=True)
        self._config = DriverConfig(robot=host, headless=False, own_address=host)
        self._joints = joints
        self.result: object = None
        self.listens = threading.Event()

    def run(self) -> None:
        self.result = asyncio.run(self._drive())

    async def _drive(self) -> object:
        async with URDriver(self._config.robot, headless=False, own_address=self._config.robot) as driver:
            self.listens.set()
            async with asyncio.timeout(60.0):
                while not driver.program_running:
                    await asyncio.sleep(0.05)
            return await driver.execute([points.movej(self._joints)])


def chapter_ten(page: Page, rig: Rig) -> None:
    """Empty program, URCaps, External Control, host in the installation, save, play: the driver moves the arm."""
    goal = (0.2, -1.4, 1.5, -1.7, -1.5, 0.1)
    driver = Driver(rig.host, goal)
    driver.start()
    assert driver.listens.wait(30.0)
    new_program(page)
    row(page, "Robot Program").click()
    insert(page, "external_control")
    expect(row(page, "Control by")).to_have_attribute("aria-selected", "true")
    page.get_by_test_id("tab-installation").click()
    page.get_by_test_id("driver-host").fill(rig.host)
    page.get_by_test_id("driver-port").fill("50002")
    page.get_by_test_id("driver-save").click()
    expect(page.get_by_text("Saved", exact=True)).to_be_visible()
    page.get_by_test_id("tab-program").click()
    save_as(page, "external_control")
    assert (rig.programs / "external_control.urp").is_file()
    page.get_by_test_id("program-play").click()
    expect(row(page, "Control by")).to_have_class(lambda_class("is-running"))
    driver.join(60.0)
    assert not driver.is_alive()
    assert rig.state("actual_q") == pytest.approx(goal, abs=1e-3)
    page.get_by_test_id("stop").click()


def lambda_class(name: str):
    import re

    return re.compile(rf"\b{name}\b")


def test_chapter_ten_is_typed_click_by_click(rig: Rig, open_page: Open) -> None:
    chapter_ten(open_page("program"), rig)
