"""Programs of PolyScope X: read, translated by the nodes of older software, or played from their saved script."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.controller import Controller
from emulator.machine import ControllerConfig
from emulator.programs.loading import ProgramLoadError
from tests.budget import examples
from tests.robotapi.rig import empty_urpx, node, urpx, wait
from tests.rows import each_row
from urproto.modes import RuntimeState
from urproto.robots import load_model
from urproto.versions import PolyscopeVersion
from urscript.polyscope.urpx import UrpxError, read_information, read_urpx
from urscript.work import run_to_end

X = PolyscopeVersion(10, 12)
VENDOR = node("vendor-thing", "v")
# the form of the vendor's files: a label for each node that writes URScript, numbered by its place in nodeIDList
SAVED = '$ 1 "ur-program"\n$ 5 "ur-code"\n$ 6 "vendor-thing"\nset_standard_digital_out(3, True)\nsleep(0.1)'


@pytest.fixture
def controller(tmp_path: Path) -> Controller:
    return Controller(ControllerConfig(model=load_model("ur5e"), version=X, running=True, programs_dir=tmp_path))


def load(controller: Controller, data: bytes, name: str = "file.urpx") -> None:
    path = controller.config.programs_dir
    assert path is not None
    (path / name).write_bytes(data)
    run_to_end(controller.programs.load_steps(path / name))


def play(controller: Controller, periods: int) -> list[RuntimeState]:
    controller.programs.play()
    states = []
    for _ in range(periods):
        controller.tick()
        states.append(controller.programs.state)
    return states


def test_a_wait_takes_its_duration_and_its_node_is_shown(controller: Controller) -> None:
    load(controller, urpx("slow job", wait(0.5)))
    loaded = controller.programs.loaded
    assert loaded is not None
    assert (loaded.name, [line.element.tag for line in loaded.tree.lines]) == ("slow job", ["MainProgram", "Wait"])  # type: ignore[union-attr]
    playing = play(controller, 500).count(RuntimeState.PLAYING) * controller.period_s
    assert playing == pytest.approx(0.5, abs=0.05)


def test_the_applications_urscript_comes_first(controller: Controller) -> None:
    program = json.loads(urpx("job", wait(0.1)))
    program["application"]["urscript"]["script"] = "set_tcp(p[0, 0, 0.25, 0, 0, 0])\nglobal seen = 7"
    load(controller, json.dumps(program).encode())
    controller.programs.play()
    controller.tick()
    while controller.programs.state is RuntimeState.PLAYING:
        assert controller.programs.variables["seen"] == 7
        controller.tick()
    assert controller.installation.tcp[2] == 0.25


def test_unknown_nodes_are_played_from_their_saved_script(controller: Controller) -> None:
    load(controller, urpx("job", VENDOR, script=SAVED, known=("v",)))
    loaded = controller.programs.loaded
    assert loaded is not None
    assert loaded.tree is None
    assert [(each.number, each.text) for each in loaded.outline if each.number in (1, 6)] == [
        (1, "Program"),
        (6, "Vendor thing"),
    ]
    assert "unknown node vendor-thing" in loaded.notes[0]
    play(controller, 30)
    assert controller.snapshot.actual_digital_output_bits >> 3 & 1


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (urpx("job", VENDOR), "unknown node vendor-thing. Nothing is played instead: the file has no URScript"),
        (urpx("job", VENDOR, script=SAVED), "the URScript in the file lacks the node Vendor thing"),
        (
            urpx("job", VENDOR, script=SAVED, known=("v", "gone")),
            "6 nodes write URScript, but the URScript in the file has 7",
        ),
        (urpx("job", VENDOR, script="x = = 1", known=("v",)), "The URScript in it cannot be played instead"),
        (urpx("job", node("ur-wait", "w", type="signal")), "node ur-wait for 'signal' is not supported"),
        (b"<xml/>", "not JSON"),
    ],
)
def test_unplayable_programs_are_refused_and_the_loaded_one_is_kept(
    controller: Controller, data: bytes, problem: str
) -> None:
    with pytest.raises(ProgramLoadError, match=problem):
        load(controller, data)
    assert controller.programs.loaded is not None
    assert controller.programs.loaded.name == "Default program"


def test_each_software_line_has_its_program_format(controller: Controller, tmp_path: Path) -> None:
    with pytest.raises(ProgramLoadError, match=r"use a \.urpx"):
        load(controller, b"", "old.urp")
    older = Controller(ControllerConfig(model=load_model("ur5e"), programs_dir=tmp_path))
    with pytest.raises(ProgramLoadError, match=r"use a \.urp or"):
        load(older, urpx("job"))


def _changed(*path: Any, value: Any) -> bytes:
    program = json.loads(urpx("job", wait(1.0)))
    place = program
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return json.dumps(program).encode()


INFORMATION = ("program", "programInformation")
CODE = ("program", "programContent", "children", 5)


@each_row(
    ("data", "problem"),
    [
        (b"", "not JSON"),
        (b"[]", "the file is not an object"),
        (b"{}", "program is not an object"),
        (b'{"program": {"x": NaN}}', "NaN"),
        (b"[" * 100_000, "not JSON"),
        (b" " * (5 << 20), "a program may have 1,048,576"),
        (_changed(*INFORMATION, value=None), "programInformation is not an object"),
        (_changed(*INFORMATION, "name", value=7), "name is not text"),
        (_changed(*INFORMATION, "name", value=" "), "name is empty"),
        (_changed(*INFORMATION, "createdDate", value="today"), "not a date"),
        (_changed("program", "urscript", "nodeIDList", value=5), "not a list"),
        (_changed("program", "programContent", "contributedNode", "type", value="ur-code"), "begins with 'ur-code'"),
        (_changed(*CODE, "contributedNode", "type", value="ur-wait"), "'ur-wait' is at the top level of the program"),
        (_changed(*CODE, "children", value=5), "no type, or its children"),
        (_changed(*CODE, "children", value=[{}]), "contributedNode is not an object"),
    ],
)
def test_files_that_are_not_programs(data: bytes, problem: str) -> None:
    with pytest.raises(UrpxError, match=problem):
        read_urpx(data)


def test_nesting_depth_of_nodes_is_limited() -> None:
    deep: dict[str, Any] = wait(1.0)
    for _ in range(100):
        deep = {**node("ur-folder", "f"), "children": [deep]}
    with pytest.raises(UrpxError, match="more than 60 deep"):
        read_urpx(urpx("job", deep))


@settings(max_examples=examples(100), deadline=None)
@given(st.binary(max_size=200), st.integers(min_value=0), st.integers(min_value=0))
def test_any_bytes_are_a_program_or_refused(junk: bytes, start: int, length: int) -> None:
    data = urpx("job", wait(1.0))
    start %= len(data)
    data = data[:start] + junk + data[start + length % 300 :]
    try:
        program = read_urpx(data)
        program.tree()
    except UrpxError:
        return
    assert program.name == read_information(data).name


def test_the_default_program_has_no_nodes() -> None:
    program = read_urpx(empty_urpx("Default program"))
    assert [node.type for node in program.root.walk()][-1] == "ur-code"
    assert program.name == "Default program"
