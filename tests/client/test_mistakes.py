"""Mistakes that people make on a command line, and the line that tells them what to do."""

import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from tests.rows import each_row
from urproto.commandline import Deferred

MISTAKES = {
    "client.cli": (
        (["dashbord"], "No such command 'dashbord'. Did you mean 'dashboard'?"),
        (["send", "missing.script"], "File 'missing.script' does not exist."),
        (["send", "."], "File '.' is a directory."),
        (["send", "program.urp"], "program.urp: is not text"),
        (["send", "sec.script", "--wait"], "a controller does not report the end of a secondary program: leave out"),
        (["goal", "--positions", "0,-90,0,-90,0,0"], "takes radians, but -90 looks like degrees: add --degrees"),
        (["goal", "--positions", "0,0,0"], "--positions takes 6 joint angles, not 3"),
        (["goal", "--positions", "a,b,c,d,e,f"], "--positions takes numbers separated by commas, not 'a,b,c,d,e,f'"),
        (["watch", "actual_tcp"], "no RTDE output is called 'actual_tcp': did you mean actual_q"),
        (["installation", "show", "missing.installation"], "missing.installation: No such file or directory"),
        (["pendant", "--port", "99999"], "99999 is not in the range 1<=x<=65535"),
        (["decode", "missing.pcap"], "cannot read missing.pcap: No such file or directory"),
        (["state", "--robot-ip", "127.254.254.1"], "check the address, and that the controller is up and offers"),
    ),
    "emulator.cli": (
        (["--model", "ur4"], "choose one of ur3, ur3e, ur5, "),
        (["--models"], "No such option: --models"),
        (["--pendant-port", "99999"], "99999 is not in the range 1<=x<=65535"),
        (["--polyscope", "9.9"], "requires PolyScope 5.x, or 10."),
        (["--fault", "drop_conection"], "unknown fault 'drop_conection': did you mean drop_connection?"),
        (["--gripper", "robotiq-2f-58"], "did you mean robotiq-2f-85?"),
        (["ctl", "state", "--robot-ip", "127.254.254.1"], "(Connection refused): start the emulator, or check"),
        (["flet"], "No such command 'flet'. Did you mean 'fleet'?"),
    ),
}


@pytest.mark.parametrize(
    ("module", "arguments", "answer"),
    [
        pytest.param(module, arguments, answer, id=" ".join([module, *arguments]))
        for module, mistakes in MISTAKES.items()
        for arguments, answer in mistakes
    ],
)
def test_a_mistake_gets_one_line_that_helps(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    module: str,
    arguments: list[str],
    answer: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("program.urp").write_bytes(b"\x1f\x8b\0\0")
    Path("sec.script").write_text("sec s():\n  sync()\nend\n")
    monkeypatch.setattr(sys, "argv", [module, *arguments])
    with pytest.raises(SystemExit) as ended:
        import_module(module).main()
    assert ended.value.code in (1, 2)
    errors = capsys.readouterr().err
    assert answer in errors.splitlines()[-1]
    assert "Traceback" not in errors


@each_row("module", ["client.cli", "emulator.cli", "emulator.check"])
def test_help_is_whole_and_without_markup(module: str) -> None:
    for name, text in helps(get_command(import_module(module).app), module):
        assert "``" not in text, name
        cut = [line for line in text.splitlines() if line.endswith("...") and "Usage" not in line]
        assert all(line.strip() == "..." or ", ..." in line for line in cut), f"{name}: {cut}"


def helps(command: Any, name: str) -> Iterator[tuple[str, str]]:
    if isinstance(command, Deferred):
        command = command.load()
    yield name, command.get_help(command.make_context(name, [], resilient_parsing=True))
    for word, below in getattr(command, "commands", {}).items():
        yield from helps(below, f"{name} {word}")
