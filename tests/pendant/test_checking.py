"""Checking the editor's text with the checker command."""

import asyncio
import json
from pathlib import Path

import pytest

from client.pendant.draft import Draft, check, check_forever
from client.programs import CheckerError, ScriptProblem, read_problems
from emulator import script_cli as cli
from urproto.compat_asyncio import timeout
from urproto.versions import PolyscopeVersion
from urscript.files import ScriptFile

VERSION = PolyscopeVersion.parse("5.11")
WRONG = "def go():\n  movJ([0, 0, 0, 0, 0, 0])\n  sync(\nend\n"


async def test_check_returns_messages_of_checker(tmp_path: Path) -> None:
    """The same messages at the same positions."""
    expected = ScriptFile("-", WRONG.encode()).problems(cli.libraries(), VERSION)
    found = await check(WRONG, VERSION)
    assert found
    assert [(problem.line, problem.column, problem.text) for problem in found] == [
        (p.line, p.column, p.message) for p in expected
    ]
    assert await check("def go():\n  sync()\nend\n", VERSION) == ()


def test_output_is_parsed_into_errors_and_warnings() -> None:
    rows = [(3, 5, "error", "b"), (1, 2, "warning", "a")]
    output = json.dumps([dict(zip(("line", "column", "severity", "message"), row, strict=True)) for row in rows])
    expected = [ScriptProblem(1, 2, warning=True, message="a"), ScriptProblem(3, 5, warning=False, message="b")]
    assert read_problems(1, output.encode(), b"") == expected
    with pytest.raises(CheckerError, match="urscript check: no memory"):
        read_problems(2, output.encode(), b"no memory\n")


async def test_draft_is_checked_after_each_change(monkeypatch: pytest.MonkeyPatch) -> None:
    draft, problems = Draft(), list[str]()
    checking = asyncio.create_task(check_forever(draft, lambda: VERSION, problems.append))
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
