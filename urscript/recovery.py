"""Going on after a syntax error, for those who want to see all of them at once.

Where it goes on is a guess at what the author meant: a broken statement ends where a line begins
that can start a statement, and a broken ``if``, ``while``, ``def`` or ``thread`` still has its
block. What is skipped may have given a name its meaning, so names in it are not looked up
(`RecoveringParser.damaged`): a mistake is reported, its consequences are not.
"""

from collections.abc import Callable, Sequence
from typing import NoReturn, TypeVar

from urscript.errors import Cause, CompileError
from urscript.expressions import ExpressionParser
from urscript.hints import FOREIGN_BLOCKS
from urscript.tokens import KEYWORDS, Token
from urscript.work import Steps

ResultT = TypeVar("ResultT")

_IN_EXPRESSIONS = frozenset(["and", "or", "xor", "not", "True", "False", "None", "run"])
_AT_LINE_START = (KEYWORDS - _IN_EXPRESSIONS) | {"run", "name", "$"}
_BLOCKS = frozenset(["def", "thread", "if", "while"])
_NESTING = {"(": 1, "[": 1, ")": -1, "]": -1}


class RecoveringParser(ExpressionParser):
    """Reads expressions, and knows what to skip. Without `errors` the first error is raised."""

    def __init__(self, source: str, tokens: list[Token], errors: list[CompileError] | None) -> None:
        super().__init__(source, tokens)
        self._errors = errors
        self._hopeless = False
        self.damaged: set[str] = set()  # names in what did not parse

    @property
    def recovering(self) -> bool:
        """True when errors are gathered."""
        return self._errors is not None

    def complain(self, problem: str, blamed: Callable[[Sequence[Token]], Steps[Cause | None]]) -> Steps[None]:
        """A syntax error at the next token, after which reading goes on there.

        blamed: finds out of all tokens what is to blame for it.
        """
        try:
            self.fail(problem, None, (yield from blamed(self.tokens)))
        except CompileError as error:
            self._note(error)

    def give_up(self, problem: str, token: Token | None = None) -> NoReturn:
        """A syntax error that would only be repeated by going on."""
        self._hopeless = True
        self.fail(problem, token)

    def header(self, read: Callable[[], ResultT], instead: ResultT) -> ResultT:
        """What a compound statement says before its block; `instead` when it is broken."""
        start = self.at
        try:
            return read()
        except CompileError as error:
            self._note(error)
            self._go_on(start, self._header_end(self.at))
            return instead

    def skip_header(self) -> None:
        """Step past a word that stands where it must not, and what belongs to it in its line."""
        self._go_on(self.at, self._header_end(self.at + 1))

    def recover(self, error: CompileError, start: int) -> bool:
        """Go on behind the statement that began at token number `start`; raises `error` when that is not wanted.

        True when what follows is the block of a statement that there is not, as of a ``for``.
        """
        self._note(error)
        at = max(self.at, start + 1)
        while not self._begins_line(start):  # what stands before in the line may have been meant otherwise
            start -= 1
        opens = self.tokens[start].text in FOREIGN_BLOCKS
        if opens:
            end = self._header_end(at)
            opens = self.tokens[end - 1].kind == ":"
        self._go_on(start, end if opens else self._statement_end(self._past_brackets(start, at)))
        return opens

    def at_end_word(self, word: Token) -> None:
        """An error at the word of ``end if``, or at ``endif``."""
        try:
            self.fail("a block ends with 'end' alone", word)
        except CompileError as error:
            self._note(error)

    def _note(self, error: CompileError) -> None:
        if self._errors is None or self._hopeless:
            raise error
        if all((known.line, known.column) != (error.line, error.column) for known in self._errors):
            self._errors.append(error)
        if self.string_before(error.line):  # all that follows is taken for text, and text for program
            self._hopeless = True
            raise error

    def _go_on(self, start: int, at: int) -> None:
        self.damaged.update(token.text for token in self.tokens[start:at] if token.kind == "name")
        self.at = at
        self._depth = 0

    def _begins_line(self, at: int) -> bool:
        return at == 0 or self.tokens[at].line > self.tokens[at - 1].line

    def _header_end(self, at: int) -> int:
        """Behind the next colon of the line, or at the next line."""
        tokens = self.tokens
        while tokens[at].kind not in ("end", "end of text") and not self._begins_line(at):
            at += 1
            if tokens[at - 1].kind == ":":
                break
        return at

    def _past_brackets(self, start: int, at: int) -> int:
        """Behind the brackets that are open between two tokens, when they are closed before the next statement."""
        open_brackets = sum(_NESTING.get(token.kind, 0) for token in self.tokens[start:at])
        end = at
        while open_brackets > 0:
            kind = self.tokens[end].kind
            if kind == "end of text" or (kind in KEYWORDS and kind not in _IN_EXPRESSIONS):
                return at
            open_brackets += _NESTING.get(kind, 0)
            end += 1
        return end

    def _statement_end(self, at: int) -> int:
        """Where the next line begins that can start a statement, or the block ends."""
        blocks = 0
        while self.tokens[at].kind != "end of text":
            kind = self.tokens[at].kind
            if not blocks and (kind == "end" or (kind in _AT_LINE_START and self._begins_line(at))):
                break
            blocks += (kind in _BLOCKS) - (kind == "end")
            at += 1
        return at
