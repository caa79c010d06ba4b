"""Controllers, in a browser: a running manager's controllers are switched, and the arm follows the sliders."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from math import degrees, radians
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.pendant.conftest import Rig, eventually, number

ROOT = Path(__file__).resolve().parents[2]
SCALED = "scaled_joint_trajectory_controller"
FORWARD = "forward_velocity_controller"


@pytest.fixture
def manager(rig: Rig) -> Iterator["subprocess.Popen[str]"]:
    """``ur-client controllers serve`` in another terminal."""
    command = [sys.executable, "-m", "client", "controllers", "serve", "--robot-ip", rig.host]
    with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True, env=os.environ) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("ready:"):
                break
        try:
            yield process
        finally:
            process.terminate()
            process.wait(20.0)


def base(rig: Rig) -> float:
    return degrees(rig.control.state(["actual_q"])["actual_q"][0])


@pytest.mark.long
def test_screen_explains_how_to_start_missing_manager(rig: Rig, open_page: Callable[[str], Page]) -> None:
    page = open_page("controllers")
    expect(page.get_by_test_id("manager-problem")).to_contain_text(f"ur-client controllers serve --robot-ip {rig.host}")
    expect(page.get_by_test_id("sliders-enable")).to_be_disabled()
    expect(page.get_by_label("Elbow", exact=True)).to_be_disabled()


@pytest.mark.long
@pytest.mark.usefixtures("manager")
def test_controllers_are_switched_and_arm_follows_sliders(
    rig: Rig, manager: "subprocess.Popen[str]", open_page: Callable[[str], Page]
) -> None:
    rig.control.set_speed_slider(1.0)
    page = open_page("controllers")
    row, other = page.get_by_test_id(f"controller-{SCALED}"), page.get_by_test_id(f"controller-{FORWARD}")
    expect(row.locator(".chip")).to_have_text("active")
    expect(row).to_contain_text("*_joint/position (6)")
    page.get_by_label(f"Activate {FORWARD}").click()  # another controller uses the arm
    expect(page.locator(".q-notification")).to_contain_text("position and velocity cannot be commanded")
    for name in (SCALED, FORWARD):
        page.get_by_label(f"Tick {name}").click()
    page.get_by_test_id("controllers-switch").click()
    expect(other.locator(".chip")).to_have_text("active")
    expect(row.locator(".chip")).to_have_text("inactive")
    expect(page.get_by_test_id("sliders-enable")).to_be_disabled()
    page.get_by_label(f"Deactivate {FORWARD}").click()
    expect(other.locator(".chip")).to_have_text("inactive")
    page.get_by_label(f"Activate {SCALED}").click()
    expect(row.locator(".chip")).to_have_text("active")

    angle, slider = page.get_by_test_id("slider-number-0"), page.get_by_test_id("slider-0")
    eventually(lambda: abs(number(angle) - base(rig)) < 0.1)  # sliders follow the arm
    expect(slider).to_be_disabled()
    page.get_by_test_id("sliders-enable").click()
    expect(slider).to_be_enabled()
    began = base(rig)
    box = slider.bounding_box()
    assert box is not None
    low, high = (float(slider.get_attribute(end) or "") for end in ("min", "max"))
    x, y = box["x"] + box["width"] * (began - low) / (high - low), box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    for step in range(12):
        page.mouse.move(x + 2.0 * step, y)
        page.wait_for_timeout(50)
    eventually(lambda: base(rig) > began + 1.0)  # while the button is still held
    page.mouse.up()
    assert number(angle) > began + 5.0
    eventually(lambda: abs(base(rig) - number(angle)) < 0.2)
    angle.fill("3.5")
    angle.press("Enter")
    eventually(lambda: abs(base(rig) - 3.5) < 0.1)
    slider.press("ArrowRight")
    eventually(lambda: base(rig) > 3.55)

    page.get_by_test_id("sliders-enable").click()
    expect(slider).to_be_disabled()
    manager.kill()
    expect(page.get_by_test_id("manager-problem")).to_contain_text("no controller manager is running")
    expect(page.get_by_test_id(f"controller-{SCALED}")).to_have_count(0)
    assert abs(radians(base(rig))) < 0.2  # the arm has not moved
