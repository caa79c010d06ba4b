"""Verbs that list, show, save, step and play programs."""

import base64
import gzip
from pathlib import Path

import pytest

from emulator.machine import ControllerConfig
from emulator.virtual import VirtualRobot
from urproto.controlapi import BadArguments, NotPossible
from urproto.robots import load_model

SCRIPT = "# counts\ndef count():\n  i = 0\n  while True:\n    i = i + 1\n    sync()\n  end\nend\n"
NODES = (
    '<Folder name="Pick"><children><Wait type="Sleep"><waitTime>30</waitTime></Wait></children></Folder>'
    '<SuppressedNode><suppressedNode class="Folder" name="Later">'
    '<children><Comment comment="not now"/></children></suppressedNode></SuppressedNode>'
    '<Comment comment="done &lt;b&gt;"/>'
)
TREE = (
    '<URProgram name="t"><children><MainProgram runOnlyOnce="true" InitVariablesNode="false">'
    f"<children>{NODES}</children></MainProgram></children></URProgram>"
)


@pytest.fixture
def robot(tmp_path: Path) -> VirtualRobot:
    (tmp_path / "count.script").write_text(SCRIPT)
    (tmp_path / "tree.urp").write_bytes(gzip.compress(TREE.encode()))
    return VirtualRobot(ControllerConfig(model=load_model("ur3"), running=True, programs_dir=tmp_path))


def test_listed_programs_are_those_that_can_be_loaded(robot: VirtualRobot, tmp_path: Path) -> None:
    (tmp_path / "cell" / "a").mkdir(parents=True)
    (tmp_path / "cell" / "a" / "deep.script").write_text("textmsg(1)")
    (tmp_path / "tree.script").write_text("def tree():\nend\n")  # as PolyScope saves it with each program
    (tmp_path / "notes.txt").write_text("")
    (tmp_path / "cell" / "round").symlink_to(tmp_path, target_is_directory=True)
    (tmp_path / "elsewhere.script").symlink_to("/etc/hostname")
    assert robot.programs() == ["cell/a/deep.script", "count.script", "tree.urp"]
    for name in robot.programs():
        assert robot.dashboard(f"load {name}").startswith("Loading program")


def test_listing_many_files_takes_several_periods(robot: VirtualRobot, tmp_path: Path) -> None:
    for number in range(200):
        (tmp_path / f"p{number:03}.script").write_text("")
    before = robot.time()["time_s"]
    assert len(robot.programs()) == 202
    assert robot.time()["time_s"] > before


def test_without_a_folder_only_the_external_control_program_exists() -> None:
    robot = VirtualRobot(ControllerConfig(model=load_model("ur5e"), running=True))
    assert robot.programs() == ["external_control.urp"]  # for drivers
    assert robot.program() == {"file": None, "running": False, "text": "", "tree": []}


def test_the_text_of_a_script_is_available_before_and_while_it_runs(robot: VirtualRobot) -> None:
    robot.dashboard("load count.script")
    assert robot.program() == {"file": "count.script", "running": False, "text": SCRIPT, "tree": []}
    robot.dashboard("play")
    robot.step(10)
    shown = robot.program()
    assert (shown["file"], shown["running"]) == ("count.script", True)
    line = robot.state(["script_control_line"])["script_control_line"]
    assert "sync()" in shown["text"].splitlines()[line - 1]


def test_a_clients_program_is_shown_while_it_runs_then_the_loaded_one(robot: VirtualRobot) -> None:
    robot.dashboard("load count.script")
    robot.send_script("def other():\n  sleep(1)\nend\n")
    robot.run_until("runtime_state == PLAYING")
    assert robot.program() == {
        "file": None,
        "running": True,
        "text": "def other():\n  sleep(1)\nend\n",
        "tree": [],
    }
    robot.run_until("runtime_state == STOPPED")
    assert robot.program()["file"] == "count.script"


def test_a_tree_has_its_nodes_and_its_script_once_played(robot: VirtualRobot) -> None:
    robot.dashboard("load tree.urp")
    loaded = robot.program()
    assert (loaded["file"], loaded["text"]) == ("tree.urp", "")
    assert [(node["number"], node["depth"], node["text"]) for node in loaded["tree"]] == [
        (1, 0, "Robot Program"),
        (2, 1, "Pick"),
        (3, 2, "Wait: 30"),
        (4, 1, "Later"),
        (5, 2, "Comment"),
        (6, 1, "'done <b>'"),
    ]
    assert [node["number"] for node in loaded["tree"] if node["suppressed"]] == [4, 5]
    robot.dashboard("play")
    robot.run_until("runtime_state == PLAYING")
    playing = robot.program()
    assert playing["tree"] == loaded["tree"]
    assert '$ 3 "Wait: 30"' in playing["text"]


# files


