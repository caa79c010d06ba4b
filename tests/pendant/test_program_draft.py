"""The program draft: edits of several users, its views, and its persistence."""

import asyncio
from pathlib import Path

import pytest

from client.pendant.program_draft import ProgramDraft
from client.pendant.program_view import palette
from client.pendant.saved import ProgramFile, SavedDraft
from urproto.compat_asyncio import timeout
from urproto.robots import load_model
from urproto.versions import PolyscopeVersion
from urscript.polyscope.document import read_document
from urscript.polyscope.registry import kinds

CB3 = (PolyscopeVersion(3, 15, 8), load_model("ur3"))
E_SERIES = (PolyscopeVersion(5, 11, 0), load_model("ur5e"))
Q = (0.3, -1.3, 1.4, -1.7, -1.57, 0.3)
POSE = (0.2, -0.3, 0.25, 0.0, 3.1, 0.0)
NO_TCP = (0.0,) * 6


def create_draft(
    folder: Path | None = None, robot: tuple[PolyscopeVersion, object] = CB3
) -> tuple[ProgramDraft, list[str]]:
    errors = list[str]()
    draft = ProgramDraft(ProgramFile(folder, "robot"), errors.append, lambda: None, lambda: robot)  # type: ignore[arg-type, return-value]
    return draft, errors


@pytest.fixture(params=[CB3, E_SERIES], ids=["CB3", "e-Series"])
def draft(request: pytest.FixtureRequest) -> ProgramDraft:
    return create_draft(robot=request.param)[0]


def titles(draft: ProgramDraft) -> list[str]:
    return [row.title for row in draft.view.rows()]


def test_nodes_are_inserted_near_selection(draft: ProgramDraft) -> None:
    folder = draft.insert("folder", draft.view.first())
    comment = draft.insert("comment", folder)
    wait = draft.insert("wait", comment)
    draft.insert("waypoint", wait)  # gets a Move around it
    draft.insert("thread", wait)  # next to the robot program
    assert [(row.kind, row.depth) for row in draft.view.rows()] == [
        ("variables_setup", 0),
        ("robot_program", 0),
        ("folder", 1),
        ("comment", 2),
        ("wait", 2),
        ("move", 2),
        ("waypoint", 3),
        ("thread", 0),
        ("empty", 1),
    ]
    with pytest.raises(ValueError, match="must follow an If"):
        draft.insert("else", wait)


def test_node_is_dropped_before_after_or_into_another(draft: ProgramDraft) -> None:
    first = draft.insert("comment", draft.view.first())
    folder = draft.insert("folder", first)
    wait = draft.insert("wait", draft.view.rows()[1].id)

    def kinds_shown() -> list[tuple[str, int]]:
        return [(row.kind, row.depth) for row in draft.view.rows()[2:] if row.kind != "empty"]

    draft.drop(wait, first, "before")
    assert kinds_shown() == [("wait", 1), ("comment", 1), ("folder", 1)]
    draft.drop(wait, folder, "onto")
    assert kinds_shown() == [("comment", 1), ("folder", 1), ("wait", 2)]
    draft.drop(folder, first, "onto")  # a comment has no children
    assert kinds_shown() == [("comment", 1), ("folder", 1), ("wait", 2)]
    draft.drop(first, wait, "after")
    assert kinds_shown() == [("folder", 1), ("wait", 2), ("comment", 2)]
    with pytest.raises(ValueError, match="cannot be moved into or next to itself"):
        draft.drop(folder, wait, "after")
    draft.undo()
    assert kinds_shown() == [("comment", 1), ("folder", 1), ("wait", 2)]
    draft.delete(wait)
    with pytest.raises(ValueError, match="no longer in the program"):
        draft.drop(wait, first, "before")


def test_deleted_node_is_reported_and_restored_by_undo(draft: ProgramDraft) -> None:
    node = draft.insert("comment", draft.view.first())
    draft.set(node, "comment", "mine")
    draft.delete(node)
    with pytest.raises(ValueError, match="no longer in the program"):
        draft.set(node, "comment", "yours")
    with pytest.raises(ValueError, match="no longer in the program"):
        draft.view.number(node)
    draft.undo()
    assert draft.view.text(node) == "'mine'"
    draft.redo()
    assert not draft.view.has(node)


