"""Program, in a browser: programs are created, saved, played, edited by two users, and preserved."""

import asyncio
import base64
import gzip
import json
import os
import re
import signal
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from math import degrees, dist
from pathlib import Path
from threading import Event

import pytest
from playwright.sync_api import Browser, Locator, Page, expect

from client.driver import TrajectoryResult, URDriver, points
from client.rtde import BlockingRTDEClient
from tests.pendant.conftest import SLOW_FRAMES, VIEWPORT, Rig, eventually
from tests.pendant.pendants import pendant
from urproto.modes import RuntimeState

OpenPage = Callable[[str], Page]
ABOVE = (0.3, -1.3, 1.4, -1.7, -1.57, 0.3)
DOWN = (0.3, -1.2, 1.5, -1.9, -1.57, 0.3)
BIN = (-0.3, -1.2, 1.2, -1.6, -1.57, 0.0)
HOME = (0.0, -1.2, 1.2, -1.6, -1.57, 0.0)
FIELDS = ("timestamp", "actual_q", "actual_digital_output_bits", "runtime_state")
SCRIPT = f"""def by_hand():
  movej({list(ABOVE)}, a=1.4, v=1.05)
  movel({list(DOWN)}, a=1.2, v=0.25)
  set_standard_digital_out(2, True)
  sleep(0.3)
  movel({list(ABOVE)}, a=1.2, v=0.25)
  movej({list(BIN)}, a=1.4, v=1.05)
  set_standard_digital_out(2, False)
end
"""


def row(page: Page, text: str) -> Locator:
    return page.locator(".program-row", has=page.locator(".program-row-text", has_text=re.compile(f"^{text}"))).last


def selected(page: Page) -> str:
    """The id of the selected node."""
    chosen = page.locator(".program-row[aria-selected=true]")
    expect(chosen).to_have_count(1)
    return chosen.get_attribute("data-node") or ""


def insert(page: Page, kind: str, shown: str) -> None:
    """Insert a node from the palette, and wait until it is selected and its fields are shown."""
    before = selected(page)
    page.get_by_test_id(f"insert-{kind}").click()
    new = page.locator(f'.program-row[aria-selected=true]:not([data-node="{before}"])')
    expect(new.locator(".program-row-text")).to_have_text(re.compile(f"^{shown}"))
    expect_fields(page, shown)


def select(page: Page, shown: str) -> None:
    row(page, shown).locator(".program-row-text").click()
    expect(row(page, shown)).to_have_attribute("aria-selected", "true")
    expect_fields(page, shown)


def expect_fields(page: Page, shown: str) -> None:
    """Wait for the fields of the selected node: for a moment, the form still shows the previous ones."""
    expect(page.get_by_test_id("form-title")).to_contain_text(re.compile(f"^{shown}", re.IGNORECASE))
    expect(page.locator(f'.program-fields[data-node="{selected(page)}"]')).to_have_count(1)


def fill(page: Page, key: str, value: str) -> None:
    box = page.get_by_test_id(f"field-{key}")
    box.fill(value)
    box.press("Enter")


def choose(page: Page, key: str, title: str) -> None:
    page.get_by_test_id(f"field-{key}").click()
    page.get_by_role("option", name=title, exact=True).click()


def close_program(page: Page, test_id: str) -> None:
    """Press a button that replaces the program, and confirm if it has unsaved changes."""
    title = page.get_by_test_id("program-title")
    expect(title).to_have_attribute("data-state", re.compile("changed|saved"))
    changed = title.get_attribute("data-state") == "changed"
    page.get_by_test_id(test_id).click()
    if changed:
        page.get_by_test_id("agree").click()


def new_program(page: Page) -> None:
    close_program(page, "program-new")
    title = page.get_by_test_id("program-title")
    expect(title).to_have_attribute("data-state", "saved")
    expect(title).to_have_text("unnamed")
    expect(page.locator(".program-row-text")).to_have_text(["Variables Setup", "Robot Program", "<empty>"])


def save_as(page: Page, name: str) -> None:
    page.get_by_test_id("program-save-as").click()
    page.get_by_test_id("program-name").fill(name)
    page.get_by_test_id("program-save-confirm").click()
    expect(page.get_by_test_id("program-title")).to_have_text(f"{name}.urp")


def drive(host: str, goal: tuple[float, ...], listening: Event, arrived: Event) -> TrajectoryResult:
    """A driver that waits until its External Control node is played, moves the arm, and stays until that ends."""

    async def run() -> TrajectoryResult:
        async with URDriver(host, headless=False, own_address=host) as driver:
            listening.set()
            await driver.wait_for_program(60.0)
            result = await driver.execute([points.movej(goal)])
            arrived.set()
            while driver.program_running:  # a program that loops requests its code again
                await driver.next_state()
            return result

    return asyncio.run(run())


