"""Move, in a browser: held buttons move the arm, and released or lost ones stop it."""

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import degrees, dist, radians
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from client.rtde import BlockingRTDEClient
from tests.budget import subset
from tests.pendant.conftest import Rig, eventually, number
from tests.pendant.pendants import pendant
from urproto.robots import kinematics_of, load_model
from urproto.robots.pose import rotvec_to_matrix

BENT = (0.2, -1.4, 1.5, -1.7, -1.5, 0.1)
OpenPage = Callable[[str], Page]


@pytest.fixture
def bent(rig: Rig) -> Rig:
    """An arm far from limits and singularities."""
    eventually(lambda: not any(rig.state("target_qd")))
    rig.control.set_joints(BENT)
    return rig


def q(rig: Rig) -> tuple[float, ...]:
    return tuple(rig.state("actual_q"))


def tcp(rig: Rig) -> tuple[float, ...]:
    return tuple(rig.state("actual_TCP_pose"))


def at_rest(rig: Rig) -> bool:
    return not any(rig.state("target_qd"))


@contextmanager
def hold_button(page: Page, test_id: str) -> Iterator[None]:
    page.get_by_test_id(test_id).hover()
    page.mouse.down()
    yield
    page.mouse.up()


def open_watcher(rig: Rig) -> BlockingRTDEClient:
    """A second RTDE client, which observes the arm."""
    return BlockingRTDEClient(rig.host, ("actual_q", "target_qd"))


def is_moving(watcher: BlockingRTDEClient) -> bool:
    return any(watcher.latest()["target_qd"])


def type_target(page: Page, test_id_prefix: str, values: tuple[float, ...]) -> None:
    expect(page.get_by_test_id(f"{test_id_prefix}-1")).not_to_have_value(
        "0.00"
    )  # filled with the present position first
    for i, value in enumerate(values):
        page.get_by_test_id(f"{test_id_prefix}-{i}").fill(f"{value:.4f}")


@pytest.mark.long
def test_third_party_client_sees_jogged_joint(bent: Rig, open_page: OpenPage) -> None:
    rtde_receive = pytest.importorskip("rtde_receive")
    page = open_page("move")
    watcher = rtde_receive.RTDEReceiveInterface(bent.host)
    try:
        with hold_button(page, "joint-2-plus"):
            eventually(lambda: watcher.getActualQ()[2] > BENT[2] + 0.05)
            expect(page.get_by_test_id("activity")).to_have_text("Jogging")
        eventually(lambda: not any(watcher.getTargetQd()))
        position = watcher.getActualQ()
        assert position[:2] == pytest.approx(BENT[:2], abs=1e-3)
        assert position[3:] == pytest.approx(BENT[3:], abs=1e-3)
        angle = page.get_by_test_id("angle-2")
        eventually(lambda: angle.inner_text() == f"{degrees(watcher.getActualQ()[2]):.2f}")
    finally:
        watcher.disconnect()


@pytest.mark.long
@pytest.mark.parametrize("key", subset(["Space", "Enter"], now=["Space"]))
def test_held_key_on_button_jogs_until_released(bent: Rig, open_page: OpenPage, key: str) -> None:
    page = open_page("move")
    with open_watcher(bent) as watcher:
        page.get_by_test_id("joint-2-plus").focus()
        page.keyboard.down(key)
        eventually(lambda: watcher.latest()["actual_q"][2] > BENT[2] + 0.05)
        page.keyboard.down(key)  # key repeat
        position = watcher.latest()["actual_q"][2]
        eventually(lambda: watcher.latest()["actual_q"][2] > position + 0.05)
        page.keyboard.up(key)
        eventually(lambda: not is_moving(watcher))
        q = watcher.latest()["actual_q"]
        assert q[:2] == pytest.approx(BENT[:2], abs=1e-3)
        assert q[3:] == pytest.approx(BENT[3:], abs=1e-3)
    expect(page.get_by_test_id("activity")).to_have_text("")


@pytest.mark.long
@pytest.mark.parametrize("lost", subset(["tab", "window", "button"], now=["window"]))
def test_losing_focus_releases_held_key(bent: Rig, open_page: OpenPage, lost: str) -> None:
    page = open_page("move")
    with open_watcher(bent) as watcher:
        page.get_by_test_id("axis-z-plus").focus()
        page.keyboard.down("Space")
        eventually(lambda: is_moving(watcher))
        if lost == "tab":
            page.keyboard.down("Tab")  # its release is never seen
        elif lost == "window":
            page.evaluate("window.dispatchEvent(new Event('blur'))")
        else:
            page.evaluate("document.activeElement.blur()")
        eventually(lambda: not is_moving(watcher))
        page.keyboard.up("Space")


