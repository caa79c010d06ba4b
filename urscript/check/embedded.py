"""URScript in string literals of Python and C++, with the place of each of its lines in the host file."""

import ast
import re
import warnings
from collections.abc import Iterator
from typing import Any, Final

from urproto.text import from_bytes, to_bytes

_PYTHON: Final = re.compile(
    r"#[^\n]*|(?P<prefix>[A-Za-z]{0,2})(?P<quote>\"{3}|'{3}|\"|')(?P<body>(?:\\.|(?!(?P=quote))[^\\])*)(?P=quote)",
    re.DOTALL,
)
_CPP: Final = re.compile(
    r"//[^\n]*|/\*.*?\*/|'(?:\\.|[^'\\\n])+'|R\"(?P<mark>[^ ()\\\n]{0,16})\((?P<raw>.*?)\)(?P=mark)\""
    r"|\"(?P<body>(?:\\.|[^\"\\\n])*)\"|\s+|(?P<other>.)",
    re.DOTALL,
)
_PIECE: Final = re.compile(r"\\\r?\n|\\n|\\.|\r?\n|[^\\\r\n]+|\r", re.DOTALL)
_RAW_PIECE: Final = re.compile(r"\r?\n|[^\r\n]+|\r")
_LETTERS: Final = {"t": "\t", "r": "\r", '"': '"', "'": "'", "\\": "\\"}
_BRACES: Final = re.compile(r"\{\{|\}\}|\{[^{}]*\}")
_CONVERSION: Final = re.compile(r"%[-+#0]*\d*(?:\.\d+)?l?[sdifgru]")
_COMMENT: Final = re.compile(r"#[^\n]*")
_BEGIN: Final = re.compile(r"(?:def|sec)\s+[\w{}.]+\s*\(\s*\)\s*:")
_END: Final = re.compile(r"\bend$")


class Embedded:
    """A text put together from literals. starts: the place in the host of the first character of each of its lines."""

    def __init__(self, *, converted: bool = False) -> None:
        """converted: values are filled in for % with a letter, as by printf."""
        self.text = ""
        self.starts: list[tuple[int, int]] = []
        self.converted = converted
        self._pieces: list[str] = []
        self._fresh = True

    def add(self, piece: str, line: int, column: int) -> None:
        """Append a piece of at most one line; a line feed ends the line."""
        if self._fresh:
            self.starts.append((line, column))
        self._fresh = piece == "\n"
        self._pieces.append(piece)

    def literal(self, body: str, line: int, column: int, *, raw: bool) -> None:
        """Append the value of a literal, whose body begins at a place in the host."""
        for match in (_RAW_PIECE if raw else _PIECE).finditer(body):
            piece = match[0]
            if piece in ("\n", "\r\n"):
                self.add("\n", line, column)
            elif raw or piece[0] != "\\":
                self.add(piece, line, column)
            elif piece == "\\n":
                self.add("\n", line, column)
            elif piece[1] not in "\r\n":
                self.add(_LETTERS.get(piece[1], piece), line, column)
            line, column = (line + 1, 1) if piece.endswith("\n") else (line, column + len(piece))

    def finished(self) -> bool:
        """Whether it is a program; completes `text`."""
        self.text = "".join(self._pieces)
        if self.converted:
            self.text = _CONVERSION.sub(lambda match: "{" + "_" * (len(match[0]) - 2) + "}", self.text)
        code = _COMMENT.sub("", self.text).strip()
        return _BEGIN.match(code) is not None and _END.search(code, len(code) - 4) is not None


def in_python(source: str) -> Iterator[Embedded]:
    """The programs in a Python file. Raises SyntaxError."""
    lines = source.split("\n")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its escapes: they are not what is checked
        waiting: list[ast.AST] = [ast.parse(source)]
    while waiting:
        node = waiting.pop()
        terms, found = _terms(node), Embedded()
        if isinstance(node, ast.BinOp | ast.JoinedStr | ast.Constant | ast.Call) and _put(terms[0], lines, found):
            for term in terms[1:]:
                if not _put(term, lines, found):
                    found.add("{_}", term.lineno, term.col_offset + 1)
            if found.finished():
                yield found
                continue
        if len(terms) > 1:  # a text among them is only a part of one
            waiting.extend(term for term in terms if not isinstance(term, ast.Constant | ast.JoinedStr))
        else:
            waiting.extend(ast.iter_child_nodes(node))


def _terms(node: Any) -> list[Any]:
    """The terms of a sum, or the node alone."""
    terms = []
    while isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        terms.append(node.right)
        node = node.left
    return [node, *reversed(terms)]


def _put(node: ast.AST, lines: list[str], found: Embedded) -> bool:
    """Append a text with its literals; False if the node is not a text."""
    match node:
        case ast.Constant(value=str()) | ast.JoinedStr():
            _put_literals(node, lines, found)
            return True
        case ast.BinOp(op=ast.Mod(), left=ast.Constant(value=str()) as text):
            found.converted = True
            _put_literals(text, lines, found)
            return True
        case ast.Call(func=ast.Attribute(value=ast.Constant(value=str()) as text, attr="format")):
            _put_literals(text, lines, found)
            return True
    return False


def _put_literals(node: ast.Constant | ast.JoinedStr, lines: list[str], found: Embedded) -> None:
    """Append adjacent literals. Columns of Python's tree count bytes of UTF-8."""
    assert node.end_lineno is not None
    assert node.end_col_offset is not None
    first, last = node.lineno - 1, node.end_lineno - 1
    rows = lines[first : last + 1]
    rows[-1] = from_bytes(to_bytes(rows[-1])[: node.end_col_offset])
    start = len(from_bytes(to_bytes(rows[0])[: node.col_offset]))
    segment = "\n".join(rows)
    for match in _PYTHON.finditer(segment, start):
        if match["quote"] is None:
            continue
        prefix, body = match["prefix"].lower(), match["body"]
        if "f" in prefix:
            body = _BRACES.sub(_braces, body)
        before = segment[: match.start("body")]
        column = len(before) - before.rfind("\n")
        found.literal(body, node.lineno + before.count("\n"), column, raw="r" in prefix)


def _braces(match: re.Match[str]) -> str:
    """Doubled braces of an f-string become single ones; others become a placeholder of the same length."""
    text = match[0]
    return text[0] if text in ("{{", "}}") else "{" + re.sub(r"\W", "_", text[1:-1]) + "}"


def in_cpp(source: str) -> Iterator[Embedded]:
    """The programs in a C++ file: raw literals, and adjacent ones."""
    found, line, line_start = Embedded(converted=True), 1, 0
    for match in _CPP.finditer(source):
        group = "raw" if match["raw"] is not None else "body" if match["body"] is not None else ""
        if group:
            newlines = source.count("\n", match.start(), match.start(group))
            column = match.start(group) - line_start + 1
            found.literal(match[group], line + newlines, column, raw=group == "raw")
        elif match["other"] is not None and found.starts:
            if found.finished():
                yield found
            found = Embedded(converted=True)
        if "\n" in match[0]:
            line += match[0].count("\n")
            line_start = match.start() + match[0].rindex("\n") + 1


READERS: Final = {".py": in_python, **dict.fromkeys([".cpp", ".hpp", ".cc", ".cxx", ".h", ".hh"], in_cpp)}
"""How the programs in a file are found, by the ending of its name."""
