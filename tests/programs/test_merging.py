"""Merging programs by node: pairs of edits of one program give what both edits in one editor give, or a conflict."""

import re
from collections import Counter
from random import Random
from typing import Any

import pytest
from editing_rig import E_SERIES, HOME, INSTALLATION, ZERO, editor

from tests.robotapi.rig import urpx, wait
from urproto.robots import kinematics_of, load_model
from urscript.polyscope.document import DocumentError, link, packed, read_document, unpacked, write_document
from urscript.polyscope.editing import ROOT, ProgramEditor
from urscript.polyscope.installation_settings import change_setting, new_installation
from urscript.polyscope.lines import read_lines
from urscript.polyscope.merging import merge_files
from urscript.polyscope.places import EditError
from urscript.polyscope.urpx import read_urpx

ARM = load_model("ur5e")
Edit = tuple[str, tuple[Any, ...], dict[str, Any]]


def large_program() -> bytes:
    """A program with most kinds of nodes that hold others."""
    made = editor(E_SERIES)
    loop = made.insert("loop", into=ROOT, values={"type": "Counting", "count": 2})
    folder = made.insert("folder", into=ROOT, values={"name": "pick"})
    branch = made.insert("if", into=ROOT, values={"expression": "True"})
    otherwise = made.insert("else", after=branch)
    thread = made.insert("thread")
    subprogram = made.insert("subprogram")
    for at, place in enumerate((ROOT, loop, folder, branch, otherwise, thread, subprogram)):
        for count in range(3):
            made.insert("wait", into=place, values={"type": "Sleep", "time": 1.0 + at + count / 10})
        made.insert("set", into=place, values={"type": "DigitalOutput", "output": f"digital_out[{at}]", "level": "1"})
        made.insert("comment", into=place, values={"comment": f"here {at}"})
        if at < 3:
            waypoint = made.insert("waypoint", into=place)
            teach(made, waypoint, 0.1 * at)
    return packed(made.document())


def teach(made: ProgramEditor, waypoint: str, base_rad: float) -> None:
    joints = (base_rad, *HOME[1:])
    made.teach(waypoint, joints, kinematics_of(ARM).forward(joints), ZERO)


def opened(data: bytes) -> ProgramEditor:
    return ProgramEditor(read_document(data), "made", INSTALLATION, E_SERIES, ARM)


def random_edit(rng: Random, data: bytes) -> Edit:
    """An edit of a program; its nodes have the same ids in every editor."""
    rows = opened(data).rows()
    inner = [row for row in rows if row.depth and row.kind in ("wait", "set", "comment", "waypoint")]
    holders = [row for row in rows if row.kind in ("loop", "folder", "if", "else", "thread", "subprogram")]
    node, holder = rng.choice(inner), rng.choice(holders)
    how = rng.choice(("set", "set", "insert", "insert", "delete", "move", "suppress", "hold"))
    if how == "set":
        key, value = {
            "wait": ("time", round(rng.uniform(20, 90), 3)),
            "set": ("level", "0"),
            "comment": ("comment", f"other {rng.random()}"),
            "waypoint": ("blend", round(rng.uniform(1, 90), 3)),
        }[node.kind]
        return "set", (node.id, key, value), {}
    if how == "insert":
        kind = rng.choice(("wait", "comment", "loop"))
        values: dict[str, dict[str, Any]] = {
            "wait": {"type": "Sleep", "time": round(rng.uniform(100, 900), 3)},
            "comment": {"comment": f"new {rng.random()}"},
            "loop": {"type": "Counting", "count": rng.randrange(100)},
        }
        return "insert", (kind,), {"after": node.id, "values": values[kind]}
    if how == "move":
        return "move", (node.id,), {"into": holder.id}
    if how == "hold":
        return "set", (holder.id, *(("name", f"F{rng.randrange(99)}") if holder.kind == "folder" else ("x", 0))), {}
    return how, (node.id,), {}


