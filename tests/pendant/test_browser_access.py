"""Every screen is accessible with low vision, a screen reader or without a mouse, and fits on tablets and phones.

The screens and their views are found on the page, so new ones are tested without changes here.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from typing import Any

import pytest
from playwright.sync_api import Browser, Locator, Page, expect

from client.pendant.screens import SCREENS
from tests.browser import AXE, violations
from tests.pendant.conftest import SLOW_FRAMES, VIEWPORT, Rig, eventually

SIZES = {"laptop": (1366, 768), "landscape tablet": (1024, 768), "portrait tablet": (800, 1280), "phone": (390, 844)}
# Elements outside the window or in a box that is too small for them. Code may be wider.
CUT_OFF = """() => {
  const cut = [];
  const page = document.scrollingElement;
  if (page.scrollWidth > innerWidth) cut.push(`the page is ${page.scrollWidth} wide`);
  const parts = 'button, a[href], input, canvas, label, .q-tab, .q-slider, .q-field, .q-card, .live, .chip';
  for (const part of document.querySelectorAll(parts)) {
    if (!part.checkVisibility({ visibilityProperty: true, opacityProperty: true })) continue;
    if (part.closest('.program-text, .script-editor')) continue;
    const { left, right, top, bottom, width, height } = part.getBoundingClientRect();
    if (!width || !height) continue;
    const what = `${part.dataset.testid || part.className.toString().slice(0, 60)} ${part.textContent.slice(0, 30)}`;
    if (left < -1 || right > innerWidth + 1) cut.push(`${what}: ${Math.round(left)} to ${Math.round(right)}`);
    if (part.closest('.frame') && (top < -1 || bottom > innerHeight + 1)) cut.push(`${what}: above or below`);
    const hides = /hidden|clip/.test(getComputedStyle(part).overflowX + getComputedStyle(part).overflowY);
    const full = part.scrollWidth > part.clientWidth + 1 || part.scrollHeight > part.clientHeight + 1;
    if (part.type === 'number' && part.scrollWidth > part.clientWidth + 1) cut.push(`${what}: ${part.value} is cut`);
    if (part.textContent.trim() && full && (hides || part.matches('button'))) cut.push(`${what}: does not fit`);
  }
  for (const form of document.querySelectorAll('.target-grid'))
    if (form.scrollHeight > form.clientHeight + 1) cut.push(`${form.textContent}: the last rows are cut`);
  return cut;
}"""
POPUP = 'def tell():\n  popup("Parts are out", "Feeder", warning=True, blocking=True)\nend\n'
OUTLINE = """() => {
  const { tagName } = document.activeElement;
  const style = getComputedStyle(document.activeElement);
  const outlined = style.outlineStyle !== 'none' && parseFloat(style.outlineWidth) >= 2;
  const shown = outlined || /INPUT|TEXTAREA/.test(tagName); // the frames of fields get thicker
  return [document.activeElement.closest('[data-testid]')?.dataset.testid || tagName, shown || tagName === 'BODY'];
}"""


@pytest.fixture(scope="module", params=["cb3", pytest.param("e-series", marks=pytest.mark.long)])
def robot(request: pytest.FixtureRequest, tmp_path_factory: Any) -> Iterator[Rig]:
    with ExitStack() as opened:
        if request.param == "e-series":
            rig = opened.enter_context(closing(Rig("ur5e", tmp_path_factory.mktemp("programs"))))
            rig.reset()
        else:
            rig = request.getfixturevalue("shared_rig").clean()
        for _ in range(15):  # more than the list can show
            rig.control.inject_fault("delay", port="modbus", delay_s=0.01)
        rig.control.clear_faults()
        yield rig


@pytest.fixture(scope="module")
def page(robot: Rig, browser: Browser) -> Iterator[Page]:
    """The pendant of one robot, in the light theme for CB3 and in the dark theme for e-Series, with a touch screen."""
    dark = robot.control.describe()["model"] == "ur5e"
    context = browser.new_context(viewport=VIEWPORT, color_scheme="dark" if dark else "light", has_touch=True)
    with closing(context):
        context.add_init_script(SLOW_FRAMES)
        page = context.new_page()
        page.goto(f"{robot.url}/{SCREENS[0].name}")
        expect(page.locator(".robot-name")).to_contain_text("PolyScope")
        yield page


def views(page: Page) -> Iterator[str]:
    """Show every view of every screen in turn, including nested views; yields their names."""
    for screen in SCREENS:
        click(page.get_by_test_id(f"tab-{screen.name}"))
        page.wait_for_function(f"() => location.pathname === '/{screen.name}'")  # then it is built
        tabs = page.locator(".screen:visible .q-tab:visible")
        if not tabs.count():
            yield screen.name
        for index in range(tabs.count()):
            click(tabs.nth(index))
            expect(tabs.nth(index)).to_have_attribute("aria-selected", "true")
            yield f"{screen.name}, {tabs.nth(index).inner_text()}"


def click(element: Locator) -> None:
    """Click immediately: Playwright would wait for several frames, which are slow in this browser."""
    element.evaluate("element => element.click()")


def reload(page: Page, screen: str) -> None:
    page.goto(f"{page.url.rpartition('/')[0]}/{screen}")
    page.evaluate(f"() => {{ {AXE} }}")


@pytest.mark.long
def test_screens_are_accessible_and_not_cut_off(page: Page) -> None:
    reload(page, SCREENS[0].name)
    problems = list[str]()
    for view in views(page):
        problems += persistent_problems(f"{view}: ", lambda: violations(page, "html"))
        for name, (width, height) in SIZES.items():
            page.set_viewport_size({"width": width, "height": height})
            problems += persistent_problems(f"{view} on a {name}: ", lambda: page.evaluate(CUT_OFF))
        page.set_viewport_size(VIEWPORT)
    assert not problems, "\n".join(problems)


def persistent_problems(where: str, find: Callable[[], list[str]]) -> list[str]:
    """Problems that persist after the page has settled."""
    found = list[str]()

    def no_problems() -> bool:
        found[:] = find()
        return not found

    try:
        eventually(no_problems, within_s=10.0)
    except AssertionError:
        return [where + problem for problem in found]
    return []


@pytest.mark.long
def test_dialogues_and_messages_are_accessible(page: Page, robot: Rig) -> None:
    reload(page, "graph")
    click(page.get_by_test_id("choose-0"))
    expect(page.get_by_test_id("signal-search")).to_be_visible()
    problems = persistent_problems("signals: ", lambda: violations(page, ".q-dialog"))
    reload(page, "run")
    robot.control.send_script(POPUP)
    expect(page.get_by_test_id("dialogue-text")).to_have_text("Parts are out")
    problems += persistent_problems("popup: ", lambda: violations(page, ".q-dialog"))
    click(page.get_by_test_id("popup-ok"))
    expect(page.get_by_test_id("dialogue")).to_be_hidden()
    robot.control.protective_stop()
    expect(page.get_by_test_id("stop-cause")).to_be_visible()
    problems += persistent_problems("protective stop: ", lambda: violations(page, ".q-dialog"))
    robot.control.unlock_protective_stop()
    expect(page.get_by_test_id("stop-dialogue")).to_be_hidden()
    click(page.get_by_test_id("run-load"))
    expect(page.locator(".q-notification")).to_be_visible()
    problems += persistent_problems("message: ", lambda: violations(page, ".q-notification"))
    assert not problems, "\n".join(problems)


@pytest.mark.long
def test_every_tab_can_be_tapped_and_the_robot_is_named(page: Page, robot: Rig) -> None:
    try:
        for width, height in SIZES.values():
            page.set_viewport_size({"width": width, "height": height})
            for tab in page.locator(".tabs .q-tab:visible").all():
                tab.tap(trial=True)  # fails if something lies over it
    finally:
        page.set_viewport_size(VIEWPORT)
    assert robot.host in page.title()


@pytest.mark.long
def test_keyboard_focus_reaches_all_controls_and_is_visible(page: Page) -> None:
    reload(page, "move")
    expect(page.get_by_test_id("joints-move")).to_be_enabled()
    page.get_by_test_id("tab-move").focus()
    reached = list[str]()
    while not reached or reached[-1] != "BODY":
        page.keyboard.press("Tab")
        name, shown = page.evaluate(OUTLINE)
        assert shown, f"nothing shows that {name} has the focus"
        reached.append(name)
    expected = [*(f"axis-{axis}-plus" for axis in ("x", "y", "z", "rx", "ry", "rz")), "jog-speed", "freedrive"]
    expected += ["stop-moving", *(f"joint-{joint}-plus" for joint in range(6)), "joints-move"]
    assert [name for name in reached if name in expected] == expected
