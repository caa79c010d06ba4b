"""Placeholders of templates, ``{x}`` and ``{{x}}``: replaced by names of the same length, so that places stay true."""

import re
from typing import Final

_HOLE: Final = r"(?:\{\{[^{}\n]*\}\}|\{[^{}\n]*\})"
_PLACEHOLDER: Final = re.compile(
    rf'"[^"\n{{}}]*"|#[^\n]*|(?P<line>(?m:^[ \t]*{_HOLE}[ \t]*(?:#[^\n]*)?$))|\w{{0,50}}{_HOLE}(?:\w|{_HOLE})*'
)
_LAST_ARGUMENT: Final = re.compile(r"(=[^=(),\n]*)(,[ \t]*\{\{?[^{}\n]*\}\}?)(?=[ \t]*\))")
"""A placeholder after an argument by name: it stands for further ones."""
_IN_NUMBER: Final = re.compile(r"[0-9]\.$")
_NO_LETTER: Final = re.compile(r"[^A-Za-z0-9_]")
_POSE: Final = "p"  # p[{x}] is a pose once it is filled in, but reads like an element of a variable


def filled(text: str) -> tuple[str, set[str]]:
    """A text without placeholders, and the names that stand for them. One alone on its line may be any statements."""
    names = {_POSE}

    def fill(match: re.Match[str]) -> str:
        found = match[0]
        if found[0] in '"#':
            return found
        if match["line"]:
            return " " * len(found)
        if found[0].isdigit() or _IN_NUMBER.search(text, max(match.start() - 2, 0), match.start()):
            return "0" * len(found)
        name = _NO_LETTER.sub("_", found)
        names.add(name)
        return name

    without = _LAST_ARGUMENT.sub(lambda match: match[1] + " " * len(match[2]), text)
    return _PLACEHOLDER.sub(fill, without), names
