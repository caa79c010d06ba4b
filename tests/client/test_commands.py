"""What the commands tell a shell: exit statuses, JSON, completion, and silence when Ctrl-C comes early."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path

import pytest

from tests.budget import subset
from urproto.testing.process import EmulatorProcess

if sys.platform != "linux":  # emulators have addresses of their own there
    pytest.skip("the loopback addresses are those of Linux", allow_module_level=True)

LATER = partial(pytest.param, marks=pytest.mark.long)  # with the long tests
ROOT = Path(__file__).parents[2]
SCRIPTS = Path(sys.executable).parent
DEADLINE_S = 60


@pytest.fixture(scope="module")
def robot() -> Iterator[EmulatorProcess]:
    with EmulatorProcess(["--running"]) as robot:
        yield robot


def run(*command: str, host: str = "127.0.0.1", folder: Path = ROOT) -> "subprocess.CompletedProcess[str]":
    environment = os.environ | {"UR_ROBOT_IP": host, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-m", *command],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )


@pytest.mark.parametrize(
    ("line", "status", "output"),
    [
        ("robotmode", 0, "Robotmode: RUNNING\n"),
        ("get loaded program", 0, "No program loaded\n"),
        LATER("setUserRole operator", 0, "Setting user role: operator\n"),
        ("make coffee", 1, "could not understand: 'make coffee' - this controller does not know the command"),
        LATER("load nothing.urp", 1, "File not found: nothing.urp"),
        LATER("play", 1, "Failed to execute: play"),
        LATER("setUserRole king", 1, "Failed setting user role: king"),
        ("version", 1, "could not understand: 'version'"),  # CB3 has none
    ],
)
def test_dashboard(robot: EmulatorProcess, line: str, status: int, output: str) -> None:
    done = run("client", "dashboard", line, host=robot.host)
    assert done.returncode == status, done.stderr
    if status:
        assert done.stdout == ""
        assert done.stderr.count("\n") == 1
        assert output in done.stderr
    else:
        assert (done.stdout, done.stderr) == (output, "")


def test_json(robot: EmulatorProcess) -> None:
    done = run("client", "dashboard", "play", "--json", host=robot.host)
    assert json.loads(done.stdout) == {"command": "play", "answer": "Failed to execute: play", "done": False}
    assert done.returncode == 1
    state = json.loads(run("client", "state", "--json", host=robot.host).stdout)
    assert (state["robot_mode"], state["polyscope"]) == ("RUNNING", "3.15.8")  # RTDE reports the build of URControl
    assert len(state["actual_q"]) == 6
    checked = json.loads(script("ur-emulator-check", robot.host, "--json"))
    assert {one["server"]: one["found"] for one in checked}["rtde"] == "ok"
    types = json.loads(run("client", "controllers", "types", "--json").stdout)
    assert "forward_command_controller/ForwardCommandController" in types["types"]
    doctor = json.loads(run("client", "doctor", "--json").stdout)
    assert {"grade", "subject", "text", "mend"} <= doctor[0].keys()


def script(name: str, *arguments: str) -> str:
    return subprocess.run(
        [SCRIPTS / name, *arguments], capture_output=True, text=True, timeout=DEADLINE_S, check=False
    ).stdout


def test_states_as_lines_of_json(robot: EmulatorProcess) -> None:
    command = [sys.executable, "-m", "client", "watch", "actual_q", "robot_mode", "--json", "--robot-ip", robot.host]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT, text=True) as watching:
        assert watching.stdout is not None
        states = [json.loads(watching.stdout.readline()) for _ in range(3)]
        watching.send_signal(signal.SIGINT)
    assert all(len(state["actual_q"]) == 6 and state["robot_mode"] == 7 for state in states)


@pytest.mark.parametrize(
    ("text", "options", "status", "output"),
    [
        ("# first\ndef hello():\n  sleep(0.1)\nend\n", (), 0, "hello is running\n"),
        ("def hello():\n  sleep(0.1)\nend\n", ("--wait",), 0, "hello is running\nhello has ended\n"),
        LATER("set_digital_out(0, True)\n", (), 0, " is running\n"),
        ("sec s():\n  set_digital_out(0, True)\nend\n", (), 0, "sent "),
        ("sec s():\n  set_digital_ut(0, True)\nend\n", (), 1, "hello.script:2:3: "),
        LATER(
            "sec s():\n  set_digital_ut(0, True)\nend\n", ("--no-check",), 1, "line 2, column 3: compile_error_name_not"
        ),
        LATER("sec s():\n  set_digital_out(0, True)\nend\n", ("--wait",), 2, "a controller does not report the end"),
        LATER(
            "def hello():\n  txtmsg(1)\nend\n", ("--no-check",), 1, "hello line 2, column 3: compile_error_name_not_fou"
        ),
        ("# A page\n\nThis is prose, and no program.\n", (), 1, "hello.script:3:6: syntax error at 'is'"),
        LATER("# A page\n\nThis is prose, and no program.\n", ("--no-check",), 1, "syntax_error_on_line:3"),
        ("def hello():\n  a = [1]\n  b = a[5]\nend\n", ("--wait",), 1, "hello line 3"),
    ],
)
def test_send(
    robot: EmulatorProcess, tmp_path: Path, text: str, options: tuple[str, ...], status: int, output: str
) -> None:
    (file := tmp_path / "hello.script").write_text(text)
    done = run("client", "send", str(file), *options, host=robot.host)
    assert done.returncode == status, done.stderr
    assert output in (done.stderr if status else done.stdout)


@pytest.mark.parametrize(
    ("verb", "reason", "mended_by"),
    [
        ("protective_stop", "PROTECTIVE_STOP C209A0", ("restart_safety", "release_brakes")),
        LATER("press_emergency_stop", "ROBOT_EMERGENCY_STOP", ("release_emergency_stop", "release_brakes")),
        LATER("power_off", "the robot mode is POWER_OFF", ("release_brakes",)),
        LATER("stop", "it was stopped before its end", ()),
    ],
)
def test_waiting_ends_when_the_robot_stops(tmp_path: Path, verb: str, reason: str, mended_by: tuple[str, ...]) -> None:
    (file := tmp_path / "long.script").write_text("def long():\n  sleep(600)\nend\n")
    with EmulatorProcess(["--running"]) as robot:
        command = [sys.executable, "-m", "client", "send", str(file), "--wait", "--robot-ip", robot.host]
        with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as sending:
            assert sending.stdout is not None
            assert sending.stdout.readline() == "long is running\n"
            if verb == "stop":
                run("client", "dashboard", "stop", host=robot.host)
            else:
                getattr(robot.control, verb)()
            _, output = sending.communicate(timeout=DEADLINE_S)
    assert sending.returncode == 1
    assert "program long:" in output
    assert reason in output
    assert output.count("\n") == 1


def test_brackets_in_texts_are_no_markup(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(
        "controller_manager:\n  ros__parameters:\n    update_rate: 500\n    arm:\n      type: made/Up[rad]\n"
    )
    done = run("client", "controllers", "list", "--controllers", str(tmp_path / "c.yaml"))
    assert done.returncode == 1
    assert "made/Up[rad]" in done.stdout


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion(shell: str) -> None:
    """The script that Typer writes makes the shell complete commands, options and values."""
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    for words, expected in (
        (["ur-client", "dash"], "dashboard"),
        (["ur-client", "dashboard", "rob"], "robotmode"),
        (["ur-client", "watch", "actual_TCP_p"], "actual_TCP_pose"),
        (["ur-emulator", "fl"], "fleet"),
        (["ur-emulator", "--model", "ur16"], "ur16e"),
        (["ur-emulator-check", "--req"], "--require"),
    ):
        assert expected in completed(shell, words), words


@cache
def completion_source(shell: str, program: str) -> str:
    """As --show-completion prints it in that shell."""
    environment = os.environ | {completion_variable(program): f"source_{shell}"}
    return subprocess.run([SCRIPTS / program], env=environment, capture_output=True, text=True, check=True).stdout


def completion_variable(program: str) -> str:
    return f"_{program.replace('-', '_').upper()}_COMPLETE"


def completed(shell: str, words: list[str]) -> str:
    program = words[0]
    variable, source = completion_variable(program), completion_source(shell, program)
    environment = os.environ | {"PATH": f"{SCRIPTS}:{os.environ['PATH']}"}
    function = f"_{program.replace('-', '_')}_completion"
    if shell == "bash":
        listed = " ".join(words)
        completion = f"COMP_WORDS=({listed}); COMP_CWORD={len(words) - 1}; {function} {program}"
        code = f'{source}\n{completion}; echo "${{COMPREPLY[@]}}"'
    elif shell == "fish":
        code = f"{source}\ncomplete --do-complete '{' '.join(words)}'"
    else:  # its completion needs a terminal: what the function asks for is asked for
        assert function in source or variable in source
        code = f"{variable}=complete_zsh _TYPER_COMPLETE_ARGS='{' '.join(words)}' {program}"
    command = [shell, "-f", "-c", code] if shell == "zsh" else [shell, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=DEADLINE_S, check=False)
    return done.stdout + done.stderr


@pytest.mark.parametrize("name", ["ur-emulator", "ur-client", "ur-emulator-check"])
def test_version(name: str) -> None:
    assert script(name, "--version").split()[0] == name


@pytest.mark.parametrize(
    "command",
    subset(["ur-emulator --ephemeral-ports", "ur-client state", "urscript run x"], now=["ur-client state"]),
)
def test_an_early_ctrl_c_ends_in_silence(command: str, tmp_path: Path) -> None:
    """At any moment of the start, imports of compiled packages among them."""
    (tmp_path / "x").write_text("sleep(60)\n")
    environment = os.environ | {"UR_ROBOT_IP": "127.0.0.1"}
    chance = random.Random(1)
    # whoever started the tests in the background may have told them to ignore Ctrl-C
    begin = "import signal, sys\nsignal.signal(signal.SIGINT, signal.default_int_handler)\nprint('begun', flush=True)\n"
    begin += "from {}.__main__ import main\nsys.argv = {}\nmain()"
    words = command.split()
    entry = {"ur-emulator": "emulator", "ur-client": "client"}.get(words[0], words[0])
    for _ in range(4):
        with subprocess.Popen(
            [sys.executable, "-c", begin.format(entry, words)],
            cwd=tmp_path,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "begun\n"
            time.sleep(chance.uniform(0.0, 0.6))
            process.send_signal(signal.SIGINT)
            _, output = process.communicate(timeout=DEADLINE_S)
        assert "Traceback" not in output, output
        assert "Exception" not in output, output