def test_nodes_are_moved_within_and_out_of_parent(draft: ProgramDraft) -> None:
    folder = draft.insert("folder", draft.view.first())
    first = draft.insert("halt", folder)
    second = draft.insert("comment", first)
    order = [(row.kind, row.depth) for row in draft.view.rows()][2:]
    assert order == [("folder", 1), ("halt", 2), ("comment", 2)]
    draft.move_by(second, -1)
    assert [row.kind for row in draft.view.rows()][3:] == ["comment", "halt"]
    draft.move_by(second, -1)
    assert [(row.kind, row.depth) for row in draft.view.rows()][2:] == [("comment", 1), ("folder", 1), ("halt", 2)]
    assert draft.view.neighbour(second) == folder
    assert draft.view.neighbour(first) == folder


def test_rows_have_marks_and_problems(draft: ProgramDraft) -> None:
    node = draft.insert("waypoint", draft.view.first())
    marks = {row[0]: row[5] for row in draft.view.shown_rows()}
    assert marks[node] == marks[draft.view.first()] == "undefined"
    assert draft.view.problem(node)
    assert any("teach it" in problem for problem in draft.view.problems())
    draft.teach(node, "position", Q, POSE, NO_TCP)
    assert draft.view.problems() == []
    draft.suppress(node)
    draft.toggle_breakpoint(node)
    assert {row[0]: row[5] for row in draft.view.shown_rows()}[node].split()[-2:] == ["suppressed", "breakpoint"]
    draft.suppress(node)
    draft.toggle_breakpoint(node)
    assert {row[0]: row[5] for row in draft.view.shown_rows()}[node] == ""


def test_taught_waypoint_has_position_of_arm(draft: ProgramDraft) -> None:
    node = draft.insert("waypoint", draft.view.first())
    assert draft.view.waypoints() == ()
    draft.teach(node, "position", Q, POSE, NO_TCP)
    assert draft.view.joints(node, "position") == pytest.approx(Q)
    ((node_id, position),) = draft.view.waypoints()
    assert node_id == node
    assert len(position) == 3


def test_every_kind_in_palette_has_a_form(draft: ProgramDraft) -> None:
    entries = [entry for group in palette(draft.editor.version).values() for entry in group]
    assert {entry.name for entry in entries} == {entry["key"] for entry in draft.editor.palette()}
    for entry in entries:
        assert entry.title == kinds()[entry.name].title
        assert entry.icon
        try:
            node = draft.insert(entry.name, draft.view.first())
        except ValueError:
            continue  # it can only be inserted into certain nodes
        assert draft.view.form(node) or not kinds()[entry.name].fields
        draft.undo()


def test_copies_are_pasted_into_same_and_new_program(draft: ProgramDraft) -> None:
    node = draft.insert("comment", draft.view.first())
    draft.set(node, "comment", "again")
    draft.copy(node)
    draft.paste(node)
    draft.new()
    draft.paste(draft.view.first())
    assert titles(draft)[-1] == "'again'"
    other, _ = create_draft()
    with pytest.raises(ValueError, match="copy a node first"):
        other.paste(other.view.first())


def test_saving_and_opening_reset_changed(draft: ProgramDraft) -> None:
    draft.insert("halt", draft.view.first())
    assert draft.changed
    version, files = draft.version, draft.files("job")
    assert sorted(files) == ["job.script", "job.txt", "job.urp"]
    assert read_document(files["job.urp"] or b"").attributes["name"] == "job"
    draft.mark_saved("cell/job.urp", version)
    assert (draft.title, draft.changed) == ("cell/job.urp", False)
    version = draft.version
    draft.insert("halt", draft.view.first())  # while it was being saved
    draft.mark_saved("cell/job.urp", version)
    assert draft.changed
    draft.open(files["job.urp"] or b"", "cell/job.urp")
    assert not draft.changed
    assert titles(draft)[-1] == "Halt"
    with pytest.raises(ValueError, match=r"bad.urp cannot be opened"):
        draft.open(b"<a/>", "bad.urp")


async def test_every_change_is_saved_within_a_second(tmp_path: Path) -> None:
    draft, errors = create_draft(tmp_path)
    saving = asyncio.create_task(draft.keep_saving())
    draft.insert("halt", draft.view.first())
    async with timeout(1.0):
        while not (tmp_path / "robot.json").exists():
            await asyncio.sleep(0.01)
    saving.cancel()
    restored, _ = create_draft(tmp_path)
    assert titles(restored)[-1] == "Halt"
    assert (restored.changed, restored.path, errors) == (True, "", [])


def test_invalid_saved_draft_is_moved_aside_and_reported(tmp_path: Path) -> None:
    ProgramFile(tmp_path, "robot").write(SavedDraft("x.urp", True, b"<a/>"))
    draft, errors = create_draft(tmp_path)
    assert titles(draft) == ["Variables Setup", "Robot Program", "<empty>"]
    assert "robot.unreadable" in errors[0]