def choose_feature(page: Page, feature: str) -> None:
    """Choose the feature of the jog buttons, and wait until the pendant has received it."""
    choice = page.get_by_test_id("feature")
    choice.get_by_text(feature).click()
    expect(choice).to_have_attribute("data-state", feature.lower())


@pytest.mark.long
def test_tool_moves_along_its_own_axis(bent: Rig, open_page: OpenPage) -> None:
    page = open_page("move")
    before = tcp(bent)
    choose_feature(page, "Tool")
    with hold_button(page, "axis-z-minus"):
        eventually(lambda: dist(tcp(bent)[:3], before[:3]) > 0.03)
    eventually(lambda: at_rest(bent))
    after = tcp(bent)
    axis = rotvec_to_matrix(*before[3:])[2::3]
    displacement = [b - a for a, b in zip(before[:3], after[:3], strict=True)]
    along = sum(a * b for a, b in zip(axis, displacement, strict=True))
    assert along == pytest.approx(-dist(before[:3], after[:3]), abs=1e-3)
    assert after[3:] == pytest.approx(before[3:], abs=2e-3)


@pytest.mark.long
def test_view_feature_follows_camera(bent: Rig, open_page: OpenPage) -> None:
    page = open_page("move")
    choose_feature(page, "View")
    page.get_by_test_id("view-front").click()  # along -x: right is +y
    page.wait_for_function("Math.abs(pendant.context.azimuth() - Math.PI / 2) < 0.01")
    before = tcp(bent)
    with hold_button(page, "axis-x-plus"):
        eventually(lambda: tcp(bent)[1] > before[1] + 0.02)
    assert tcp(bent)[0] == pytest.approx(before[0], abs=2e-3)


def test_typed_targets_are_reached_or_refused(bent: Rig, open_page: OpenPage) -> None:
    page = open_page("move")
    type_target(page, "target-joint", (0.0, 400.0))
    page.get_by_test_id("joints-move").click()
    expect(page.get_by_text("Shoulder cannot go to 400.00°")).to_be_visible()
    assert q(bent) == pytest.approx(BENT, abs=1e-3)
    goal = (20.0, -80.0, 85.0, -95.0, -85.0, 10.0)
    type_target(page, "target-joint", goal)
    page.get_by_test_id("joints-move").click()
    eventually(lambda: tuple(map(degrees, q(bent))) == pytest.approx(goal, abs=0.05))
    expect(page.get_by_test_id("activity")).to_have_text("")
    page.get_by_test_id("target-pose").click()
    page.get_by_test_id("pose-present").click()
    x, y, z, *turn = tcp(bent)
    eventually(lambda: abs(number(page.get_by_test_id("target-pose-2")) - 1e3 * z) < 0.05)
    page.get_by_test_id("target-pose-2").fill(f"{1e3 * (z + 0.02):.2f}")
    page.get_by_test_id("pose-kind").get_by_text("MoveL").click()
    page.get_by_test_id("pose-move").click()
    eventually(lambda: tcp(bent) == pytest.approx((x, y, z + 0.02, *turn), abs=1e-3))


def test_move_is_stopped(bent: Rig, open_page: OpenPage) -> None:
    page = open_page("move")
    page.get_by_test_id("target-poses").click()
    page.get_by_test_id("go-Zero").click()
    expect(page.get_by_test_id("activity")).to_have_text("Moving to Zero")
    eventually(lambda: not at_rest(bent))
    page.get_by_test_id("stop-moving").click()
    eventually(lambda: at_rest(bent))
    expect(page.get_by_test_id("activity")).to_have_text("")
    assert dist(q(bent), (0.0,) * 6) > 0.5


@pytest.mark.long
def test_stop_button_ends_program(bent: Rig, open_page: OpenPage) -> None:
    bent.control.send_script("def far():\n  while True:\n    sync()\n  end\nend\n")
    page = open_page("move")
    expect(page.get_by_test_id("slowed")).to_have_text("A program is running: stop it first.")
    expect(page.get_by_test_id("joints-move")).to_be_disabled()
    page.get_by_test_id("stop-moving").click()
    eventually(lambda: bent.state("runtime_state") == "STOPPED")
    expect(page.get_by_test_id("slowed")).to_have_text("")
    expect(page.get_by_test_id("joints-move")).to_be_enabled()


