"""Initialize, in a browser."""

from playwright.sync_api import expect


def test_the_arm_is_switched_off_and_on_again(rig, open_page):
    page = open_page("initialize")
    page.get_by_test_id("power-off").click()
    expect(page.get_by_test_id("status")).to_contain_text("Power off")
    assert rig.state("robot_mode") == "POWER_OFF"
    page.get_by_test_id("brake-release").click()
    expect(page.get_by_test_id("status")).to_contain_text("Normal")
    assert rig.state("robot_mode") == "RUNNING"
