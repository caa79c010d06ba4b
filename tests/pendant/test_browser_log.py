"""Log, in a browser."""

from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from emulator.virtual import virtual_robot
from tests.pendant.conftest import eventually
from urproto.trace.page import run_in

FLOOD = 'def flood():\n  i = 0\n  while i < 5000:\n    i = i + 1\n    textmsg("message ", i)\n  end\nend\n'


def clear_log(page: Page, lines: Locator) -> bool:
    """Clear the view; returns False if a late line arrived."""
    page.get_by_test_id("log-clear").click()
    try:
        expect(lines).to_have_count(0, timeout=1000)
    except AssertionError:
        return False
    return True


@pytest.mark.long
def test_stop_is_logged_and_texts_are_escaped(rig, open_page):
    page = open_page("log")
    lines = page.locator(".log-lines .log-line")
    expect(lines).not_to_have_count(0)
    eventually(lambda: clear_log(page, lines))
    rig.control.send_script('textmsg("<b>bold</b><img src=x onerror=alert(1)>")')
    expect(page.get_by_text("<b>bold</b><img src=x onerror=alert(1)>")).to_be_visible()
    rig.control.protective_stop(code=153, argument=2)
    page.get_by_test_id("stop-hide").click()
    line = lines.and_(page.locator(".warning"))
    expect(line.filter(has_text="C153A2")).to_contain_text("The position deviates from the path: elbow")
    expect(line.filter(has_text="Safety mode changed to protective stop")).to_have_count(1)
    page.get_by_test_id("log-words").fill("elbow")
    expect(lines).to_have_count(1)
    with page.expect_download() as download:
        page.get_by_test_id("log-csv").click()
    assert download.value.suggested_filename.endswith(".csv")
    assert "C153A2,The position deviates" in Path(download.value.path()).read_text()


@pytest.mark.long
def test_the_run_so_far_can_be_downloaded_as_a_page(rig, open_page, tmp_path):
    page = open_page("log")
    with page.expect_download(timeout=120_000) as download:  # the run is executed again, at a low priority
        page.get_by_test_id("log-trace").click()
    file = tmp_path / "run.html"
    download.value.save_as(file)
    assert run_in(file)


@pytest.mark.long
def test_a_journal_of_any_run_is_opened_in_another_tab_and_other_files_are_refused(rig, open_page, tmp_path):
    run = virtual_robot("ur3", running=True)
    run.send_script('textmsg("of another robot")')
    run.step(100)
    file, garbage = tmp_path / "of <b>monday.journal", tmp_path / "garbage.html"
    file.write_bytes(run.journal)
    garbage.write_bytes(b"?" * 1000)
    page = open_page("log")
    field = page.get_by_test_id("log-file").locator("input[type=file]")
    field.set_input_files(garbage)
    expect(page.get_by_text("garbage.html is not the page of a trace")).to_be_visible(timeout=120_000)
    expect(page.get_by_test_id("log-opened")).to_be_hidden()
    field.set_input_files(file)
    link = page.get_by_test_id("log-opened")
    expect(link).to_have_text(f"Show {file.name}", timeout=120_000)
    with page.expect_popup() as popup:
        link.click()
    opened = popup.value
    opened.wait_for_selector("body[data-ready]")
    expect(opened.get_by_text("of another robot").first).to_be_visible()
    opened.locator("#end").click()
    expect(opened.locator("#clock")).to_contain_text("41.8")


@pytest.mark.long
def test_page_stays_responsive_under_message_flood(rig, open_page):
    page = open_page("log")
    rig.control.send_script(FLOOD)
    expect(page.get_by_text("message 5000", exact=True)).to_be_visible()
    expect(page.locator(".log-lines .log-line")).to_have_count(500)
    page.get_by_test_id("tab-run").click()
    expect(page.get_by_test_id("run-state")).to_be_visible()
    expect(page.get_by_test_id("run-time")).to_contain_text("flood")
