"""The page of a comparison of two programs in a browser: their changes, and the paths of their tools."""

import math
from pathlib import Path

import pytest
from editing_rig import E_SERIES, HOME, ZERO, id_of
from playwright.sync_api import expect, sync_playwright
from typer.testing import CliRunner

from client.commands.program import program_app
from tests.browser import CHROMIUM, FLAGS, violations
from tests.conftest import IN_REAL_TIME
from urproto.robots import kinematics_of, load_model
from urproto.trace.model import TraceError
from urscript.polyscope.document import packed
from urscript.polyscope.editing import ROOT, ProgramEditor
from urscript.polyscope.files import new_program
from urscript.polyscope.installation_file import InstallationFile

pytestmark = [pytest.mark.timeout(300), pytest.mark.xdist_group(IN_REAL_TIME)]  # one browser at a time
ARM = load_model("ur10e")


def program() -> ProgramEditor:
    """Two waypoints of a UR10e; it repeats without an end."""
    made = ProgramEditor(new_program("made", E_SERIES, ARM), "made", InstallationFile("default"), E_SERIES, ARM)
    for base_rad in (0.0, 0.4):
        teach(made, made.insert("waypoint", into=ROOT), base_rad)
    return made


def teach(made: ProgramEditor, waypoint: str, base_rad: float) -> list[float]:
    """Teach it; returns the position of the TCP."""
    joints = (base_rad, *HOME[1:])
    pose = kinematics_of(ARM).forward(joints)
    made.teach(waypoint, joints, pose, ZERO)
    return list(pose[:3])


def page_of(before: ProgramEditor, after: ProgramEditor, folder: Path) -> Path:
    files, page = [folder / "before.urp", folder / "after.urp"], folder / "page.html"
    for file, made in zip(files, (before, after), strict=True):
        file.write_bytes(packed(made.document()))
    done = CliRunner().invoke(program_app, ["diff", *map(str, files), "--html", str(page)])
    assert (done.exit_code, done.output) == (0, "")
    return page


def test_the_page_has_the_paths_of_both_programs(tmp_path):
    """As they are run or, if one cannot be run, from waypoint to waypoint."""
    runs, waypoints = tmp_path / "runs", tmp_path / "waypoints"
    before, after = program(), program()
    moved = teach(after, id_of(after, "waypoint"), -0.3)
    runs.mkdir()
    pages = [page_of(before, after, runs)]
    waypoints.mkdir()
    after.insert("waypoint", into=ROOT)
    pages.append(page_of(before, after, waypoints))
    with sync_playwright() as running:
        browser = running.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_context(viewport={"width": 1366, "height": 768}, offline=True).new_page()
        problems: list[str] = []
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
        for file, about, lanes in zip(pages, ("UR10e, PolyScope", "UR10e: 0.000 s to 2"), (True, False), strict=True):
            page.goto(file.as_uri())
            page.wait_for_selector("body[data-ready]")
            expect(page.locator("#changes ins").first).to_contain_text("-17.189")
            assert page.locator("#changes p").all_text_contents() == [
                f"{waypoints / 'after.urp'} cannot be run here: after: the waypoint Waypoint_3 was never taught; "
                "the paths lead from waypoint to waypoint"
            ] * (not lanes)
            expect(page.locator("#about")).to_contain_text(about)
            expect(page.locator("#key")).to_have_text(f"{file.parent / 'before.urp'} {file.parent / 'after.urp'} ")
            colors = page.evaluate("() => [...document.querySelectorAll('#key i')].map((i) => i.style.background)")
            assert len(set(colors)) == 2
            assert page.evaluate("trace.run.lanes.length > 0") is lanes
            marks = page.evaluate("trace.arms().map((arm) => arm.waypoints.map(({ position }) => position.toArray()))")
            assert marks[1][0] == pytest.approx(moved)
            assert marks[0][0] != pytest.approx(moved)
            paths = page.evaluate(
                "[trace.run, trace.other].map(({ columns }) => columns.actual_TCP_pose.slice(0, 3).map((c) => [...c]))"
            )
            for path, points in zip(paths, marks, strict=True):
                rows = list(zip(*path, strict=True))
                assert rows[0] == pytest.approx(points[0], abs=1e-4)  # it begins there, and is at the others later
                assert all(min(math.dist(row, point) for row in rows) < 1e-4 for point in points)
            expect(page.locator("#difference")).to_contain_text("first difference")
            assert not violations(page, "html")
        browser.close()
        assert not problems


def test_a_page_without_3d(tmp_path, monkeypatch):
    """Without its library or any waypoint, the page has the changes, and says why it has no paths."""

    def missing() -> bytes:
        raise TraceError("nothing draws it")

    empty = ProgramEditor(new_program("made", E_SERIES, ARM), "made", InstallationFile("default"), E_SERIES, ARM)
    unready = ProgramEditor(new_program("made", E_SERIES, ARM), "made", InstallationFile("default"), E_SERIES, ARM)
    unready.insert("waypoint", into=ROOT)
    unready.insert("comment", into=ROOT, values={"comment": "<b>"})
    shown = page_of(empty, unready, tmp_path).read_text("utf-8")
    assert "was never taught" in shown
    assert "<p>No paths in 3D: there are no taught waypoints</p>" in shown
    monkeypatch.setattr("client.difference_page.library", missing)
    shown = page_of(empty, unready, tmp_path).read_text("utf-8")
    assert "<p>No paths in 3D: nothing draws it</p>" in shown
    assert '<tr class="added"><td>added<td>Robot Program' in shown
    assert "Comment &#x27;&lt;b&gt;&#x27;" in shown
