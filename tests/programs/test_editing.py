"""Programs are edited node by node, by several users at the same time, with undo."""

import json

import pytest
from editing_rig import CB3, E_SERIES, HOME, INSTALLATION, editor, id_of, outline, reopened

from tests.rows import each_row
from urproto.robots.pose import pose_trans
from urproto.versions import PolyscopeVersion
from urscript.polyscope.editing import ROOT, EditError
from urscript.polyscope.numbers import taught_pose
from urscript.polyscope.registry import kinds

POSE = (0.3, -0.2, 0.4, 0.0, 3.0, 0.0)
TCP = (0.0, 0.0, 0.1, 0.0, 0.0, 0.0)


def titles(edited):
    return [f"{'  ' * row.depth}{row.title}" for row in edited.rows()]


def test_a_pick_and_place_program_is_created_and_reopened():
    made = editor()
    first = made.insert("waypoint", into=ROOT)
    move = made.rows()[-2].id
    made.set_all(move, {"motion": "MoveL", "tool_speed": 100.0, "feature": "table", "tcp": "gripper"})
    second = made.insert("waypoint", after=first, values={"name": "above", "blend": 20.0})
    for node in (first, second):
        made.teach(node, HOME, POSE, TCP)
    loop = made.insert("loop", into=ROOT, values={"type": "Counting", "count": 3})
    made.insert("set", into=loop, values={"type": "DigitalOutput", "output": "clamp", "level": "1"})
    made.insert("wait", into=loop, values={"type": "Sleep", "time": 0.5})
    made.insert("assignment", into=loop, values={"variable": "n", "expression": "n + 1"})
    branch = made.insert("if", into=ROOT, values={"expression": "n >= 2 and part_there == True"})
    made.insert("halt", into=branch)
    made.insert("comment", into=made.insert("else", after=branch), values={"comment": "nothing to do"})
    assert titles(made) == [
        "Variables Setup",
        "Robot Program",
        "  MoveL",
        "    Waypoint_1",
        "    above",
        "  Loop 3 times",
        "    Set clamp=On",
        "    Wait: 0.5",
        "    n≔n + 1",
        "  If n ≥ 2 and part_there ≟ True ",
        "    Halt",
        "  Else",
        "    'nothing to do'",
    ]
    assert made.problems() == []
    assert all(row.defined for row in made.rows())
    script = made.written().text()
    assert "movel(Waypoint_1_p, a=1.2, v=0.1)" not in script  # the feature is a variable and may have moved
    assert "pose_trans(table, pose_trans(" in script
    assert "v=0.1" in script
    assert "r=0.02" in script
    assert "set_tcp(p[0.0, 0.0, 0.1, 0.0, 0.0, 0.0])" in script
    assert "set_standard_digital_out(3, True)" in script
    assert "get_standard_digital_in(2)" in script
    again = reopened(made)
    assert outline(again) == outline(made)
    assert again.written().text() == script
    assert again.document() == made.document()


def test_undo_restores_the_same_bytes_and_redo_repeats():
    made = editor()
    before = made.document()
    waypoint = made.insert("waypoint", into=ROOT)
    made.teach(waypoint, HOME, POSE, TCP)
    thread = made.insert("thread", into=ROOT)
    made.insert("script", into=thread, values={"line": "sync()"})
    made.suppress(waypoint)
    made.move(id_of(made, "move"), into=thread)
    made.paste(made.copy(thread), into=ROOT)
    made.delete(thread)
    after, done = made.document(), []
    while made.can_undo:
        done.append(made.undo())
    assert made.document() == before
    assert not made.modified
    assert done[-1] == "Insert Waypoint"
    for _ in done:
        made.redo()
    assert made.document() == after
    assert made.modified
    assert waypoint not in {row.id for row in made.rows()}
    made.undo()
    assert waypoint in {row.id for row in made.rows()}  # the ids are restored
    made.redo()
    with pytest.raises(EditError, match="no longer in the program"):
        made.set(waypoint, "name", "x")


