"""The page of a trace in a browser: from a file, without a network."""

from pathlib import Path

import pytest
from journal_rig import Recorded
from playwright.sync_api import Page, expect, sync_playwright

from emulator.journal.trace import trace_of
from tests.browser import CHROMIUM, FLAGS, violations
from tests.conftest import IN_REAL_TIME
from urproto.trace.page import packed, write_page

pytestmark = [pytest.mark.timeout(300), pytest.mark.xdist_group(IN_REAL_TIME)]  # one browser at a time
TIMEOUT_S = 45.0  # long enough under load
PROGRAM = """def pick():
  textmsg("begin")
  set_standard_digital_out(3, True)
  movej([0.4, -1.4, 1.5, -1.7, -1.5, 0.3], a=3, v=2)
  q = get_actual_joint_positions()
  while True:
    q[0] = q[0] + STEP
    servoj(q)
  end
end
"""
LAPTOP = {"width": 1366, "height": 768}


def run_with(step: str, path: Path) -> str:
    run = Recorded("ur5e")
    run.robot.add_object("box", {"box": [0.1, 0.1, 0.1], "pose": [-0.4, -0.3, 0.05, 0, 0, 0.5]})
    run.robot.send_script(PROGRAM.replace("STEP", step))
    run.robot.step(1000)
    run.robot.move_object("box", [-0.4, -0.2, 0.05, 0, 0, 0])
    run.robot.step(1000)
    path.write_bytes(run.journal)
    trace, difference = trace_of(path)
    assert not difference
    return packed(trace)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """A run that ends in a protective stop, and a mended one over it."""
    folder = tmp_path_factory.mktemp("trace")
    page = folder / "run.html"
    write_page(page, "<run> & co", run_with("0.1", folder / "a"), run_with("0.002", folder / "b"))
    return page


@pytest.fixture(scope="module")
def browser():
    with sync_playwright() as running:
        browser = running.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def page(browser, file):
    """The page at its beginning, offline; it must load nothing else, and log no error."""
    context = browser.new_context(viewport=LAPTOP, offline=True)
    context.set_default_timeout(TIMEOUT_S * 1000)
    page = context.new_page()
    problems = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
    page.on("request", lambda request: problems.append(request.url) if not request.url.startswith("blob:") else None)
    opened(page, f"{file.as_uri()}")
    yield page
    context.close()
    assert set(problems) <= {file.as_uri()}


def opened(page: Page, url: str) -> None:
    page.goto(url)
    page.wait_for_selector("body[data-ready]")


def now(page):
    return page.evaluate("trace.now()")


def angles(page):
    """Of the first joint: as drawn, and as recorded at the cursor."""
    return page.evaluate(
        "() => [trace.arms()[0].joints[0].rotation.z, trace.run.columns.actual_q[0][trace.run.row(trace.now())]]"
    )


def lane(page, name):
    """Entries of a lane: time and text."""
    return page.evaluate(
        "name => trace.run.lanes.find(lane => lane.name === name).entries.map(({time, text}) => [time, text])", name
    )


def stop_time(page):
    return next(time for time, text in lane(page, "Safety mode") if text == "PROTECTIVE_STOP")


def wait_drawn(page):
    """Two frames: what was scheduled has been drawn."""
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


def test_the_arm_and_the_program_follow_the_cursor(page):
    assert page.title() == "<run> & co"
    drawn = []
    for time_s in (41.3, 41.8, 42.3):
        page.evaluate("time => trace.go(time)", time_s)
        expect(page.locator("#clock")).to_have_text(f"{time_s:.3f} s")
        wait_drawn(page)
        angle, recorded = angles(page)
        assert angle == pytest.approx(recorded)
        drawn.append(angle)
    assert len(set(drawn)) == 3
    expect(page.locator("#source [data-current]")).to_contain_text("movej")
    boxes = "() => trace.arms()[0].objects[0].mesh.position.y"
    assert page.evaluate(boxes) == pytest.approx(-0.3)
    page.keyboard.press("End")
    wait_drawn(page)
    assert page.evaluate(boxes) == pytest.approx(-0.2)


