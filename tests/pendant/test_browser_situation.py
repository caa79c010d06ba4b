"""The situation on several screens, in a browser: consistent and correct."""

import os
import re
import signal

import pytest
from playwright.sync_api import Page, expect

from tests.pendant.conftest import Rig

COUNT = "def count():\n  global i = 0\n  while True:\n    i = i + 1\n    sleep(0.05)\n  end\nend\n"


def show(page: Page, screen: str) -> None:
    page.get_by_test_id(f"tab-{screen}").click()


@pytest.mark.long
def test_safeguard_is_opened_closed_and_reset(rig: Rig, open_page) -> None:
    try:
        (rig.programs / "count.script").write_text(COUNT)
        rig.control.dashboard("load count.script")
        rig.control.dashboard("play")
        page = open_page("initialize")
        rig.control.open_safeguard()
        for test_id in ("robot-mode", "safety-mode", "status"):
            expect(page.get_by_test_id(test_id)).to_contain_text("Safeguard stop")
        expect(page.get_by_test_id("safeguard-state")).to_have_text("Open")
        expect(page.get_by_test_id("robot-hint")).to_have_text(
            "The safeguard is open: close it. The program then continues."
        )
        expect(page.get_by_test_id("unlock")).to_be_disabled()
        expect(page.get_by_test_id("play")).to_be_disabled()
        show(page, "move")
        expect(page.get_by_test_id("slowed")).to_contain_text("Safeguard stop")
        page.get_by_test_id("joint-0-plus").dispatch_event("pointerdown")
        expect(page.get_by_role("alert")).to_contain_text("Safeguard stop. The safeguard is open")
        show(page, "initialize")
        rig.control.close_safeguard()
        expect(page.get_by_test_id("safeguard-state")).to_have_text("Closed, not reset")
        expect(page.get_by_test_id("robot-mode")).to_have_text("Safeguard stop")
        page.get_by_test_id("unlock").click()
        expect(page.get_by_test_id("robot-mode")).to_have_text("Normal")
        expect(page.get_by_test_id("safeguard-state")).to_have_text("Closed")
        expect(page.get_by_test_id("program-state")).to_have_text("Playing")
    finally:
        rig.control.close_safeguard()
        rig.control.reset_safeguard()


@pytest.mark.long
def test_values_that_are_no_longer_renewed_are_grey(rig: Rig, open_page) -> None:
    page = open_page("initialize")
    old = page.get_by_test_id("old")
    expect(page.get_by_test_id("robot-mode")).to_have_text("Normal")
    expect(old).to_be_hidden()
    os.kill(rig.pendant_pid, signal.SIGSTOP)
    try:
        expect(old).to_have_text(re.compile(r"these values are [2-9] s old"))
        expect(page.get_by_test_id("robot-mode")).to_have_css("opacity", "0.45")
        expect(page.get_by_test_id("power-off")).to_have_css("opacity", "0.5")
        page.get_by_test_id("power-off").click()  # has no effect later
    finally:
        os.kill(rig.pendant_pid, signal.SIGCONT)
    expect(old).to_be_hidden()
    expect(page.get_by_test_id("robot-mode")).to_have_css("opacity", "1")
    expect(page.get_by_test_id("robot-mode")).to_have_text("Normal")
    assert rig.state("robot_mode") == "RUNNING"


@pytest.fixture
def disconnect_robot(rig: Rig):
    """Disconnects the robot from the network until the end of the test."""

    def disconnect() -> None:
        for port in ("rtde", "primary", "dashboard"):
            rig.control.inject_fault("refuse_connections", port=port)
            rig.control.inject_fault("drop_connection", port=port)

    yield disconnect
    rig.control.clear_faults()


def test_screens_show_no_values_of_disconnected_robot(rig: Rig, disconnect_robot, open_page) -> None:
    page = open_page("initialize")
    expect(page.get_by_test_id("robot-mode")).to_have_text("Normal")
    expect(page.get_by_test_id("joint-mode-2")).to_have_text("Running")
    disconnect_robot()
    expect(page.locator(".lost")).to_be_visible()
    for test_id in ("robot-mode", "status"):
        expect(page.get_by_test_id(test_id)).to_contain_text("Not connected")
    expect(page.get_by_test_id("robot-hint")).to_have_text(
        "The robot does not answer. The pendant keeps trying to reach it."
    )
    expect(page.get_by_test_id("robot-lamp")).to_have_attribute("data-state", "unknown")
    for test_id in ("safety-mode", "safeguard-state", "limits-state", "joint-mode-2", "program-state"):
        expect(page.get_by_test_id(test_id)).to_have_text("–")
    expect(page.locator('[data-state="ready"]')).to_have_count(0)
    show(page, "move")
    expect(page.get_by_test_id("angle-0")).to_have_text("–")
    expect(page.get_by_test_id("slowed")).to_contain_text("Not connected")
    for test_id in ("joint-0-plus", "axis-x-minus", "freedrive", "stop-moving", "joints-move", "play"):
        expect(page.get_by_test_id(test_id)).to_be_disabled()
    show(page, "io")
    for test_id in ("DO0", "CO0", "DI0"):
        expect(page.get_by_test_id(test_id)).to_be_disabled()
    show(page, "move")
    rig.control.clear_faults()
    expect(page.get_by_test_id("status")).to_contain_text("Normal")
    expect(page.get_by_test_id("angle-0")).not_to_have_text("–")
