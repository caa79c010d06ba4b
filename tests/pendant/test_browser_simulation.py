"""Simulation, in a browser."""

import re
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

import pytest
from playwright.sync_api import Page, expect
from playwright.sync_api import TimeoutError as NotInTime

from tests.pendant.conftest import eventually
from tests.pendant.pendants import pendant

_TRIES = 3


@pytest.fixture
def open_tab(open_page) -> Callable[..., Page]:
    """Opens the screen with one of its tabs."""

    def open_(tab: str = "") -> Page:
        page = open_page("simulation")
        page.wait_for_function(
            "typeof pendant.pixelPosition == 'function' && pendant.pixelPosition()"
        )  # the arm is drawn
        if tab:
            page.get_by_test_id(f"sim-{tab}").click()
        return page

    return open_


def choose(page: Page, test_id: str, text: str) -> None:
    """Choose an option, with retries: under load, a browser may miss a click on a new element."""
    option = page.get_by_role("option", name=text, exact=True)
    for _ in range(_TRIES):
        if not option.is_visible():
            page.get_by_test_id(test_id).click()
        with suppress(NotInTime):
            option.wait_for(timeout=10_000)
            break
    option.click()


def pixel_position(page: Page, name: str = "") -> tuple[float, float]:
    """Position of an object, or of the ball at the tool, on the page; waits until it is at rest."""
    page.wait_for_function(
        """name => {
            const at = typeof pendant.pixelPosition == "function" && pendant.pixelPosition(name || undefined);
            const same = at && window.before && at.every((value, i) => Math.abs(value - window.before[i]) < 0.5);
            window.before = at;
            return same;
        }""",
        arg=name,
        polling=400,
    )
    x, y = page.evaluate("name => pendant.pixelPosition(name || undefined)", name)
    return x, y


@pytest.mark.long
def test_injected_fault_strikes_and_is_listed(rig, open_tab):
    page = open_tab()
    expect(page.get_by_test_id("fault-text")).to_contain_text("Connections are closed")
    choose(page, "fault-port", "dashboard")
    with socket.create_connection((rig.host, rig.robot.ports["dashboard"]), 20.0) as client:
        assert client.recv(100)
        page.get_by_test_id("fault-inject").click()
        with pytest.raises(ConnectionResetError):
            client.recv(100)
    expect(page.get_by_test_id("faults")).to_contain_text("port dashboard")


@pytest.mark.long
def test_invalid_fault_is_refused_and_lasting_fault_is_cleared(rig, open_tab):
    page = open_tab()
    choose(page, "fault-kind", "Arm: Encoder jump")
    page.get_by_test_id("fault-inject").click()
    expect(page.locator(".q-notification")).to_contain_text("needs joint, by_rad")
    choose(page, "fault-kind", "Bytes in transit: Stall")
    choose(page, "fault-port", "secondary")
    page.get_by_test_id("fault-inject").click()
    eventually(lambda: newest_fault(rig) == ("stall", {"port": "secondary"}, "in force"))
    page.locator("[data-testid^=fault-clear-]").click()
    eventually(lambda: newest_fault(rig) == ("stall", {"port": "secondary"}, "over"))
    expect(page.locator("[data-testid^=fault-clear-]")).to_have_count(0)
    rig.control.inject_fault("delay", port="rtde", delay_s=0.01)  # it strikes again and again
    button = page.locator("[data-testid^=fault-clear-]")
    button.evaluate("it => { it.same = true }")
    struck = page.locator(".sim-fault[data-state=on] .sim-strikes")
    expect(struck).not_to_have_text(struck.inner_text())
    assert button.evaluate("it => it.same"), "its row was replaced"
    button.click()
    eventually(lambda: newest_fault(rig) == ("delay", {"port": "rtde", "delay_s": 0.01}, "over"))


def newest_fault(rig) -> tuple[str, dict[str, object], str] | None:
    faults = rig.control.faults()
    return (faults[-1]["kind"], faults[-1]["arguments"], faults[-1]["state"]) if faults else None


@pytest.mark.long
def test_dragging_ball_or_entering_wrench_pushes_tool(rig, open_tab):
    page = open_tab()
    eventually(lambda: pull_ball(page, rig))
    expect(page.get_by_test_id("measured-force")).not_to_contain_text("Measured 0.0 N")
    page.mouse.up()
    eventually(lambda: force(rig) == 0.0)
    assert rig.control.world()["push"] is None
    page.get_by_test_id("wrench-fz").fill("12.5")
    page.get_by_test_id("wrench-push").click()
    eventually(lambda: (rig.control.world()["push"] or {}).get("wrench", [0] * 6)[2] == 12.5)
    page.get_by_test_id("wrench-release").click()
    eventually(lambda: rig.control.world()["push"] is None)


def pull_ball(page: Page, rig) -> bool:
    """Drag the ball; returns False if it moved before it was hit, which can happen under load."""
    x, y = pixel_position(page)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 30, y, steps=3)
    deadline = time.monotonic() + 2.0
    while force(rig) <= 5.0 and time.monotonic() < deadline:
        time.sleep(0.02)
    if force(rig) <= 5.0:
        page.mouse.up()
    return force(rig) > 5.0


def force(rig) -> float:
    return sum(value * value for value in rig.state("actual_TCP_force")[:3]) ** 0.5


