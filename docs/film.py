"""Takes docs/images/first_minutes.webp: a robot is started, jogged and led around a post, in a browser.

python docs/film.py        # wants Chromium, and the extras pendant, plan and test

The robot runs at a fraction of real time, so that a slow machine has time for every picture; each is shown for as long
as the robot's time says.
"""

import io
import shutil
import sys
import tempfile
from pathlib import Path
from time import sleep

from PIL import Image
from playwright.sync_api import Locator, Page, sync_playwright
from screenshots import FLAGS, GOAL_DEG, IMAGES, POST, SIZE, START, TABLE, pendant

from urtesting.process import EmulatorProcess

FILE = IMAGES / "first_minutes.webp"
SHOWN = (960, 600)
PACE = 0.15  # of real time
QUALITY = 55
SHORTEST_MS, LONGEST_MS = 60, 700  # that a picture is shown
LAST_MS = 2500
POINTER = """
addEventListener("DOMContentLoaded", () => {
  const dot = document.createElement("div");
  Object.assign(dot.style, {position: "fixed", width: "22px", height: "22px", margin: "-11px 0 0 -11px", zIndex: 99999,
    borderRadius: "50%", background: "rgba(240, 140, 0, .55)", border: "2px solid white", pointerEvents: "none"});
  document.body.append(dot);
  addEventListener("mousemove", (e) => Object.assign(dot.style, {left: e.clientX + "px", top: e.clientY + "px"}), true);
  addEventListener("mousedown", () => { dot.style.background = "rgba(240, 90, 0, .95)"; }, true);
  addEventListener("mouseup", () => { dot.style.background = "rgba(240, 140, 0, .55)"; }, true);
});
"""


class Film:
    """Pictures of a page, each with how long it is shown."""

    def __init__(self, page: Page, robot: EmulatorProcess) -> None:
        self._page, self._robot = page, robot
        self._pictures: list[Image.Image] = []
        self._shown_ms: list[int] = []
        self._at_s: float | None = None

    def take(self) -> None:
        """The page as it is now."""
        now_s = self._robot.state()["timestamp"]
        if self._at_s is not None:
            passed_ms = round(1000.0 * (now_s - self._at_s))
            self._shown_ms.append(min(LONGEST_MS, max(SHORTEST_MS, passed_ms)))
        self._at_s = now_s
        picture = Image.open(io.BytesIO(self._page.screenshot()))
        self._pictures.append(picture.convert("RGB").resize(SHOWN, Image.Resampling.LANCZOS))

    def until(self, done: Locator, most: int = 150) -> None:
        """Pictures until something is on the page."""
        for _ in range(most):
            self.take()
            if done.count():
                return
        raise RuntimeError(f"the film waits for {done}")

    def rest(self, pictures: int) -> None:
        """So many more."""
        for _ in range(pictures):
            self.take()

    def point(self, at: Locator) -> None:
        """The pointer goes there, seen."""
        box = at.bounding_box()
        assert box is not None
        self._page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2, steps=4)
        self.take()

    def click(self, at: Locator) -> None:
        """Point there and press."""
        self.point(at)
        self._page.mouse.down()
        self.take()
        self._page.mouse.up()
        self.take()

    def write(self, file: Path) -> None:
        """As an animated WebP that begins again for ever."""
        first, *others = self._pictures
        durations = [*self._shown_ms, LAST_MS]
        first.save(file, save_all=True, append_images=others, duration=durations, loop=0, quality=QUALITY, method=6)
        sys.stdout.write(f"{file}: {len(durations)} pictures, {sum(durations) / 1000:.0f} s, ")
        sys.stdout.write(f"{file.stat().st_size // 1000} kB\n")


def play(page: Page, film: Film) -> None:
    """What is seen."""
    film.rest(2)
    film.click(page.get_by_test_id("brake-release"))
    film.until(page.locator("[data-testid=robot-lamp][data-state=ready]"))
    film.click(page.get_by_test_id("tab-move"))
    page.locator("canvas").wait_for()
    sleep(3)
    film.rest(2)
    film.point(page.get_by_test_id("joint-0-plus"))
    page.mouse.down()
    film.rest(12)
    page.mouse.up()
    film.rest(3)
    for i, angle in enumerate(GOAL_DEG):
        page.get_by_test_id(f"target-joint-{i}").fill(f"{angle:.1f}")
        film.take()
    film.click(page.get_by_test_id("target-plan"))
    page.wait_for_function("() => pendant.handle?.()")
    film.rest(1)
    film.click(page.get_by_test_id("plan"))
    film.until(page.locator(".plan-status[data-state=good]"))
    film.click(page.get_by_test_id("plan-move"))
    film.until(page.get_by_test_id("activity").filter(visible=True))
    film.until(page.get_by_test_id("activity").filter(visible=False))


def main() -> None:
    """Start everything, and look."""
    with (
        tempfile.TemporaryDirectory() as folder,
        EmulatorProcess(["--model", "ur5e", "--speed", f"{PACE}"]) as robot,
        pendant(robot, folder) as url,
        sync_playwright() as playwright,
    ):
        robot.set_joints(START)
        robot.add_object("table", TABLE)
        robot.add_object("post", POST)
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        page = browser.new_page(viewport=SIZE, color_scheme="light")
        page.set_default_timeout(120_000)
        page.add_init_script(POINTER)
        page.goto(f"{url}/initialize")
        page.wait_for_timeout(3000)
        film = Film(page, robot)
        play(page, film)
        film.write(FILE)
        browser.close()


if __name__ == "__main__":
    main()