@each_row(
    ("kind", "values", "field", "refusal"),
    [
        ("wait", {"type": "Sleep", "time": -1}, "time", "Wait: 0.01, Time: -1 s is outside the limits: 0 or more s"),
        ("move", {"joint_speed": 1e4}, "joint_speed", "10000 °/s is outside the limits: 0 to 360 °/s"),
        ("move", {"joint_speed": "fast"}, "joint_speed", "must be a number in °/s, not 'fast'"),
        ("move", {"joint_speed": float("nan")}, "joint_speed", "must be a number in °/s"),
        ("loop", {"type": "Counting", "count": 2.5}, "count", "must be a whole number, not 2.5"),
        ("loop", {"type": "Often"}, "type", "must be one of Forever, Counting, While, not 'Often'"),
        ("loop", {"count": 2}, "count", "has no field 'count'"),
        ("set", {"type": "DigitalOutput", "output": "digital_in[0]"}, "output", "cannot be used here"),
        ("set", {"type": "DigitalOutput", "output": "digital_out[9]"}, "output", "no input or output called"),
        ("set", {"tcp": "hand"}, "tcp", "the installation cell has no TCP called 'hand'"),
        ("set_payload", {"payload": "nothing"}, "payload", "has no payload called 'nothing'"),
        ("move", {"feature": "moon"}, "feature", "has no feature called 'moon'"),
        ("assignment", {"variable": "1x"}, "variable", "'1x' is not a name for a variable"),
        ("call", {"subprogram": "S"}, "subprogram", "there is no subprogram called 'S'"),
        ("comment", {"comment": "\x07"}, "comment", "which is not allowed in XML"),
        ("comment", {"comment": 5}, "comment", "must be text, not 5"),
        ("folder", {"hidden": "no"}, "hidden", "must be true or false, not 'no'"),
        ("folder", {"name": "  "}, "name", "a name is required"),
        ("waypoint", {"position": [1, 2]}, "position", "must be text"),
        ("waypoint", {"name": ""}, "name", "a value is required|a name is required"),
        ("wait", {"depth": 1}, "depth", "has no field 'depth'; it has type"),
    ],
)
def test_a_value_that_a_field_cannot_take_is_refused_with_node_and_field(kind, values, field, refusal):
    made = editor()
    before = made.document()
    with pytest.raises(EditError, match=refusal.replace("(", r"\(")) as refused:
        made.insert(kind, into=ROOT, values=values)
    assert refused.value.field == field
    assert refused.value.node
    assert made.document() == before
    assert not made.can_undo
    assert made.revision == 0


def test_nodes_can_be_placed_only_where_allowed():
    made = editor()
    wait = made.insert("wait", into=ROOT)
    branch = made.insert("if", into=ROOT)
    switch = made.insert("switch", into=ROOT)
    case = id_of(made, "case")
    for kind, where, refusal in [
        ("case", {"into": ROOT}, "must be inside a Switch, not inside Robot Program"),
        ("wait", {"into": switch}, "can contain only cases"),
        ("wait", {"into": wait}, "can contain no nodes"),
        ("else", {"into": ROOT}, "must follow an If"),
        ("until", {"into": ROOT}, "must be inside a Direction"),
        ("before_start", {"into": ROOT}, None),
        ("variables_setup", {"into": ROOT}, "already has its Variables Setup"),
        ("robot_program", {"into": ROOT}, "no node 'robot_program' to insert"),
        ("palletizing", {"into": ROOT}, "no node 'palletizing' to insert: choose one of"),
        ("wait", {}, "name exactly one place"),
        ("wait", {"into": "n999"}, "n999 is no longer in the program"),
        ("wait", {"before": made.rows()[0].id}, "cannot be placed next to"),
    ]:
        if refusal is None:
            made.insert(kind, **where)
            continue
        with pytest.raises(EditError, match=refusal):
            made.insert(kind, **where)
    made.insert("else", into=branch)
    made.insert("elseif", into=branch)
    with pytest.raises(EditError, match="already has an Else"):
        made.insert("else", into=branch)
    made.insert("halt", after=branch)  # not between an If and its branches
    made.insert("default_case", into=switch)
    with pytest.raises(EditError, match="already has a default case"):
        made.insert("default_case", after=case)
    with pytest.raises(EditError, match="cannot be moved into or next to itself"):
        made.move(branch, into=branch)
    with pytest.raises(EditError, match="cannot be deleted"):
        made.delete(id_of(made, "robot_program"))
    assert [row.kind for row in made.rows() if row.depth < 2 and row.kind != "empty"] == [
        *("variables_setup", "before_start", "robot_program", "wait", "if", "elseif", "else", "halt", "switch")
    ]