def encoded(text: str) -> str:
    return base64.b64encode(text.encode()).decode()


def test_a_program_is_saved_read_back_and_loaded(robot: VirtualRobot, tmp_path: Path) -> None:
    assert robot.save_program("cell/new.script", encoded(SCRIPT)) == "cell/new.script"
    assert robot.save_program("/programs/cell/new.script", encoded("# again\n" + SCRIPT)) == "cell/new.script"
    assert base64.b64decode(robot.read_program("cell/new.script")).decode() == "# again\n" + SCRIPT
    assert robot.programs() == ["cell/new.script", "count.script", "tree.urp"]
    assert robot.dashboard("load cell/new.script").startswith("Loading program")
    assert [path.name for path in (tmp_path / "cell").iterdir()] == ["new.script"]
    assert robot.delete_program("cell/new.script")
    assert not robot.delete_program("cell/new.script")
    assert not list((tmp_path / "cell").iterdir())


@pytest.mark.parametrize(
    "path",
    ["../out.urp", "/etc/out.urp", "a/../../out.urp", "out/x.urp", "link.urp", "x.py", ".hidden.urp", "", "a\0.urp"],
)
def test_paths_outside_the_folder_and_other_file_types_are_refused(
    robot: VirtualRobot, tmp_path: Path, path: str
) -> None:
    (tmp_path / "out").symlink_to("/tmp", target_is_directory=True)
    (tmp_path / "link.urp").symlink_to(tmp_path / "count.script")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(BadArguments):
        robot.save_program(path, encoded(SCRIPT))
    for other in (robot.read_program, robot.delete_program):
        with pytest.raises(BadArguments):
            other(path)
    assert sorted(tmp_path.rglob("*")) == before


def test_unsavable_programs_are_refused_with_the_reason(robot: VirtualRobot, tmp_path: Path) -> None:
    with pytest.raises(BadArguments, match="must not exceed 2 MiB"):
        robot.save_program("big.script", encoded("#" * (2 << 20) + "\n"))
    with pytest.raises(BadArguments, match="not base64"):
        robot.save_program("x.script", "?")
    with pytest.raises(NotPossible, match="cannot be written"):
        robot.save_program("count.script/x.script", encoded(""))
    with pytest.raises(NotPossible, match=r"nowhere\.urp cannot be read"):
        robot.read_program("nowhere.urp")


def test_without_a_folder_programs_are_saved_to_a_temporary_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    robot = VirtualRobot(ControllerConfig(model=load_model("ur3"), running=True))
    with pytest.raises(NotPossible, match="--programs"):
        robot.read_program("x.script")
    robot.save_program("x.script", encoded(SCRIPT))
    assert robot.programs() == ["external_control.urp", "x.script"]
    assert robot.dashboard("load x.script").startswith("Loading program")
    assert str(tmp_path) in robot.log()[0]


# breakpoints and steps

WAYS = """def ways():
  global n = 0
  def sub():
    $ 5 "sub"
    n = n + 100
  end
  thread beside():
    while (True):
      $ 9 "beside"
      sync()
    end
  end
  run beside()
  while (n < 1000):
    $ 1 "one"
    n = n + 1
    $ 2 "way" "breakAfter"
    n = n + 10
    $ 3 "via" "noBreak"
    sub()
  end
end
"""


@pytest.fixture
def ways(robot: VirtualRobot, tmp_path: Path) -> VirtualRobot:
    (tmp_path / "ways.script").write_text(WAYS)
    robot.dashboard("load ways.script")
    return robot


def paused_at(robot: VirtualRobot) -> str:
    robot.step(50)  # a pause can occur in the same period in which the program continues
    assert robot.state(["runtime_state"])["runtime_state"] == "PAUSED"
    return robot.variables()["n"]


def test_a_breakpoint_pauses_before_its_node_and_after_a_waypoint(ways: VirtualRobot) -> None:
    ways.set_breakpoints([1, 2, 3])
    ways.dashboard("play")
    reached = []
    for _ in range(4):
        reached.append(paused_at(ways))
        ways.dashboard("play")
    assert reached == ["0", "11", "111", "122"]  # 3 is not a node to pause at
    assert ways.breakpoints() == [1, 2, 3]
    paused_at(ways)
    ways.set_breakpoints([])
    ways.dashboard("play")
    ways.run_until("runtime_state == STOPPED")


def test_steps_go_from_node_to_node_of_the_main_program(ways: VirtualRobot) -> None:
    reached = []
    for _ in range(5):
        assert ways.step_program()
        reached.append(paused_at(ways))
    assert reached == ["0", "1", "11", "111", "112"]  # and never in the other thread
    ways.set_breakpoints([1])
    ways.dashboard("load count.script")
    assert ways.breakpoints() == []
    ways.dashboard("play")
    ways.run_until("runtime_state == PLAYING")
    with pytest.raises(NotPossible, match="pause it first"):
        ways.step_program()


