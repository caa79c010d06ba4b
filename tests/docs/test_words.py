"""Phrases listed in docs/writing.md occur in no text for users, its listed words in no name; words have one meaning."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

pytestmark = pytest.mark.xdist_group("architecture")  # each worker would have to read every module
ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("urproto", "urscript", "emulator", "client")


@cache
def sources() -> list[tuple[Path, str]]:
    paths = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    return [(path, path.read_text(encoding="utf-8")) for path in paths]


def trees(pattern: "re.Pattern[str]") -> Iterator[tuple[Path, ast.Module]]:
    """The modules in which something may occur, also in a text of several literals; to parse all of them takes long."""
    across = re.compile(pattern.pattern.replace("\\ ", r"[\sfr\"']+"), pattern.flags)
    return ((path, ast.parse(text)) for path, text in sources() if across.search(text))


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
    found = [
        f"{where}: {name}: see docs/writing.md" for where, name in names("|".join(avoided)) if avoided & _parts(name)
    ]
    assert not found, "\n".join(found)


def names(words: str) -> Iterator[tuple[str, str]]:
    for path, tree in trees(re.compile(words, re.IGNORECASE)):
        for node in ast.walk(tree):
            for field in ("name", "arg", "id", "attr"):
                if isinstance(name := getattr(node, field, None), str):
                    yield f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 0)}", name


def _parts(name: str) -> set[str]:
    return {part.lower().removesuffix("s") for part in re.findall(r"[A-Z]?[a-z]+", name)}


def texts(wrong: "re.Pattern[str]") -> Iterator[tuple[str, str]]:
    """The place of each text, and the text: pages, and every string of the code, including docstrings."""
    for page in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")):
        if page.name != "writing.md":
            yield page.name, page.read_text(encoding="utf-8")
    for path, tree in trees(wrong):
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield f"{path.relative_to(ROOT)}:{node.lineno}", node.value


def test_no_listed_phrase_is_used() -> None:
    avoided = phrases()
    assert len(avoided) > 7
    wrong = re.compile("|".join(map(re.escape, avoided)), re.IGNORECASE)
    found = [
        f"{where}: {match[0]!r}: see docs/writing.md" for where, text in texts(wrong) if (match := wrong.search(text))
    ]
    assert not found, "\n".join(found)


def client_trees() -> Iterator[tuple[str, ast.Module]]:
    """Modules of the client library with their places, without the pendant, which has words of its own."""
    for path, text in sources():
        if "client" in path.parts and "pendant" not in path.parts:
            yield str(path.relative_to(ROOT)), ast.parse(text)


def test_words_of_the_client_have_one_meaning() -> None:
    page = (ROOT / "docs" / "writing.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\w+) \| (`.+) \|$", page.split("### Words of the client library")[1], re.MULTILINE)
    meanings = {name: {*re.findall(r"`(\w+)`", types), "None"} for name, types in rows}
    assert {"robot", "driver", "control", "host"} == meanings.keys()
    found = []
    for where, tree in client_trees():
        for node in (one for one in ast.walk(tree) if isinstance(one, ast.arg | ast.AnnAssign)):
            name = getattr(node, "arg", None) or ast.unparse(getattr(node, "target", node))
            allowed = meanings.get(name.removeprefix("self.").removeprefix("_"))
            text = ast.unparse(annotation) if allowed and (annotation := getattr(node, "annotation", None)) else ""
            if text and not text.startswith("Annotated") and not {*re.findall(r"\w+", text)} <= allowed:
                found.append(f"{where}:{node.lineno}: {name}: {text}: see docs/writing.md")
    assert not found, "\n".join(found)


def test_no_two_public_classes_of_the_client_have_one_name() -> None:
    places: dict[str, list[str]] = {}
    for where, tree in client_trees():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(f"{where}:{node.lineno}")
    assert not {name: where for name, where in places.items() if len(where) > 1}
