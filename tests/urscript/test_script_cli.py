"""The ``urscript`` command."""

import pytest

from emulator import script_cli as cli
from urscript import LibrarySet
from urscript.library import LIBRARIES


@pytest.fixture(autouse=True)
def _no_robot(monkeypatch):
    monkeypatch.setattr(cli, "libraries", lambda: LibrarySet(LIBRARIES))


def test_check_shows_every_broken_program_of_a_file(tmp_path, capsys):
    path = tmp_path / "two.script"
    path.write_text("# two programs\ndef a():\n  x = norn(1)\nend\n\ndef b():\n  y = norm(1, 2)\nend\n")
    assert cli.main(["check", str(path)]) == 1
    assert capsys.readouterr().out.splitlines() == [
        f"{path}:3:7: function 'norn' is not defined; did you mean 'norm'?",
        "  3 |   x = norn(1)",
        "    |       ^",
        f"{path}:7:7: warning: Type error: norm takes exactly 1 arguments (2 given)",
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
    assert cli.main(["functions", "--model", "ur5e"]) == 0
    assert "make_list(length, initial_value, capacity=None)" in capsys.readouterr().out
    assert cli.main(["functions"]) == 0
    assert "make_list" not in capsys.readouterr().out


def test_check_assumes_what_the_emulator_does_and_takes_the_series_from_the_version(tmp_path, capsys):
    path = tmp_path / "a.script"
    path.write_text("x = make_list(3, 0)\n")
    assert cli.main(["check", str(path)]) == 1
    assert "make_list" in capsys.readouterr().out
    for options in (["--polyscope", "5.15"], ["--model", "ur10e"], ["--model", "UR10E", "--polyscope", "5.21.3"]):
        assert cli.main(["check", str(path), *options]) == 0
    assert "for PolyScope 5.21.3" in capsys.readouterr().out
    assert cli.main(["check", str(path), "--model", "ur5", "--polyscope", "5.11"]) == 2
    assert "UR5 (CB3) requires PolyScope 3.0 to 3.15, not 5.11" in capsys.readouterr().err
    assert cli.main(["check", str(path), "--model", "ur99"]) == 2


def test_warnings_alone_are_shown_and_no_failure(tmp_path, capsys):
    path = tmp_path / "a.script"
    path.write_text("def f():\n  if False:\n    norm(1, 2)\n  end\nend\n")
    assert cli.main(["check", str(path)]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0] == f"{path}:3:5: warning: Type error: norm takes exactly 1 arguments (2 given)"
    assert out[-1] == f"{path}: no errors, 1 warning for PolyScope 3.15.8"


def test_version(capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("urscript ")