@pytest.mark.long
def test_freedrive_lasts_while_button_is_held(bent: Rig, open_page: OpenPage) -> None:
    page = open_page("move")
    before = tcp(bent)
    with hold_button(page, "freedrive"):
        expect(page.get_by_test_id("activity")).to_have_text("Freedrive")
        bent.control.push_tool([0.0, 0.0, 40.0, 0.0, 0.0, 0.0])
        eventually(lambda: tcp(bent)[2] > before[2] + 0.005)
    expect(page.get_by_test_id("activity")).to_have_text("")
    bent.control.release_tool()
    page.get_by_test_id("freedrive-keep").click()
    expect(page.get_by_test_id("activity")).to_have_text("Freedrive")
    page.get_by_test_id("freedrive-keep").click()
    expect(page.get_by_test_id("activity")).to_have_text("")
    with hold_button(page, "freedrive"):
        expect(page.get_by_test_id("activity")).to_have_text("Freedrive")
        page.evaluate(FROZEN)
        expect(page.get_by_test_id("activity")).to_have_text("")


@pytest.mark.long
def test_two_browsers_stay_in_step_and_only_one_jogs(bent: Rig, open_page: OpenPage) -> None:
    one, other = open_page("move"), open_page("move")
    before = q(bent)
    with hold_button(one, "joint-0-plus"):
        eventually(lambda: q(bent)[0] > before[0] + 0.05)
        expect(other.get_by_test_id("activity")).to_have_text("Jogging")
        other.get_by_test_id("joint-1-plus").dispatch_event("pointerdown")
        expect(other.get_by_text("Another browser is jogging the arm")).to_be_visible()
    eventually(lambda: at_rest(bent))
    assert q(bent)[1] == pytest.approx(before[1], abs=1e-3)


@pytest.mark.long
def test_closing_one_browser_does_not_stop_motion_of_another(bent: Rig, open_page: OpenPage) -> None:
    one, other = open_page("move"), open_page("move")
    before = q(bent)
    with hold_button(one, "joint-0-plus"):
        eventually(lambda: q(bent)[0] > before[0] + 0.05)
        position = q(bent)[0]
        other.close()
        eventually(lambda: q(bent)[0] > position + 0.05)
    eventually(lambda: at_rest(bent))


@pytest.mark.long
def test_saved_poses_are_shared_between_browsers(bent: Rig, open_page: OpenPage) -> None:
    one, other = open_page("move"), open_page("move")
    for page in (one, other):
        page.get_by_test_id("target-poses").click()
    one.get_by_test_id("pose-name").fill("over the box")
    one.get_by_test_id("pose-save").click()
    expect(other.get_by_test_id("go-over the box")).to_be_visible()
    other.get_by_test_id("menu-over the box").click()
    other.get_by_test_id("pose-rename").click()
    other.get_by_test_id("pose-new-name").fill("beside it")
    other.get_by_test_id("pose-renamed").click()
    expect(one.get_by_test_id("go-beside it")).to_be_visible()
    saved = json.loads((bent.programs / "poses.json").read_text("utf-8"))
    assert saved == {"ur3": {"beside it": pytest.approx(BENT, abs=1e-3)}}
    one.get_by_test_id("menu-beside it").click()
    one.get_by_test_id("pose-delete").click()
    expect(other.get_by_test_id("go-beside it")).to_have_count(0)


FROZEN = "for (let i = 0; i < 1e5; i++) clearInterval(i)"  # the page stops sending; its socket stays open


@pytest.mark.parametrize("lost", subset(["blur", "closed", "frozen"], now=["closed"]))
def test_arm_stops_when_page_is_left(bent: Rig, open_page: OpenPage, lost: str) -> None:
    page = open_page("move")
    page.get_by_test_id("joint-0-minus").hover()
    page.mouse.down()
    eventually(lambda: not at_rest(bent))
    if lost == "blur":
        page.evaluate("window.dispatchEvent(new Event('blur'))")
    elif lost == "frozen":
        page.evaluate(FROZEN)
    else:
        page.close()
    eventually(lambda: at_rest(bent))


