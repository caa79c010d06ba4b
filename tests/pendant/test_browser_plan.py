"""Move, Plan, in a browser: targets are dragged, paths are shown, and nothing moves without confirmation."""

import re
from collections.abc import Callable, Iterator
from math import degrees, dist, radians
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.pendant.conftest import SLOW_FRAMES, VIEWPORT, Rig, eventually
from tests.pendant.pendants import pendant
from urproto.robots import kinematics_of, load_model

BENT = (0.2, -1.4, 1.5, -1.7, -1.5, 0.1)
BESIDE = (80.0, -80.0, 86.0, -97.0, -86.0, 6.0)  # degrees; the post is between it and BENT
POST = {"box": [0.06, 0.06, 0.4], "pose": [-0.15, -0.33, 0.2]}
OpenPage = Callable[[str], Page]
DRAWN = """() => {
  const scene = Object.values(window).find((value) => value?.isScene);
  const red = (part) => part.material.color.getHexString() === "d02020";
  const found = { objects: [], red: [], links: 0, path: false, ghost: null };
  scene.traverse((part) => {
    if (part.name.startsWith("object ")) {
      found.objects.push(part.name.slice(7));
      if (red(part)) found.red.push(part.name.slice(7));
    } else if (part.isMesh) {
      let top = part;
      while (top && top.name !== "ghost") top = top.parent;
      if (top && red(part)) found.links += 1;
    }
    if (part.name === "path") found.path = true;
    if (part.name === "ghost joint 0") found.ghost = part.rotation.z;
  });
  return found;
}"""


@pytest.fixture
def bent(rig: Rig) -> Iterator[Rig]:
    """An arm far from limits and singularities, among objects that are removed afterwards."""
    eventually(lambda: not any(rig.state("target_qd")))
    rig.control.set_joints(BENT)
    yield rig
    for name in rig.control.objects():
        rig.control.remove_object(name)


def q(rig: Rig) -> tuple[float, ...]:
    return tuple(rig.state("actual_q"))


def drawn_scene(page: Page) -> dict[str, Any]:
    return page.evaluate(DRAWN)


