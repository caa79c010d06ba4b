"""The page of a comparison of two files: of programs, with the path of the tool of each in 3D.

The client does not import the language and the emulator: a program is run by the command ``urscript run``, in virtual
time and without a network.
"""

import subprocess
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

from client.errors import ClientError, FileError
from client.programs import all_problems, controller, open_lines, open_program
from client.recording.trace import arm_of
from urproto.compat import module_command
from urproto.durable import write_file
from urproto.robots import RobotModel, choose_version
from urproto.robots.pose import Pose, pose_inv, pose_trans
from urproto.text import from_bytes, readable, to_bytes
from urproto.trace.model import Trace, TraceError
from urproto.trace.page import library, packed, run_in, write_page
from urscript.polyscope.comparing import Change, change_page, change_table
from urscript.polyscope.document import DocumentError
from urscript.polyscope.editing import ProgramEditor
from urscript.polyscope.numbers import six, taught_pose
from urscript.polyscope.tree import TreeError, tag_of

_LIMITS: Final = ("--timeout", "60", "--script-network", "none")  # robot time [s]; guess: most cycles are shorter
_PATIENCE_S: Final = 120.0  # such a run usually takes ten seconds; guess: more than that is a loop that only computes
_RESULT: Final = "result  "


class _Taught(NamedTuple):
    """A waypoint: joint angles [rad], and the poses of TCP and flange in the base frame."""

    joints: Pose
    tcp: Pose
    flange: Pose


def write_difference_page(page: Path, before: Path, after: Path, changes: Sequence[Change], model: str | None) -> None:
    """Write the page. model: the arm; None to recognise it by the waypoints. Raises FileError, ClientError."""
    title, table = f"{before} and {after}", change_table(changes)
    try:
        if open_lines(after).kind == "program":
            _write_with_paths(page, title, table, [_Side(path, model) for path in (before, after)])
        else:
            write_file(page, to_bytes(change_page(title, table)))
    except OSError as error:
        raise FileError(page, error.strerror or str(error)) from None


class _Side:
    """One of the two programs."""

    def __init__(self, path: Path, model: str | None) -> None:
        self.path = path
        self._editor = open_program(path, model)
        self._taught = list(_taught(self._editor))
        self._arm = _arm(self._editor, self._taught, model)

    @property
    def waypoints(self) -> list[list[float]]:
        """Positions of the TCP [m]."""
        return [list(point.tcp[:3]) for point in self._taught]

    def script(self) -> bytes:
        """URScript of one cycle. Raises ClientError."""
        for line in self._editor.tree.lines:
            if tag_of(line.element) == "MainProgram":
                line.element.attributes["runOnlyOnce"] = "true"
        try:
            return to_bytes(self._editor.written().text())
        except (TreeError, DocumentError) as error:
            raise self._not_run(str(error)) from None

    def run(self, script: bytes) -> tuple[str, str]:
        """A packed run, from the first waypoint on, and what it does not show, "" if nothing. Raises ClientError."""
        begin = ["--joints", *(f"{angle:.6f}" for angle in self._taught[0].joints)] if self._taught else []
        with TemporaryDirectory() as folder:
            page = Path(folder, "page.html")
            options = ["--model", self._arm.name, "--polyscope", str(self._editor.version), "--page", str(page)]
            command = [*module_command("urscript"), "run", *options, *_LIMITS, *begin, "--", "-"]
            try:
                done = subprocess.run(command, input=script, capture_output=True, timeout=_PATIENCE_S)
            except subprocess.TimeoutExpired:
                raise self._not_run(f"the first minute of it takes longer than {_PATIENCE_S:g} s to compute") from None
            except OSError as error:
                raise self._not_run(f"urscript run: {error.strerror or error}") from None
            if not page.exists():
                usage = readable(from_bytes(done.stderr)).splitlines()
                reasons = usage[-1:] or [problem.message for problem in all_problems(self._editor)]
                raise self._not_run(reasons[0] if reasons else "urscript run wrote no page")
            run = run_in(page)
        if done.returncode:
            result = readable(from_bytes(done.stdout)).splitlines()[-1].removeprefix(_RESULT)
            return run, f"{self.path}: the run is not complete: {result}"
        controlled = self._editor.tree.needs_external_control
        return run, f"{self.path}: its External Control nodes do nothing here" if controlled else ""

    def along_waypoints(self) -> str:
        """A packed run that is at another waypoint each second, "" without waypoints."""
        if not self._taught:
            return ""
        trace = Trace(self.path.name, self._arm.title, self._arm)
        for second, point in enumerate([*self._taught, self._taught[-1]]):
            trace.add(float(second), {"actual_q": point.joints, "actual_TCP_pose": point.tcp})
        return packed(trace)

    def _not_run(self, reason: str) -> ClientError:
        return ClientError(f"{self.path} cannot be run here: {reason}")


def _taught(editor: ProgramEditor) -> Iterator[_Taught]:
    """The fixed waypoints that are not suppressed, in the order of the tree."""
    for line in editor.tree.lines:
        position = line.element.child("position")
        if tag_of(line.element) != "Waypoint" or line.suppressed or position is None:
            continue
        try:
            joints, tcp = taught_pose(position)
            offset = position.child("TCPOffset")
            flange = pose_trans(tcp, pose_inv(six(offset.get("pose")))) if offset is not None else tcp
        except DocumentError:
            continue  # the translation reports it
        if line.element.get("type") in ("", "Fixed"):
            yield _Taught(joints, tcp, flange)


def _arm(editor: ProgramEditor, taught: Sequence[_Taught], model: str | None) -> RobotModel:
    """The chosen arm, or the one with which the waypoints were taught, if it exists in the program's version."""
    chosen, _ = controller(model, str(editor.version))
    found = None if model else arm_of([point.joints for point in taught], [point.flange for point in taught])
    try:
        return found if found is not None and choose_version(str(editor.version), found) else chosen
    except ValueError:
        return chosen


def _runs(sides: Sequence[_Side]) -> tuple[list[str], list[str]]:
    """The runs of both programs, and remarks. If one cannot be run, both are shown by their waypoints."""
    try:
        scripts = [side.script() for side in sides]
        with ThreadPoolExecutor(len(sides)) as threads:
            runs = list(threads.map(_Side.run, sides, scripts))
    except ClientError as error:
        return [side.along_waypoints() for side in sides], [f"{error}; the paths lead from waypoint to waypoint"]
    return [run for run, _ in runs], [remark for _, remark in runs if remark]


def _write_with_paths(page: Path, title: str, table: str, sides: Sequence[_Side]) -> None:
    remarks: list[str] = []
    try:
        library()  # before the runs, which take a while
        runs, remarks = _runs(sides)
        shown = [(side, run) for side, run in zip(sides, runs, strict=True) if run]
        if not shown:
            raise TraceError("there are no taught waypoints")
        above = (
            '<details open><summary>Changes</summary><div id="changes" tabindex="0" role="region" aria-label="Changes">'
            f"{_paragraphs(remarks)}{table}</div></details>"
        )
        details = [{"title": str(side.path), "waypoints": side.waypoints} for side, _ in shown]
        write_page(page, title, *(run for _, run in shown), above=above, details=details)
    except TraceError as error:
        write_file(page, to_bytes(change_page(title, _paragraphs([*remarks, f"No paths in 3D: {error}"]) + table)))


def _paragraphs(lines: Sequence[str]) -> str:
    return "".join(f"<p>{escape(readable(line))}</p>\n" for line in lines)
