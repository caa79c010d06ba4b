"""PolyScope's files under git: readable differences, by git itself."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from editing_rig import E_SERIES, HOME, ZERO, editor, id_of
from tree_rig import Arm
from typer.testing import CliRunner

from client.commands.git import git_app
from client.commands.program import program_app
from client.errors import URError
from emulator.commands.requests import ScriptUnit
from urproto.modes import RuntimeState
from urproto.robots import kinematics_of, load_model
from urproto.versions import PolyscopeVersion
from urscript.polyscope.comparing import differences
from urscript.polyscope.document import link, packed, read_document, write_document
from urscript.polyscope.editing import ROOT, ProgramEditor
from urscript.polyscope.files import save_program
from urscript.polyscope.installation_settings import change_setting, new_installation
from urscript.polyscope.lines import read_lines

REPOSITORY = Path(__file__).resolve().parents[2]


class Repository:
    """A git repository that does not read this user's configuration. errors: of the last command."""

    errors = ""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self("init", "-b", "main")
        self("config", "user.name", "Someone")
        self("config", "user.email", "someone@example.com")

    def __call__(self, *arguments: str, status: int = 0) -> str:
        nobody = {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_SYSTEM": os.devnull, "GIT_EDITOR": "true"}
        done = subprocess.run(
            ["git", *arguments],
            cwd=self.folder,
            env={**os.environ, **nobody, "PYTHONPATH": str(REPOSITORY)},
            capture_output=True,
            encoding="utf-8",
        )
        assert done.returncode == status, done.stdout + done.stderr
        self.errors = done.stderr
        return done.stdout

    def save(self, name: str, contents: bytes, message: str = "") -> None:
        (self.folder / name).write_bytes(contents)
        if message:
            self("add", "-A")
            self("commit", "-m", message)


@pytest.fixture
def repository(tmp_path, monkeypatch):
    repository = Repository(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert "4 lines added" in CliRunner().invoke(git_app, ["install"]).output
    return repository


def file_of(edited: ProgramEditor) -> bytes:
    return packed(edited.document())


def program() -> ProgramEditor:
    """A program with a loop, waits, and a taught waypoint."""
    made = editor(E_SERIES)
    waypoint = made.insert("waypoint", into=ROOT)
    made.teach(waypoint, HOME, kinematics_of(made.program.model).forward(HOME), ZERO)
    loop = made.insert("loop", into=ROOT, values={"type": "Counting", "count": 2})
    for time in (0.1, 0.2, 0.3, 0.4):
        made.insert("wait", into=loop, values={"type": "Sleep", "time": time})
    return made


def test_git_shows_what_changed_by_node(repository):
    made = program()
    repository.save("p.urp", file_of(made), "Begin")
    root = new_installation(E_SERIES, "default")
    repository.save("default.installation", packed(write_document(root)), "Installation")
    waypoint = id_of(made, "waypoint")
    joints = (0.1, *HOME[1:])
    made.teach(waypoint, joints, kinematics_of(load_model("ur5e")).forward(joints), ZERO)
    repository.save("p.urp", file_of(made))
    change_setting(root, "tcps", "TCP", {"pose": [0.0, 0.0, 0.15, 0.0, 0.0, 0.0]})
    repository.save("default.installation", packed(write_document(root)))
    changed = [line for line in repository("diff", "-U0").splitlines() if line[:1] in "+-" and line[:3] not in "+++---"]
    assert len(changed) == 4, changed
    assert "Position and rotation: [0, 0, 150, 0, 0, 0] mm" in changed[1]
    assert "Waypoint_1 | Type: Fixed position | Position: [5.730, -85.944, 85.944," in changed[3]
    repository("commit", "-am", "Teach")
    repository.save("p.urp", b"\x1f\x8bnothing", "Break it")
    assert "(not readable: " in repository("log", "-p", "-1")
    assert CliRunner().invoke(git_app, ["uninstall"]).output.endswith("4 lines removed\n")
    assert "Binary files" in repository("diff", "HEAD~1", "HEAD", "--", "p.urp")
    assert "polyscope" not in repository("config", "--local", "--list")


def test_git_merges_rebases_and_bisects(repository):
    """Two branches change different nodes; then the same, which is a conflict with a file that can be opened."""
    made = program()
    repository.save("p.urp", file_of(made), "Begin")
    waits = [row.id for row in made.rows() if row.kind == "wait"]

    def branch(name: str, start: str, *edits: tuple[str, float]) -> None:
        repository("checkout", "-b", name, start)
        for wait, time in edits:
            made.set(wait, "time", time)
            repository.save("p.urp", file_of(made), f"{wait} waits {time}")
        for _ in edits:
            made.undo()

    def times() -> list[float]:
        data = (repository.folder / "p.urp").read_bytes()
        return [line.values["Time"] for _, line in read_lines(data).walk() if line.kind == "Wait"]

    branch("left", "main", (waits[0], 5.0))
    branch("right", "main", (waits[2], 6.0), (waits[3], 7.0))
    repository("merge", "left", "-m", "Merge")
    assert times() == ["5.0 s", "0.2 s", "6.0 s", "7.0 s"]
    assert not repository("log", "--merges", "-p", "--format=%s").splitlines()[1:]
    branch("other", "main", (waits[1], 8.0))
    branch("again", "main", (waits[2], 9.0))
    repository("rebase", "other")
    assert times() == ["0.1 s", "8.0 s", "9.0 s", "0.4 s"]
    repository("bisect", "start", "again", "main")
    run = f"{shlex.quote(sys.executable)} -m client git show p.urp | grep -q 'Wait: 0.2'"
    assert "waits 8.0" in repository("bisect", "run", "sh", "-c", run)
    repository("bisect", "reset")
    repository("merge", "right", status=1)
    shown = times()
    assert shown == ["5.0 s", "8.0 s", "9.0 s", "6.0 s", "7.0 s"], shown
    assert "MERGE CONFLICT" in (repository("diff", "HEAD", "--", "p.urp"))
    assert "p.urp" in repository("diff", "--name-only", "--diff-filter=U")
    repository("merge", "--abort")
    repository("checkout", "-b", "broken", "left")
    repository.save("p.urp", b"\x1f\x8bnothing", "Break it")
    repository("merge", "right", status=1)
    assert (repository.folder / "p.urp").read_bytes() == b"\x1f\x8bnothing"


def test_a_merged_program_that_only_together_cannot_be_run_is_a_conflict(repository):
    """Ours deletes the assignment of a variable that theirs uses in a new node: no value was changed by both."""
    made = editor(E_SERIES)
    assignment = made.insert("assignment", into=ROOT, values={"variable": "count", "expression": "1"})
    wait = made.insert("wait", into=ROOT, values={"type": "Sleep", "time": 0.5})
    repository.save("p.urp", file_of(made), "Begin")
    repository("checkout", "-b", "theirs")
    made.insert("script", after=wait, values={"line": "textmsg(count)"})
    repository.save("p.urp", file_of(made), "Use it")
    made.undo()
    repository("checkout", "main")
    made.delete(assignment)
    repository.save("p.urp", file_of(made), "Delete it")
    repository("merge", "theirs", status=1)
    problem = "only the merged program cannot be run: variable 'count' is not defined"
    assert f"p.urp: textmsg(count): {problem}\n" in repository.errors
    assert any(
        "textmsg(count)" in line.text for _, line in read_lines((repository.folder / "p.urp").read_bytes()).walk()
    )
    repository("merge", "--abort")
    made.insert("assignment", before=wait, values={"variable": "count", "expression": "2"})
    repository.save("p.urp", file_of(made), "Assign it elsewhere")
    repository("merge", "theirs", "-m", "Merge")


def test_nodes_of_unknown_types_are_named_and_shown_with_their_settings():
    """Palletizing, Seek and others have no public files with scripts: their settings are shown as they are stored."""
    tag = b"gui.program.some.GridSearchNode"
    node = b"""<TAG name="Grid_1" rows="3"><corner><JointAngles angles="0.0, -1.5707963, 0, 0, 0, 0"/>
        <offset pose="0, 0, 0.1, 0, 0, 0" angles="some"/></corner><children>""".replace(b"TAG", tag)
    written = write_document(link(read_document(file_of(program()))))
    data = written.replace(b"<Wait ", node + b"<Wait ", 1).replace(b"</Wait>", b"</Wait></children></" + tag + b">", 1)
    depths = {line.text: depth for depth, line in read_lines(data).walk()}
    shown = (
        "Grid search Grid_1 | rows: 3 | corner.JointAngles.angles: [0.000, -90.000, 0.000, 0.000, 0.000, 0.000] ° | "
        "corner.offset.pose: [0.000, 0.000, 100.000] mm, rotation [0.00000, 0.00000, 0.00000] | "
        "corner.offset.angles: some"
    )
    assert depths[shown] + 1 == depths["Wait: 0.1 | Wait for: A time | Time: 0.1 s"]
    [change] = differences(read_lines(data), read_lines(data.replace(b'rows="3"', b'rows="4"')))
    assert (change.how, change.values) == ("changed", {"rows": ("3", "4")})


def test_diff_lists_added_removed_moved_and_changed_nodes(tmp_path):
    made = program()
    (tmp_path / "a.urp").write_bytes(file_of(made))
    loop, first = id_of(made, "loop"), id_of(made, "wait")
    waits = [row.id for row in made.rows() if row.kind == "wait"]
    made.set(first, "time", 9)
    made.delete(waits[1])
    made.move(waits[3], before=loop)
    made.insert("comment", into=loop, values={"comment": "new"})
    (tmp_path / "b.urp").write_bytes(file_of(made))
    arguments = ["diff", str(tmp_path / "a.urp"), str(tmp_path / "b.urp")]
    assert CliRunner().invoke(program_app, arguments).output.splitlines() == [
        "moved: Robot Program > Wait: 0.4",
        "removed: Robot Program > Loop 2 times > Wait: 0.2 | Wait for: A time | Time: 0.2 s",
        "changed: Robot Program > Loop 2 times > Wait: 9.0",
        "  title: Wait: 0.1 -> Wait: 9.0",
        "  Time: 0.1 s -> 9.0 s",
        "added: Robot Program > Loop 2 times > Comment 'new'",
    ]
    found = json.loads(CliRunner().invoke(program_app, [*arguments, "--json"]).output)
    assert [change["how"] for change in found] == ["moved", "removed", "changed", "added"]
    assert found[2]["values"]["Time"] == ["0.1 s", "9.0 s"]
    (tmp_path / "c.installation").write_bytes(write_document(new_installation(E_SERIES)))
    with pytest.raises(URError, match="compare equal kinds"):
        raise CliRunner().invoke(program_app, ["diff", arguments[1], str(tmp_path / "c.installation")]).exception


def test_check_finds_a_script_of_another_state(tmp_path):
    """Speeds, times and positions count, also those of the installation; how numbers are written does not."""
    path = tmp_path / "p.urp"
    made = program()
    save_program(made, path)

    def check(*options: str) -> tuple[int, str]:
        done = CliRunner().invoke(program_app, ["check", str(path), *options])
        return done.exit_code, done.output

    assert check() == (0, f"{path}: no problems found for PolyScope {E_SERIES}\n")
    script = path.with_suffix(".script")
    written = script.read_text()
    script.write_text(written.replace("sleep(0.1)", "sleep( 0.1000 )").replace("  $ ", "  step_count_1=2\n  $ "))
    assert check()[0] == 0
    made.set(id_of(made, "wait"), "time", 7)
    joints = (0.1, *HOME[1:])
    made.teach(id_of(made, "waypoint"), joints, kinematics_of(load_model("ur5e")).forward(joints), ZERO)
    path.write_bytes(file_of(made))
    status, output = check()
    what = "the saved script is from another state: it has"
    assert status == 1
    assert [line.removeprefix(f"{path}").split(": ", 1)[0] for line in output.splitlines()] == ["", "", ":6"]
    assert output.splitlines()[2] == f"{path}:6: Wait: 7.0: {what} sleep(0.1), not sleep(7)"
    assert f"{what} Waypoint_1_q=[0,-1.5," in output
    status, output = check("--format", "sarif")
    results = json.loads(output)["runs"][0]["results"]
    assert (status, [result["ruleId"] for result in results]) == (1, ["URS108"] * 2)  # one for a line
    assert results[1]["locations"][0]["physicalLocation"]["region"]["startLine"] == 6
    assert "title=URS108 stale-script" in check("--format", "github")[1]


def test_convert_says_what_goes_to_polyscope_x_by_node(tmp_path):
    """Waits as nodes, motions as URScript, nodes of URCaps not; the script runs on an arm with that version."""
    path, script = tmp_path / "p.urp", tmp_path / "x.script"
    made = program()
    made.set(id_of(made, "robot_program"), "loops", False)
    suppressed = made.insert("comment", into=ROOT, values={"comment": "no"})
    made.suppress(suppressed)
    path.write_bytes(file_of(made))
    done = CliRunner().invoke(program_app, ["convert", str(path), "-o", str(script)])
    assert done.exit_code == 0, done.output
    assert [" ".join(line.split()) for line in done.output.splitlines()] == [
        "script Variables Setup",
        "node Robot Program (ur-code)",
        "script MoveJ",
        "script Waypoint_1",
        "script Loop 2 times",
        *(f"node Wait: {time} (ur-wait)" for time in (0.1, 0.2, 0.3, 0.4)),
        "nothing 'no' (suppressed)",
    ]
    arm = Arm(tmp_path, version=PolyscopeVersion(10, 12))
    arm.controller.post(ScriptUnit(script.read_text(), "block"))
    arm.until(lambda: arm.state is RuntimeState.PLAYING)
    arm.until(lambda: arm.state is RuntimeState.STOPPED)
    made.insert("external_control", into=ROOT)
    path.write_bytes(file_of(made))
    done = CliRunner().invoke(program_app, ["convert", str(path), "--json"])
    assert done.exit_code == 1
    assert "URCapX" in json.loads(done.output)[-1]["note"]
    with pytest.raises(URError, match="not PolyScope X"):
        raise CliRunner().invoke(program_app, ["convert", str(path), "--polyscope", "5.22"]).exception