def applied(data: bytes, *edits: Edit, twice: bool = False) -> bytes | None:
    """The program after edits; None if one is not possible. twice: a node may be deleted twice."""
    made = opened(data)
    for how, arguments, options in edits:
        try:
            getattr(made, how)(*arguments, **options)
        except EditError:
            if not (twice and how == "delete"):
                return None
    return packed(made.document())


def shown(data: bytes) -> list[tuple[int, str]]:
    return [(depth, line.text) for depth, line in read_lines(data).walk()]


def comments_of(data: bytes) -> list[str]:
    """The comments that mark conflicts, without those that end a version of a node."""
    marks = [text for _, text in shown(data) if "MERGE CONFLICT " in text]
    return [text for text in marks if "MERGE CONFLICT end of" not in text]


def counts_of_pairs(seeds: range) -> Counter[str]:
    """Merge a pair of edits for each seed, and count the results."""
    base, found = large_program(), Counter[str]()
    for seed in seeds:
        rng = Random(seed)
        while True:
            first = [random_edit(rng, base) for _ in range(rng.randrange(1, 3))]
            second = [random_edit(rng, base) for _ in range(rng.randrange(1, 3))]
            ours, theirs = applied(base, *first), applied(base, *second)
            if ours is not None and theirs is not None:
                break
        merged = merge_files(base, ours, theirs)
        assert opened(merged.data).rows(), seed
        orders = [(*first, *second), (*second, *first)]
        both = {tuple(shown(data)) for order in orders if (data := applied(base, *order, twice=True))}
        if merged.conflicts:
            found["conflict"] += 1
            found["conflict without need"] += len(both) == 1
            assert len(comments_of(merged.data)) == len(merged.conflicts), (seed, merged.conflicts)
        elif tuple(shown(merged.data)) in both:
            found["right"] += 1
        else:
            found["wrong"] += 1
            print(seed, first, second)
    return found


def test_thirty_pairs_of_edits_merge():
    found = counts_of_pairs(range(30))
    assert not found["wrong"], found
    assert found["right"] >= 28, found


@pytest.mark.long
def test_five_hundred_pairs_of_edits_merge():
    found = counts_of_pairs(range(500))
    assert not found["wrong"], found
    assert found["right"] >= 475, found


def merged_edits(first: list[Edit], second: list[Edit]) -> tuple[list[str], list[str]]:
    """The conflicts of two edits of the large program, and the lines of the result that differ from ours."""
    base = large_program()
    ours, theirs = applied(base, *first), applied(base, *second)
    assert ours is not None
    assert theirs is not None
    merged = merge_files(base, ours, theirs)
    assert merge_files(base, ours, base).data == ours
    assert merge_files(base, base, theirs).data == theirs
    before = Counter(shown(ours))
    return merged.conflicts, [text for depth, text in shown(merged.data) if (depth, text) not in before]


def test_a_conflict_keeps_ours_and_marks_theirs():
    rows = opened(large_program()).rows()
    waits = [row.id for row in rows if row.kind == "wait"]
    conflicts, new = merged_edits([("set", (waits[0], "time", 7.5), {})], [("set", (waits[0], "time", 8.5), {})])
    what = "Wait: 7.5: waitTime text: '7.5' in ours, '8.5' in theirs"
    assert conflicts == [what]
    assert new == [
        f"Comment 'MERGE CONFLICT {what}'",
        "Comment 'MERGE CONFLICT end of ours, theirs is suppressed'",
        "Wait: 8.5 | Suppressed: yes | Wait for: A time | Time: 8.5 s",
        "Comment 'MERGE CONFLICT end of theirs'",
    ]
    deleted = [("delete", (waits[1],), {})]
    changed = [("set", (waits[1], "time", 8.5), {})]
    assert merged_edits(deleted, changed)[0] == ["Wait: 8.5: ours deleted it, theirs changed it"]
    assert merged_edits(changed, deleted)[0] == ["Wait: 8.5: theirs deleted it, ours changed it"]
    new = [("insert", ("comment",), {"after": waits[2], "values": {"comment": text}}) for text in ("our", "their")]
    assert merged_edits(new[:1], new[1:])[0] == [
        "Comment 'their': both versions inserted nodes here: those before are ours, these are theirs"
    ]
    assert merged_edits(new[:1], new[:1]) == ([], [])
    loop = next(row.id for row in rows if row.kind == "loop")
    moves = [("move", (waits[3],), {"into": loop}), ("move", (waits[3],), {"before": waits[0]})]
    assert "both versions moved it" in merged_edits(moves[:1], moves[1:])[0][0]


