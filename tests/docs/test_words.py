"""Phrases that docs/writing.md asks not to use are in no text that people see."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("urproto", "urscript", "emulator", "client")


def phrases() -> list[str]:
    page = (ROOT / "docs" / "writing.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (.+?) \| .+? \|$", page.split("## Phrases")[1], re.MULTILINE)
    return [row for row in rows if row not in ("not", "---")]


def texts() -> Iterator[tuple[str, str]]:
    """Where a text stands, and the text: pages, and every string of the code with its docstrings."""
    for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        if page.name != "writing.md":
            yield page.name, page.read_text(encoding="utf-8")
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
                    yield f"{path.relative_to(ROOT)}:{node.lineno}", node.value


def test_no_phrase_of_the_list_is_used() -> None:
    avoided = phrases()
    assert len(avoided) > 7
    wrong = re.compile("|".join(map(re.escape, avoided)), re.IGNORECASE)
    found = [f"{where}: {match[0]!r}: see docs/writing.md" for where, text in texts() if (match := wrong.search(text))]
    assert not found, "\n".join(found)
