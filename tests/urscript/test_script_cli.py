"""The ``urscript`` command."""

import pytest

from urscript import cli
from urscript.library import LIBRARIES


@pytest.fixture(autouse=True)
def _no_robot(monkeypatch):
    monkeypatch.setattr(cli, "_libraries", lambda: LIBRARIES)


def test_check_shows_every_broken_program_of_a_file(tmp_path, capsys):
    path = tmp_path / "two.script"
    path.write_text("# two programs\ndef a():\n  x = norn(1)\nend\n\ndef b():\n  y = norm(1, 2)\nend\n")
    assert cli.main(["check", str(path)]) == 1
    assert capsys.readouterr().out.splitlines() == [
        f"{path}:3:7: function 'norn' is not known; did you mean 'norm'?",
        "  3 |   x = norn(1)",
        "    |       ^",
        f"{path}:7:7: Type error: norm takes exactly 1 arguments (2 given)",
        "  7 |   y = norm(1, 2)",
        "    |       ^",
    ]


def test_check_a_good_file(tmp_path, capsys):
    path = tmp_path / "good.script"
    path.write_bytes(b"x = 1\r\ndef f():\r\n return x\r\nend\r\ny = f()\r\n")
    assert cli.main(["check", str(path), "--polyscope", "3.15.8"]) == 0
    assert "no problems found" in capsys.readouterr().out


def test_wrong_usage(tmp_path, capsys):
    assert cli.main(["check", str(tmp_path / "missing.script")]) == 2
    assert cli.main(["functions", "--polyscope", "five"]) == 2
    assert "five" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        cli.main(["frobnicate"])


def test_functions_follow_the_version(capsys):
    assert cli.main(["functions"]) == 0
    assert "make_list(length, initial_value, capacity=None)" in capsys.readouterr().out
    assert cli.main(["functions", "--polyscope", "3.15.8"]) == 0
    assert "make_list" not in capsys.readouterr().out
