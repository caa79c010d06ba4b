"""The emulator plays programs created on the command line; a node type is declared in one place."""

import json
import runpy
from pathlib import Path

import pytest
from editing_rig import CB3, E_SERIES, ZERO, editor, id_of, outline, reopened
from tree_rig import Arm
from typer.testing import CliRunner

from client.commands.program import program_app
from client.errors import URError
from client.programs import all_problems, open_program
from tests.networks import MemorySockets
from urproto.modes import RuntimeState
from urscript.polyscope.document import make, read_document, unpacked, write_document
from urscript.polyscope.editing import ROOT
from urscript.polyscope.files import outline_text, save_program
from urscript.polyscope.forms import attribute_number, attribute_text
from urscript.polyscope.installation_settings import set_driver_address
from urscript.polyscope.registry import NODES, Kind, node
from urscript.polyscope.surroundings import ORDERS

PAGE = Path(__file__).resolve().parents[2] / "docs" / "generate.py"
CODE = b'# HEADER_BEGIN\nglobal nodes = 0\n# HEADER_END\n# NODE_CONTROL_LOOP_BEGINS\nnodes = nodes + 1\n\
textmsg("node ", nodes)\nsleep(0.1)\n# NODE_CONTROL_LOOP_ENDS\n\n'


def run(*arguments: object) -> str:
    """What the command prints. Raises its error."""
    done = CliRunner().invoke(program_app, [str(argument) for argument in arguments])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == 0, done.output
    return done.output


@pytest.mark.parametrize(
    ("model", "options"), [("ur3", []), ("ur5", ["--polyscope", "3.12"]), ("ur5e", ["--model", "ur5e"])]
)
def test_the_emulator_plays_a_program_created_with_new(tmp_path, model, options):
    """Loaded from the dashboard, it sends a request to the driver in its installation, and runs the answer."""
    path = tmp_path / "external_control.urp"
    output_text = run("new", path, "--host", "10.1.2.3", "--port", 50010, *(options or ["--model", model]))
    assert "the driver is at 10.1.2.3:50010" in output_text
    assert not path.with_suffix(".script").exists()  # its code is from the driver
    assert path.with_suffix(".txt").read_text().splitlines()[-1] == "     Control by 10.1.2.3"
    arm = Arm(tmp_path, model)
    network = arm.controller.programs.socket_backend = MemorySockets(("10.1.2.3", 50010))
    assert arm.request("load external_control.urp").startswith("Loading program: /programs/external_control.urp")
    answers: list[str] = []
    from emulator.commands.requests import DashboardLine

    arm.controller.post(DashboardLine("play"), answers.append)
    arm.until(lambda: network.opened and network.opened[-1].sent == b"request_program\n", 0.2)
    network.opened[-1].feed(CODE)
    arm.until(lambda: answers, 0.5)
    assert answers == ["Starting program"]
    arm.until(lambda: arm.state is RuntimeState.STOPPED)
    assert arm.texts == ["node 1"]


@pytest.mark.parametrize("version", [CB3, E_SERIES])
def test_the_emulator_plays_a_program_saved_by_the_editor(tmp_path, version):
    """From the tree and from the accompanying script: the same motion, the same outputs."""
    made = editor(version)
    waypoint = made.insert("waypoint", into=ROOT)
    made.set(id_of(made, "robot_program"), "loops", False)
    goal = (0.1, -1.4, 1.4, -1.6, -1.57, 0.1)
    from urproto.robots import kinematics_of

    made.teach(waypoint, goal, kinematics_of(made.program.model).forward(goal), ZERO)
    loop = made.insert("loop", into=ROOT, values={"type": "Counting", "count": 2})
    made.insert("set", into=loop, values={"type": "DigitalOutput", "output": "clamp", "level": "1"})
    made.insert("script", into=loop, values={"line": f'textmsg("round ", {made.form(loop)["fields"][2]["value"]})'})
    assert save_program(made, tmp_path / "made.urp") == ""
    (tmp_path / "alone.script").write_bytes((tmp_path / "made.script").read_bytes())
    (tmp_path / "cell.installation").write_bytes(
        b'<Installation><IOs><DigitalOutputNames value=", , , clamp, , , , "/></IOs><T activePose="TCP"><tcp name="TCP"'
        b' offset="0,0,0,0,0,0"/></T></Installation>'
    )
    made.set(id_of(made, "robot_program"), "loops", True)
    made.undo()
    root = read_document((tmp_path / "made.urp").read_bytes())
    root.attributes |= {"installation": "cell", "installationRelativePath": "cell"}
    (tmp_path / "made.urp").write_bytes(write_document(root))
    for name in ("made.urp", "alone.script"):
        arm = Arm(tmp_path, "ur5e" if version is E_SERIES else "ur5")
        assert arm.request(f"load {name}").startswith("Loading program")
        assert arm.request("play") == "Starting program", arm.messages
        arm.until(lambda arm=arm: arm.state is RuntimeState.STOPPED)
        assert arm.q == pytest.approx(goal, abs=1e-3), name
        assert arm.texts == ["round 0", "round 1"], name
        assert arm.controller.snapshot.actual_digital_output_bits & 8, name