@pytest.mark.long
def test_keyboard(page):
    begin, end = page.evaluate("() => [trace.run.time(0), trace.run.time(trace.run.samples - 1)]")
    page.keyboard.press("ArrowRight")
    assert now(page) == pytest.approx(begin + 0.008)
    page.keyboard.press("End")
    assert now(page) == pytest.approx(end)
    page.keyboard.press("ArrowLeft")
    assert now(page) == pytest.approx(end - 0.008)
    page.keyboard.press("Home")
    assert now(page) == pytest.approx(begin)
    events = sorted({time for name in ("Faults", "Outputs") for time, _ in lane(page, name)})
    seen = []
    for _ in range(30):
        page.keyboard.press("]")
        seen.append(now(page))
    assert {round(time, 4) for time in events} <= {round(time, 4) for time in seen}
    page.keyboard.press("[")
    assert now(page) < seen[-1]
    page.keyboard.press("+")
    left, right = page.evaluate("() => [trace.view().left, trace.view().right]")
    assert right - left == pytest.approx((end - begin) / 2)
    page.keyboard.press("0")
    assert page.evaluate("() => trace.view().right - trace.view().left") == pytest.approx(end - begin)
    page.keyboard.press("Home")
    page.keyboard.press("Space")
    page.wait_for_function("begin => trace.now() > begin + 0.05", arg=begin)
    page.keyboard.press("Space")
    expect(page.locator("#play")).to_have_attribute("aria-pressed", "false")


def test_search_in_log_program_and_messages(page):
    page.locator("#search").fill("DO3")
    expect(page.locator("#found")).to_have_text("1 events")
    page.locator("#events button").click()
    assert now(page) == pytest.approx(lane(page, "Outputs")[0][0])
    page.locator("#search").fill("textmsg")
    expect(page.locator("#found")).to_contain_text("1 lines of programs")
    page.locator("#search").fill("send_script")
    page.locator("#events button").click()
    expect(page.locator("#detail")).to_contain_text("servoj")
    page.locator("#search").fill("C150")
    page.locator("#events button").click()
    assert now(page) == pytest.approx(stop_time(page), abs=0.01)


def test_a_link_to_a_moment(page, file):
    page.evaluate("trace.go(42.4)")
    page.wait_for_url("**/run.html#t=42.400")
    opened(page, f"{file.as_uri()}#t=43.120")
    expect(page.locator("#clock")).to_have_text("43.120 s")
    page.evaluate("location.hash = '#t=42'")
    expect(page.locator("#clock")).to_have_text("42.000 s")


@pytest.mark.long
def test_two_runs_are_compared(page):
    difference = page.evaluate("trace.difference()")
    movej_ends_s = next(time for time, text in lane(page, "Program line") if "servoj" in text)
    assert movej_ends_s <= difference["time"] < stop_time(page)
    expect(page.locator("#difference")).to_contain_text(f"first difference at {difference['time']:.3f} s, Base:")
    page.locator("#there").click()
    assert now(page) == pytest.approx(difference["time"])
    page.evaluate("trace.go(100)")
    wait_drawn(page)
    first, second = page.evaluate("() => trace.arms().map(({joints}) => joints[0].rotation.z)")
    assert abs(first - second) > 0.1
    page.locator("#shift").fill("0.5")
    expect(page.locator("#difference")).not_to_contain_text(f"at {difference['time']:.3f} s")


@pytest.mark.long
def test_zoom_and_pan_with_the_pointer(page):
    box = page.locator("#lanes").bounding_box()
    page.mouse.click(box["x"] + box["width"] * 0.6, box["y"] + 30)
    assert 42.0 < now(page) < 44.0
    page.mouse.wheel(0, -500)
    page.wait_for_function("() => trace.view().right - trace.view().left < 3.5")
    left = page.evaluate("trace.view().left")
    page.mouse.wheel(200, 0)
    page.wait_for_function("left => trace.view().left > left", arg=left)


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.long)])
def test_accessible_and_not_cut_off(page, scheme):
    page.emulate_media(color_scheme=scheme)
    page.reload()
    page.wait_for_selector("body[data-ready]")
    page.get_by_label("TCP force").check()
    page.evaluate("trace.go(43)")
    assert not violations(page, "html")
    for width in (1366, 390):
        page.set_viewport_size({"width": width, "height": 768})
        assert page.evaluate("() => document.scrollingElement.scrollWidth <= innerWidth")
