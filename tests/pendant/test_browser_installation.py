"""Installation, in a browser."""

import pytest
from playwright.sync_api import Error, expect

from tests.pendant.conftest import eventually


@pytest.mark.long
def test_tcp_is_saved_and_activated(rig, open_page):
    page, other = open_page("installation"), open_page("installation")
    page.get_by_test_id("tcp-name").fill('gripper "x"')
    page.get_by_test_id("tcp-2").fill("152.5")
    page.get_by_test_id("tcp-save").click()
    row = other.get_by_test_id('tcp gripper "x"')
    expect(row).to_contain_text("152.5 mm")
    row.get_by_role("button", name="Use").click()
    eventually(lambda: rig.state("tcp_offset") == pytest.approx([0, 0, 0.1525, 0, 0, 0]))
    expect(page.get_by_test_id("tcp-active-2")).to_have_text("152.50 mm")
    expect(page.get_by_test_id("tcp-active")).to_have_text('gripper "x"')
    page.get_by_test_id("tcp Flange").get_by_role("button", name="Use").click()
    eventually(lambda: rig.state("tcp_offset") == [0] * 6)


@pytest.mark.long
def test_payload_external_control_and_arm_data(rig, open_page):
    page = open_page("installation")
    page.get_by_test_id("payload-mass").fill("0.5")
    page.get_by_test_id("payload-cz").fill("40")
    page.get_by_test_id("payload-use").click()
    expect(page.get_by_test_id("payload-active")).to_have_text("In effect: 0.500 kg at 0.0, 0.0, 40.0 mm")
    assert rig.state("payload_cog") == pytest.approx([0, 0, 0.04])
    expect(page.get_by_test_id("driver-port")).to_have_value("50002")
    page.get_by_test_id("driver-host").fill("10.1.2.3")
    page.get_by_test_id("driver-port").fill("50102")
    page.get_by_test_id("driver-save").click()
    eventually(lambda: rig.control.external_control() == {"host": "10.1.2.3", "port": 50102})
    page.get_by_test_id("installation-arm").click()
    expect(page.get_by_test_id("serial")).to_have_text(rig.control.describe()["serial_number"])
    expect(page.get_by_test_id("calibration")).to_have_text("nominal")
    expect(page.get_by_test_id("hash")).to_contain_text("calib_")


@pytest.mark.long
def test_settings_are_saved_to_installation_file(rig, open_page):
    page, other = open_page("installation"), open_page("installation")
    for opened_page in (page, other):
        opened_page.get_by_test_id("installation-file").click()
        expect(opened_page.get_by_test_id("setting-name")).to_have_value("TCP")
    page.get_by_test_id("setting-name").fill("pen")
    page.get_by_test_id("setting-pose-2").fill("152.5")
    page.get_by_test_id("setting-add").click()
    eventually(lambda: [row["name"] for row in installation_rows(rig, "tcps")] == ["TCP", "pen"])
    page.get_by_test_id("setting-active").click()
    page.get_by_test_id("setting-save").click()
    eventually(lambda: rig.state("tcp_offset") == pytest.approx([0, 0, 0.1525, 0, 0, 0]))
    choose(other, "setting-row", "pen")
    expect(other.get_by_test_id("setting-pose-2")).to_have_value("152.5")
    choose(page, "setting", "External Control")
    page.get_by_test_id("setting-host").fill("10.9.8.7")
    page.get_by_test_id("setting-save").click()
    eventually(lambda: rig.control.external_control()["host"] == "10.9.8.7")
    choose(page, "setting", "Safety: planes")
    expect(page.get_by_test_id("setting-note")).to_contain_text("no robot accepts it as its own")
    expect(page.get_by_test_id("setting-name")).to_have_value("Safety plane 0")
    choose(page, "setting-mode", "REDUCED")
    page.get_by_test_id("setting-normal-2").fill("1")
    page.get_by_test_id("setting-distance").fill("250")
    page.get_by_test_id("setting-save").click()
    eventually(lambda: rig.state("robot_mode") == "POWER_OFF")
    assert installation_rows(rig, "safety_planes")[0]["distance"] == pytest.approx(0.25)
    choose(page, "setting", "Payload")
    page.get_by_test_id("setting-mass").fill("-3")
    page.get_by_test_id("setting-save").click()
    expect(page.get_by_text("between 0 and 100 kg")).to_be_visible()
    rig.control.change_installation("tcps", {"active": True}, "TCP")
    rig.control.change_installation("safety_planes", {"mode": "DISABLED"}, "0")
    assert (rig.programs / "default.installation").is_file()


def choose(page, test_id, text):
    """Open the list until it stays open: under load, it may be rebuilt during the click."""
    option = page.get_by_role("option", name=text, exact=True)
    for _ in range(5):
        page.get_by_test_id(test_id).click()
        try:
            option.wait_for(timeout=10_000)
            break
        except Error:
            continue
    option.click()


def installation_rows(rig, section):
    return rig.control.installation(section)["sections"][section]
