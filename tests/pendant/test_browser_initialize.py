"""Initialize, in a browser."""

import re

import pytest
from playwright.sync_api import expect


def test_arm_is_powered_off_and_on(rig, open_page):
    page = open_page("initialize")
    expect(page.get_by_test_id("power-on")).to_be_disabled()
    page.get_by_test_id("power-off").click()
    expect(page.get_by_test_id("status")).to_contain_text("Power off")
    expect(page.get_by_test_id("joint-mode-2")).to_have_text("Power off")
    assert rig.state("robot_mode") == "POWER_OFF"
    page.get_by_test_id("power-on").click()
    expect(page.get_by_test_id("robot-mode")).to_have_text("Idle")
    assert rig.state("robot_mode") == "IDLE"
    page.get_by_test_id("brake-release").click()
    expect(page.get_by_test_id("robot-mode")).to_have_text("Normal")
    expect(page.get_by_test_id("joint-mode-2")).to_have_text("Running")
    assert rig.state("robot_mode") == "RUNNING"


@pytest.fixture
def speed_up(rig):
    """Slows time down, so that a countdown does not end before the browser shows it; calling the value speeds it up."""
    rig.control.set_speed(0.1)
    yield lambda: rig.control.set_speed(10.0)
    rig.control.set_speed(1.0)


def test_protective_stop_is_explained_and_unlocked_after_countdown(rig, open_page, speed_up):
    page = open_page("initialize")
    rig.control.protective_stop(153, 2)
    expect(page.get_by_test_id("safety-mode")).to_have_text("Protective stop")
    page.get_by_test_id("stop-hide").click()
    expect(page.get_by_test_id("safety-cause")).to_contain_text("C153A2: ")
    unlock = page.get_by_test_id("unlock")
    expect(unlock).to_have_text(re.compile(r"Unlock in [1-5] s"))
    expect(unlock).to_be_disabled()
    speed_up()
    expect(unlock).to_have_text(re.compile("Unlock protective stop"))
    unlock.click()
    expect(page.get_by_test_id("safety-mode")).to_have_text("Normal")
    expect(unlock).to_be_hidden()
    assert rig.state("safety_mode") == "NORMAL"


@pytest.mark.long
def test_emergency_stop_is_pressed_and_released(rig, open_page):
    page = open_page("initialize")
    button = page.get_by_test_id("estop")
    button.click()
    expect(button).to_have_attribute("data-state", "pressed")
    expect(page.get_by_test_id("safety-mode")).to_have_text("Robot emergency stop")
    expect(page.get_by_test_id("robot-mode")).to_have_text("Robot emergency stop")
    expect(page.get_by_test_id("power-on")).to_be_disabled()
    assert rig.state("safety_mode") == "ROBOT_EMERGENCY_STOP"
    button.click()
    expect(button).to_have_attribute("data-state", "released")
    page.get_by_test_id("brake-release").click()
    expect(page.get_by_test_id("robot-mode")).to_have_text("Normal")
    assert rig.state("robot_mode") == "RUNNING"


@pytest.mark.long
def test_safety_system_is_restarted_after_violation(rig, open_page):
    page = open_page("initialize")
    rig.control.trip_safety("joint_speed_violation", 3)
    expect(page.get_by_test_id("safety-mode")).to_have_text("Violation")
    expect(page.get_by_test_id("safety-cause")).to_contain_text("C191A35: ")
    expect(page.get_by_test_id("joint-mode-3")).to_have_text("Violation")
    page.get_by_test_id("unlock").click()
    expect(page.get_by_test_id("safety-mode")).to_have_text("Normal")
    assert rig.state("safety_mode") == "NORMAL"


@pytest.mark.long
def test_payload_fields_set_and_follow_robot(rig, open_page):
    page = open_page("initialize")
    rig.control.set_payload(0.25, (0.0, 0.0, 0.01))
    expect(page.get_by_test_id("payload-mass")).to_have_value("0.250")
    expect(page.get_by_test_id("payload-cz")).to_have_value("10.0")
    page.get_by_test_id("payload-mass").fill("1.5")
    page.get_by_test_id("payload-cx").fill("-20")
    page.get_by_test_id("payload-set").click()
    rig.control.run_until("payload > 1.4")
    assert rig.state("payload_cog") == [-0.02, 0.0, 0.01]
    rig.control.set_payload(0.0)
