"""The pages of the documentation as a reader uses them: blocks of code in their order.

A block is run unless an HTML comment before it, which readers do not see, says otherwise:

    <!-- not run: reason -->           why it cannot run here
    <!-- in another terminal -->       started, and kept running to the end of the page
    <!-- file: name -->                written to this file
    <!-- robot: address options -->    anywhere: a robot that the page requires: an emulator with these options
"""

import re
from dataclasses import dataclass
from pathlib import Path

__all__ = ["LANGUAGES", "PAGES", "ROOT", "Block", "Robot", "blocks", "indented", "robots"]

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")),
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "reference").glob("*.md")),
    ROOT / "examples" / "ci" / "README.md",
)
LANGUAGES = {"sh", "shell", "python", "yaml", "toml", "urscript", "text", "ros"}  # ros: run with ROS 2, by tests/ros2

_BLOCK = re.compile(
    r"(?:^<!-- (?P<note>[^\n]*?) -->\n)?^```(?P<language>\S*)\n(?P<code>.*?)^```$", re.MULTILINE | re.DOTALL
)
_ROBOT = re.compile(r"^<!-- robot: (\S+)(.*?) -->$", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A block of code. note: the comment before it, or empty. line: its first line in the page."""

    page: Path
    line: int
    language: str
    code: str
    note: str

    @property
    def reason(self) -> str:
        """The reason why it is not run; empty if it is run."""
        return self.note.removeprefix("not run: ") if self.note.startswith("not run: ") else ""

    @property
    def file(self) -> str:
        """The file to write it to; empty if it is not a file."""
        return self.note.removeprefix("file: ") if self.note.startswith("file: ") else ""

    @property
    def stays(self) -> bool:
        """Whether it keeps running while the rest of the page is run."""
        return self.note == "in another terminal"

    @property
    def place(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


@dataclass(frozen=True)
class Robot:
    """A robot that a page requires."""

    host: str
    options: tuple[str, ...]


def blocks(page: Path) -> list[Block]:
    """All blocks of a page, in order."""
    text = page.read_text()
    return [
        Block(page, text.count("\n", 0, match.start()) + 1, match["language"], match["code"], match["note"] or "")
        for match in _BLOCK.finditer(text)
    ]


def robots(page: Path) -> list[Robot]:
    """The robots that the page requires."""
    return [Robot(host, tuple(options.split())) for host, options in _ROBOT.findall(page.read_text())]


def indented(page: Path) -> list[int]:
    """Lines of code without a fence, which would not be found."""
    lines = re.sub(r"^```.*?^```$", lambda match: "\n" * match[0].count("\n"), page.read_text(), flags=re.M | re.S)
    found = []
    before = ""
    for number, line in enumerate(lines.splitlines(), 1):
        if line.startswith("    ") and not before.strip() and not line.lstrip().startswith(("-", "*")):
            found.append(number)
        before = line
    return found
