"""Verbs that say which programs there are, and what runs."""

import gzip
from pathlib import Path

import pytest

from emulator.control.control import VirtualRobot
from emulator.machine import ControllerConfig
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


def test_programs_are_those_that_load_takes(robot: VirtualRobot, tmp_path: Path) -> None:
    (tmp_path / "cell" / "a").mkdir(parents=True)
    (tmp_path / "cell" / "a" / "deep.script").write_text("textmsg(1)")
    (tmp_path / "tree.script").write_text("def tree():\nend\n")  # as PolyScope saves it with each program
    (tmp_path / "notes.txt").write_text("")
    (tmp_path / "cell" / "round").symlink_to(tmp_path, target_is_directory=True)
    (tmp_path / "elsewhere.script").symlink_to("/etc/hostname")
    assert robot.programs() == ["cell/a/deep.script", "count.script", "tree.urp"]
    for name in robot.programs():
        assert robot.dashboard(f"load {name}").startswith("Loading program")


def test_many_files_take_their_time(robot: VirtualRobot, tmp_path: Path) -> None:
    for number in range(200):
        (tmp_path / f"p{number:03}.script").write_text("")
    before = robot.time()["time_s"]
    assert len(robot.programs()) == 202
    assert robot.time()["time_s"] > before


def test_without_a_folder_there_is_the_program_of_drivers_and_before_the_first_none_runs() -> None:
    robot = VirtualRobot(ControllerConfig(model=load_model("ur5e"), running=True))
    assert robot.programs() == ["external_control.urp"]  # for drivers
    assert robot.program() == {"file": None, "running": False, "text": "", "tree": []}


def test_a_script_has_its_text_before_and_while_it_runs(robot: VirtualRobot) -> None:
    robot.dashboard("load count.script")
    assert robot.program() == {"file": "count.script", "running": False, "text": SCRIPT, "tree": []}
    robot.dashboard("play")
    robot.step(10)
    shown = robot.program()
    assert (shown["file"], shown["running"]) == ("count.script", True)
    line = robot.state(["script_control_line"])["script_control_line"]
    assert "sync()" in shown["text"].splitlines()[line - 1]


def test_a_program_of_a_client_is_shown_while_it_runs_then_the_loaded_one_again(robot: VirtualRobot) -> None:
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


def test_a_tree_has_its_nodes_and_once_played_its_script(robot: VirtualRobot) -> None:
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
