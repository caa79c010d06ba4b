"""Error recovery: continue after a syntax error, so that all errors of a text can be reported together.

The position where parsing resumes is a guess at what the author meant: a broken statement ends where a line begins that
can start a statement, and a broken ``if``, ``while``, ``def`` or ``thread`` still has its block. The skipped text may
have defined names, so the names in it are never reported as undefined (`RecoveringParser.damaged`): a mistake is
reported, but its consequences are not.
"""

from collections.abc import Callable, Sequence
from typing import NoReturn, TypeAlias, TypeVar

from urscript.errors import Cause, CompileError
from urscript.expressions import ExpressionParser
from urscript.hints import FOREIGN_BLOCKS, is_like_branch
from urscript.tokens import IN_EXPRESSIONS, KEYWORDS, Token
from urscript.work import Steps

ResultT = TypeVar("ResultT")
Blame: TypeAlias = Callable[[Sequence[Token]], Steps[Cause | None]]

_AT_LINE_START = (KEYWORDS - IN_EXPRESSIONS) | {"run", "name", "$"}
_BLOCKS = frozenset(["def", "thread", "if", "while"])
_LOOKS = 200_000  # tokens in which the end of a block is looked for, for all errors of a text
_NESTING = {"(": 1, "[": 1, ")": -1, "]": -1}


class RecoveringParser(ExpressionParser):
    """Reads expressions, and knows how much to skip after an error. Without `errors`, the first error is raised.

    all_tokens: those of the whole text, if `tokens` are not.
    """

    def __init__(
        self,
        source: str,
        tokens: list[Token],
        errors: list[CompileError] | None,
        all_tokens: Callable[[], Sequence[Token]] | None,
    ) -> None:
        super().__init__(source, tokens)
        self._all_tokens = all_tokens
        self._errors = errors
        self._places: set[tuple[int, int]] = set()  # lines and columns of them
        self._causes: dict[Blame, Cause | None] = {}
        self._unrecoverable = False
        self._looks = _LOOKS
        self.damaged: set[str] = set()  # names in text that did not parse

    @property
    def recovering(self) -> bool:
        """True when errors are collected."""
        return self._errors is not None

    def report(self, problem: str, blamed: Blame) -> Steps[None]:
        """Report a syntax error at the next token and continue there.

        blamed: finds the cause of the error among all tokens.
        """
        try:
            self.fail(problem, None, (yield from self.cause(blamed)))
        except CompileError as error:
            self._record(error)

    def cause(self, blamed: Blame) -> Steps[Cause | None]:
        """What `blamed` finds, which is the same for each error of a text."""
        if blamed not in self._causes:
            tokens = self._all_tokens() if self._all_tokens else self.tokens
            self._causes[blamed] = yield from blamed(tokens)
        return self._causes[blamed]

    def give_up(self, problem: str, token: Token | None = None) -> NoReturn:
        """Raise a syntax error that would only be repeated if parsing continued."""
        self._unrecoverable = True
        self.fail(problem, token)

    def header(self, read: Callable[[], ResultT], instead: ResultT) -> ResultT:
        """Read the header of a compound statement; returns `instead` when it is broken."""
        start = self.at
        try:
            return read()
        except CompileError as error:
            self._record(error)
            self.resume_at(start, self._header_end(self.at))
            return instead

    def skip_header(self) -> None:
        """Step past a misplaced keyword and the rest of its header."""
        self.resume_at(self.at, self._header_end(self.at + 1))

    def recover(self, error: CompileError, start: int) -> bool:
        """Continue after the statement that began at token `start`; raises `error` when errors are not collected.

        Returns True when the block of a statement follows that URScript does not have, such as ``for``.
        """
        self._record(error)
        at = max(self.at, start + 1)
        while not self._begins_line(start):  # the text before it on the line may be part of the mistake
            start -= 1
        header_end = self._header_end(at)
        colon = self.tokens[header_end - 1].kind == ":"
        end = header_end if colon else self._statement_end(self._past_brackets(start, at))
        opens = self._opens_block(start, end, colon=colon)
        self.resume_at(start, end if opens or not colon else self._statement_end(self._past_brackets(start, at)))
        return opens

    def _opens_block(self, start: int, end: int, *, colon: bool) -> bool:
        """Whether a line that did not parse, from one token to another, is the header of a block.

        It is if it ends with a colon, or if the next line is indented further, and an ``end`` in its column follows.
        """
        first, following = self.tokens[start], self.tokens[end]
        if first.text in FOREIGN_BLOCKS:
            return colon
        if first.kind != "name" or is_like_branch(first.text) or not self._begins_line(end):
            return False
        return (colon or following.column > first.column) and self._is_closed(end, first.column)

    def _is_closed(self, at: int, column: int) -> bool:
        """Whether the first ``end`` that is surplus after a token is in a column."""
        blocks = 0
        for place in range(at, min(at + self._looks, len(self.tokens))):
            self._looks -= 1
            kind = self.tokens[place].kind
            if kind == "end" and not blocks:
                return self.tokens[place].column == column and self._begins_line(place)
            blocks += (kind in _BLOCKS) - (kind == "end")
        return False

    def at_end_word(self, word: Token) -> None:
        """Report an error at the second word of ``end if``, or at ``endif``."""
        try:
            self.fail("a block ends with 'end' alone", word)
        except CompileError as error:
            self._record(error)

    def _record(self, error: CompileError) -> None:
        if self._errors is None or self._unrecoverable:
            raise error
        if (place := (error.line, error.column)) not in self._places:
            self._places.add(place)
            self._errors.append(error)
        if self.string_before(error.line) or self.string_before(error.line + 1):
            # A quote is missing: from here on, strings and code are swapped.
            self._unrecoverable = True
            raise error

    def resume_at(self, start: int, at: int) -> None:
        """Continue at a token; those from `start` on did not parse."""
        self.damaged.update(token.text for token in self.tokens[start:at] if token.kind == "name")
        self.at = at
        self._depth = 0

    def _begins_line(self, at: int) -> bool:
        return at == 0 or self.tokens[at].line > self.tokens[at - 1].line

    def _header_end(self, at: int) -> int:
        """The index of the token after the next colon on the line, or of the next line."""
        tokens = self.tokens
        while tokens[at].kind not in ("end", "end of text") and not self._begins_line(at):
            at += 1
            if tokens[at - 1].kind == ":":
                break
        return at

    def _past_brackets(self, start: int, at: int) -> int:
        """The index after the brackets left open between two tokens, if they are closed before the next statement."""
        open_brackets = sum(_NESTING.get(token.kind, 0) for token in self.tokens[start:at])
        end = at
        while open_brackets > 0:
            kind = self.tokens[end].kind
            if kind == "end of text" or (kind in KEYWORDS and kind not in IN_EXPRESSIONS):
                return at
            open_brackets += _NESTING.get(kind, 0)
            end += 1
        return end

    def _statement_end(self, at: int) -> int:
        """The index where the next line begins that can start a statement, or where the block ends."""
        blocks = 0
        while self.tokens[at].kind != "end of text":
            kind = self.tokens[at].kind
            if not blocks and (kind == "end" or (kind in _AT_LINE_START and self._begins_line(at))):
                break
            blocks += (kind in _BLOCKS) - (kind == "end")
            at += 1
        return at