def external_control_program(page: Page, rig: Rig) -> None:
    """Create a program with an External Control node, set its host, save and play it: a driver moves the arm."""
    goal, listening, arrived = (0.2, -1.4, 1.5, -1.7, -1.5, 0.1), Event(), Event()
    with ThreadPoolExecutor(1) as pool:  # Playwright uses the event loop of this thread
        driver = pool.submit(drive, rig.host, goal, listening, arrived)
        assert listening.wait(30.0)
        new_program(page)
        select(page, "Robot Program")
        insert(page, "external_control", "Control by")
        page.get_by_test_id("tab-installation").click()
        page.get_by_test_id("driver-host").fill(rig.host)
        page.get_by_test_id("driver-port").fill("50002")
        page.get_by_test_id("driver-save").click()
        eventually(lambda: rig.control.external_control() == {"host": rig.host, "port": 50002})
        page.get_by_test_id("tab-program").click()
        save_as(page, "external_control")
        assert (rig.programs / "external_control.urp").is_file()
        page.get_by_test_id("program-play").click()
        expect(row(page, "Control by")).to_have_class(re.compile("is-running"))
        eventually(lambda: rig.state("actual_q") == pytest.approx(goal, abs=1e-3))
        assert arrived.wait(30.0)  # the control program reports the result a moment after the arm is there
        page.get_by_test_id("stop").click()
        assert driver.result(60.0) is TrajectoryResult.SUCCESS


@pytest.mark.long
def test_external_control_program_is_created_and_played(rig: Rig, open_page: OpenPage) -> None:
    external_control_program(open_page("program"), rig)


def insert_waypoint(page: Page, rig: Rig, name: str, q: tuple[float, ...]) -> None:
    """Move the arm and teach the waypoint that was inserted last."""
    select(page, "Waypoint_1")
    rig.control.set_joints(q)
    eventually(lambda: teach_and_check(page, q))  # once the pendant has received the position
    fill(page, "name", name)
    expect(row(page, name)).not_to_have_class(re.compile("is-undefined"))


def teach_and_check(page: Page, q: tuple[float, ...]) -> bool:
    """Teach the selected waypoint; returns whether it has these joint angles."""
    page.get_by_test_id("teach-position").click()
    position = page.get_by_test_id("field-position")
    expect(position).to_contain_text("Joints")
    page.wait_for_timeout(100)
    shown = [float(number) for number in re.findall(r"-?[\d.]+", position.inner_text())]
    return shown == pytest.approx([degrees(angle) for angle in q], abs=0.1)


def add_move(page: Page, rig: Rig, motion: str, name: str, q: tuple[float, ...]) -> None:
    """Append a Move with a waypoint to the program."""
    select(page, "Robot Program")
    insert(page, "move", "MoveJ")
    if motion != "MoveJ":
        choose(page, "motion", motion)
        expect(row(page, motion)).to_be_visible()
    insert_waypoint(page, rig, name, q)


def add_output(page: Page, level: str) -> None:
    """Append a Set of digital output 2 to the program."""
    select(page, "Robot Program")
    insert(page, "set", "Set")
    choose(page, "type", "A digital output")
    choose(page, "output", "digital_out[2]")
    choose(page, "level", level)


def pick_and_place(page: Page, other: Page, rig: Rig) -> None:
    """Create a pick-and-place program in two browsers."""
    new_program(page)
    select(page, "Robot Program")
    page.get_by_test_id("field-loops").click()
    add_move(page, rig, "MoveJ", "Above", ABOVE)
    expect(row(other, "Above")).to_be_visible()  # and continue there
    add_move(other, rig, "MoveL", "Down", DOWN)
    add_output(other, "On")
    select(page, "Robot Program")
    insert(page, "wait", "Wait")
    choose(page, "type", "A time")
    fill(page, "time", "0.3")
    add_move(page, rig, "MoveL", "Back", ABOVE)
    add_move(page, rig, "MoveJ", "Bin", BIN)
    add_output(page, "Off")


