"""Takes the pictures of docs/pendant.md, docs/teaching.md and docs/journal.md: a browser looks at every screen, at a
class page and at traces.

python docs/screenshots.py        # wants Chromium, and the extras pendant and test
"""

import re
import shutil
import socket
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ipaddress import ip_address
from pathlib import Path
from subprocess import PIPE, Popen
from typing import Any

from playwright.sync_api import Browser, Page, sync_playwright

from client.pendant.program_draft import ProgramDraft
from client.pendant.saved import ProgramFile, SavedDraft
from emulator.journal.file import MemorySink
from emulator.journal.recorder import record
from emulator.journal.trace import trace_of
from emulator.virtual import virtual_robot
from urproto.robots import kinematics_of, load_model
from urproto.testing.process import EmulatorProcess
from urproto.trace.page import packed, write_page

IMAGES = Path(__file__).with_name("images")
SIZE = {"width": 1280, "height": 800}
FLAGS = ["--no-sandbox", "--disable-background-networking", "--use-gl=angle", "--use-angle=swiftshader"]
DARK = ("graph", "simulation")
SETTLE_MS = 2500
CLASS_HOST = "127.0.0.31"
START = (0.6, -1.3, 1.4, -1.7, -1.57, 0.3)
TABLE = {"box": [0.8, 0.5, 0.04], "pose": [0.0, -0.55, -0.02, 0.0, 0.0, 0.0]}
POST = {"box": [0.08, 0.08, 0.6], "pose": [-0.24, -0.62, 0.3, 0.0, 0.0, 0.6]}
GOAL_DEG = (115.0, -74.0, 80.0, -97.0, -90.0, 17.0)  # the post is between
PROGRAM = """def pick_and_place():
  picks = 0
  above = [0.6, -1.3, 1.4, -1.7, -1.57, 0.3]
  bin = [-0.6, -1.2, 1.2, -1.6, -1.57, 0.0]
  while True:
    movej(above, a=1.2, v=0.6)
    set_standard_digital_out(2, True)
    picks = picks + 1
    movej(bin, a=1.2, v=0.6)
    set_standard_digital_out(2, False)
    textmsg("picked ", picks)
  end
end
"""


