"""Scripts through the primary interface, and the command line."""

import socket

import pytest
from typer.testing import CliRunner

from client import cli, dashboard, rtde
from client.errors import ScriptFailedError
from client.primary import BlockingPrimaryClient, PrimaryClient
from urproto.dashboard import GREETING, encode_line
from urproto.primary.messages import (
    PROGRAM_STARTED,
    PROGRAM_STOPPED,
    KeyMessage,
    RuntimeExceptionMessage,
    TextMessage,
    VersionMessage,
)
from urproto.rtde import codec
from urproto.rtde.fields import OUTPUT_FIELDS
from urproto.rtde.recipes import Recipe
from urproto.versions import PolyscopeVersion

VERSION = PolyscopeVersion(3, 15, 8)
GOOD = "def hello():\n  sleep(1)\nend"
BAD = "def hello():\n  txtmsg(1)\nend"


def run_scripts(connection: socket.socket) -> None:
    connection.sendall(VersionMessage.of(VERSION, "today").encode(VERSION))
    received = b""
    while data := connection.recv(4096):
        received += data
        if not received.endswith(b"end\n"):
            continue
        if b"txtmsg" in received:
            error = RuntimeExceptionMessage(line=2, column=3, text="compile_error_name_not_found:txtmsg:")
            connection.sendall(error.encode(VERSION))
        else:
            connection.sendall(KeyMessage(title=PROGRAM_STARTED, text="hello").encode(VERSION))
            connection.sendall(TextMessage(text="1").encode(VERSION))
            connection.sendall(KeyMessage(title=PROGRAM_STOPPED, text="hello").encode(VERSION))
        received = b""


def test_a_program_runs_and_ends(serve):
    with BlockingPrimaryClient("127.0.0.1", serve(run_scripts)) as robot:
        assert robot.run(robot.core.run_script(GOOD)) == "hello"
        assert robot.run(robot.core.wait_until_stopped()) == "hello"


async def test_a_program_runs_and_ends_async(serve):
    async with PrimaryClient("127.0.0.1", serve(run_scripts)) as robot:
        assert await robot.run(robot.core.run_script(GOOD)) == "hello"
        message = await robot.run(robot.core.next_message())
        assert message == TextMessage(text="1")


def test_a_program_that_does_not_compile(serve):
    with (
        BlockingPrimaryClient("127.0.0.1", serve(run_scripts)) as robot,
        pytest.raises(ScriptFailedError, match="line 2, column 3: compile_error") as failed,
    ):
        robot.run(robot.core.run_script(BAD))
    assert (failed.value.line, failed.value.column) == (2, 3)


# the command line


@pytest.fixture
def invoke(capsys, monkeypatch):
    """Run ``ur-client``; its exit status, output and error output."""

    def run(*arguments: str):
        monkeypatch.setattr("sys.argv", ["ur-client", *arguments])
        with pytest.raises(SystemExit) as end:
            cli.main()
        captured = capsys.readouterr()
        return end.value.code or 0, captured.out, captured.err

    return run


def offset(port: int, standard: int) -> str:
    return str(port - standard)


def test_dashboard_command(serve, invoke):
    def answer(connection):
        connection.sendall(encode_line(GREETING))
        connection.sendall(b"Powering on\n" if connection.recv(100) == b"power on\n" else b"?\n")

    port = serve(answer)
    status, out, _ = invoke("dashboard", "power on", "--port-offset", offset(port, dashboard.PORT))
    assert (status, out) == (0, "Powering on\n")


def test_state_command(serve, invoke):
    names = ("timestamp", "robot_mode", "safety_mode", "runtime_state", "target_speed_fraction",
             "actual_q", "actual_qd", "actual_TCP_pose")  # fmt: skip
    recipe = Recipe.of(names, OUTPUT_FIELDS)
    values = (41.5, 7, 1, 2, 1.0, (0.25,) * 6, (0.0,) * 6, (0.5,) * 6)
    replies = {
        "V": codec.ProtocolReply(True),
        "v": codec.VersionReply(VERSION),
        "O": codec.SetupOutputsReply(recipe.types),
        "S": codec.StartReply(True),
    }

    def answer(connection):
        decoder = codec.RTDEDecoder()
        while data := connection.recv(4096):
            for package in decoder.feed(data):
                connection.sendall(replies[chr(package.type)].encode(2))
                if package.type == ord("S"):
                    connection.sendall(codec.OutputData(recipe.pack(values)).encode(2))

    status, out, _ = invoke("state", "--port-offset", offset(serve(answer), rtde.PORT))
    assert status == 0
    assert "3.15.8" in out
    assert "RUNNING" in out
    assert "PLAYING" in out
    assert "0.2500, 0.2500" in out


def test_errors_are_one_line(invoke):
    with socket.create_server(("127.0.0.1", 0)) as free:
        unused = free.getsockname()[1]
    status, out, err = invoke("dashboard", "play", "--port-offset", offset(unused, dashboard.PORT))
    assert (status, out) == (1, "")
    assert err.startswith("ur-client: no connection to 127.0.0.1")
    assert err.count("\n") == 1


def test_help_names_the_commands():
    result = CliRunner().invoke(cli.app, ["--help"])
    assert all(name in result.output for name in ("dashboard", "state", "send"))