def record_run(rig: Rig, start: Callable[[], object]) -> tuple[list[tuple[float, ...]], float]:
    """Joint angles and output 2 during a run, and its duration [s]."""
    rig.control.set_joints(HOME)
    positions, times_s = list[tuple[float, ...]](), list[float]()
    with BlockingRTDEClient(rig.host, FIELDS) as watcher:
        start()
        eventually(lambda: watcher.latest()["runtime_state"] == RuntimeState.PLAYING)
        while (state := watcher.receive())["runtime_state"] == RuntimeState.PLAYING:
            positions.append((*state["actual_q"], float(state["actual_digital_output_bits"] >> 2 & 1)))
            times_s.append(state["timestamp"])
    return positions, times_s[-1] - times_s[0]


@pytest.mark.long
def test_two_users_create_pick_and_place_equivalent_to_script(rig: Rig, open_page: OpenPage) -> None:
    page, other = open_page("program"), open_page("program")
    pick_and_place(page, other, rig)
    names = "Variables, Robot, MoveJ, Above, MoveL, Down, Set, Wait, MoveL, Back, MoveJ, Bin, Set"
    for shown in (page, other):
        expect(shown.locator(".program-row-text")).to_have_text([re.compile(f"^{name}") for name in names.split(", ")])
    save_as(page, "pick")
    script = (rig.programs / "pick.script").read_text()
    assert "set_standard_digital_out(2,True)" in script.replace(" ", "")
    expect(other.get_by_test_id("program-title")).to_have_text("pick.urp")
    new_program(other)
    close_program(other, "program-open")
    other.get_by_test_id("program-choice").get_by_text("pick.urp").click()
    expect(page.get_by_test_id("program-title")).to_have_text("pick.urp")
    rig.control.set_speed(2.0)
    from_tree, from_tree_s = record_run(rig, page.get_by_test_id("program-play").click)
    from_script, from_script_s = record_run(rig, lambda: rig.control.send_script(SCRIPT))
    for path, other_path in ((from_tree, from_script), (from_script, from_tree)):
        assert max(min(dist(place, other_place) for other_place in other_path) for place in path[::10]) < 0.05
    assert from_tree_s == pytest.approx(from_script_s, rel=0.1)
    # undo is shared, selections are not
    select(page, "Wait")
    select(other, "Bin")
    page.keyboard.press("Escape")
    page.get_by_test_id("program-delete").click()
    expect(row(other, "Wait")).to_have_count(0)
    expect(row(other, "Bin")).to_have_attribute("aria-selected", "true")
    other.get_by_test_id("program-undo").click()
    expect(row(page, "Wait")).to_be_visible()


@pytest.mark.long
def test_keyboard_editing_stepping_and_playing_from_selection(rig: Rig, open_page: OpenPage) -> None:
    page = open_page("program")
    new_program(page)
    select(page, "Robot Program")
    for text in ("one", "two", "three"):
        insert(page, "comment", "Comment")
        fill(page, "comment", text)
        expect(row(page, f"'{text}'")).to_be_visible()
    insert(page, "wait", "Wait")
    choose(page, "type", "An expression")
    expect(row(page, "Wait")).to_have_class(re.compile("is-undefined"))
    choose(page, "type", "A time")
    fill(page, "time", "x")
    expect(page.get_by_text("must be a number in s, not 'x'")).to_be_visible()
    fill(page, "time", "60")
    expect(page.locator(".program-row.is-undefined")).to_have_count(0)
    # typed content is committed when another node is selected without Enter
    select(page, "'one'")
    page.get_by_test_id("field-comment").fill("once")
    select(page, "'two'")
    expect(page.get_by_test_id("field-comment")).to_have_value("two")
    expect(row(page, "'once'")).to_be_visible()
    select(page, "Wait")
    page.get_by_test_id("field-time").fill("y")
    select(page, "'two'")
    expect(page.get_by_text("must be a number in s, not 'y'")).to_be_visible()
    # keys
    select(page, "'once'")
    page.keyboard.press("ArrowDown")
    expect(row(page, "'two'")).to_be_focused()
    page.keyboard.press("Alt+ArrowUp")
    shown = page.locator(".program-row-text")
    expect(shown).to_have_text(["Variables Setup", "Robot Program", "'two'", "'once'", "'three'", re.compile("Wait")])
    page.keyboard.press("Control+z")
    expect(shown.nth(2)).to_have_text("'once'")
    page.keyboard.press("Control+e")
    expect(row(page, "'two'")).to_have_class(re.compile("is-suppressed"))
    page.keyboard.press("Control+e")
    expect(row(page, "'two'")).not_to_have_class(re.compile("is-suppressed"))
    page.keyboard.press("F9")
    expect(row(page, "'two'")).to_have_class(re.compile("is-breakpoint"))
    # played
    save_as(page, "steps")
    running = page.locator(".program-row.is-running .program-row-text")
    page.get_by_test_id("program-play").click()
    expect(running).to_have_text("'two'")
    expect(page.get_by_test_id("program-state")).to_have_text("Paused")
    page.get_by_test_id("program-step").click()
    expect(running).to_have_text("'three'")
    page.get_by_test_id("program-play").click()
    expect(running).to_have_text(re.compile("Wait"))
    page.get_by_test_id("stop").click()
    expect(running).to_have_count(0)
    select(page, "'three'")
    page.get_by_test_id("program-play-from").click()
    expect(running).to_have_text(re.compile("Wait"))
    assert rig.control.variables()["_hidden_play_from_selection"] == "False"
    page.get_by_test_id("stop").click()
    select(page, "Variables Setup")
    page.get_by_test_id("program-play-from").click()
    expect(page.get_by_text("not part of the robot program")).to_be_visible()