def main() -> None:
    """Start everything, look at every screen."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "pick_and_place.script").write_text(PROGRAM)
        with EmulatorProcess(["--model", "ur5e", "--running", "--programs", folder]) as robot:
            robot.dashboard("load pick_and_place.script")
            robot.dashboard("play")
            robot.add_object("table", TABLE)
            _make_program(Path(folder), robot)
            with pendant(robot, folder) as url, sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)

                def look(screen: str, name: str = "", act: Callable[[Page], object] = lambda page: None) -> None:
                    scheme: Any = "dark" if screen in DARK else "light"
                    _look(browser.new_page(viewport=SIZE, color_scheme=scheme), url, screen, name or screen, act)

                for screen in (
                    "graph",
                    "initialize",
                    "run",
                    "program",
                    "move",
                    "io",
                    "log",
                    "installation",
                    "simulation",
                ):
                    look(screen)
                robot.dashboard("stop")
                robot.set_joints(START)
                robot.add_object("post", POST)
                look("move", "plan", plan)
                with _manager(robot):
                    look("controllers", act=lambda page: page.get_by_test_id("sliders-enable").click())
                class_page(browser)
                traces(browser, Path(folder))
                browser.close()


def _make_program(folder: Path, robot: EmulatorProcess) -> None:
    """The program that the pendant finds on its machine, as if somebody had made it there before."""
    file = ProgramFile(folder, f"{robot.host}_{robot.ports['primary']}")
    draft = ProgramDraft(file, print, lambda: None, lambda: (None, load_model("ur5e")))
    above, pick = (0.6, -1.3, 1.4, -1.7, -1.57, 0.3), (0.6, -1.2, 1.5, -1.9, -1.57, 0.3)
    place = (-0.6, -1.2, 1.2, -1.6, -1.57, 0.0)
    for motion, name, q in (("MoveJ", "Above", above), ("MoveL", "Pick", pick)):
        move = draft.insert("move", draft.view.first())
        draft.set(move, "motion", motion)
        _teach(draft, name, q)
    grip = draft.insert("set", draft.view.first())
    for key, value in (("type", "DigitalOutput"), ("output", "digital_out[2]"), ("level", "1")):
        draft.set(grip, key, value)
    wait = draft.insert("wait", draft.view.first())
    draft.set(wait, "type", "Sleep")
    draft.set(wait, "time", 0.5)
    draft.insert("move", draft.view.first())
    _teach(draft, "Place", place)
    draft.insert("waypoint", draft.view.rows()[-1].id)
    file.write(SavedDraft("pick_and_place.urp", False, draft.data()))


def _teach(draft: ProgramDraft, name: str, q: tuple[float, ...]) -> None:
    """The waypoint at the end."""
    node = draft.view.rows()[-1].id
    draft.set(node, "name", name)
    pose = kinematics_of(load_model("ur5e")).forward(q)
    draft.teach(node, "position", q, pose, (0.0,) * 6)


def plan(page: Page) -> None:
    """A path around the post, to a target that is typed."""
    for i, angle in enumerate(GOAL_DEG):
        page.get_by_test_id(f"target-joint-{i}").fill(f"{angle:.1f}")
    page.get_by_test_id("target-plan").click()
    page.wait_for_function("() => pendant.handle?.()")
    page.get_by_test_id("plan").click()
    page.locator(".plan-status[data-state=good]").wait_for()


def _look(page: Page, url: str, screen: str, name: str, act: Callable[[Page], object]) -> None:
    page.goto(f"{url}/{screen}")
    page.wait_for_timeout(SETTLE_MS * (4 if screen == "graph" else 1))
    act(page)
    page.wait_for_timeout(SETTLE_MS)
    target = IMAGES / f"pendant_{name}.png"
    page.screenshot(path=target)
    sys.stdout.write(f"{target}: {target.stat().st_size // 1000} kB\n")
    page.close()


def class_page(browser: Browser) -> None:
    """The page of a class of six, as its teacher sees it; two arms move."""
    words = ["--model", "ur3", "--count", "6", "--first-host", CLASS_HOST, "--running", "--class-port", "6070"]
    command = [sys.executable, "-u", "-m", "emulator", "fleet", *words, "--teacher-password", "t"]
    with Popen(command, stdout=PIPE, text=True) as fleet:
        assert fleet.stdout is not None
        while not fleet.stdout.readline().startswith("Ready"):
            pass
        for number in (2, 5):
            with socket.create_connection((str(ip_address(CLASS_HOST) + number), 30001)) as robot:
                robot.sendall(PROGRAM.encode())
        page = browser.new_page(viewport=SIZE)
        page.goto(f"http://{CLASS_HOST}:6070")
        page.get_by_label("Password").fill("t")
        page.get_by_role("button", name="Enter").click()
        for number, name in enumerate(("Ada", "Bo", "Chen"), 1):
            page.get_by_test_id(f"robot-{number}").get_by_label("Name").fill(name)
            page.keyboard.press("Enter")
        page.wait_for_timeout(SETTLE_MS)
        page.screenshot(path=IMAGES / "class_page.png")
        page.close()
        fleet.terminate()


def traces(browser: Browser, folder: Path) -> None:
    """The case of docs/journal.md: its program, and the mended one over it."""
    found = re.search(r"```urscript\n(.*?)```", Path(__file__).with_name("journal.md").read_text(), re.DOTALL)
    assert found is not None
    runs = []
    for name, program in (("run", found[1]), ("mended", found[1].replace("+ 0.05", "+ 0.05 * get_steptime()"))):
        robot = virtual_robot("ur5e", running=True)
        recorder = record(robot, MemorySink())
        robot.send_script(program)
        robot.step(2500)
        journal = folder / f"{name}.journal"
        journal.write_bytes(recorder.journal)
        runs.append(packed(trace_of(journal)[0]))
    for name, shown in (("trace", runs[:1]), ("trace_compared", runs)):
        write_page(folder / "page.html", "run.journal", *shown)
        page = browser.new_page(viewport={"width": 1366, "height": 768})
        page.goto((folder / "page.html").as_uri())
        page.wait_for_selector("body[data-ready]")
        page.get_by_label("Search").fill("C150")
        page.locator("#events button").click()
        page.get_by_label("Search").fill("")
        page.wait_for_timeout(SETTLE_MS)
        page.screenshot(path=IMAGES / f"{name}.png")
        page.close()


@contextmanager
def pendant(robot: EmulatorProcess, folder: str) -> Iterator[str]:
    """The address of a pendant for the robot, which keeps its files in the folder."""
    words = ["--robot-ip", robot.host, "--host", robot.host, "--modbus-port", str(robot.ports["modbus"])]
    words += ["--poses", f"{folder}/poses.json", "--tools", f"{folder}/tools.json", "--drafts", folder, "--with-parent"]
    process = Popen([sys.executable, "-u", "-m", "client", "pendant", *words], stdin=PIPE, stdout=PIPE, text=True)
    assert process.stdout is not None
    assert process.stdin is not None
    process.stdout.readline()
    yield f"http://{robot.host}:6080"
    process.stdin.close()
    process.wait()


@contextmanager
def _manager(robot: EmulatorProcess) -> Iterator[None]:
    """A controller manager that is running for the robot."""
    words = [sys.executable, "-u", "-m", "client", "controllers", "serve", "--robot-ip", robot.host]
    with Popen(words, stderr=PIPE, text=True) as process:
        assert process.stderr is not None
        next(line for line in process.stderr if line.startswith("ready:"))
        yield
        process.terminate()


if __name__ == "__main__":
    main()