def test_what_both_versions_name_the_same_stays_apart():
    """New waypoints with another position get another name; so do the variables of new loops; others are a conflict."""
    base = large_program()
    ours, theirs = opened(base), opened(base)
    for made, place, angle in ((ours, "loop", 0.5), (theirs, "folder", 0.9)):
        holder = next(row.id for row in made.rows() if row.kind == place)
        teach(made, made.insert("waypoint", into=holder), angle)
        made.insert("loop", into=holder, values={"type": "Counting", "count": 5})
    merged = merge_files(base, packed(ours.document()), packed(theirs.document()))
    assert not merged.conflicts
    lines = [line for _, line in read_lines(merged.data).walk()]
    points = [line.name for line in lines if line.kind == "Waypoint"]
    assert len(set(points)) == len(points) == 5
    counters = [line.values["Counts in"] for line in lines if line.kind == "Loop"]
    assert len(set(counters)) == len(counters) == 3
    for made in (ours, theirs):
        holder = next(row.id for row in made.rows() if row.kind == ("loop" if made is ours else "folder"))
        made.insert("assignment", into=holder, values={"variable": "both", "expression": "1"})
    merged = merge_files(base, packed(ours.document()), packed(theirs.document()))
    assert [conflict.partition(": ")[2] for conflict in merged.conflicts] == ["both versions have a new variable both"]


def test_a_deleted_subprogram_that_theirs_calls_is_kept():
    base = large_program()
    ours, theirs = opened(base), opened(base)
    ours.delete(next(row.id for row in ours.rows() if row.kind == "subprogram"))
    theirs.insert("call", into=ROOT, values={"subprogram": "SubProgram_1"})
    merged = merge_files(base, packed(ours.document()), packed(theirs.document()))
    assert merged.conflicts == ["SubProgram_1: ours deleted it, theirs calls it"]
    result = opened(merged.data)
    assert [row.title for row in result.rows() if row.kind == "call"] == ["Call SubProgram_1"]
    assert not result.problems()
    assert "SubProgram_1()" in result.written().text()


def test_installations_variables_and_programs_of_polyscope_x_merge_by_setting():
    root = new_installation(E_SERIES, "cell")
    base = packed(write_document(root))

    def changed(*changes: tuple[str, str, dict[str, Any]]) -> bytes:
        document = link(read_document(base))
        for section, row, values in changes:
            change_setting(document, section, row, values)
        return packed(write_document(document))

    tcp, name = ("tcps", "TCP", {"pose": [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]}), ("io", "digital_in[2]", {"name": "part"})
    merged = merge_files(base, changed(tcp), changed(name))
    assert merged.conflicts == []
    assert unpacked(merged.data) == unpacked(changed(tcp, name))
    other = ("tcps", "TCP", {"pose": [0.0, 0.0, 0.2, 0.0, 0.0, 0.0]})
    merged = merge_files(base, changed(tcp), changed(other))
    assert unpacked(merged.data) == unpacked(changed(tcp))
    assert len(merged.conflicts) == 1
    assert merged.conflicts[0].endswith(
        "offset: '0.0, 0.0, 0.1, 0.0, 0.0, 0.0' in ours, '0.0, 0.0, 0.2, 0.0, 0.0, 0.0' in theirs"
    )
    merged = merge_files(b"#t\na=1\nb=2\n", b"#t\na=5\nb=2\n", b"#t\nb=3\nc=4\n")
    assert merged.conflicts == ["variables.a: 'a=5' in ours, - in theirs"]
    assert merged.data == b"#t\na=5\nb=3\nc=4\n"
    long = [f"#t\na=[{', '.join(map(str, range(40)))}, {end}]\n".encode() for end in (0, 1, 2)]
    assert merge_files(*long).conflicts == [
        "variables.a: '...35, 36, 37, 38, 39, 1]' in ours, '...35, 36, 37, 38, 39, 2]' in theirs"
    ]
    limits = [
        unpacked(base).replace(
            b"</Installation>",
            b'  <SafetySettings>\n    <a v="%d" w="%d"/>\n  </SafetySettings>\n</Installation>' % pair,
        )
        for pair in ((1, 1), (2, 1), (1, 3))
    ]
    merged = merge_files(*limits)
    assert merged.data == limits[1]
    assert merged.conflicts == [
        "Installation.SafetySettings.a.v: '2' in ours, '1' in theirs",
        "Installation.SafetySettings.a.w: '1' in ours, '3' in theirs",
    ]
    with pytest.raises(DocumentError, match="both versions have a new file"):
        merge_files(b"", changed(tcp), base)
    with pytest.raises(DocumentError, match="different kinds: installation, program"):
        merge_files(base, changed(tcp), large_program())


