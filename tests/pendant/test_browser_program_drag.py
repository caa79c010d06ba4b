"""Program, in a browser: nodes are dragged."""

from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.pendant.conftest import Rig, eventually

PLACES = {"before": 0.15, "onto": 0.5, "after": 0.85}  # of a row's height


@pytest.mark.long
def test_nodes_are_dragged_before_into_and_after_others(rig: Rig, open_page: Callable[[str], Page]) -> None:
    page = open_page("program")
    page.get_by_test_id("program-new").click()
    title, agree = page.get_by_test_id("program-title"), page.get_by_test_id("agree")
    eventually(lambda: agree.is_visible() or title.inner_text() == "unnamed")
    if agree.is_visible():
        agree.click()
    shown = page.locator(".program-row-text")
    expect(shown).to_have_text(["Variables Setup", "Robot Program", "<empty>"])
    for kind in ("halt", "folder", "wait"):
        page.get_by_test_id(f"insert-{kind}").click()
        page.locator(".program-row[aria-selected=true]", has_text=kind.capitalize()).wait_for()

    def drag(text: str, onto: str, place: str) -> None:
        rows = page.locator(".program-row")
        here, there = (rows.filter(has_text=name).bounding_box() for name in (text, onto))
        assert here is not None
        assert there is not None
        page.mouse.move(here["x"] + 120, here["y"] + here["height"] / 2)
        page.mouse.down()
        page.mouse.move(there["x"] + 120, there["y"] + PLACES[place] * there["height"], steps=4)
        expect(rows.filter(has_text=onto)).to_have_attribute("data-drop", place)

    def level(text: str) -> str | None:
        return page.locator(".program-row", has_text=text).get_attribute("aria-level")

    expect(shown.nth(4)).to_have_text("Wait")
    assert (level("Folder"), level("Wait")) == ("2", "3")
    drag("Wait", "Halt", "before")
    page.mouse.up()
    expect(shown.nth(2)).to_have_text("Wait")
    assert level("Wait") == "2"
    drag("Halt", "Folder", "onto")
    page.mouse.up()
    expect(shown.nth(4)).to_have_text("Halt")
    assert level("Halt") == "3"
    drag("Wait", "Folder", "after")
    page.keyboard.press("Escape")  # nothing is dropped
    page.mouse.up()
    page.keyboard.press("Control+z")
    expect(shown.nth(2)).to_have_text("Wait")
    expect(shown.nth(3)).to_have_text("Halt")
    drag("Wait", "Folder", "after")
    page.mouse.up()
    expect(shown.nth(2)).to_have_text("Halt")