def test_the_command_line_shows_checks_and_exports(tmp_path):
    path = tmp_path / "p.urp"
    run("new", path, "--empty")
    with pytest.raises(URError, match=r"p\.urp: exists: pass --force to overwrite it"):
        run("new", path)
    for wrong, output_text in [
        (("new", tmp_path / "p.txt"), r"the name of a program must end in \.urp"),
        (("new", tmp_path / "q.urp", "--model", "ur7"), "ur7"),
        (("new", tmp_path / "q.urp", "--empty", "--host", "h"), "--empty leaves out"),
        (("show", tmp_path / "none.urp"), "none.urp: No such file"),
        (("export", path, "-o", tmp_path / "p.pdf"), r"exported to \.script or \.txt"),
    ]:
        with pytest.raises(URError, match=output_text):
            run(*wrong)
    lacks = "<empty> lacks the node to execute here"
    assert run("show", path, "--numbers").splitlines()[1:] == [
        "1   Variables Setup",
        "2   Robot Program | Program loops forever: yes",
        "3     <empty>",
    ]
    done = CliRunner().invoke(program_app, ["check", str(path)])
    assert (done.exit_code, done.output) == (1, f"{path}:3: <empty>: {lacks}\n")
    edited = open_program(path)
    wait = edited.insert("wait", into=ROOT, values={"type": "Sleep", "time": 0.25})
    save_program(edited, path)
    assert run("check", path).startswith(f"{path}: no problems found for PolyScope 3.15")
    assert run("export", path).split() == [str(path.with_suffix(".script")), str(path.with_suffix(".txt"))]
    assert "  sleep(0.25)" in path.with_suffix(".script").read_text()
    assert path.with_suffix(".txt").read_text() == " Program\n   Variables Setup\n   Robot Program\n     Wait: 0.25\n"
    shown = json.loads(run("show", path, "--json"))
    assert shown[-1]["values"] == {"Wait for": "A time", "Time": "0.25 s"}
    line = edited.insert("script", after=wait, values={"line": "movel(1,"})
    problems = all_problems(edited)
    assert [problem.node for problem in problems] == [line], problems  # the checker's line belongs to the node
    (tmp_path / "broken.urp").write_bytes(b"\x1f\x8bnothing")
    (tmp_path / "default.installation").write_bytes(b"<URProgram/>")
    with pytest.raises(URError, match=r"broken\.urp: "):
        run("show", tmp_path / "broken.urp")
    with pytest.raises(URError, match=r"default\.installation: <URProgram> is not an installation"):
        run("new", tmp_path / "q.urp", "--host", "10.0.0.1")


def test_adding_a_driver_keeps_the_rest_of_the_installation(tmp_path):
    before = (
        b'<Installation directory="/programs">\n  <IOs>\n    <A value=", "/>\n  </IOs>\n'
        b'  <Alias reference="../IOs"/>\n  <T activePose="TCP">\n    <tcp name="TCP" offset="0,0,0,0,0,0"/>\n  </T>\n'
        b"  <Contributions>\n    <URCaps>\n"
        b'      <Contributed id="EthernetIP" name="Ethernet/IP"/>\n'
        b'      <Contributed id="x" name="External Control">\n        <data key="host_ip" value="1.2.3.4"/>\n'
        b"      </Contributed>\n    </URCaps>\n  </Contributions>\n</Installation>"
    )
    (tmp_path / "cell.installation").write_bytes(before)
    run("new", tmp_path / "p.urp", "--host", "10.0.0.9", "--installation", "cell")
    after = unpacked((tmp_path / "cell.installation").read_bytes())
    line = b'        <data key="name" value="10.0.0.9"/>\n'
    expected = before.replace(b"1.2.3.4", b"10.0.0.9").replace(b'9"/>\n      </', b'9"/>\n' + line + b"      </")
    assert after == expected
    root = read_document(after)
    set_driver_address(root, "10.0.0.9", 50099)
    assert b'<data key="port_nr" value="50099"/>' in write_document(root)


def test_suppressed_nodes_are_quoted_in_the_text():
    made = editor()
    move = made.insert("move", into=ROOT)
    made.insert("comment", into=move, values={"comment": "a"})
    made.insert("comment", into=ROOT, values={"comment": "b"})
    made.suppress(move)
    assert outline_text(made) == (" Program\n   Variables Setup\n   Robot Program\n     'MoveJ'\n     'b'\n")


@pytest.fixture
def blink():
    """A node type that the tests add in one place."""

    @node(
        "Blink",
        Kind(
            "blink",
            "Blink",
            "Advanced",
            lambda element: f"Blink {element.get('times')} times",
            new=lambda _: make("Blink", times="3"),
            undefined=lambda element: "" if element.get("text") else "its text",
            fields=(
                attribute_number("times", "Times", "times", whole=True, low=1, high=9),
                attribute_text("text", "Text", "text"),
            ),
        ),
        attributes="text times",
    )
    def translate(writer, element):
        """Write a message several times."""
        for _ in range(int(element.get("times"))):
            writer.line(f'textmsg("{element.get("text")}")')

    yield
    del NODES["Blink"], ORDERS["Blink"]


@pytest.mark.usefixtures("blink")
def test_a_new_node_type_is_declared_in_one_place():
    made = editor()
    assert {"key": "blink", "title": "Blink", "group": "Advanced"} in made.palette()
    added = made.insert("blink", into=ROOT)
    assert [problem.message for problem in made.problems()] == ["Blink 3 times lacks its text"]
    assert [field["key"] for field in made.form(added)["fields"]] == ["times", "text"]
    made.set_all(added, {"times": 2, "text": "on"})
    assert made.problems() == []
    assert b'<Blink text="on" times="2"/>' in made.document()  # in its attribute order
    assert outline(reopened(made)) == outline(made)
    assert made.written().text().count('textmsg("on")') == 2
    page = runpy.run_path(str(PAGE))["program_nodes"]()
    assert "| `blink` | Blink | among nodes | `times` (integer 1 to 9); `text` (text) |" in page