def test_programs_of_polyscope_x_merge_by_node():
    """Changes of different nodes merge; the same setting, and a deleted node, are conflicts with both values."""

    def saved(*waits: tuple[float, str]) -> bytes:
        return urpx("job", *(wait(seconds, guid) for seconds, guid in waits), script="sleep(1)")

    def times(data: bytes) -> list[str]:
        assert read_urpx(data).name == "job"
        return [line.values["time.value"] for _, line in read_lines(data).walk() if line.kind == "ur-wait"]

    base = saved((1, "a"), (2, "b"))
    merged = merge_files(base, saved((5, "a"), (2, "b")), saved((1, "a"), (6, "b"), (7, "c")))
    assert (merged.conflicts, times(merged.data)) == ([], ["5", "6", "7"])
    merged = merge_files(base, saved((5, "a"), (2, "b")), saved((6, "a"), (2, "b")))
    assert times(merged.data) == ["5", "2"]
    assert [conflict.partition("parameters.")[2] for conflict in merged.conflicts] == [
        "time.entity.value: '5' in ours, '6' in theirs",
        "time.value: '5' in ours, '6' in theirs",
    ]
    merged = merge_files(base, saved((2, "b")), saved((6, "a"), (2, "b")))
    assert times(merged.data) == ["2"]
    [conflict] = merged.conflicts
    assert re.fullmatch(r"program.*\.a: - in ours, '\{.*ur-wait.*\.\.\.' in theirs", conflict), conflict


def test_waypoints_of_one_name_keep_one_position():
    """Ours teaches a position anew, theirs uses its name once more: both nodes go to the new one."""
    base = large_program()
    ours, theirs = opened(base), opened(base)
    name = next(row.title for row in ours.rows() if row.kind == "waypoint")
    teach(ours, next(row.id for row in ours.rows() if row.title == name), 0.7)
    clip = theirs.copy(next(row.id for row in theirs.rows() if row.title == name))
    theirs.paste(clip, into=next(row.id for row in theirs.rows() if row.kind == "thread"))
    for pair in ((ours, theirs), (theirs, ours)):
        merged = merge_files(base, *(packed(made.document()) for made in pair))
        assert not merged.conflicts
        points = [line for _, line in read_lines(merged.data).walk() if line.name == name]
        assert [line.values["Position"].split(",")[0] for line in points] == ["[40.107"] * 2


def test_a_subprogram_that_theirs_deleted_and_ours_calls_is_kept():
    base = large_program()
    ours, theirs = opened(base), opened(base)
    theirs.delete(next(row.id for row in theirs.rows() if row.kind == "subprogram"))
    ours.insert("call", into=ROOT, values={"subprogram": "SubProgram_1"})
    merged = merge_files(base, packed(ours.document()), packed(theirs.document()))
    assert merged.conflicts == ["SubProgram_1: theirs deleted it, ours calls it"]
    assert not opened(merged.data).problems()