def test_an_if_is_deleted_with_its_branches():
    made = editor()
    branch = made.insert("if", into=ROOT, values={"expression": "True"})
    made.insert("else", after=branch)
    last = made.insert("halt", into=ROOT)
    made.move(branch, after=last)
    assert [row.kind for row in made.rows()] == [
        "variables_setup",
        "robot_program",
        "halt",
        "if",
        "empty",
        "else",
        "empty",
    ]
    made.suppress(branch)
    assert [row.suppressed for row in made.rows()[3:]] == [True] * 4
    assert made.problems() == []
    assert "Else" not in made.written().text()
    made.suppress(branch, on=False)
    pasted = made.paste(made.copy(branch), before=branch)
    assert len(pasted) == 2
    made.delete(branch)
    assert [row.kind for row in made.rows()].count("else") == 1


@pytest.mark.parametrize("version", [CB3, E_SERIES])
def test_a_waypoint_is_saved_as_on_its_series(version):
    made = editor(version)
    waypoint = made.insert("waypoint", into=ROOT)
    assert [(problem.node, problem.message) for problem in made.problems()] == [
        (waypoint, "Waypoint_1 lacks its position: teach it")
    ]
    rows = {row.id: row for row in made.rows()}
    assert [row.defined for row in rows.values()] == [True, False, False, False]  # and all its parents
    model = made.program.model
    from urproto.robots import kinematics_of

    pose = kinematics_of(model).forward(HOME, TCP)
    made.teach(waypoint, HOME, pose, TCP)
    position = made._places.spot(waypoint).node.child("position")
    joints, taught = taught_pose(position)
    assert joints == pytest.approx(HOME, abs=0)
    assert taught == pytest.approx(pose, abs=1e-9)
    assert made.form(waypoint)["fields"][2]["value"]["joints"] == list(HOME)
    assert made.problems() == []
    text = made.document().decode()
    assert ("<JointAngles" in text) == (version is E_SERIES)
    assert ("<outputFlangePose" in text) == (version is CB3)
    if version is CB3:
        flange = position.parent.child("outputFlangePose").get("pose")
        numbers = tuple(map(float, flange.split(",")))
        assert pose_trans(numbers, TCP) == pytest.approx(pose, abs=1e-9)
    with pytest.raises(EditError, match="expected six numbers"):
        made.teach(waypoint, HOME[:5], pose, TCP)


def test_waypoints_of_the_same_name_share_a_position():
    made = editor()
    first = made.insert("waypoint", into=ROOT)
    (second,) = made.paste(made.copy(first), after=first)
    made.teach(second, HOME, POSE, TCP)
    assert made.form(first)["fields"][2]["value"] == made.form(second)["fields"][2]["value"]
    made.rename(second, "other")
    assert [row.title for row in made.rows()][-2:] == ["Waypoint_1", "other"]


