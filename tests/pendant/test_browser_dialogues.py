"""Dialogues over the screens, in a browser."""

import pytest
from playwright.sync_api import expect

from tests.pendant.conftest import eventually

ASK = 'def ask():\n  global n = request_integer_from_primary_client("how <many>?")\n  sleep(60)\nend\n'
POPUP = 'def tell():\n  popup("<i>parts</i> are out", "Feeder", warning=True, blocking=True)\n  sleep(60)\nend\n'


@pytest.mark.long
def test_integer_question_accepts_only_integers(rig, open_page):
    page, other = open_page("io"), open_page("log")
    rig.control.send_script(ASK)
    expect(other.get_by_test_id("dialogue-text")).to_have_text("how <many>?")
    page.get_by_test_id("answer").fill("a few")
    page.get_by_test_id("answer-ok").click()
    expect(page.get_by_text("The program expects an integer")).to_be_visible()
    page.get_by_test_id("answer").fill("12")
    page.get_by_test_id("answer").press("Enter")
    expect(page.get_by_test_id("dialogue")).to_be_hidden()
    expect(other.get_by_test_id("dialogue")).to_be_hidden()
    rig.control.run_until("script_control_line == 3")
    assert rig.control.variables() == {"n": "12"}


@pytest.mark.long
def test_blocking_popup_is_closed_from_pendant(rig, open_page):
    page = open_page("move")
    rig.control.send_script(POPUP)
    expect(page.get_by_test_id("dialogue")).to_contain_text("Feeder")
    expect(page.get_by_test_id("dialogue-text")).to_have_text("<i>parts</i> are out")
    page.get_by_test_id("popup-ok").click()
    expect(page.get_by_test_id("dialogue")).to_be_hidden()
    eventually(lambda: rig.control.popups() == [])


@pytest.mark.long
def test_protective_stop_shows_cause_and_unlocks_after_countdown(rig, open_page):
    page = open_page("log")
    enable = page.get_by_test_id("stop-enable")
    rig.control.set_speed(0.2)
    try:
        rig.control.protective_stop(code=157, argument=0)
        expect(page.get_by_test_id("stop-cause")).to_have_text("C157A0: A collision was detected: base")
        expect(enable).to_be_disabled()
        expect(enable).to_contain_text("Unlock in")
        rig.control.set_speed(20.0)
        enable.click()  # once it is enabled
        expect(page.get_by_test_id("stop-dialogue")).to_be_hidden()
    finally:
        rig.control.set_speed(1.0)
    eventually(lambda: rig.state("safety_mode") == "NORMAL")
