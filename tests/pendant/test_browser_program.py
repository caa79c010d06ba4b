"""Program, in a browser: programs are made from nothing, saved, played, edited by two people, and kept."""

import asyncio
import os
import re
import signal
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from math import dist
from pathlib import Path
from threading import Event

import pytest
from playwright.sync_api import Browser, Locator, Page, expect

from client.driver import TrajectoryResult, URDriver, points
from client.rtde import BlockingRTDEClient
from tests.pendant.conftest import FEW_FRAMES, SIZE, Rig, eventually
from tests.pendant.pendants import pendant

Open = Callable[[str], Page]
ABOVE = (0.3, -1.3, 1.4, -1.7, -1.57, 0.3)
DOWN = (0.3, -1.2, 1.5, -1.9, -1.57, 0.3)
BIN = (-0.3, -1.2, 1.2, -1.6, -1.57, 0.0)
BY_HAND = f"""def by_hand():
  set_tcp(p[0, 0, 0, 0, 0, 0])
  movej({list(ABOVE)}, a=1.4, v=1.05)
  movel({list(DOWN)}, a=1.2, v=0.25)
  set_standard_digital_out(2, True)
  sleep(0.3)
  movel({list(ABOVE)}, a=1.2, v=0.25)
  movej({list(BIN)}, a=1.4, v=1.05)
  set_standard_digital_out(2, False)
end
"""


def row(page: Page, text: str) -> Locator:
    return page.locator(".program-row", has=page.locator(".program-row-text", has_text=re.compile(f"^{text}"))).last


def insert(page: Page, kind: str, shown: str) -> None:
    """By the palette; the new node is selected then."""
    page.get_by_test_id(f"insert-{kind}").click()
    expect(row(page, shown)).to_have_attribute("aria-selected", "true")


def select(page: Page, shown: str) -> None:
    row(page, shown).locator(".program-row-text").click()
    expect(page.get_by_test_id("form-title")).to_contain_text(re.compile(f"^{shown}", re.IGNORECASE))


def fill(page: Page, key: str, value: str) -> None:
    box = page.get_by_test_id(f"field-{key}")
    box.fill(value)
    box.press("Enter")


def choose(page: Page, key: str, title: str) -> None:
    page.get_by_test_id(f"field-{key}").click()
    page.get_by_role("option", name=title, exact=True).click()


def new_program(page: Page) -> None:
    page.get_by_test_id("program-new").click()
    title, agree = page.get_by_test_id("program-title"), page.get_by_test_id("agree")
    eventually(lambda: agree.is_visible() or title.inner_text() == "unnamed")
    if agree.is_visible():
        agree.click()
    expect(title).to_have_text("unnamed")
    expect(page.locator(".program-row-text")).to_have_text(["Variables Setup", "Robot Program", "<empty>"])


def save_as(page: Page, name: str) -> None:
    page.get_by_test_id("program-save-as").click()
    page.get_by_test_id("program-name").fill(name)
    page.get_by_test_id("program-save-it").click()
    expect(page.get_by_test_id("program-title")).to_have_text(f"{name}.urp")


def drive(host: str, goal: tuple[float, ...], listens: Event) -> TrajectoryResult:
    """A driver that waits until its External Control node is played, moves the arm, and stays until that ends."""

    async def run() -> TrajectoryResult:
        async with URDriver(host, headless=False, own_address=host) as driver:
            listens.set()
            await driver.wait_for_program(60.0)
            result = await driver.execute([points.movej(goal)])
            while driver.program_running:  # a program that loops asks again
                await driver.next_state()
            return result

    return asyncio.run(run())


def chapter_ten(page: Page, rig: Rig) -> None:
    """Empty program, URCaps, External Control, host in the installation, save, play: a driver moves the arm."""
    goal, listens = (0.2, -1.4, 1.5, -1.7, -1.5, 0.1), Event()
    with ThreadPoolExecutor(1) as pool:  # the browser's library has the loop of this thread
        driver = pool.submit(drive, rig.host, goal, listens)
        assert listens.wait(30.0)
        new_program(page)
        select(page, "Robot Program")
        insert(page, "external_control", "External Control")
        page.get_by_test_id("tab-installation").click()
        page.get_by_test_id("driver-host").fill(rig.host)
        page.get_by_test_id("driver-port").fill("50002")
        page.get_by_test_id("driver-save").click()
        eventually(lambda: rig.control.external_control() == {"host": rig.host, "port": 50002})
        page.get_by_test_id("tab-program").click()
        save_as(page, "external_control")
        assert (rig.programs / "external_control.urp").is_file()
        page.get_by_test_id("program-play").click()
        expect(row(page, "External Control")).to_have_class(re.compile("is-running"))
        eventually(lambda: rig.state("actual_q") == pytest.approx(goal, abs=1e-3))
        page.get_by_test_id("stop").click()
        assert driver.result(60.0) is TrajectoryResult.SUCCESS


def test_chapter_ten_is_typed_click_by_click(rig: Rig, open_page: Open) -> None:
    chapter_ten(open_page("program"), rig)


def waypoint(page: Page, rig: Rig, name: str, q: tuple[float, ...]) -> None:
    """Teach the selected waypoint: the arm is brought there, as a person would by hand."""
    fill(page, "name", name)
    expect(row(page, name)).to_be_visible()
    rig.control.set_joints(q)
    eventually(lambda: dist(rig.state("actual_q"), q) < 1e-6)
    page.wait_for_timeout(300)  # thirty states a second come to the pendant
    page.get_by_test_id("teach-position").click()
    expect(page.get_by_test_id("field-position")).to_contain_text("Joints")


def pick_and_place(page: Page, rig: Rig) -> None:
    """Made from nothing: three moves with taught waypoints, two Sets, a Wait; twice, for it is a loop's work."""
    new_program(page)
    select(page, "Robot Program")
    page.get_by_test_id("field-loops").click()
    insert(page, "waypoint", "Waypoint_1")
    waypoint(page, rig, "Above", ABOVE)
    select(page, "MoveJ")
    insert(page, "move", "MoveJ")
    choose(page, "motion", "MoveL")
    select(page, "MoveL")


def played(rig: Rig, start: Callable[[], object]) -> list[tuple[float, ...]]:
    """Where the arm was on the way, and output 2, from one play to its end."""
    rig.control.set_joints(BIN)
    way = list[tuple[float, ...]]()
    with BlockingRTDEClient(rig.host, ("actual_q", "actual_digital_output_bits", "runtime_state")) as watcher:
        start()
        while watcher.latest()["runtime_state"] != 2:
            pass
        while (state := watcher.receive())["runtime_state"] == 2:
            way.append((*state["actual_q"], float(state["actual_digital_output_bits"] >> 2 & 1)))
    return way
