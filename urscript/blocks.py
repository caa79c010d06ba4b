"""The defs and threads of a text, kept by their text, so that a text that changes is read again only where it has.

A text is read as its *outline*: in it, a def or thread is ``def`` and ``end`` with as many line ends between them as it
has, so that all places stay what they are. Only the outline is tokenized and parsed; then the tokens and the syntax
tree of each def or thread are put in, whose lines count from its own first one.

A block has its own tokens because it begins and ends a line, and no string or bracket reaches across that. It has its
own syntax tree if it parses without an error. If it does not, the mistake may be before or after it: it then becomes a
part of the outline, without the blocks inside it.
"""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Final, NamedTuple

from urscript.errors import CompileError
from urscript.parser import Included, parse_tokens
from urscript.syntax import Constant, FunctionDef, Kept, ListLiteral, NumberList, PoseLiteral, Program
from urscript.tokens import Token, tokenize
from urscript.work import run_to_end

_WORD: Final = re.compile(r'"[^"]*"|#[^\n]*|\b(def|thread|if|while|end)\b', re.ASCII)
_LAST_ON_LINE: Final = re.compile(r"[ \t\r\f\v]*(?:#|\n|\Z)")
_BLANKS: Final = " \t\r\f\v"
_WORDS: Final = ("def", "thread")
_END: Final = "end"
_DEEPEST: Final = 40  # nested blocks; a deeper text is read as a whole, because the parser limits the depth
_LEVELS: Final = 4  # of blocks within blocks, each of which has a list of all its tokens
_TEXTS: Final = 4  # whose blocks are kept
_NEW: Final = tuple.__new__


class Placed(NamedTuple):
    """A block in a text. start: its offset; lines: those before it."""

    start: int
    lines: int
    block: "Block"


class Block:
    """A def or thread, from the beginning of its first line to its ``end``. inner: the largest blocks within it."""

    def __init__(self, text: str, inner: Sequence[Placed]) -> None:
        self.text = text
        self.inner = inner
        self.needed = 0  # the number of the latest text that contained it
        self._moved: tuple[int, list[Token]] | None = None

    @cached_property
    def stub(self) -> str:
        """What stands for it in an outline."""
        head = len(self.text) - len(self.text.lstrip(_BLANKS))
        head += len(next(word for word in _WORDS if self.text.startswith(word, head)))
        last = max(self.text.rfind("\n") + 1, head)
        return f"{self.text[:head]}{self._line_ends}{' ' * (len(self.text) - last - len(_END))}{_END}"

    @cached_property
    def _line_ends(self) -> str:
        return "\n" * self.text.count("\n")

    def tokens_after(self, lines: int) -> list[Token]:
        """Its tokens in a text with that many lines before it. Raises CompileError for one that is too long."""
        moved = self._moved
        if moved is None:
            moved = 0, _tokens(self.text, self.inner)[:-1]
        if moved[0] != lines:
            by = lines - moved[0]
            moved = lines, [_NEW(Token, (kind, text, line + by, at, new)) for kind, text, line, at, new in moved[1]]
        self._moved = moved
        return moved[1]

    @cached_property
    def program(self) -> tuple[Program, Kept] | None:
        """It as a program of one statement; None if it does not mean the same wherever it is."""
        if any(block.program is None for _, _, block in self.inner):
            return None  # nor would it parse
        errors: list[CompileError] = []
        try:
            program = _parsed(self.text, self.inner, errors, statements=True)
        except (CompileError, RecursionError):
            return None
        alone = len(program.body) == 1 and isinstance(program.body[0], FunctionDef)
        if errors or not alone or not all(map(_has_literal_defaults, program.functions.values())):
            return None
        return program, Kept(program.words)


