"""Run, in a browser."""

import gzip
import re

import pytest
from playwright.sync_api import Page, expect

from tests.pendant.conftest import eventually

COUNT = "def count():\n  global i = 0\n  while True:\n    i = i + 1\n    sleep(0.05)\n  end\nend\n"
TREE = (
    '<URProgram name="t"><children><MainProgram runOnlyOnce="false"><children><Folder name="Pick"><children>'
    '<Wait type="Sleep"><waitTime>60</waitTime></Wait>'
    "</children></Folder></children></MainProgram></children></URProgram>"
)


def write(page: Page, text: str) -> None:
    """Replace the text of the editor."""
    page.get_by_test_id("run-tab-script").click()
    page.locator(".cm-content").click()
    page.keyboard.press("Control+A")
    page.keyboard.press("Delete")
    page.keyboard.insert_text(text)


def test_program_is_loaded_played_and_monitored(rig, open_page):
    (rig.programs / "count.script").write_text(COUNT)
    page = open_page("run")
    page.get_by_test_id("run-choose").click()
    page.get_by_test_id("run-file").get_by_text("count.script").click()
    expect(page.get_by_test_id("run-loaded")).to_have_text("/programs/count.script")
    expect(page.locator(".program-line").first).to_contain_text("def count():")
    page.get_by_test_id("run-play").click()
    expect(page.get_by_test_id("run-state")).to_have_text("Playing")
    expect(page.get_by_test_id("run-time")).to_contain_text("count")
    expect(page.locator(".program-line.current")).to_contain_text("sleep(0.05)")
    # by its name: variables of the program before may still be shown for a moment
    row = page.locator(".variable", has=page.locator(".variable-name", has_text=re.compile("^i$")))
    expect(row).to_contain_text("int")
    value = row.locator(".variable-value")
    expect(value).to_have_text(re.compile(r"\d"))
    first = int(value.inner_text())
    expect(value).not_to_have_text(str(first))
    assert int(value.inner_text()) > first
    page.get_by_test_id("run-stop").click()
    expect(page.get_by_test_id("run-state")).to_have_text("Stopped")
    expect(page.locator(".program-line.current")).to_have_count(0)


@pytest.mark.long
def test_executing_node_is_highlighted(rig, open_page):
    (rig.programs / "tree.urp").write_bytes(gzip.compress(TREE.encode()))
    page = open_page("run")
    page.get_by_test_id("run-path").fill("tree.urp")
    page.get_by_test_id("run-load").click()
    expect(page.locator(".program-node")).to_have_text(["1Robot Program", "2Pick", "3Wait: 60"])
    page.get_by_test_id("run-play").click()
    expect(page.locator(".program-node.current")).to_have_text("3Wait: 60")


def test_missing_file_is_reported(open_page):
    page = open_page("run")
    page.get_by_test_id("run-path").fill("nowhere.urp")
    page.get_by_test_id("run-load").click()
    expect(page.get_by_text("File not found: nowhere.urp")).to_be_visible()


@pytest.mark.long
def test_error_is_marked_and_text_is_shared_between_browsers(rig, open_page):
    page = open_page("run")
    write(page, "def bad():\n  a = [1, 2]\n  b = a[7]\nend\n")
    page.get_by_test_id("script-send").click()
    expect(page.get_by_test_id("script-error")).to_contain_text("Line 3, column")
    expect(page.locator(".script-bad-line")).to_contain_text("b = a[7]")
    expect(page.get_by_test_id("script-phase")).to_have_text("Error")
    other = open_page("run")
    other.get_by_test_id("run-tab-script").click()
    expect(other.locator(".cm-content")).to_contain_text("b = a[7]")
    write(other, "def good():\n  global answer = 42\n  sleep(60)\nend\n")
    expect(page.locator(".cm-content")).to_contain_text("answer = 42")
    other.get_by_test_id("script-send").click()
    expect(page.get_by_test_id("script-phase")).to_have_text("Running")
    expect(page.get_by_test_id("script-error")).to_be_hidden()
    eventually(
        lambda: rig.control.variables() == {"answer": "42"}
    )  # the program counts as running before its first line
    page.get_by_test_id("run-tab-program").click()
    expect(page.locator(".program-line.current")).to_contain_text("sleep(60)")


@pytest.mark.long
def test_checker_messages_are_shown_while_typing(rig, open_page):
    page = open_page("run")
    write(page, "def bad():\n  movJ([0, 0, 0, 0, 0, 0])\nend\n")
    problems = page.get_by_test_id("script-error")
    expect(problems).to_contain_text("Line 2, column 3: function 'movJ' is not defined")
    expect(page.locator(".script-bad-line")).to_contain_text("movJ")
    page.get_by_test_id("script-send").click()  # the robot refuses it, too
    expect(page.get_by_test_id("script-phase")).to_have_text("Error")
    expect(problems).not_to_contain_text("compile_error")
    expect(problems).to_contain_text("function 'movJ' is not defined")
    write(page, "def good():\n  sync()\nend\n")
    expect(problems).to_be_hidden()
    expect(page.locator(".script-bad-line")).to_have_count(0)


@pytest.mark.long
def test_file_is_opened_in_editor(open_page, tmp_path):
    (tmp_path / "job.script").write_bytes(b"\xef\xbb\xbfdef opened():\r\n  sync()\r\nend\r\n")
    page = open_page("run")
    write(page, "# nothing of worth")
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Open").click()
    chooser.value.set_files(tmp_path / "job.script")
    page.get_by_test_id("agree").click()
    expect(page.locator(".cm-content")).to_contain_text("def opened():")
