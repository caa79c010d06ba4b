"""Modules that a command imports at startup: a shell loop over common commands must not wait for numpy."""

import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_command

import client
from client.cli import app
from tests.rows import each_row

HEAVY = ("numpy", "pinocchio", "coal", "matplotlib", "mcap", "foxglove")
NOBODY = 1  # a port where nothing listens
CALL = """
import sys
from {module} import main
sys.argv = {words!r}
try:
    main()
finally:
    sys.stderr.write(f"\\nloaded: {{sorted(sys.modules.keys() & {heavy!r})}}")
"""


def loaded(module: str, *words: str) -> str:
    """The last line on standard error of a module's command line."""
    code = CALL.format(module=module, words=list(words), heavy=set(HEAVY))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert "Traceback" not in done.stderr, done.stderr
    return done.stderr.splitlines()[-1]


@each_row(
    ("module", "words"),
    [
        ("client.cli", "ur-client --help"),
        ("client.cli", f"ur-client dashboard play --robot-ip 127.0.0.1 --port-offset {NOBODY - 29999}"),
        ("client.cli", "ur-client state --help"),
        ("client.cli", "ur-client send --help"),
        ("client.cli", "ur-client watch --help"),
        ("client.cli", "ur-client decode --help"),
        ("emulator.__main__", "ur-emulator --help"),
        ("emulator.__main__", "ur-emulator --version"),
        ("emulator.__main__", f"ur-emulator ctl ports --port {NOBODY}"),
        ("emulator.check", "ur-emulator-check --help"),
        ("emulator.script_cli", "urscript --help"),
    ],
)
def test_common_commands_import_nothing_heavy(module, words):
    assert loaded(module, *words.split()) == "loaded: []"


def test_checking_a_script_needs_no_arm(tmp_path: Path):
    script = tmp_path / "move.script"
    script.write_text("def f():\n  movej([0, -1, 1, 0, 0, 0])\nend\n")
    assert loaded("emulator.script_cli", "urscript", "check", str(script)) == "loaded: []"


def test_imported_modules_are_detected():
    assert loaded("client.cli", "ur-client", "record", "--help") == "loaded: ['numpy']"


def test_command_summaries_match_their_help():
    commands = get_command(app).commands
    assert len(commands) > 10
    for name, listed in commands.items():
        own = listed.load().help
        assert " ".join(own.split()).startswith(listed.help), name


def test_every_public_name_of_the_client_exists():
    assert all(getattr(client, name) is not None for name in client.__all__)
    assert set(client.__all__) <= set(dir(client))
    with pytest.raises(AttributeError, match="no attribute 'Robots'"):
        _ = client.Robots
