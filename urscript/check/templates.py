"""Placeholders of templates, ``{x}`` and ``{{x}}``: replaced by names of the same length, so that places stay true."""

import re
from typing import Final

_PLACEHOLDER: Final = re.compile(
    r'"[^"\n{}]*"|#[^\n]*|(?m:^[ \t]*(?:\{\{[^{}\n]*\}\}|\{[^{}\n]*\})[ \t]*$)|\{\{[^{}\n]*\}\}|\{[^{}\n]*\}'
)
_LAST_ARGUMENT: Final = re.compile(r"(=[^=(),\n]*)(,[ \t]*\{\{?[^{}\n]*\}\}?)(?=[ \t]*\))")
"""A placeholder after an argument by name: it stands for further ones."""
_NO_LETTER: Final = re.compile(r"[^A-Za-z0-9_]")
_POSE: Final = "p"  # p[{x}] is a pose once it is filled in, but reads like an element of a variable


def filled(text: str) -> tuple[str, set[str]]:
    """A text without placeholders, and the names that stand for them. One alone on its line may be any statements."""
    names = {_POSE}

    def fill(match: re.Match[str]) -> str:
        found = match[0]
        if found[0] in '"#':
            return found
        if found.strip() == found and not _alone(match):
            name = _NO_LETTER.sub("_", found)
            names.add(name)
            return name
        return " " * len(found)

    without = _LAST_ARGUMENT.sub(lambda match: match[1] + " " * len(match[2]), text)
    return _PLACEHOLDER.sub(fill, without), names


def _alone(match: re.Match[str]) -> bool:
    text = match.string
    before = text.rfind("\n", 0, match.start()) + 1
    after = text.find("\n", match.end())
    return not (text[before : match.start()] + text[match.end() : after if after >= 0 else None]).strip()
