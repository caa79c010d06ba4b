"""The tokenizer.

Newlines are white space; a token only remembers whether one came before it outside brackets,
which the parser needs in three places (calls, indexing, bare ``return``). Nothing is an error
here: what cannot start a token becomes an ``invalid`` token, so that the parser reports the
first fault of the text and not the first odd character.
"""

import re
from typing import NamedTuple

from urproto.text import BLANKS
from urscript.work import Steps

__all__ = ["KEYWORDS", "Token", "tokenize"]

_KEYWORDS = """
def end thread sec if elif else while break continue return halt global local run kill join
enter_critical exit_critical and or xor not True False None
"""
KEYWORDS = frozenset(_KEYWORDS.split())

_TOKEN = re.compile(
    r"""[ \t\r\f\v]*(?:
        (?P<newline>\n)
      | (?P<comment>\#[^\n]*)
      | (?P<name>[A-Za-z_][A-Za-z0-9_]*)
      | (?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)
      | (?P<operator>==|!=|<=|>=|[-+*/%<>=()\[\],:.!$])
      | (?P<string>"[^"]*")
      | (?P<invalid>[^ \t\r\f\v\n]))""",
    re.VERBOSE,
)

_WORK = 2  # of a token and the space around it; a line end and a comment count as much
_SLICE = 32  # of these between two yields, wherever lines end: a text may be one line


class Token(NamedTuple):
    """`kind` is the word or sign itself for keywords and operators; otherwise name, number, string, invalid, end."""

    kind: str
    text: str
    line: int
    column: int
    after_newline: bool


def tokenize(source: str) -> Steps[list[Token]]:
    """The tokens of a text, closed by one of kind ``end of text``."""
    tokens: list[Token] = []
    add = tokens.append
    line, line_start, depth, fresh = 1, 0, 0, True
    for number, match in enumerate(_TOKEN.finditer(source), 1):
        if number % _SLICE == 0:
            yield _SLICE * _WORK
        group = match.lastgroup
        if group == "newline":
            line += 1
            line_start = match.end()
            fresh = fresh or depth == 0
            continue
        if group is None or group == "comment":
            continue
        text = match[group]
        column = match.start(group) - line_start + 1
        if group == "name":
            add(Token(text if text in KEYWORDS else group, text, line, column, fresh))
        elif group == "operator":
            depth = max(0, depth + (text in "([") - (text in ")]"))
            add(Token(text, text, line, column, fresh))
        else:
            add(Token(group, text, line, column, fresh))
            if group == "string" and "\n" in text:
                line += text.count("\n")
                line_start = match.start(group) + text.rindex("\n") + 1
        fresh = False
    tail = source.rstrip(BLANKS)
    end_line = tail.count("\n") + 1
    add(Token("end of text", "", end_line, len(tail) - (tail.rfind("\n") + 1) + 1, True))
    return tokens