def test_a_step_that_cannot_begin_is_discarded(ways: VirtualRobot) -> None:
    ways.dashboard("power off")
    ways.run_until("robot_mode == POWER_OFF")
    assert not ways.step_program()
    ways.release_brakes()
    ways.run_until("robot_mode == RUNNING")
    ways.dashboard("play")
    ways.step(50)
    assert ways.variables() == {}  # it ran to its end


# play from a node


def written(text: str) -> str:
    """An expression, as the editor stores it."""
    letters = text.replace('"', "&quot;")
    parts = letters.split("&quot;")
    shown = '<ExpressionChar character="&quot;"/>'.join(
        "".join(f'<ExpressionChar character="{letter}"/>' for letter in part) for part in parts
    )
    return f"<expression>{shown}</expression>"


def note(letter: str) -> str:
    text = f's = s + "{letter}"'
    return f'<Script type="Line">{written(text)}</Script>'


ORDERED = "".join(
    (
        '<URProgram name="t"><children><MainProgram runOnlyOnce="true" InitVariablesNode="true"><children>',
        '<InitVariablesNode><variables><ProgramVariable name="s">',  # 2
        written('""').replace("expression>", "initializeExpression>"),
        "</ProgramVariable></variables></InitVariablesNode>",
        note("a"),  # 3
        f'<Folder name="F"><children>{note("b")}{note("c")}</children></Folder>',  # 4, 5, 6
        f'<If type="If">{written("False")}<children>{note("d")}</children></If>',  # 7, 8
        f'<If type="Else"><children>{note("e")}{note("f")}</children></If>',  # 9, 10, 11
        '<Loop type="Counting" count="2"><loopVariable name="k"/><children>',  # 12
        f"{note('g')}{note('h')}</children></Loop>",  # 13, 14
        f'<Loop type="While">{written("False")}<children>{note("i")}</children></Loop>',  # 15, 16
        f'<If type="If" checkContinuously="true">{written("False")}<children>{note("x")}</children></If>',  # 17, 18
        "<SuppressedNode><suppressedNode class='Folder' name='Later'/></SuppressedNode>",  # 19
        '<Wait type="Sleep"><waitTime>60</waitTime></Wait></children></MainProgram>',  # 20
        '<Thread name="T" runOnlyOnce="true"><children>',  # 21
        '<Wait type="Sleep"><waitTime>1</waitTime></Wait></children></Thread>',
        "</children></URProgram>",
    )
)


@pytest.fixture
def ordered(robot: VirtualRobot, tmp_path: Path) -> VirtualRobot:
    (tmp_path / "ordered.urp").write_bytes(gzip.compress(ORDERED.encode()))
    robot.dashboard("load ordered.urp")
    return robot


def test_a_program_played_from_a_node_loops_back_to_earlier_nodes(ordered: VirtualRobot) -> None:
    whole = "abcefghgh"
    went = {}
    for node in (1, 3, 4, 6, 7, 8, 11, 14, 16, 20):
        assert ordered.play_from(node)
        ordered.step(50)
        went[node] = ordered.variables()["s"]
        assert ordered.variables()["threadId_T"] == "1"  # threads run, variables have their initial values
        ordered.dashboard("stop")
        ordered.run_until("runtime_state == STOPPED")
    assert went == {
        **{1: whole, 3: whole, 4: whole[1:], 6: whole[2:], 7: whole[3:]},
        **{8: "dghgh", 11: "fghgh", 14: "hgh", 16: "i", 20: ""},
    }


@pytest.mark.parametrize(
    ("node", "reason"),
    [
        (0, "has no node 0"),
        (2, "not part of the robot program"),
        (9, "part of the node before"),
        (18, "node 17, If, whose expression is checked continuously"),
        (19, "suppressed"),
        (22, "not part of the robot program"),
        (23, "has no node 23"),
    ],
)
def test_playing_from_an_unsuitable_node_is_refused_with_the_reason(
    ordered: VirtualRobot, node: int, reason: str
) -> None:
    with pytest.raises(NotPossible, match=reason):
        ordered.play_from(node)
    assert ordered.state(["runtime_state"])["runtime_state"] == "STOPPED"


def test_only_a_loaded_tree_at_rest_can_be_played_from_a_node(ordered: VirtualRobot) -> None:
    ordered.dashboard("play")
    ordered.run_until("runtime_state == PLAYING")
    with pytest.raises(NotPossible, match="stop it first"):
        ordered.play_from(3)
    ordered.dashboard("stop")
    ordered.run_until("runtime_state == STOPPED")
    ordered.dashboard("load count.script")
    with pytest.raises(NotPossible, match="no program tree"):
        ordered.play_from(3)
