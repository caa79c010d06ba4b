"""The tokenizer.

Newlines are white space. A token only records whether a newline came before it outside brackets, which the parser needs
in three places (calls, indexing, bare ``return``). A keyword that begins a statement ends brackets that were never
closed, so a mistake in one statement does not change the tokens of the next block.

The only error raised here is for an excessively long token. A character that cannot start a token becomes an
``invalid`` token, so that the parser reports the first mistake in the text rather than the first invalid character.
"""

import re
from typing import NamedTuple

from urproto.text import BLANKS
from urscript.errors import CompileError
from urscript.work import Steps, release

_KEYWORDS = """
def end thread sec if elif else while break continue return halt global local run kill join
enter_critical exit_critical and or xor not True False None
"""
KEYWORDS = frozenset(_KEYWORDS.split())
IN_EXPRESSIONS = frozenset(["and", "or", "xor", "not", "True", "False", "None", "run"])
STATEMENT_WORDS = KEYWORDS - IN_EXPRESSIONS - {"sec"}
"""Keywords that never stand within brackets; ``sec`` is also a member of what time() returns."""

_TOKEN = re.compile(
    r"""[ \t\r\f\v]{0,1000}(?:
        (?P<newline>\n)
      | (?P<comment>\#[^\n]{0,49999})
      | (?P<name>[A-Za-z_][A-Za-z0-9_]{0,49999})
      | (?P<number>(?:[0-9]{1,49999}\.?[0-9]{0,49999}|\.[0-9]{1,49999})(?:[eE][+-]?[0-9]{1,49999})?)
      | (?P<operator>==|!=|<=|>=|[-+*/%<>=()\[\],:.!$])
      | (?P<string>"(?:[^"]{0,49997}"|[^"]{49999}))
      | (?P<blank>[ \t\r\f\v])
      | (?P<invalid>[^ \t\r\f\v\n]))""",
    re.VERBOSE,
)

_NEW = tuple.__new__  # a third faster than calling the class

_LONGEST = 50_000
"""Longest token [characters], as in the expression above, so that a step reads a bounded amount of text (a guess)."""

_WORK = 2  # per token with the space around it; a line end and a comment count as much
_SLICE = 32  # tokens between two yields, regardless of line ends: a text may be a single line


class Token(NamedTuple):
    """A token. `kind` is the text itself for keywords and operators; otherwise name, number, string, invalid or
    ``end of text``."""

    kind: str
    text: str
    line: int
    column: int
    after_newline: bool


def tokenize(source: str) -> Steps[list[Token]]:
    """The tokens of a text; the last one has the kind ``end of text``. Raises CompileError for a token too long."""
    tokens: list[Token] = []
    add = tokens.append
    line, line_start, depth, fresh = 1, 0, 0, True
    last, end_line, end_start = 0, 1, 0  # end of the last token or comment, with its line
    number = 0
    matches = _TOKEN.finditer(source)
    while (match := next(matches, None)) is not None:
        number += 1
        if number % _SLICE == 0:
            yield _SLICE * _WORK
        group = match.lastgroup
        if group == "newline":
            line += 1
            line_start = match.end()
            fresh = fresh or depth == 0
            continue
        if group is None or group == "blank":
            continue
        text = match[group]
        if group == "comment":
            if len(text) == _LONGEST:  # skip the rest of the line, faster than with the regular expression
                end = source.find("\n", match.end())
                matches = _TOKEN.finditer(source, end) if end >= 0 else iter(())
                text = source[match.start(group) : end if end >= 0 else None]
            last, end_line, end_start = match.start(group) + len(text.rstrip(BLANKS)), line, line_start
            continue
        column = match.start(group) - line_start + 1
        if len(text) >= _LONGEST:
            yield from release(tokens)
            message = f"syntax error: this {group} is longer than {_LONGEST - 2} characters"
            raise CompileError.syntax(message, line, column, source)
        if group == "name":
            if text in STATEMENT_WORDS:
                fresh, depth = fresh or line > end_line, 0
            add(_NEW(Token, (text if text in KEYWORDS else group, text, line, column, fresh)))
        elif group == "operator":
            depth = max(0, depth + (text in "([") - (text in ")]"))
            add(_NEW(Token, (text, text, line, column, fresh)))
        else:
            add(_NEW(Token, (group, text, line, column, fresh)))
            if group == "string" and "\n" in text:
                line += text.count("\n")
                line_start = match.start(group) + text.rindex("\n") + 1
        last, end_line, end_start = match.end(), line, line_start
        fresh = False
    add(Token("end of text", "", end_line, last - end_start + 1, True))
    return tokens
