"""The layout of a text: indentation, spaces between tokens, blank lines.

Newlines have a meaning in three places, and several statements may stand on one line, so every token stays on the line
where its author put it. What changes is the space before it: two spaces for each open block, the same around operators
everywhere, at most one blank line. The tokens of the result are those of the text; comments and strings are kept.
"""

from typing import Final

from urproto.text import BLANKS
from urscript.errors import CompileError
from urscript.files import ScriptFile
from urscript.parser import parse
from urscript.tokens import Token, tokenize
from urscript.work import run_to_end

_INDENT: Final = "  "  # as PolyScope writes it
_OPENING: Final = frozenset(["def", "sec", "thread", "if", "while"])
_BRANCHES: Final = frozenset(["else", "elif"])
_OPERATORS: Final = frozenset(["==", "!=", "<=", ">=", "<", ">", "+", "-", "*", "/", "%", "=", "and", "or", "xor", "."])
_CONTINUED: Final = _OPERATORS | frozenset(
    ["not", "!", "if", "elif", "while", "global", "local", "run", "join", "kill"]
)
_SIGNS: Final = frozenset("+-")
_OPERANDS: Final = frozenset(["name", "number", "string", ")", "]", "True", "False", "None"])
_TIGHT_BEFORE: Final = frozenset(",:)].")
_TIGHT_AFTER: Final = frozenset("([.!")
_COMPARING: Final = frozenset("=!<>")


def formatted(text: str) -> str:
    """The text with the usual layout. Raises CompileError for a token that is too long."""
    crlf = text.count("\r\n") == text.count("\n") > 0
    bare = text.removeprefix("\ufeff")
    bare = bare.replace("\r\n", "\n") if crlf else bare
    tokens = run_to_end(tokenize(bare))
    result = _Layout(bare, tokens).text()
    if _meanings(run_to_end(tokenize(result))) != _meanings(tokens):
        raise AssertionError("formatting would change the program")
    if result.startswith("\ufeff"):  # a stray one, which must not become the text's byte order mark
        result = "\n" + result
    return text[: text.startswith("\ufeff")] + (result.replace("\n", "\r\n") if crlf else result)


def syntax_error(file: ScriptFile) -> CompileError | None:
    """The first syntax error of a file."""
    for unit in file.units:
        try:
            run_to_end(parse(unit.text))
        except CompileError as error:
            found = file.located(error, unit)
            return found if isinstance(found, CompileError) else error
    return None


def _meanings(tokens: list[Token]) -> list[tuple[str, str, bool]]:
    return [(token.kind, token.text, token.after_newline) for token in tokens]


class _Layout:
    """Writes a text again, token by token."""

    def __init__(self, text: str, tokens: list[Token]) -> None:
        self._text = text
        self._tokens = tokens
        self._out: list[str] = []
        self._level = 0  # open blocks
        self._brackets: list[int] = []  # the line of each open bracket
        self._blank = False  # whether a blank line is due

    def text(self) -> str:
        starts = [0]
        for line in self._text.split("\n"):
            starts.append(starts[-1] + len(line) + 1)
        end, unary = 0, False
        for at, token in enumerate(self._tokens):
            start = starts[token.line - 1] + token.column - 1 if token.kind != "end of text" else len(self._text)
            rows = self._text[end:start].split("\n")
            before = self._tokens[at - 1] if at else None
            if before is None:
                rows.insert(0, "")
            elif len(rows) == 1 and token.kind != "end of text":
                self._out.append(self._space(before, token, unary=unary))
            self._comments(rows, at)
            if len(rows) > 1 and token.kind != "end of text":
                self._new_line(self._indentation(at))
            self._out.append(token.text)
            unary = token.kind in _SIGNS and (before is None or before.kind not in _OPERANDS)
            self._count(token)
            end = start + len(token.text)
        return "".join(self._out).strip("\n") + "\n" if len(self._out) > 1 else ""

    def _comments(self, rows: list[str], at: int) -> None:
        """Write the comments between two tokens, and note whether there is a blank line."""
        last = self._tokens[at].kind == "end of text"
        for number, row in enumerate(rows if last else rows[:-1]):
            comment = row.strip(BLANKS)
            if comment and number == 0:  # at least two spaces, and more where the author aligned comments
                space = row[: row.index(comment)]
                self._out.append(" " * max(len(space) if space.count(" ") == len(space) else 0, 2) + comment)
            elif comment:
                column = len(row) - len(row.lstrip(BLANKS)) + 1
                outer = self._tokens[at].kind in _BRANCHES and column <= self._tokens[at].column
                self._new_line(self._indentation(at) if outer else self._indentation(at, closing=False))
                self._out.append(comment)
            elif number:
                self._blank = True

    def _new_line(self, indentation: str) -> None:
        self._out.append(f"\n\n{indentation}" if self._blank else f"\n{indentation}")
        self._blank = False

    def _indentation(self, at: int, *, closing: bool = True) -> str:
        """That of a line which begins with a token; with closing, the blocks and brackets it closes are left."""
        token, before = self._tokens[at], self._tokens[at - 1].kind if at else ""
        level, brackets, line = self._level, list(self._brackets), token.line
        while closing and token.line == line and token.kind in ("end", ")", "]"):
            if token.kind == "end":
                level -= 1
            elif brackets:
                opened = brackets.pop()
                brackets = [other for other in brackets if other != opened]
            at += 1
            token = self._tokens[at]
        if closing and token.line == line and token.kind in _BRANCHES:
            level -= 1
        continued = not self._brackets and (before in _CONTINUED or (closing and token.kind in _OPERATORS))
        return _INDENT * (max(level, 0) + len(set(brackets)) + continued)

    def _count(self, token: Token) -> None:
        if token.kind in _OPENING:
            self._level += 1
        elif token.kind == "end":
            self._level = max(self._level - 1, 0)
        elif token.kind in "([":
            self._brackets.append(token.line)
        elif token.kind in ")]" and self._brackets:
            self._brackets.pop()

    def _space(self, left: Token, right: Token, *, unary: bool) -> str:
        """The space between two tokens on one line."""
        named = "=" in (left.kind, right.kind) and self._brackets
        called = right.kind == "(" and left.kind == "name"
        indexed = right.kind == "[" and left.kind in ("name", ")", "]")
        tight = unary or right.kind in _TIGHT_BEFORE or left.kind in _TIGHT_AFTER
        return "" if (tight or named or called or indexed) and not _merge(left, right) else " "


def _merge(left: Token, right: Token) -> bool:
    """Whether two tokens would be read as others if there were no space between them."""
    first, last = right.text[:1], left.text[-1:]
    if left.kind == "number" or last.isalnum() or last == "_":
        return first.isalnum() or first == "_" or (first == "." and left.kind == "number")
    return (last == "." and first.isdigit()) or (last in _COMPARING and first == "=")