class Blocks:
    """The blocks of the latest texts."""

    def __init__(self) -> None:
        self._known: dict[str, Block] = {}
        self._texts = 0

    def next_text(self) -> None:
        """Keep those of the latest texts alone, because another one follows."""
        self._texts += 1
        known = list(self._known.items())  # in one step: another thread may be adding some
        self._known = {text: block for text, block in known if block.needed > self._texts - _TEXTS}

    def tokens(self, text: str) -> list[Token]:
        """The same as `tokenize`. Raises CompileError."""
        return _tokens(text, self._within(text))

    def parse(self, source: str, errors: list[CompileError], *, statements: bool = False) -> Program:
        """The same as `urscript.parser.parse`, with the words of the text. Raises CompileError."""
        blocks = self._within(source)
        if not statements and blocks and not blocks[0].start and source.lstrip(_BLANKS).startswith(_WORDS[0]):
            blocks = [*blocks[0].block.inner, *blocks[1:]]  # the first def is the program itself
        return _parsed(source, blocks, errors, statements=statements)

    def _within(self, text: str) -> list[Placed]:
        """The largest blocks of a text."""
        top: list[_Span] = []
        opened: list[tuple[int, list[_Span]]] = []  # where each open block begins, if it may be one; those inside it
        for match in _WORD.finditer(text):
            word = match[1]
            if word == _END and opened:
                start, inner = opened.pop()
                around = opened[-1][1] if opened else top
                nested = sum(start >= 0 for start, _ in opened)
                if start >= 0 and nested < _LEVELS and _LAST_ON_LINE.match(text, match.end()):
                    around.append(_Span(start, match.end(), inner))
                else:
                    around += inner
            elif word and word != _END:
                start = text.rfind("\n", 0, match.start()) + 1
                first = word in _WORDS and not text[start : match.start()].strip(_BLANKS)
                opened.append((start if first else -1, []))
                if len(opened) > _DEEPEST:
                    return []
        return self._placed(text, [*top, *(span for _, inner in opened for span in inner)], 0)

    def _placed(self, text: str, spans: "Sequence[_Span]", begin: int) -> list[Placed]:
        """The blocks of some spans, in a part of the text that begins at an offset."""
        placed = []
        at, lines = begin, 0
        for start, end, spans_inside in spans:
            lines += text.count("\n", at, start)
            at = start
            inside, part = self._placed(text, spans_inside, start), text[start:end]
            block = self._known.get(part)
            if block is None:
                block = self._known[part] = Block(part, inside)
            block.needed = self._texts
            placed.append(Placed(start - begin, lines, block))
        return placed


class _Span(NamedTuple):
    start: int
    end: int
    inner: "list[_Span]"


def _outline(text: str, blocks: Sequence[Placed]) -> str:
    parts: list[str] = []
    at = 0
    for start, _, block in blocks:
        parts += text[at:start], block.stub
        at = start + len(block.text)
    return "".join([*parts, text[at:]])


def _tokens(text: str, blocks: Sequence[Placed]) -> list[Token]:
    """All tokens of a text, in which there are some blocks."""
    by_line = {lines + 1: block for _, lines, block in blocks}
    tokens: list[Token] = []
    of_outline = iter(run_to_end(tokenize(_outline(text, blocks))))
    for token in of_outline:
        block = by_line.get(token.line) if token.kind in _WORDS else None
        if block is None:
            tokens.append(token)
        else:
            tokens += block.tokens_after(token.line - 1)
            next(of_outline)  # its end
    return tokens


def _parsed(text: str, blocks: Sequence[Placed], errors: list[CompileError], *, statements: bool) -> Program:
    parsed = list(_with_program(blocks))
    tokens = run_to_end(tokenize(_outline(text, parsed)))
    words = Counter(token.text for token in tokens if token.kind == "name")
    included = {}
    for _, lines, block in parsed:
        if block.program is not None:
            included[lines + 1] = Included(*block.program, lines)
            words.update(block.program[0].words)
    steps = parse_tokens(
        text, tokens, errors, statements=statements, included=included, all_tokens=lambda: _tokens(text, blocks)
    )
    program = run_to_end(steps)
    program.words = words
    return program


def _with_program(blocks: Sequence[Placed], start: int = 0, lines: int = 0) -> Iterator[Placed]:
    """The largest blocks with a syntax tree among some, which are in a text that begins elsewhere."""
    for at, before, block in blocks:
        if block.program is not None:
            yield Placed(start + at, lines + before, block)
        else:
            yield from _with_program(block.inner, start + at, lines + before)


def _has_literal_defaults(function: FunctionDef) -> bool:
    """Whether its defaults have nothing to report: where a function is called, they are compiled with the call."""
    for parameter in function.scope.parameters:
        default = parameter.default
        items = default.items if isinstance(default, ListLiteral | PoseLiteral) else [default] if default else []
        if not all(isinstance(item, Constant | NumberList) for item in items):
            return False
    return True
