"""``urscript check`` in a folder: files are written, the command runs in this process."""

import json
from argparse import ArgumentParser

import pytest

from urscript.check import command
from urscript.check.project import project_of


@pytest.fixture
def check(tmp_path, monkeypatch, capsys):
    """check({"a.script": text}, "a.script", "--strict") -> exit status; `check.out` and `check.err` are its output."""
    monkeypatch.chdir(tmp_path)

    def run(files, *words):
        for name, text in files.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(text if isinstance(text, bytes) else text.encode())
        project_of.cache_clear()
        parser = ArgumentParser()
        command.add_arguments(parser)
        status = command.run(parser.parse_args(words or list(files)))
        run.out, run.err = capsys.readouterr()
        return status

    return run


@pytest.fixture
def findings(check):
    """The findings of `check` as (file, line, column, code)."""

    def run(files, *words):
        assert check(files, "--format=json", *(words or list(files))) in (0, 1), check.err
        return [(f["file"], f["line"], f["column"], f["code"]) for f in json.loads(check.out)]

    return run
