"""A robot with PolyScope X at the same pendant: every screen opens, and Program explains the differences."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from client.pendant.screens import SCREENS
from tests.pendant.conftest import SLOW_FRAMES, VIEWPORT, Rig, eventually
from tests.pendant.test_browser_program import choose, insert, new_program, select

pytestmark = pytest.mark.long


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Rig]:
    with closing(Rig("ur5e", tmp_path, "--polyscope", "10.12")) as rig:
        yield rig


@pytest.fixture
def page(robot: Rig, browser: Browser) -> Iterator[Page]:
    with closing(browser.new_context(viewport=VIEWPORT)) as context:
        context.add_init_script(SLOW_FRAMES)
        page, errors = context.new_page(), list[str]()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(f"{robot.url}/{SCREENS[0].name}")
        expect(page.locator(".robot-name")).to_contain_text("PolyScope 10.12")
        yield page
        assert not errors


def test_every_screen_opens_and_program_plays_as_script(robot: Rig, page: Page) -> None:
    for screen in SCREENS:
        tab = page.get_by_test_id(f"tab-{screen.name}")
        if not tab.is_visible():
            assert screen.name == "cameras"  # this robot has no scene
            continue
        tab.click()
        page.wait_for_function(f"() => location.pathname === '/{screen.name}'")
        expect(page.locator(".screen")).to_be_visible()
    page.get_by_test_id("tab-program").click()
    new_program(page)
    expect(page.get_by_test_id("program-reason")).to_contain_text("PolyScope X does not load .urp programs")
    expect(page.get_by_test_id("program-step")).to_be_disabled()
    expect(page.get_by_test_id("program-breakpoint")).to_be_disabled()
    select(page, "Robot Program")
    page.get_by_test_id("field-loops").click()
    insert(page, "set", "Set")
    choose(page, "type", "A digital output")
    choose(page, "output", "digital_out[2]")
    choose(page, "level", "On")
    page.get_by_test_id("program-play").click()
    eventually(lambda: robot.state("actual_digital_output_bits") == 4)
    eventually(lambda: robot.state("runtime_state") == "STOPPED")