@pytest.mark.long
def test_browser_waking_from_sleep_does_not_resume_motion(bent: Rig, open_page: OpenPage, browser: Browser) -> None:
    page = open_page("move")
    page.get_by_test_id("joint-0-minus").hover()
    page.mouse.down()
    eventually(lambda: not at_rest(bent))
    processes = browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]
    renderers = [process["id"] for process in processes if process["type"] == "renderer"]
    assert renderers
    for signal_number in (signal.SIGSTOP, signal.SIGCONT):
        for renderer in renderers:
            os.kill(renderer, signal_number)
        if signal_number == signal.SIGSTOP:
            eventually(lambda: at_rest(bent))
            time.sleep(3.0)  # longer than a browser under load is silent
    expect(page.get_by_text("press it again")).to_be_visible()
    assert at_rest(bent)
    page.mouse.up()
    with hold_button(page, "joint-0-plus"):
        eventually(lambda: not at_rest(bent))


@pytest.mark.long
def test_drawn_tcp_matches_robot(bent: Rig, open_page: OpenPage) -> None:
    page = open_page("move")
    expected = [*kinematics_of(load_model("ur3")).forward(q(bent))]
    read = """() => {
      const scene = getElement(document.querySelector(".move-view .arm").id.slice(1)).scene;
      scene.updateMatrixWorld(true);
      return scene.getObjectByName("tcp")?.matrixWorld.elements;
    }"""

    def differs() -> float:
        matrix: Any = page.evaluate(read)
        if matrix is None:
            return 1.0
        axes = rotvec_to_matrix(*expected[3:])
        shown = [matrix[4 * column + row] for row in range(3) for column in range(3)]
        return max(dist(matrix[12:15], expected[:3]), dist(shown, axes))

    eventually(lambda: differs() < 1e-3)


@contextmanager
def pendant_without_control_api(rig: Rig) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """A pendant that treats the emulator as a real robot."""
    with pendant(rig.host, "--port", "6081", "--control-port", "0") as process:
        yield process, f"http://{rig.host}:6081/move"


@pytest.mark.long
def test_real_robot_needs_confirmation_and_stops_when_pendant_dies(bent: Rig, browser: Browser) -> None:
    with pendant_without_control_api(bent) as (pendant, url):
        context = browser.new_context(viewport={"width": 1280, "height": 800})
        page = context.new_page()
        page.goto(url)
        expect(page.locator(".robot-name")).to_contain_text("UR3")
        expect(page.get_by_test_id("angle-0")).not_to_have_text("\N{EN DASH}")
        with hold_button(page, "joint-0-plus"):
            expect(page.get_by_test_id("confirm-move")).to_be_visible()
        assert at_rest(bent)
        page.get_by_test_id("confirm-move").click()
        page.get_by_test_id("joint-0-plus").hover()
        page.mouse.down()
        eventually(lambda: not at_rest(bent))
        pendant.send_signal(signal.SIGKILL)
        eventually(lambda: at_rest(bent))
        eventually(lambda: bent.state("runtime_state") == "STOPPED")
        assert bent.state("safety_mode") == "NORMAL"
        context.close()


SCENE = """() => {
  const scene = Object.values(window).find((value) => value?.isScene);
  const [trace, ghost] = ["trace", "ghost"].map((name) => scene.getObjectByName(name));
  const labels = [...document.querySelectorAll(".arm div")].filter((label) => label.style.display !== "none");
  return {
    points: trace?.visible ? trace.geometry.drawRange.count : -1,
    ghost: Boolean(ghost?.visible),
    frames: labels.map((label) => label.textContent),
  };
}"""


@pytest.mark.long
def test_scene_shows_frames_tcp_trace_and_ghost(bent: Rig, open_page: OpenPage) -> None:
    page = open_page("move")
    expect(page.get_by_test_id("joints-move")).to_be_enabled()
    eventually(lambda: page.evaluate(SCENE)["points"] == -1)
    page.get_by_test_id("show-frames").click()
    eventually(lambda: "tcp" in page.evaluate(SCENE)["frames"] and "forearm_link" in page.evaluate(SCENE)["frames"])
    page.get_by_test_id("show-trace").click()
    expect(page.get_by_test_id("target-joint-1")).not_to_have_value("0.00")
    page.get_by_test_id("target-joint-0").fill("40")
    eventually(lambda: page.evaluate(SCENE)["ghost"])
    page.get_by_test_id("joints-move").click()
    eventually(lambda: q(bent)[0] == pytest.approx(radians(40), abs=1e-3))
    eventually(lambda: not page.evaluate(SCENE)["ghost"])
    assert page.evaluate(SCENE)["points"] > 3
    page.get_by_test_id("trace-clear").click()
    eventually(lambda: page.evaluate(SCENE)["points"] <= 1)
    page.get_by_test_id("show-frames").click()
    eventually(lambda: "tcp" not in page.evaluate(SCENE)["frames"])
