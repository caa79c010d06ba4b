"""Messages say how to install an extra, from where this project came; classifiers and extras name the same Pythons."""

import json
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from urproto import extras
from urproto.compat import load_toml

PROJECT = load_toml((Path(__file__).resolve().parents[2] / "pyproject.toml").read_text())["project"]
ORIGINS = [
    ({"url": "file:///home/me/ur%20emulator", "dir_info": {}}, "pip install '/home/me/ur emulator[record]'"),
    ({"url": "file:///a/b", "dir_info": {"editable": True}}, "pip install --editable '/a/b[record]'"),
    (
        {"url": "https://a.example/ur.git", "vcs_info": {"vcs": "git", "commit_id": "0"}},
        "pip install 'ur-emulator[record] @ git+https://a.example/ur.git'",
    ),
    (
        {"url": "https://a.example/ur.whl", "archive_info": {}},
        "pip install 'ur-emulator[record] @ https://a.example/ur.whl'",
    ),
    (None, "in the folder of ur-emulator, pip install '.[record]'"),
]


@pytest.mark.parametrize(("origin", "command"), ORIGINS)
def test_the_command_names_the_origin(monkeypatch: pytest.MonkeyPatch, origin: object, command: str) -> None:
    recorded = SimpleNamespace(read_text=lambda _: origin and json.dumps(origin))
    monkeypatch.setattr(extras, "distribution", lambda _: recorded)
    assert extras.how_to_install("record") == command


@pytest.mark.parametrize(
    ("minor", "extra", "answer"),
    [
        (14, "plan", "use Python 3.10 to 3.13: the packages of the extra plan do not exist for this one"),
        (10, "physics", "use Python 3.11 or newer: the packages of the extra physics do not exist for this one"),
        (14, "pinocchio", "pip install"),
    ],
)
def test_another_python_is_named_where_packages_are_missing(
    monkeypatch: pytest.MonkeyPatch, minor: int, extra: str, answer: str
) -> None:
    monkeypatch.setattr(sys, "version_info", SimpleNamespace(minor=minor))
    assert answer in extras.how_to_install(extra)


def test_extras_name_the_pythons_of_the_messages() -> None:
    markers = {
        name: next((found for text in wanted if (found := re.search(r"python_version (<|>=) '3\.(\d+)'", text))), None)
        for name, wanted in PROJECT["optional-dependencies"].items()
    }
    known = {
        name: (found[1], int(found[2])) for name, found in markers.items() if found and name not in ("test", "check")
    }
    assert known == {"plan": ("<", 14), "physics": (">=", 11)}
    assert extras._PYTHONS == {"plan": (10, 13), "physics": (11, 99), "learning": (11, 99)}
    pythons = re.findall(r"Python :: 3\.(\d+)", "\n".join(PROJECT["classifiers"]))
    assert list(map(int, pythons)) == list(range(10, 15))