def test_a_relative_waypoint_and_one_in_a_variable():
    made = editor()
    made.insert("assignment", into=ROOT, values={"variable": "target", "expression": "p[0.1,0.2,0.3,0,3.1,0]"})
    moved = made.insert("waypoint", into=ROOT, values={"type": "Relative"})
    with pytest.raises(EditError, match="only a relative waypoint"):
        made.teach(made.insert("waypoint", after=moved), HOME, POSE, TCP, start=True)
    made.undo()
    made.teach(moved, HOME, POSE, TCP, start=True)
    made.teach(moved, HOME, (*POSE[:2], 0.5, *POSE[3:]), TCP)
    to = made.insert("waypoint", after=moved, values={"type": "Variable", "variable": "target"})
    with pytest.raises(EditError, match="pose is in a variable"):
        made.teach(to, HOME, POSE, TCP)
    assert made.problems() == []
    assert made.rows()[-1].title == "target"
    assert "pose_sub(Waypoint_1_to_p, Waypoint_1_from_p)" in made.written().text()
    made.rename(to, "goal")
    assert made.document().count(b'name="goal"') == 1
    assert b'name="target"' not in made.document()
    assert "goal≔" in made.rows()[2].title


def test_a_subprogram_is_called_until_it_is_deleted():
    made = editor()
    sub = made.insert("subprogram", into=ROOT)
    made.insert("halt", into=sub)
    call = made.insert("call", into=ROOT, values={"subprogram": "SubProgram_1"})
    made.rename(sub, "leave")
    assert made.form(call)["fields"][0]["value"] == "leave"
    assert "leave()" in made.written().text()
    assert outline(reopened(made)) == outline(made)
    again = reopened(made)
    assert again.written().text() == made.written().text()
    clip = made.copy(call)
    made.delete(sub)
    assert [problem.message for problem in made.problems()] == ["Call  lacks the subprogram to call"]
    other = editor()
    there = other.insert("subprogram", into=ROOT, values={"name": "leave"})
    other.insert("comment", into=there, values={"comment": "hers"})
    other.paste(clip, into=ROOT)
    assert other.document().count(b'name="leave"') == 1  # the other user's subprogram of that name, not ours
    assert b"hers" in other.document()


def test_untranslatable_nodes_are_reported_at_the_node():
    made = editor()
    pin = made.insert("set", into=ROOT, values={"type": "DigitalOutput", "output": "clamp"})
    missing = made.insert("home", into=ROOT)
    tcp = made.insert("set", into=ROOT, values={"tcp": "gripper"})
    assert made.problems() == []
    made.installation = type(INSTALLATION)(name="bare")
    assert [(problem.node, problem.message) for problem in made.problems()] == [
        (pin, "the installation bare has no input or output called clamp"),
        (missing, "the installation bare has no home position"),
        (tcp, "the installation bare has no TCP called 'gripper'"),
    ]
    assert [row.problem for row in made.rows()][-1] == "the installation bare has no TCP called 'gripper'"


def test_two_users_edit_one_program():
    """Each refers to nodes by their ids, regardless of the other's changes."""
    made = editor()
    hers = made.insert("folder", into=ROOT, values={"name": "hers"})
    his = made.insert("folder", into=ROOT, values={"name": "his"})
    made.move(his, before=hers)
    made.insert("wait", into=hers, values={"type": "Sleep", "time": 1.0})
    made.delete(his)
    revision = made.revision
    for action in (
        lambda: made.insert("halt", into=his),
        lambda: made.set(his, "name", "x"),
        lambda: made.move(hers, after=his),
        lambda: made.delete(hers, his),
        lambda: made.form(his),
    ):
        with pytest.raises(EditError, match=r"Folder\) is no longer in the program") as refused:
            action()
        assert refused.value.node == his
    assert made.revision == revision
    made.undo()
    made.insert("halt", into=his)
    assert [row.title for row in made.rows()][2:] == ["his", "Halt", "hers", "Wait: 1.0"]


