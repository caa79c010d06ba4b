"""Random programs: after any edits, a program survives saving, and all edits are undone exactly."""

from typing import Any

from editing_rig import CB3, E_SERIES, HOME, ZERO, editor, outline, reopened
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.builtins import LIBRARIES
from tests.budget import examples
from tests.rows import each_row
from urscript.builtins import LibrarySet
from urscript.compiler import compile_script
from urscript.polyscope.editing import EditError, ProgramEditor
from urscript.polyscope.registry import kinds

LIBRARY_SET = LibrarySet(LIBRARIES)
KEYS = sorted(kind.key for kind in kinds().values() if kind.new is not None)
PLACES = ("into", "before", "after")
NUMBER = st.integers(0, 10_000)
EDITS = st.tuples(
    st.sampled_from(
        ("insert", "insert", "insert", "set", "set", "delete", "move", "suppress", "resume", "copy", "undo")
    ),
    st.sampled_from(KEYS),
    st.sampled_from(PLACES),
    NUMBER,
    NUMBER,
)
TEXTS = st.text(st.characters(exclude_categories=("Cs", "Cc")), max_size=12)


def node(made: ProgramEditor, number: int) -> str:
    rows = made.rows()
    return rows[number % len(rows)].id


def some_value(field: dict[str, Any], number: int) -> Any:
    """A value that the field may take, or not."""
    if field["choices"]:
        return field["choices"][number % len(field["choices"])]["value"]
    if field["kind"] in ("number", "integer"):
        return number if field["kind"] == "integer" else number / 8
    return {
        "boolean": bool(number % 2),
        "variable": f"v{number % 3}",
        "expression": ("1 + 2", "v0 == True", "digital_in[0] or not v1", '"a text"')[number % 4],
        "text": f"text_{number}",
    }.get(field["kind"])


def edit(made: ProgramEditor, what: tuple[str, str, str, int, int]) -> None:
    """Apply a random edit, or have it refused without any change."""
    action, kind, place, first, second = what
    before, revision = made.document(), made.revision
    try:
        if action == "insert":
            made.insert(kind, **{place: node(made, first)})
        elif action == "set":
            target = node(made, first)
            fields = made.form(target)["fields"]
            if fields:
                field = fields[second % len(fields)]
                made.set(target, field["key"], some_value(field, second // 7))
        elif action == "delete":
            made.delete(node(made, first))
        elif action == "move":
            made.move(node(made, first), **{place: node(made, second)})
        elif action in ("suppress", "resume"):
            made.suppress(node(made, first), on=action == "suppress")
        elif action == "copy":
            made.paste(made.copy(node(made, first)), **{place: node(made, second)})
        else:
            made.undo()
    except EditError:
        assert made.document() == before
        assert made.revision == revision


@settings(max_examples=examples(40), deadline=None)
@given(st.sampled_from((CB3, E_SERIES)), st.lists(EDITS, max_size=25))
def test_any_edits_survive_saving_and_are_undone_exactly(version, edits):
    made = editor(version)
    empty = made.document()
    for what in edits:
        edit(made, what)
    again = reopened(made)
    assert outline(again) == outline(made)
    assert [(line.number, line.depth) for line in made.tree.lines] == [(row.number, row.depth) for row in made.rows()]
    after = again.document()
    assert after == made.document()
    done = 0
    while made.can_undo:
        made.undo()
        done += 1
    assert made.document() == empty
    for _ in range(done):
        made.redo()
    assert made.document() == after


@settings(max_examples=examples(40), deadline=None)
@given(
    st.sampled_from((CB3, E_SERIES)),
    st.lists(st.tuples(st.sampled_from(KEYS), st.sampled_from(PLACES), NUMBER), min_size=1, max_size=12),
)
def test_any_complete_program_becomes_a_script_that_compiles(version, wanted):
    """Every inserted node is completed according to its form; then it has no problems, and its script is accepted."""
    made = editor(version)
    made.insert("subprogram", into="program")
    for kind, place, number in wanted:
        try:
            made.insert(kind, **{place: node(made, number)})
        except EditError:
            continue
    for row in made.rows():
        complete(made, row.id)
    assert [problem.message for problem in made.problems()] == []
    assert all(row.defined for row in made.rows())
    compile_script(made.written().text(), LIBRARY_SET, version)


def complete(made: ProgramEditor, target: str) -> None:
    """Set the missing values of a new node."""
    row = next(row for row in made.rows() if row.id == target)
    if row.kind == "empty":
        made.insert("halt", after=target)
        return
    if row.kind == "waypoint":
        made.teach(target, HOME, (0.3, 0.1, 0.4, 0.0, 3.0, 0.0), ZERO)
    if row.kind == "until":
        made.set(target, "type", "DISTANCE")
    if row.kind == "comment" or not row.problem:
        return
    for field in made.form(target)["fields"]:
        empty = field["value"] in (None, "")
        if empty and field["kind"] in ("expression", "subprogram", "text"):
            text = "sync()" if row.kind == "script" else "1 == 1"
            made.set(target, field["key"], field["choices"][0]["value"] if field["choices"] else text)


@given(TEXTS, st.sampled_from((CB3, E_SERIES)))
@settings(max_examples=examples(60), deadline=None)
def test_any_text_is_allowed_in_a_comment_and_an_expression(text, version):
    made = editor(version)
    comment = made.insert("comment", into="program", values={"comment": text})
    line = made.insert("script", into="program", values={"line": text})
    again = reopened(made)
    rows = [row.id for row in again.rows()]
    assert again.form(rows[2])["fields"][0]["value"] == made.form(comment)["fields"][0]["value"] == text
    assert again.form(rows[3])["fields"][1]["value"] == made.form(line)["fields"][1]["value"]


@each_row(
    ("text", "shown"),
    [
        ("a==b", "a≟b"),
        ("a == True and b!=2", "a ≟ True  and b≠2"),
        ('"a == b and True"', '"a == b and True"'),
        ("not(a)", " not (a)"),
        ("digital_in[0]==True", "digital_in[0]≟ True "),
        ("notable_x + band", "notable_x + band"),
    ],
)
def test_expressions_are_displayed_as_in_polyscope(text, shown):
    made = editor()
    line = made.insert("script", into="program", values={"line": text})
    assert made.form(line)["fields"][1]["value"] == shown
    made.set(line, "line", shown)
    assert made.form(line)["fields"][1]["value"] == shown
