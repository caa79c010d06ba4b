"""Texts for the error codes in the controller's log. The wording is ours, because a controller usually sends no text.

They are rows of ``errorcodes.csv``: a code, nothing or the arguments for which a text is added, and the text, in which
``{joint}`` stands for the joints one after the other. Source of numbers, arguments and meaning: the error table of the
vendor's public C++ libraries. The texts are only shown to people; drivers evaluate the code and the level.
"""

import csv
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

from urproto.joints import JOINT_LABELS


@cache
def _texts() -> Mapping[tuple[int, int | None], str]:
    """The text of each code, and of each of its arguments."""
    found: dict[tuple[int, int | None], str] = {}
    for row in csv.DictReader(files("urproto").joinpath("errorcodes.csv").read_text("utf-8").splitlines()):
        code, text = int(row["code"]), row["text"]
        if not row["argument"]:
            found[code, None] = text
            continue
        first, _, last = row["argument"].partition("-")
        for place, argument in enumerate(range(int(first), int(last or first) + 1)):
            found[code, argument] = text.replace("{joint}", JOINT_LABELS[place]) if last else text
    return found


def error_text(code: int, argument: int | None = None) -> str:
    """Text for an error code, with the meaning of its argument if one is given; neutral for unknown codes."""
    text = _texts().get((code, None), f"Error code C{code}")
    detail = _texts().get((code, argument)) if argument is not None else None
    return f"{text}: {detail}" if detail else text
