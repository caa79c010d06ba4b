"""Phrases listed in docs/writing.md occur in no text for users, its listed words in no name; words have one meaning."""

import ast
import re
from collections.abc import Iterator
from functools import cache

import pytest

from tests.sources import ROOT, module_path, modules, nodes

pytestmark = pytest.mark.xdist_group("architecture")  # each worker would have to read every module


def all_nodes() -> Iterator[tuple[str, ast.AST]]:
    """Every node of the code, and its module."""
    return ((module, node) for module in modules() for node in nodes(module))


def client_nodes() -> Iterator[tuple[str, ast.AST]]:
    """Those of the client library, without the pendant, which has words of its own."""
    own = (module for module in modules() if re.match(r"client\b(?!\.pendant)", module))
    return ((module, node) for module in own for node in nodes(module))


def place(module: str, node: ast.AST) -> str:
    return f"{module_path(module).relative_to(ROOT)}:{getattr(node, 'lineno', 0)}"


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
        f"{place(module, node)}: {name}: see docs/writing.md"
        for module, node in all_nodes()
        for field in ("name", "arg", "id", "attr")
        if isinstance(name := getattr(node, field, None), str) and avoided & _parts(name)
    ]
    assert not found, "\n".join(found)


@cache
def _parts(name: str) -> set[str]:
    return {part.lower().removesuffix("s") for part in re.findall(r"[A-Z]?[a-z]+", name)}


def texts() -> Iterator[tuple[str, str]]:
    """The place of each text, and the text: pages, and every string of the code, including docstrings."""
    for page in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")):
        if page.name != "writing.md":
            yield page.name, page.read_text(encoding="utf-8")
    for module, node in all_nodes():
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield place(module, node), node.value


def test_no_listed_phrase_is_used() -> None:
    avoided = phrases()
    assert len(avoided) > 7
    wrong = re.compile("|".join(map(re.escape, avoided)), re.IGNORECASE)
    found = [f"{where}: {match[0]!r}: see docs/writing.md" for where, text in texts() if (match := wrong.search(text))]
    assert not found, "\n".join(found)


def test_words_of_the_client_have_one_meaning() -> None:
    page = (ROOT / "docs" / "writing.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\w+) \| (`.+) \|$", page.split("### Words of the client library")[1], re.MULTILINE)
    meanings = {name: {*re.findall(r"`(\w+)`", types), "None"} for name, types in rows}
    assert {"robot", "driver", "control", "host"} == meanings.keys()
    found = []
    for module, node in client_nodes():
        if isinstance(node, ast.arg | ast.AnnAssign):
            name = getattr(node, "arg", None) or ast.unparse(getattr(node, "target", node))
            allowed = meanings.get(name.removeprefix("self.").removeprefix("_"))
            text = ast.unparse(annotation) if allowed and (annotation := getattr(node, "annotation", None)) else ""
            if text and not text.startswith("Annotated") and not {*re.findall(r"\w+", text)} <= allowed:
                found.append(f"{place(module, node)}: {name}: {text}: see docs/writing.md")
    assert not found, "\n".join(found)


def test_no_two_public_classes_of_the_client_have_one_name() -> None:
    places: dict[str, list[str]] = {}
    for module, node in client_nodes():
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            places.setdefault(node.name, []).append(place(module, node))
    assert not {name: where for name, where in places.items() if len(where) > 1}
