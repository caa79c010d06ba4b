"""The ``urscript`` command; ``urscript check`` is in tests/urscript/check."""

import pytest

from emulator import script_cli as cli
from urscript import LibrarySet
from urscript.library import LIBRARIES


@pytest.fixture(autouse=True)
def _no_robot(monkeypatch):
    monkeypatch.setattr(cli, "libraries", lambda: LibrarySet(LIBRARIES))


def test_wrong_usage(tmp_path, capsys):
    assert cli.main(["check", str(tmp_path / "missing.script")]) == 2
    assert cli.main(["functions", "--polyscope", "five"]) == 2
    assert "five" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        cli.main(["frobnicate"])


def test_functions_follow_the_version(capsys):
    assert cli.main(["functions", "--model", "ur5e"]) == 0
    assert "make_list(length, initial_value, capacity=None)" in capsys.readouterr().out
    assert cli.main(["functions"]) == 0
    assert "make_list" not in capsys.readouterr().out


def test_version(capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("urscript ")
