"""The page of a class in browsers: what teacher and students see, and where the link of a robot leads."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.fleet.fleet_rig import host, running
from tests.pendant.conftest import SLOW_FRAMES, VIEWPORT, eventually
from tests.pendant.test_browser_access import CUT_OFF, SIZES, violations

PORT = 6070
URL = f"http://{host(11)}:{PORT}"


@pytest.fixture(scope="module")
def class_of_three(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    options = ("--count", "3", "--running", "--class-port", str(PORT), "--first-host", host(11))
    passwords = ("--teacher-password", "for me", "--student-password", "for us")
    with running(tmp_path_factory.mktemp("class"), *options, *passwords) as fleet:
        fleet.read_until("Ready: every port of 3 robots answers")
        yield
        fleet.interrupt()


def enter(browser: Browser, password: str, path: str = "/") -> Page:
    context = browser.new_context(viewport=VIEWPORT)
    context.add_init_script(SLOW_FRAMES)
    page = context.new_page()
    page.goto(URL + path)
    page.get_by_label("Password").fill("wrong")
    page.get_by_role("button", name="Enter").click()
    expect(page.get_by_text("This password is wrong.")).to_be_visible()
    page.get_by_label("Password").fill(password)
    page.get_by_role("button", name="Enter").click()
    return page


@pytest.mark.long
@pytest.mark.usefixtures("class_of_three")
def test_a_class_in_browsers(browser: Browser) -> None:
    teacher, student = enter(browser, "for me"), enter(browser, "for us", "/robot/2")
    expect(student).to_have_url(f"http://{host(12)}:6080/")  # through the class page, without the key
    expect(student.locator(".robot-name")).to_contain_text(host(12))
    second = teacher.get_by_test_id("robot-2")
    expect(second.locator('[data-value="mode"]')).to_have_text("RUNNING")
    expect(second.locator('[data-value="clients"]')).to_contain_text("pendant")
    expect(teacher.get_by_test_id("robot-3").locator('[data-value="clients"]')).to_have_text("nobody")
    for size, (width, height) in SIZES.items():
        teacher.set_viewport_size({"width": width, "height": height})
        assert not violations(teacher, "html"), size
        assert not teacher.evaluate(CUT_OFF), size
    second.get_by_label("Name").fill("Ada")
    second.get_by_label("Name").press("Enter")
    other = enter(browser, "for us")
    expect(other.get_by_role("heading", name="Ada")).to_be_visible()
    expect(other.get_by_role("button", name="Stop all")).to_be_hidden()
    picture = other.get_by_test_id("robot-1").locator("line").last
    before = picture.get_attribute("x2")
    student.get_by_test_id("tab-move").click()
    student.get_by_test_id("joint-0-plus").dispatch_event("pointerdown")
    moved = other.get_by_test_id("robot-2").locator("line").last
    start = moved.get_attribute("x2")
    eventually(lambda: moved.get_attribute("x2") != start)
    teacher.once("dialog", lambda dialog: dialog.accept())
    teacher.get_by_role("button", name="Reset all").click()
    eventually(lambda: moved.get_attribute("x2") == picture.get_attribute("x2") == before)
    expect(teacher.get_by_role("status")).to_be_hidden()