def drag(page: Page, x: float, y: float, point: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
    """Drag the part of the handle at this point by a number of pixels."""

    def hover() -> bool:
        at = page.evaluate("(place) => pendant.handle?.(...place) ?? null", point)
        if at is None:
            return False
        page.mouse.move(*at)
        page.mouse.move(at[0] + 1, at[1])
        position.update(x=at[0], y=at[1])
        return page.evaluate("() => document.querySelector('.move-view .arm').style.cursor") == "grab"

    position = dict[str, float]()
    eventually(hover)
    page.mouse.down()
    page.mouse.move(position["x"] + x, position["y"] + y, steps=4)
    page.mouse.up()


def plan_tab(open_page: OpenPage) -> Page:
    page = open_page("move")
    page.get_by_test_id("target-plan").click()
    expect(page.get_by_test_id("plan-status")).to_contain_text("Drag the ball")
    return page


def target(page: Page) -> tuple[float, ...]:
    """Joint angles [rad] in the fields, which follow the handle."""
    page.get_by_test_id("target-joints").click()
    angles = tuple(radians(float(page.get_by_test_id(f"target-joint-{i}").input_value())) for i in range(6))
    page.get_by_test_id("target-plan").click()
    return angles


def type_target(page: Page, angles: tuple[float, ...]) -> None:
    page.get_by_test_id("target-joints").click()
    for i, angle in enumerate(angles):
        page.get_by_test_id(f"target-joint-{i}").fill(f"{angle:.2f}")
    page.get_by_test_id("target-plan").click()


@pytest.mark.long
def test_dragged_target_is_planned_and_reached_on_request(bent: Rig, open_page: OpenPage) -> None:
    bent.control.add_object("table", {"plane": {}, "pose": [0.0, 0.0, -0.02]})
    page = plan_tab(open_page)
    status = page.get_by_test_id("plan-status")
    eventually(lambda: drawn_scene(page)["objects"] == ["table"])
    drag(page, 0.0, 250.0)
    expect(status).to_contain_text(re.compile(r"wrist_3_link is \d+\.\d mm deep in table"))
    eventually(lambda: drawn_scene(page)["red"] == ["table"] and drawn_scene(page)["links"] > 0)
    page.get_by_test_id("plan").click()
    expect(status).to_contain_text("the goal cannot be reached")
    expect(page.get_by_test_id("plan-move")).to_be_disabled()
    drag(page, 20.0, -220.0)
    expect(status).to_contain_text("The target is free")
    eventually(lambda: not drawn_scene(page)["red"] and not drawn_scene(page)["links"])
    page.get_by_test_id("plan").click()
    expect(status).to_contain_text(re.compile(r"A path of \d+\.\d s"))
    eventually(lambda: drawn_scene(page)["path"])
    assert q(bent) == pytest.approx(BENT, abs=1e-3)
    goal = target(page)
    page.get_by_test_id("plan-move").click()
    eventually(lambda: q(bent) == pytest.approx(goal, abs=1e-3))
    expect(status).to_contain_text("Drag the ball")
    eventually(lambda: not drawn_scene(page)["path"])


@pytest.mark.long
def test_arrow_translates_target_and_ring_rotates_it(bent: Rig, open_page: OpenPage) -> None:
    page = plan_tab(open_page)
    forward = kinematics_of(load_model("ur3")).forward
    before = forward(BENT)
    drag(page, 0.0, -60.0, (0.0, 0.0, 0.15))
    expect(page.get_by_test_id("plan-status")).to_contain_text("The target is free")
    eventually(lambda: dist(target(page), BENT) > 0.05)
    raised = forward(target(page))
    assert raised[2] > before[2] + 0.03
    assert dist(raised[:2], before[:2]) < 2e-3
    drag(page, 40.0, 0.0, (0.085, -0.085, 0.0))
    eventually(lambda: dist(forward(target(page))[3:], raised[3:]) > 0.1)
    assert dist(forward(target(page))[:3], raised[:3]) < 2e-3
    assert q(bent) == pytest.approx(BENT, abs=1e-3)


@pytest.mark.long
def test_path_is_previewed_and_invalidated_by_scene_change(bent: Rig, open_page: OpenPage) -> None:
    bent.control.add_object("post", POST)
    page = plan_tab(open_page)
    status = page.get_by_test_id("plan-status")
    eventually(lambda: drawn_scene(page)["objects"] == ["post"])
    type_target(page, BESIDE)
    page.get_by_test_id("plan").click()
    expect(status).to_contain_text("by RRTConnect")
    angles = set[float]()
    eventually(lambda: len(angles.add(drawn_scene(page)["ghost"]) or angles) > 3)  # the ghost moves along the path
    bent.control.set_speed_slider(0.05)  # the motion takes more than a minute
    page.get_by_test_id("plan-move").click()
    eventually(lambda: any(bent.state("target_qd")) and dist(q(bent), BENT) > 0.03)
    page.get_by_test_id("stop-moving").click()
    eventually(lambda: not any(bent.state("target_qd")))
    assert dist(tuple(map(degrees, q(bent))), BESIDE) > 5.0
    page.get_by_test_id("plan-move").click()
    expect(page.get_by_text("plan again from where it is")).to_be_visible()
    bent.control.set_joints(BENT)
    bent.control.add_object("on the arm", {"sphere": 0.1, "pose": [-0.2, -0.1, 0.3]})
    expect(page.get_by_test_id("plan-move")).to_be_disabled()
    expect(page.get_by_test_id("plan-move")).to_have_attribute("title", re.compile("press Plan first"))
    page.get_by_test_id("plan").click()
    expect(status).to_contain_text("the arm cannot start here")
    expect(status).to_contain_text("on the arm")


@pytest.mark.long
def test_arm_replans_around_new_obstacle(bent: Rig, open_page: OpenPage) -> None:
    page = plan_tab(open_page)
    type_target(page, BESIDE)
    page.get_by_test_id("plan").click()
    expect(page.get_by_test_id("plan-status")).to_contain_text("straight to the goal")
    bent.control.set_speed_slider(0.05)
    page.get_by_test_id("plan-move").click()
    eventually(lambda: any(bent.state("target_qd")) and dist(q(bent), BENT) > 0.03)
    bent.control.add_object("post", POST)
    expect(page.get_by_text("Planning another path")).to_be_visible()
    expect(page.get_by_test_id("plan-status")).to_contain_text("by RRTConnect")
    bent.control.set_speed_slider(1.0)
    eventually(lambda: tuple(map(degrees, q(bent))) == pytest.approx(BESIDE, abs=0.1))


@pytest.mark.long
def test_real_robot_uses_scene_file_and_needs_confirmation(bent: Rig, browser: Browser, tmp_path: Path) -> None:
    scene = tmp_path / "cell.yaml"
    scene.write_text("objects: {post: {cylinder: [0.03, 0.6], pose: [0.3, 0.3, 0.3]}}")
    options = ("--port", "6082", "--control-port", "0", "--scene", str(scene))
    with pendant(bent.host, *options):
        context = browser.new_context(viewport=VIEWPORT)
        context.add_init_script(SLOW_FRAMES)
        page = context.new_page()
        page.goto(f"http://{bent.host}:6082/move")
        page.get_by_test_id("target-plan").click()
        expect(page.get_by_test_id("plan-source")).to_contain_text("objects of cell.yaml")
        expect(page.get_by_test_id("plan-status")).to_contain_text("Drag the ball")
        eventually(lambda: drawn_scene(page)["objects"] == ["post"])
        drag(page, 30.0, 0.0)
        expect(page.get_by_test_id("plan-status")).to_contain_text("The target is free")
        page.get_by_test_id("plan").click()
        expect(page.get_by_test_id("plan-move")).to_be_enabled()
        page.get_by_test_id("plan-move").click()
        expect(page.get_by_test_id("confirm-move")).to_be_visible()
        assert q(bent) == pytest.approx(BENT, abs=1e-3)
        page.get_by_test_id("confirm-move").click()
        eventually(lambda: dist(q(bent), BENT) > 0.03)
        context.close()