def is_saved(folder: Path, text: bytes) -> bool:
    """Whether a draft in the folder of a pendant contains a text."""
    drafts = [json.loads(file.read_text())["urp"] for file in folder.glob("*.json")]
    return any(text in gzip.decompress(base64.b64decode(urp)) for urp in drafts)


@pytest.mark.long
def test_draft_survives_killed_pendant(rig: Rig, browser: Browser, tmp_path: Path) -> None:
    options = ("--port", "6081", "--modbus-port", str(rig.robot.ports["modbus"]), "--drafts", str(tmp_path))
    context = browser.new_context(viewport=VIEWPORT)
    context.add_init_script(SLOW_FRAMES)
    page = context.new_page()
    with pendant(rig.host, *options) as process:
        page.goto(f"http://{rig.host}:6081/program")
        expect(page.locator(".program-row")).to_have_count(3)
        insert(page, "comment", "Comment")
        fill(page, "comment", "half done")
        expect(row(page, "'half done'")).to_be_visible()
        eventually(lambda: is_saved(tmp_path, b"half done"))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    page.close()
    with pendant(rig.host, *options):
        page = context.new_page()
        page.goto(f"http://{rig.host}:6081/program")
        expect(row(page, "'half done'")).to_be_visible()
        expect(page.get_by_test_id("program-title")).to_have_attribute("data-state", "changed")
    context.close()


@pytest.mark.long
def test_e_series_program_survives_restart_of_emulator_and_pendant(tmp_path: Path, browser: Browser) -> None:
    """The same on a UR5e; then both are killed and restarted, and saved and unsaved changes are preserved."""
    rig = Rig("ur5e", tmp_path)
    context = browser.new_context(viewport=VIEWPORT)
    context.add_init_script(SLOW_FRAMES)
    try:
        page = context.new_page()
        page.goto(f"{rig.url}/program")
        expect(page.locator(".robot-name")).to_contain_text("UR5e")
        external_control_program(page, rig)
        insert(page, "comment", "Comment")
        fill(page, "comment", "half done")
        expect(row(page, "'half done'")).to_be_visible()
        eventually(lambda: is_saved(tmp_path / "drafts", b"half done"))
        page.close()
        rig.robot.kill()
        os.kill(rig.pendant_pid, signal.SIGKILL)
        rig.robot.start()
        with pendant(rig.host, "--drafts", str(tmp_path / "drafts")):
            page = context.new_page()
            page.goto(f"{rig.url}/program")
            expect(row(page, "'half done'")).to_be_visible()
            close_program(page, "program-open")
            page.get_by_test_id("program-choice").get_by_text("external_control.urp").click()
            expect(row(page, "'half done'")).to_have_count(0)
            expect(row(page, "Control by")).to_be_visible()
    finally:
        context.close()
        rig.close()


@pytest.mark.long
def test_simulation_moves_drawn_arm_only(rig, open_page):
    text = "def far():\n  movej([0.4, -1.2, 1.0, -1.4, -1.5, 0.2], a=3, v=2)\nend\n"
    (rig.programs / "far.script").write_text(text)
    page = open_page("move")
    before = rig.state("actual_q")
    add_output = page.get_by_test_id("simulation-switch")
    expect(add_output).to_have_text("Real robot (emulated)")
    add_output.click()
    expect(add_output).to_have_attribute("aria-pressed", "true")
    expect(add_output).to_have_text("Simulation")
    rig.control.dashboard("load far.script")
    rig.control.dashboard("play")
    expect(page.get_by_test_id("angle-0")).to_contain_text("22.9")  # 0.4 rad
    assert rig.control.simulation() == {"on": True, "real_q_rad": before}
    add_output.click()
    expect(add_output).to_have_text("Real robot (emulated)")
    eventually(lambda: rig.state("actual_q") == before)