def test_the_palette_depends_on_the_version():
    assert {"home", "set_payload"} <= {kind["key"] for kind in editor().palette()}
    cb3 = editor(CB3)
    assert not {"home", "set_payload"} & {kind["key"] for kind in cb3.palette()}
    with pytest.raises(EditError, match=r"Home is not available in PolyScope 3.15.8 \(e-Series since 5.4 only\)"):
        cb3.insert("home", into=ROOT)
    old = editor(PolyscopeVersion(5, 11))
    old.insert("move", into=ROOT)
    assert b"optimove" not in old.document()
    assert b"createdInPolyscopeProgramVersion" not in old.document()
    json.dumps(editor().palette())


def test_a_file_that_is_not_a_program_is_refused():
    from urscript.polyscope.document import DocumentError, read_document
    from urscript.polyscope.editing import ProgramEditor
    from urscript.polyscope.tree import TreeError

    for text, error in (
        ("<Installation/>", TreeError),
        ('<URProgram><children reference="../x"/></URProgram>', DocumentError),
    ):
        with pytest.raises(error):
            ProgramEditor(read_document(text.encode()), "x", INSTALLATION, E_SERIES)


@each_row("kind", [kind for kind in kinds().values() if kind.new], ids=lambda kind: kind.key)
def test_every_kind_is_created_shown_set_saved_and_translated(kind):
    """With its default values, and with every choice of its form."""
    made = editor()
    made.insert("subprogram", into=ROOT)
    made.insert("assignment", into=ROOT, values={"variable": "v", "expression": "1"})
    holder = {"switch": "switch", "direction": "direction", "if": "if"}.get(kind.stands)
    if kind.key == "variables_setup":
        made.delete(id_of(made, "variables_setup"))
    node = made.insert(kind.key, into=made.insert(holder, into=ROOT) if holder else ROOT)
    seen = set()
    choices = [field for field in kind.fields if field.kind == "choice" and field.choices]
    for field in [None, *choices]:
        for value in [None] if field is None else [value for value, _ in field.choices]:
            if field is not None:
                if not field.shown(made._places.spot(node).node):
                    continue
                made.set(node, field.key, value)
            form = made.form(node)
            json.dumps(form)
            for entry in form["fields"]:
                seen.add(entry["key"])
                if entry["kind"] != "position" and entry["value"] not in (None, ""):
                    revision = made.revision
                    made.set(node, entry["key"], entry["value"])  # setting the displayed value is no change
                    assert made.revision == revision, entry
            assert outline(reopened(made)) == outline(made)
    while made.can_undo:
        made.undo()
    assert made.document() == editor().document()


def test_a_force_is_set_axis_by_axis_and_written_as_polyscope_does():
    made = editor()
    force = made.insert("force", into=ROOT)
    made.set(force, "z_force", 5.0)
    made.insert("wait", into=force, values={"type": "Sleep", "time": 1.0})
    assert not made.problems()
    # a line of a public program's script (Unitedplasticfabricating, test apply force, PolyScope 5.14)
    line = (
        "force_mode(tool_pose(), [0, 0, 1, 0, 0, 0], [0.0, 0.0, 5.0, 0.0, 0.0, 0.0], 2, "
        "[0.1, 0.1, 0.15, 0.3490658503988659, 0.3490658503988659, 0.3490658503988659])"
    )
    assert line in made.written().text()
    shown = [field["key"] for field in made.form(force)["fields"]]
    assert shown == ["type", "feature", "z_force", "z_speed"]
    made.set(force, "type", "Frame")
    made.set(force, "feature", "Base")
    made.set(force, "ry_yields", True)
    made.set(force, "ry_force", -0.5)
    made.set(force, "ry_speed", 30.0)
    made.set(force, "x_deviation", 20.0)
    with pytest.raises(EditError, match="outside the limits"):
        made.set(force, "z_force", 1000.0)
    text = reopened(made).written().text()
    assert "[0, 0, 1, 0, 1, 0], [0.0, 0.0, 5.0, 0.0, -0.5, 0.0], 2, [0.02, 0.1, 0.15, " in text
    for _ in range(6):
        made.undo()
    assert line in made.written().text()