@pytest.mark.long
def test_paused_time_is_stepped_without_disconnecting_clients(rig, open_tab):
    page = open_tab()
    try:
        page.get_by_test_id("time-pause").click()
        expect(page.get_by_test_id("pace")).to_have_text("time paused")
        before = rig.control.time()
        page.get_by_test_id("time-step-10").click()
        after = before["time_s"] + 10 * before["period_s"]
        expect(page.get_by_test_id("sim-clock")).to_have_text(f"{after:.3f} s")
        assert rig.control.time()["time_s"] == pytest.approx(after)
        page.wait_for_timeout(1500)  # longer than the timeout of states
        expect(page.locator(".lost")).to_be_hidden()
        page.get_by_test_id("time-resume").click()
        expect(page.get_by_test_id("pace")).to_be_hidden()
        assert not rig.control.time()["paused"]
    finally:
        rig.control.resume_time()


@pytest.mark.long
def test_objects_are_added_dragged_and_removed(rig, open_tab):
    page = open_tab("world")
    add = page.get_by_test_id("object-add")
    add.click()
    expect(page.get_by_test_id("object")).to_have_count(1)
    before = rig.control.world()["objects"]["box"]
    assert before["box"] == [0.1, 0.1, 0.1]
    eventually(lambda: drag_box(page, rig, before["pose"]))
    page.get_by_label("Remove box").click()
    eventually(lambda: rig.control.objects() == [])


def drag_box(page: Page, rig, before: list[float]) -> bool:
    """Drag the box; returns False if the view moved before it was hit, which can happen under load."""
    x, y = pixel_position(page, "box")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 25, y + 10, steps=3)
    page.mouse.up()
    with suppress(AssertionError):
        eventually(lambda: moved_horizontally(before, rig.control.world()["objects"]["box"]["pose"]), within_s=3.0)
        return True
    return False


def moved_horizontally(before: list[float], now: list[float]) -> bool:
    """Whether an object has moved horizontally only."""
    return now[:2] != before[:2] and now[2:] == before[2:]


@pytest.mark.long
def test_digital_and_analog_inputs_are_set(rig, open_tab):
    page = open_tab("inputs")
    for test_id, bit in (("DI3", 1 << 3), ("CI7", 1 << 15), ("TI1", 1 << 17)):
        switch = page.get_by_test_id(test_id)
        switch.click()
        expect(switch).to_have_attribute("data-state", "on")
        assert rig.state("actual_digital_input_bits") & bit
        switch.click()
        expect(switch).to_have_attribute("data-state", "off")
    page.get_by_test_id("AI1-slider").click()
    expect(page.get_by_test_id("AI1")).to_have_text(re.compile(r"[45]\.\d+ V"))
    eventually(lambda: rig.state("standard_analog_input1") == pytest.approx(5.0, abs=0.5))
    rig.control.set_analog_input(1, 0.0)


@pytest.mark.long
def test_safeguard_opens_and_safety_cause_trips(rig, open_tab):
    page = open_tab("safety")
    gate = page.get_by_test_id("device-safeguard")
    gate.click()
    expect(gate).to_have_attribute("data-state", "alarm")
    eventually(lambda: rig.state("safety_mode") == "SAFEGUARD_STOP")
    gate.click()
    expect(gate).to_have_attribute("data-state", "off")
    page.get_by_test_id("reset_safeguard").click()
    eventually(lambda: rig.state("safety_mode") == "NORMAL")
    page.get_by_test_id("trip").click()
    eventually(lambda: rig.state("safety_mode") == "PROTECTIVE_STOP")


@pytest.mark.long
def test_state_is_saved_and_restored(rig, open_tab, tmp_path):
    page = open_tab("arm")
    with page.expect_download() as download:
        page.get_by_test_id("save-state").click()
    file = tmp_path / "state.json"
    download.value.save_as(file)
    before = rig.state("actual_q")
    page.get_by_test_id("q0").fill("45")
    page.get_by_test_id("put-arm").click()
    eventually(lambda: rig.state("actual_q")[0] == pytest.approx(0.7854, abs=1e-3))
    page.get_by_test_id("restore-upload").locator("input[type=file]").set_input_files(file)
    eventually(lambda: rig.state("actual_q") == pytest.approx(before))


@pytest.mark.long
def test_connected_clients_are_listed(rig, open_tab):
    page = open_tab("connections")
    with socket.create_connection((rig.host, rig.robot.ports["realtime"])) as client:
        host, port = client.getsockname()
        expect(page.get_by_test_id("connections")).to_contain_text(f"{host}:{port}")
    expect(page.get_by_test_id("connections")).not_to_contain_text(f"{host}:{port}")


@pytest.fixture
def without_control(rig) -> Iterator[str]:
    """A pendant without control API, as with a real robot."""
    with pendant(rig.host, "--port", "6081", "--control-port", "0"):
        yield f"http://{rig.host}:6081"


@pytest.mark.long
def test_real_robot_has_no_simulation_screen(without_control, browser):
    page = browser.new_page()
    page.goto(f"{without_control}/initialize")
    expect(page.locator(".robot-name")).to_contain_text("UR3")
    expect(page.get_by_test_id("tab-initialize")).to_be_visible()
    expect(page.get_by_test_id("tab-simulation")).to_be_hidden()
    expect(page.get_by_test_id("estop")).to_be_hidden()
    page.goto(f"{without_control}/simulation")
    expect(page.get_by_test_id("simulation-absent")).to_contain_text("no control API")
    page.close()
