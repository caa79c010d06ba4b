"""I/O, in a browser: changes are seen by other clients, and vice versa."""

import pytest
from playwright.sync_api import expect

from client.modbus import BlockingModbusClient
from client.rtde import BlockingRTDEClient
from tests.pendant.conftest import eventually

OUTPUTS = ["actual_digital_output_bits", "tool_output_voltage", "standard_analog_output1"]


@pytest.fixture
def rtde(rig):
    with BlockingRTDEClient(rig.host, OUTPUTS) as client:
        yield client


def test_outputs_switch_and_lamps_follow(rig, open_page, rtde):
    for index in range(8):
        rig.control.set_digital_output(index, False)
    page = open_page("io")
    page.get_by_test_id("DO3").click()
    eventually(lambda: rtde.latest()["actual_digital_output_bits"] & 0xFF == 8)
    expect(page.get_by_test_id("DO3")).to_have_attribute("data-state", "on")
    rig.control.set_digital_output(3, False)
    expect(page.get_by_test_id("DO3")).to_have_attribute("data-state", "off")
    with BlockingRTDEClient(rig.host, (), [["standard_digital_output_mask", "standard_digital_output"]]):
        page.get_by_test_id("DO5").click()  # another client uses these inputs, so a program switches the output
        eventually(lambda: rtde.latest()["actual_digital_output_bits"] & 0xFF == 32)
    page.get_by_test_id("DI2").click()
    expect(page.get_by_test_id("DI2")).to_have_attribute("data-state", "on")
    assert rig.state("actual_digital_input_bits") & 4
    page.get_by_test_id("DI2").click()
    expect(page.get_by_test_id("DI2")).to_have_attribute("data-state", "off")


@pytest.mark.long
def test_tool_voltage_and_analog_output_are_set(rig, open_page, rtde):
    page = open_page("io")
    page.get_by_test_id("tool-voltage").get_by_text("12 V").click()
    eventually(lambda: rtde.latest()["tool_output_voltage"] == 12)
    page.get_by_test_id("AO1-value").fill("12.5")
    page.get_by_test_id("AO1-value").press("Enter")
    expect(page.get_by_test_id("AO1")).to_have_text("12.500 mA")
    eventually(lambda: rtde.latest()["standard_analog_output1"] == pytest.approx(0.0125))
    page.get_by_test_id("AO1-value").fill("25")
    page.get_by_test_id("AO1-value").press("Enter")
    expect(page.locator(".q-notification")).to_contain_text("25 mA is outside of 4 to 20 mA")
    page.get_by_test_id("tool-voltage").get_by_text("0 V", exact=True).click()
    eventually(lambda: rtde.latest()["tool_output_voltage"] == 0)


@pytest.mark.long
def test_rtde_and_modbus_registers_are_shown_and_written(rig, open_page):
    page = open_page("io")
    page.get_by_test_id("io-registers").click()
    cell = page.get_by_test_id("input-cell-2")
    expect(cell).to_contain_text("26")
    cell.click()
    page.get_by_test_id("number").fill("-77")
    page.get_by_test_id("number-set").click()
    expect(cell).to_contain_text("-77")
    with BlockingRTDEClient(rig.host, ["input_int_register_26"]) as other:
        assert other.latest() == {"input_int_register_26": -77}
    page.get_by_test_id("io-modbus").click()
    with BlockingModbusClient(rig.host, rig.robot.ports["modbus"]) as modbus:
        modbus.write_register(130, 1234)
        expect(page.get_by_test_id("modbus-130")).to_contain_text("1234")
        page.get_by_test_id("modbus-131").click()
        page.get_by_test_id("number").fill("4321")
        page.get_by_test_id("number").press("Enter")
        eventually(lambda: modbus.read_registers(131) == (4321,))
