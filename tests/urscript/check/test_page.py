"""The page on checking: its configurations are valid, and run as their services would run them."""

import re
import shlex
from dataclasses import fields
from pathlib import Path

import yaml

from urscript.check.project import Project

PAGE = Path(__file__).resolve().parents[3] / "docs" / "checking.md"
FILES = dict(re.findall(r"<!-- file: (\S+) -->\n```\w+\n(.*?)```", PAGE.read_text(), re.DOTALL))


def words(command):
    program, subcommand, *options = shlex.split(command)
    assert (program, subcommand) == ("urscript", "check")
    return options


def test_the_workflow_annotates_what_the_hook_refuses(check):
    workflow = yaml.safe_load(FILES[".github/workflows/urscript.yml"])
    steps = workflow["jobs"]["check"]["steps"]
    (hook,) = yaml.safe_load(FILES[".pre-commit-config.yaml"])["repos"][0]["hooks"]
    programs = [name for name in FILES if re.search(hook["files"], name)]
    assert programs == ["cell.script", "node.script"]
    for command in (words(steps[-1]["run"]), [*words(hook["entry"]), *programs]):
        assert check(FILES, *command) == 0, check.out
        assert check({"cell.script": "norm(1, 2)\n"}, *command) == 1
    check({}, *words(steps[-1]["run"]))
    assert check.out.startswith("::warning file=cell.script,line=1,col=1,")


def test_the_page_lists_every_key_of_the_project_file():
    listed = re.findall(r"`(\w+)`", " ".join(re.findall(r"^\| (`\w+`(?:, `\w+`)*) \|", PAGE.read_text(), re.MULTILINE)))
    assert [key for key in listed if key in Project.__dataclass_fields__] == [f.name for f in fields(Project)[1:]]
