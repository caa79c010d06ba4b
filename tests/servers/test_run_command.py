"""``urscript run``: whole files on an emulated arm."""

import base64
import io
import json
import socketserver
import subprocess
import sys
import threading
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from emulator import script_cli as cli
from emulator.peers.file import read_peers
from emulator.peers.log import PeersError
from tests.rows import each_row
from urproto.robots import load_model
from urproto.robots.measured import drivetrain_of
from urproto.trace.page import run_in

ROOT = Path(__file__).resolve().parents[2]
Go = Callable[..., tuple[int, str]]


@pytest.fixture
def go(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Go:
    """go(text, *options) -> exit status and output."""

    def run(text: str, *options: str) -> tuple[int, str]:
        path = tmp_path / "demo.txt"
        path.write_text(text)
        status = cli.main(["run", str(path), *options])
        return status, capsys.readouterr().out.replace(str(path), "demo.txt")

    return run


def test_messages_have_the_robot_time_and_the_state_comes_last(go: Go) -> None:
    status, out = go(
        'def f():\n  textmsg("begin ", 1)\n  sleep(0.5)\n  textmsg("end")\n  set_tcp(p[0,0,0.1,0,0,0])\nend'
    )
    lines = out.splitlines()
    assert status == 0
    assert lines[0].endswith("s] begin 1")
    times = [float(line.split()[1]) for line in lines[:2]]
    assert times[1] - times[0] == pytest.approx(0.504, abs=0.009)
    assert lines[-4] == "joints  [-1.6007, -1.7271, -2.2030, -0.8080, 1.5951, -0.0310] rad"
    assert lines[-3].startswith("TCP     p[")
    assert lines[-1] == "result  finished"


def test_the_page_of_a_run(go: Go, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Written for a run that fails as well; what cannot be written is one line."""
    page = tmp_path / "run.html"
    status, out = go('textmsg("there")\nsleep(0.1)\nmovej([9, 0, 0, 0, 0, 0])', "--page", str(page))
    assert (status, "runtime exception" in out) == (1, True)
    run = zlib.decompress(base64.b64decode(run_in(page)))
    header = json.loads(run[4:][: int.from_bytes(run[:4], "little")])
    texts = {lane["name"]: ["".join(entry[1:2]) for entry in lane["entries"]] for lane in header["lanes"]}
    assert "there" in texts["Log"]
    assert "PLAYING" in texts["Program"]
    assert header["samples"] > 1
    cli.main(["run", str(tmp_path / "demo.txt"), "--page", str(tmp_path / "no" / "run.html")])
    assert capsys.readouterr().err == f"urscript run: {tmp_path / 'no' / 'run.html'}: No such file or directory\n"


def test_moves_reach_their_target_on_the_selected_arm(go: Go) -> None:
    program = "movej([0.1,-1.2,0.3,-1.5,0.2,0.4], a=4, v=3)\ntextmsg(get_actual_joint_positions()[0] > 0.09)"
    status, out = go(program, "--model", "ur10e", "--polyscope", "5.11.1")
    assert status == 0
    assert "] True" in out
    assert "joints  [0.1000, -1.2000, 0.3000, -1.5000, 0.2000, 0.4000] rad" in out


def test_objects_around_the_arm_push_back(go: Go, tmp_path: Path) -> None:
    world = tmp_path / "world.yaml"
    world.write_text("objects: {table: {plane: {}, pose: [0, 0, 0.1], stiffness: 10000}}")
    program = """def press():
      movej([0, -1.5, 1.5, -1.57, -1.57, 0], a=4, v=3)
      place = get_actual_tcp_pose()
      place[2] = 0.098
      movel(place)
      sync()
      textmsg("pressed with ", floor(force() + 0.5))
    end"""
    assert "pressed with 20" in go(program, "--world", str(world))[1]
    assert "pressed with 0" in go(program)[1]
    world.write_text("objects: 1")
    assert go(program, "--world", str(world))[0] == 2


def test_the_final_position_of_a_dynamic_arm(go: Go) -> None:
    program = (
        "def f():\n  movej([0.1,-1.2,0.3,-1.5,0.2,0.4], a=4, v=3)\n"
        "  textmsg(get_actual_joint_positions() == get_target_joint_positions())\nend"
    )
    _, ideal = go(program)
    status, out = go(program, "--arm", "dynamic", "--seed", "3")
    assert status == 0
    assert ideal.splitlines()[0].endswith("s] True")
    assert out.splitlines()[0].endswith("s] False")
    assert go(program, "--arm", "dynamic", "--seed", "3")[1] == out


def test_an_arm_file_sets_model_and_parameters(go: Go, tmp_path: Path) -> None:
    program = "movej([0.1,-1.2,0.3,-1.5,0.2,0.4], a=4, v=3)\ntextmsg(get_actual_joint_positions())"
    drives = drivetrain_of(load_model("ur5e")).to_mapping()
    arm = tmp_path / "arm.yaml"
    outputs = []
    for coulomb in (drives["coulomb_Nm"], [1.5 * size for size in drives["coulomb_Nm"]]):
        arm.write_text(json.dumps({"model": "ur5e", **drives, "coulomb_Nm": coulomb}))
        status, out = go(program, "--arm", str(arm))
        assert status == 0
        outputs.append(out)
    assert outputs[0] == go(program, "--arm", "dynamic", "--model", "ur5e")[1]
    assert outputs[0].splitlines()[0] != outputs[1].splitlines()[0]
    arm.write_text(json.dumps({"model": "ur5e"}))
    assert go(program, "--arm", str(arm))[0] == 2


def test_a_blocking_popup_is_shown_and_closed(go: Go) -> None:
    status, out = go('def f():\n  popup("now", title="Look", blocking=True)\n  textmsg("after")\nend')
    assert status == 0
    assert out.index("popup Look: now (continued)") < out.index("after")


def test_programs_of_a_file_run_in_sequence_and_secondary_ones_in_parallel(go: Go) -> None:
    status, out = go(
        '# three\n\ndef a():\n  while not get_standard_digital_out(2):\n    sync()\n  end\n  textmsg("a")\nend\n'
        'sec s():\n  set_standard_digital_out(2, True)\nend\ndef b():\n  textmsg("b")\nend\ntextmsg("line")\n',
        "--timeout",
        "5",
    )
    assert status == 0
    assert [line.rsplit(" ", 1)[1] for line in out.splitlines()[:3]] == ["a", "b", "line"]


def test_compile_errors_are_all_shown_and_nothing_runs(go: Go) -> None:
    status, out = go('# c\ntextmsg("never")\nx = nope\ny = (1\nz = norn(1)\n')
    assert status == 1
    assert "[ " not in out
    assert [line.split(": ")[0] for line in out.splitlines() if line.startswith("demo")] == [
        "demo.txt:3:5",
        "demo.txt:4:7",
        "demo.txt:5:5",
    ]


def test_a_runtime_exception_has_a_caret_in_the_file(go: Go) -> None:
    status, out = go("# first\ndef a():\n  sync()\nend\n\n# second\ndef b():\n  x = [1]\n  y = x[3]\nend\n")
    assert status == 1
    assert "demo.txt:9:8: Index out of bounds: 3, the length is 1\n  9 |   y = x[3]\n    |        ^" in out
    assert out.endswith("result  runtime exception: line 9: Index out of bounds: 3, the length is 1\n")


def test_a_protective_stop_ends_the_run(go: Go) -> None:
    status, out = go(MOVE_OUT_OF_REACH)
    assert status == 1
    assert "safety mode PROTECTIVE_STOP" in out
    assert "result  the arm was stopped: protective stop" in out


MOVE_OUT_OF_REACH = """def f():
  here = get_actual_tcp_pose()
  movel(pose_add(here, p[0, 0, -0.2, 0, 0, 0]))
  speedl([0, 0, 3, 0, 0, 0], a=20, t=10)
end
"""


def test_a_program_that_a_watchdog_stops_has_failed(go: Go) -> None:
    watchdog = 'rtde_set_watchdog("input_int_register_24", 10, "stop")'
    status, out = go(f"def f():\n  {watchdog}\n  while True:\n    sync()\n  end\nend\n")
    assert status == 1
    assert out.splitlines()[-1].startswith("result  ")
    assert "finished" not in out.splitlines()[-1]


@each_row("end", ["halt", "return None", "sync()"])
def test_a_program_that_reaches_its_end_has_not_failed(go: Go, end: str) -> None:
    status, out = go(f"def f():\n  sleep(0.1)\n  {end}\nend\n")
    assert (status, out.splitlines()[-1]) == (0, "result  finished")


def test_a_closed_pipe_ends_the_run_silently(tmp_path: Path) -> None:
    script = tmp_path / "long.script"
    script.write_text('def f():\n  while True:\n    textmsg("a line of text")\n    sync()\n  end\nend\n')
    command = [sys.executable, "-m", "urscript", "run", str(script), "--timeout", "60"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert b"a line of text" in process.stdout.readline()
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(30) == 141


def test_a_failed_secondary_program_is_a_failure(go: Go) -> None:
    status, out = go("sec s():\n  sleep(1)\nend\n")
    assert status == 1
    assert "result  a secondary program failed" in out


def test_questions_and_paused_programs_end_the_run(go: Go) -> None:
    status, out = go('def f():\n  x = request_integer_from_primary_client("how many?")\nend')
    assert status == 1
    assert "question: how many?" in out
    assert "give one with --answer" in out


def test_an_endless_program_is_stopped(go: Go) -> None:
    status, out = go("while True:\n  sync()\nend", "--timeout", "2.5")
    assert status == 1
    assert "time    2.504 s\nresult  not finished within 2.5 s" in out or "time    2.5" in out


TRACED = """# traced
def f():
  def twice(n):
    return 2 * n
  end
  thread t():
    sync()
  end
  x = 0
  join run t()
  while x < 2:
    x = x + twice(1)
  end
  if x == 1:
    x = 2
  elif x == 2:
    x = 3
  end
end
"""


def test_trace_shows_every_statement_with_time_and_thread(go: Go) -> None:
    status, out = go(TRACED, "--trace")
    assert status == 0
    steps = [line.split("] ")[1] for line in out.splitlines() if line.startswith("[")]
    body = [step.removeprefix("f:") for step in steps if step.startswith("f:")]
    assert body == [
        "9: x = 0",
        "10: join run t()",
        "11: while x < 2:",
        "12: x = x + twice(1)",
        "4: return 2 * n",
        "11: while x < 2:",
        "14: if x == 1:",
        "17: x = 3",
    ]
    assert "t:7: sync()" in steps


def test_tracing_does_not_change_timing(go: Go) -> None:
    function = "  def g(n):\n    return n + 1\n  end\n"
    text = f"def f():\n{function}  x = 0\n  while x < 3000:\n    x = g(x)\n  end\n  textmsg(x)\nend"
    plain, traced = go(text)[1], go(text, "--trace")[1]
    assert plain.splitlines() == [line for line in traced.splitlines() if ": " not in line]


class _Echo(socketserver.StreamRequestHandler):
    def handle(self) -> None:
        self.wfile.write(b"(" + self.rfile.readline().strip() + b")")


@pytest.fixture
def echo_port() -> Iterator[int]:
    with socketserver.TCPServer(("127.0.0.1", 0), _Echo) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield server.server_address[1]
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("speed", ["max", "3"])
def test_script_sockets_are_real(go: Go, echo_port: int, speed: str) -> None:
    program = (
        f'def f():\n  open = socket_open("127.0.0.1", {echo_port}, "s")\n  socket_send_line("41, 42", "s")\n'
        '  got = socket_read_ascii_float(2, "s", 20)\n  textmsg(open, got)\n  socket_close("s")\nend'
    )
    status, out = go(program, "--speed", speed)
    assert status == 0
    assert "True[2,41,42]" in out


def test_standard_input(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(b"x = [1][2]")))
    assert cli.main(["run", "-"]) == 1
    assert "<stdin>:1:8: Index out of bounds" in capsys.readouterr().out


@pytest.mark.parametrize("options", [["--model", "ur4"], ["--polyscope", "9.1"], ["nowhere.script"]])
def test_invalid_usage(options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "a.script"
    file.write_text("sync()")
    arguments = options if options == ["nowhere.script"] else [str(file), *options]
    assert cli.main(["run", *arguments]) == 2
    assert "urscript run: " in capsys.readouterr().err


@each_row("options", [["--speed", "0"], ["--speed", "quick"], ["--timeout", "-1"]])
def test_invalid_numbers(options: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["run", "a.script", *options])
    assert ended.value.code == 2


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.script")), ids=lambda path: path.name)
def test_examples_run(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["run", str(path), "--timeout", "120"]) == 0
    assert "result  finished" in capsys.readouterr().out


def test_a_script_cannot_use_a_forbidden_network(go: Go) -> None:
    with socketserver.TCPServer(("127.0.0.1", 0), socketserver.BaseRequestHandler) as server:
        program = f'textmsg(socket_open("127.0.0.1", {server.server_address[1]}))'
        _, forbidden = go(program, "--script-network", "none")
    assert "False" in forbidden.splitlines()[-5]
    assert "network" in forbidden


def test_a_run_begins_at_the_given_joint_angles(go: Go) -> None:
    joints = ["-0.5", "-1.2", "1.1", "-1.5", "-1.5", "0.25"]
    status, out = go("textmsg(get_actual_joint_positions())", "--joints", *joints)
    assert status == 0
    assert "joints  [-0.5000, -1.2000, 1.1000, -1.5000, -1.5000, 0.2500] rad" in out


def test_inputs_and_registers_are_set_from_the_command_line_at_given_times(go: Go) -> None:
    program = """def f():
      textmsg("before ", [get_standard_digital_in(3), get_tool_digital_in(1), read_input_boolean_register(12)])
      textmsg(get_standard_analog_in(1), read_input_float_register(2))
      while read_input_integer_register(24) < 7:
        sync()
      end
      textmsg("after ", get_standard_digital_in(3))
    end"""
    inputs = ["--input", "digital3=1", "--input", "digital3=0@0.4", "--input", "tool1=true", "--input", "analog1=2.5"]
    registers = ["--register", "bool12=True", "--register", "float2=-0.5", "--register", "int24=7@0.5"]
    status, out = go(program, *inputs, *registers, "--timeout", "5")
    assert status == 0
    lines = out.splitlines()
    assert lines[0].endswith("before [True,True,True]")
    assert lines[1].endswith("2.5-0.5")
    assert lines[2].endswith("after False")
    assert float(lines[2].split()[1]) == pytest.approx(0.5, abs=0.02)


def test_questions_get_the_given_answers_in_order(go: Go) -> None:
    program = (
        'def f():\n  textmsg("n ", request_integer_from_primary_client("how many?"))\n'
        '  textmsg("b ", request_boolean_from_primary_client("sure?"))\n'
        '  textmsg("s ", request_string_from_primary_client("who?"))\nend'
    )
    status, out = go(program, "--answer", "5", "--answer", "yes", "--answer", "me")
    assert status == 0
    assert [text in out for text in ("] n 5", "] b True", "] s me", "question: sure? (answered yes)")] == [True] * 4
    status, out = go(program, "--answer", "5")
    assert status == 1
    assert "give one with --answer" in out
    status, out = go(program, "--answer", "many")
    assert status == 1
    assert "the answer 'many' was refused" in out


def test_simulated_peers_answer(go: Go, tmp_path: Path) -> None:
    peers = tmp_path / "peers.yaml"
    peers.write_text(
        "sockets:\n"
        '  10.99.1.2:5000: {greeting: "hi\\n", answers: {where: "(0.1, -2.5)", \'*\': [one, two]}}\n'
        "  '*:63352': {answers: {GET POS: \"POS 3\\n\", 'SET *': ack}}\n"
        "xmlrpc:\n"
        "  http://10.99.1.3:8080: {grip: true, where: {x: 0.1, y: 0.2, z: 0.3, rx: 0, ry: 0, rz: 1}}\n"
    )
    program = """def f():
      textmsg("open ", socket_open("10.99.1.2", 5000))
      textmsg("hello ", socket_read_line())
      socket_send_string("where")
      textmsg("at ", socket_read_ascii_float(2))
      socket_send_line("other")
      textmsg("first ", socket_read_string())
      socket_send_line("other")
      textmsg("then ", socket_read_string())
      socket_open("127.0.0.1", 63352, "gripper")
      socket_set_var("POS", 255, "gripper")
      textmsg("ack ", socket_read_byte_list(3, "gripper"))
      textmsg("pos ", socket_get_var("POS", "gripper"))
      tool = rpc_factory("xmlrpc", "http://10.99.1.3:8080/RPC2")
      textmsg("grip ", tool.grip(1))
      textmsg("where ", tool.where())
      textmsg("elsewhere ", socket_open("10.99.1.2", 5001, "x"))
      tool.unheard_of()
    end"""
    status, out = go(program, "--peers", str(peers), "--script-network", "none")
    texts = [line.split("] ", 1)[1] for line in out.splitlines() if line.startswith("[")]
    assert [text for text in texts if "network" not in text][:10] == [
        "open True",
        "hello hi",
        "at [2,0.1,-2.5]",
        "first one",
        "then two",
        "ack [3,97,99,107]",
        "pos 3",
        "grip True",
        "where p[0.1,0.2,0.3,0,0,1]",
        "elsewhere False",
    ]
    assert status == 1
    assert "has no method unheard_of" in out


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--joints", *"000009", "--model", "ur5"], "joint 5 cannot be at 9 rad"),
        (["--joints", *"00000x"], "'x' is not a number"),
        (["--input", "digital9=1"], "there is no digital9: choose from digital0 to 7"),
        (["--input", "digital1"], "not of the form NAME=VALUE"),
        (["--register", "int3=0.5"], "32-bit integer"),
        (["--register", "float3=nan"], "'nan' is not a number"),
        (["--peers", "missing.yaml"], "missing.yaml"),
    ],
)
def test_invalid_run_options(
    options: list[str], complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.script"
    path.write_text("sync()\n")
    assert cli.main(["run", str(path), *options]) == 2
    assert complaint in capsys.readouterr().err


@each_row(
    ("text", "complaint"),
    [
        ("- 1", "must be a mapping, not a list"),
        ("ftp: {}", "unknown 'ftp'; allowed are sockets, xmlrpc, modbus"),
        ("sockets: {10.0.0.1: {}}", "is not an address"),
        ("sockets: {'a:1': {says: b}}", "a:1: unknown 'says'; allowed are expect, delay"),
        ("sockets: {'a:1': {answers: {x: []}}}", "of length >= 1"),
        ("sockets: {'a:1': {answers: {x: [[1]]}}}", "text or a mapping, not a list"),
        ("sockets: {'a:1': {answers: {x: '${n}'}}}", "there is no variable n"),
        ("sockets: {'a:1': {greeting: '${n}'}}", "there is no variable n"),
        ("sockets: {'a:1': {answers: {/(/: y}}}", "is not a regular expression"),
        ("sockets: {'a:1': {answers: 'gone.py:f'}}", "gone.py:f: FileNotFoundError"),
        ("sockets: {'a:1': {binary: true, answers: {x: y}}}", "'y' is not hexadecimal"),
        ("sockets: {'a:1': {size: 0}}", "size must be a whole number >= 1"),
        ("sockets: {'a:1': {delay: -1}}", "delay must be a number >= 0"),
        ("modbus: {a: {coils: {0: []}}}", "of length >= 1"),
        ("xmlrpc: {'a:1': {}}", "is not an XML-RPC address"),
        ("[", "is not YAML"),
    ],
)
def test_an_invalid_peers_file(text: str, complaint: str, tmp_path: Path) -> None:
    path = tmp_path / "peers.yaml"
    path.write_text(text)
    with pytest.raises(PeersError, match=complaint):
        read_peers(path)
