"""Phrases listed in docs/writing.md occur in no text for users, and its listed words in no name."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("urproto", "urscript", "emulator", "client", "urtesting")


def phrases() -> list[str]:
    page = (ROOT / "docs" / "writing.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (.+?) \| .+? \|$", page.split("## Phrases")[1], re.MULTILINE)
    return [row for row in rows if row not in ("not", "---")]


def words() -> list[str]:
    page = (ROOT / "docs" / "writing.md").read_text(encoding="utf-8")
    table = page.split("| not, in a name | but |")[1].split("\n\n")[0]
    return re.findall(r"^\| (\w+) \|", table, re.MULTILINE)[:4]


def test_no_name_contains_a_listed_word() -> None:
    """Names of classes, functions, parameters, variables and attributes, whole or between underscores."""
    avoided = set(words())
    assert avoided == {"twin", "falsifier", "door", "trouble"}
    found = [f"{where}: {name}: see docs/writing.md" for where, name in names() if avoided & _parts(name)]
    assert not found, "\n".join(found)


def names() -> Iterator[tuple[str, str]]:
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                for field in ("name", "arg", "id", "attr"):
                    if isinstance(name := getattr(node, field, None), str):
                        yield f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 0)}", name


def _parts(name: str) -> set[str]:
    return {part.lower().removesuffix("s") for part in re.findall(r"[A-Z]?[a-z]+", name)}


def texts() -> Iterator[tuple[str, str]]:
    """The place of each text, and the text: pages, and every string of the code, including docstrings."""
    for page in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")):
        if page.name != "writing.md":
            yield page.name, page.read_text(encoding="utf-8")
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
                    yield f"{path.relative_to(ROOT)}:{node.lineno}", node.value


def test_no_listed_phrase_is_used() -> None:
    avoided = phrases()
    assert len(avoided) > 7
    wrong = re.compile("|".join(map(re.escape, avoided)), re.IGNORECASE)
    found = [f"{where}: {match[0]!r}: see docs/writing.md" for where, text in texts() if (match := wrong.search(text))]
    assert not found, "\n".join(found)
