"""What the checker says of the editor's text, asked for as a command."""

import asyncio
from pathlib import Path

import pytest

from client.pendant.checking import check, keep_checking, parsed
from client.pendant.draft import Draft
from urproto.compat_asyncio import timeout
from urproto.versions import PolyscopeVersion
from urscript import cli
from urscript.files import ScriptFile

VERSION = PolyscopeVersion.parse("5.11")
WRONG = "def go():\n  movJ([0, 0, 0, 0, 0, 0])\n  sync(\nend\n"


async def test_the_editor_says_what_the_checker_says(tmp_path: Path) -> None:
    """Message by message, line by line."""
    expected = ScriptFile("-", WRONG.encode()).problems(cli.LibrarySet(cli._libraries()), VERSION)
    found = await check(WRONG, VERSION)
    assert found
    assert [(one.line, one.column, one.text) for one in found] == [(p.line, p.column, p.message) for p in expected]
    assert await check("def go():\n  sync()\nend\n", VERSION) == ()


def test_errors_and_warnings_are_told_apart_and_drawings_are_left_out() -> None:
    told = "<stdin>:3:5: b\n  3 | a = b\n      ^\n<stdin>:1:2: warning: a\n<stdin>: no problems\n"
    assert [(one.line, one.column, one.severity, one.text) for one in parsed(told)] == [
        (1, 2, "warning", "a"),
        (3, 5, "error", "b"),
    ]


async def test_the_draft_is_checked_whenever_it_is_another(monkeypatch: pytest.MonkeyPatch) -> None:
    draft, problems = Draft(), list[str]()
    checking = asyncio.create_task(keep_checking(draft, lambda: VERSION, problems.append))
    try:
        draft.write("def go():\n  nowhere()\nend\n")
        async with timeout(20):
            while not draft.diagnoses:
                await asyncio.sleep(0.05)
            assert draft.diagnoses[0].line == 2
            draft.write("def go():\n  sync()\nend\n")
            while draft.diagnoses:
                await asyncio.sleep(0.05)
    finally:
        checking.cancel()
    assert not problems
