"""The statement half of the parser, and its entry point `parse`.

Parsing works in steps: generators read the statements that contain blocks, and yield after each statement. The first
error stops the parser, unless the caller collects all errors: then it continues after the broken statement
(`urscript.recovery`).

A statement ends where its grammar can no longer continue, not at the end of a line: PolyScope and several vendors write
two statements on one line, or a statement and its ``end``, with nothing between them.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

from urscript.errors import CompileError
from urscript.expressions import BLOCK_ENDS
from urscript.hints import is_end_with_word, is_like_end, misplaced_end, unclosed_block
from urscript.recovery import RecoveringParser
from urscript.syntax import (
    Assign,
    Call,
    Constant,
    Expression,
    ExpressionStatement,
    FunctionDef,
    If,
    Index,
    Kept,
    Label,
    Member,
    MethodCall,
    Name,
    Parameter,
    Program,
    ProgramKind,
    Return,
    Run,
    Scope,
    Statement,
    ThreadControl,
    While,
    Word,
)
from urscript.tokens import Token, tokenize
from urscript.work import Steps, release

_LEADING = re.compile(r"(?:[ \t\r\f\v\n]|#[^\n]*)*")
_SECONDARY = re.compile(rf"\ufeff?{_LEADING.pattern}sec\b")
_DECLARATIONS = frozenset(["global", "local"])
_MAX_BLOCKS = 60
"""Deepest nesting of blocks: a guess, above real programs and below the limit of Python's compiler."""

_PROGRAM_KINDS: dict[str, ProgramKind] = {"def": "program", "sec": "secondary"}
_MAX_LOOPS = 20
"""Deepest nesting of loops: the limit of Python's compiler."""

_MAX_FUNCTIONS = 5000
"""Most defs and threads in a program, because they are planned in one step: ten times the largest seen (a guess)."""

_WORK = 2  # per token
_RELEASE_WORK = 2  # to free a scope or a function
_STATEMENTS_WORK = 40  # to free a hundred statements or calls
_SLICE = 32  # tokens, at least, between two yields
_ABOVE_OPERATORS = 10
"""A statement starts with a target or a call, so this binding power excludes all binary operators."""


def normalize(text: str) -> str:
    """The text from the first line with code onwards, because the controller does not count the lines before it."""
    text = text.removeprefix("\ufeff")
    leading = _LEADING.match(text)
    first = leading.end() if leading else 0
    return text[text.rfind("\n", 0, first) + 1 :]


def is_secondary(text: str) -> bool:
    """Whether a text begins like a secondary program; the text may contain errors."""
    return _SECONDARY.match(text) is not None


def parse(source: str, errors: list[CompileError] | None = None, *, statements: bool = False) -> Steps[Program]:
    """The syntax tree of one normalized program.

    Raises CompileError for text that is not one program: ``def name(): … end``,
    ``sec name(): … end``, or statements; with `statements` they may begin with a def. With `errors`,
    errors are appended to that list instead, and the tree lacks the parts that did not parse.
    """
    tokens = yield from tokenize(source)
    return (yield from parse_tokens(source, tokens, errors, statements=statements))


class Included(NamedTuple):
    """A def or thread that was parsed before, as a program of one statement, and the lines before it in a text."""

    program: Program
    kept: Kept
    lines_before: int


def parse_tokens(
    source: str,
    tokens: list[Token],
    errors: list[CompileError] | None,
    *,
    statements: bool,
    included: Mapping[int, Included] = MappingProxyType({}),
    all_tokens: Callable[[], Sequence[Token]] | None = None,
) -> Steps[Program]:
    """Like `parse`, for the tokens of a text, which are released.

    included: by the line on which each begins. Its tokens are left out, except for the first and the last one, which
    the costs do not count; all_tokens: those of the whole text.
    """
    parser = _Parser(source, tokens, errors, included=included, all_tokens=all_tokens)
    error: CompileError | None = None
    try:
        program = yield from parser.statements() if statements else parser.program()
    except CompileError as found:
        error = found.with_traceback(None)
    yield from release(tokens)
    if error is None:
        return program
    if not included:
        yield from discard(parser.syntax)
    try:
        raise error
    finally:
        del error  # it refers to this frame: keeping it in a local variable would create a reference cycle


def discard(program: Program) -> Steps[None]:
    """Free a syntax tree that is no longer needed, in steps."""
    for block in program.blocks:
        yield from release(block, _STATEMENTS_WORK)
    yield from release(program.blocks)
    for scope in program.scopes:
        yield from release(scope.calls, _STATEMENTS_WORK)
        yield from release(scope.methods, _STATEMENTS_WORK)
        yield _RELEASE_WORK
    yield from release(program.scopes)
    while program.functions:
        program.functions.popitem()
        yield _RELEASE_WORK


def parse_statements(source: str) -> Steps[Program]:
    """The syntax tree of statements for an existing scope: names they assign are local unless declared global.

    Raises CompileError.
    """
    tokens = yield from tokenize(source)
    return (yield from _Parser(source, tokens, None, inner=True).statements())


class _Parser(RecoveringParser):
    def __init__(
        self,
        source: str,
        tokens: list[Token],
        errors: list[CompileError] | None,
        *,
        inner: bool = False,
        included: Mapping[int, Included] = MappingProxyType({}),
        all_tokens: Callable[[], Sequence[Token]] | None = None,
    ) -> None:
        super().__init__(source, tokens, errors, all_tokens)
        self._inner = inner  # parsing statements for an existing scope
        self._included = included
        body: list[Statement] = []
        self.syntax = Program("statement", "", body, self.scope, {}, {}, [], self.damaged, [body], [self.scope])
        self._blocks = 0
        self._loops = 0
        self._cost_of_loops = 0  # of all that have been read
        self._counted = 0  # tokens whose work has been yielded
        self._compounds: dict[str, Callable[[Any, Token], Steps[Statement]]] = {
            "def": _Parser._function,
            "thread": _Parser._function,
            "if": _Parser._if,
            "while": _Parser._while,
        }
        self._statements: dict[str, Callable[[Any, Token], Statement]] = {
            "return": _Parser._return,
            "break": _Parser._loop_word,
            "continue": _Parser._loop_word,
            "halt": _Parser._word,
            "enter_critical": _Parser._word,
            "exit_critical": _Parser._word,
            "join": _Parser._thread_control,
            "kill": _Parser._thread_control,
            "$": _Parser._label,
        }

    def program(self) -> Steps[Program]:
        program = self.syntax
        if self.token.kind in ("def", "sec"):
            program.kind = _PROGRAM_KINDS[self.take().kind]
            self.header(self._program_name, None)
            program.body = yield from self._block("to close the program")
        else:
            yield from self.statements()
        if self.token.kind != "end of text":
            yield from self.report("the program ended before this", misplaced_end)
        return program

    def _program_name(self) -> None:
        self.syntax.name = self.expect("name", "for the program").text
        self.expect("(", "after the name of the program")
        self.expect(")", "because a program takes no parameters")
        self.expect(":", "after ')'")

    def statements(self) -> Steps[Program]:
        while self.token.kind != "end of text":
            yield from self._add_statement(self.syntax.body)
        return self.syntax

    # blocks

    def _block(self, where: str) -> Steps[list[Statement]]:
        body = yield from self._open_block()
        yield from self._close(where, body)
        return body

    def _close(self, where: str, body: list[Statement]) -> Steps[None]:
        """Step past the ``end`` of a block; during recovery, branches that do not belong there join the body."""
        while self.recovering and self.token.kind in ("else", "elif"):
            yield from self.report(f"expected 'end' {where}", unclosed_block)
            self.skip_header()
            body += yield from self._open_block()
        if self.token.kind == "end":
            if self.end_with_word_at is None and is_end_with_word(self.tokens, self.at):
                self.end_with_word_at = self.at
            self.take()
            if self.recovering and is_end_with_word(self.tokens, self.at - 1):
                self.take()
                self.at_end_word(self.tokens[self.at - 1])
        elif self._at_end_word():
            self.at_end_word(self.take())
        else:
            yield from self.report(f"expected 'end' {where}", unclosed_block)

    def _at_end_word(self) -> bool:
        """True at an ``endif`` or similar, which ends a block when looking for more errors."""
        token = self.token
        alone = (
            self.recovering and token.kind == "name" and token.after_newline and self.tokens[self.at + 1].after_newline
        )
        return alone and is_like_end(self.tokens, self.at)

    def _open_block(self) -> Steps[list[Statement]]:
        """Read statements up to the word that ends the block, which the caller consumes."""
        self._blocks += 1
        if self._blocks > _MAX_BLOCKS:
            self.give_up(f"blocks are nested more than {_MAX_BLOCKS} deep")
        body: list[Statement] = []
        self.syntax.blocks.append(body)
        while self.token.kind not in BLOCK_ENDS and not self._at_end_word():
            yield from self._add_statement(body)
        self._blocks -= 1
        return body

    def _add_statement(self, body: list[Statement]) -> Steps[None]:
        start = self.at
        try:
            body.append((yield from self._statement()))
        except CompileError as error:
            if self.recover(error, start):
                body += yield from self._block("to close this block")

    def _statement(self) -> Steps[Statement]:
        """Read one statement; its cost is its number of tokens plus the extra cost of its calls."""
        first, surcharge, of_loops = self.at, self.scope.cost, self._cost_of_loops
        kind = self.token.kind
        self.started = self.measured = first
        if kind in self._compounds:
            statement = yield from self._compounds[kind](self, self.take())
        else:
            handler = self._statements.get(kind)
            if handler is not None:
                statement = handler(self, self.take())
            else:
                declared = self.take().kind if kind in _DECLARATIONS else None
                statement = yield from self._assignment_or_call(declared)
            if self.at >= self._counted + _SLICE:
                yield (self.at - self._counted) * _WORK
                self._counted = self.at
        if isinstance(statement, FunctionDef):
            return statement
        statement.cost = self.at - first + self.scope.cost - surcharge
        if isinstance(statement, While):
            self._cost_of_loops = of_loops + statement.cost
        elif isinstance(statement, If):
            statement.own_cost = statement.cost - (self._cost_of_loops - of_loops)
        return statement

    # simple statements

    def _assignment_or_call(self, declared: str | None) -> Steps[Statement]:
        start = self.token
        if start.kind not in ("name", "run"):
            if self.token.kind in BLOCK_ENDS:
                blamed = yield from self.cause(misplaced_end)
                self.fail("there is no open block it could belong to", None, blamed)
            self.fail("expected a statement")
        value = self.expression(_ABOVE_OPERATORS)
        if self.token.kind == "=":
            return (yield from self._assign(value, start, declared))
        if declared:
            self.fail(f"'{declared}' needs an assignment")
        if not isinstance(value, (Call, MethodCall, Run)):
            self.fail("this is neither an assignment nor a call" if self.token.kind in BLOCK_ENDS else "expected '='")
        return ExpressionStatement(value.line, value.column, value)

    def _assign(self, target: Expression, start: Token, declared: str | None) -> Steps[Statement]:
        if not isinstance(target, (Name, Index, Member)) or not _is_variable(target):
            self.fail("this cannot be assigned to", start)
        self.take()
        if isinstance(target, Name):
            self._bind(target.name, declared)
        if self.token.kind == "[":
            value = yield from self.long_list()
            self._counted = self.at
        else:
            value = self.expression()
        return Assign(target.line, target.column, target, value)

    def _bind(self, name: str, declared: str | None) -> None:
        at_program_level = self.scope is self.syntax.scope and not self._inner
        if at_program_level or declared == "global":
            self.syntax.globals.setdefault(name)
        elif declared == "local":
            self.scope.locals.add(name)
        else:
            self.scope.assigned.add(name)

    def _return(self, token: Token) -> Statement:
        if self._inner and self.scope is self.syntax.scope:
            self.fail("not inside a function", token)
        following = self.token
        bare = following.after_newline or following.kind in BLOCK_ENDS
        return Return(token.line, token.column, None if bare else self.expression())

    def _word(self, token: Token) -> Statement:
        return Word(token.line, token.column, token.kind)

    def _loop_word(self, token: Token) -> Statement:
        if not self._loops:
            self.fail("not inside a loop", token)
        return self._word(token)

    def _thread_control(self, token: Token) -> Statement:
        if token.kind == "join":
            self.scope.waits = True
        return ThreadControl(token.line, token.column, token.kind, self.expression())

    def _label(self, token: Token) -> Statement:
        number = self.expect("number", "for the program label")
        if not number.text.isdigit() or len(number.text) > 9:
            self.fail("the number of a program label must be an integer of at most 9 digits", number)
        text = self.expect("string", "for the program label").text[1:-1]
        option = self.take().text[1:-1] if self.token.kind == "string" else ""
        label = Label(token.line, token.column, int(number.text), text, option)
        self.syntax.labels.append(label)
        self.scope.waits = True
        return label

    # compound statements

    def _if(self, token: Token) -> Steps[Statement]:
        branches = [(yield from self._branch("if"))]
        while self.token.kind == "elif":
            self.take()
            branches.append((yield from self._branch("elif")))
        otherwise: list[Statement] = []
        if self.token.kind == "else":
            self.take()
            self.header(lambda: self.expect(":", "after else"), None)
            otherwise = yield from self._open_block()
        yield from self._close(f"to close the if on line {token.line}", otherwise)
        return If(token.line, token.column, branches, otherwise)

    def _branch(self, word: str) -> Steps[tuple[Expression, list[Statement]]]:
        condition = self._condition(word)
        return condition, (yield from self._open_block())

    def _condition(self, word: str) -> Expression:
        def read() -> Expression:
            condition = self.expression()
            self.expect(":", f"after the condition of {word}")
            return condition

        always: Expression = Constant(self.token.line, self.token.column, True)
        return self.header(read, always)

    def _while(self, token: Token) -> Steps[Statement]:
        condition = self._condition("while")
        self._loops += 1
        if self._loops > _MAX_LOOPS:
            self.give_up(f"loops are nested more than {_MAX_LOOPS} deep", token)
        body = yield from self._block(f"to close the while on line {token.line}")
        self._loops -= 1
        self.scope.loops = True
        return While(token.line, token.column, condition, body)

    def _function(self, token: Token) -> Steps[Statement]:
        if token.line in self._included and self.token.kind == "end":
            self.take()
            return self._include(token, *self._included[token.line])
        outer, outer_loops = self.scope, self._loops
        self.scope, self._loops = Scope("", is_thread=token.kind == "thread"), 0
        self.syntax.scopes.append(self.scope)
        self.header(lambda: self._signature(token), None)
        first = self.at
        body = yield from self._block(f"to close the {token.kind} on line {token.line}")
        self.scope.cost += self.at - first
        function = FunctionDef(token.line, token.column, self.scope, body)
        self._define({self.scope.name: function}, token)
        self.scope, self._loops = outer, outer_loops
        return function

    def _define(self, functions: Mapping[str, FunctionDef], token: Token) -> None:
        if len(self.syntax.functions) + len(functions) > _MAX_FUNCTIONS:
            self.fail(f"the program has more than {_MAX_FUNCTIONS} defs and threads", token)
        self.syntax.functions |= functions  # a second def of a name replaces the first

    def resume_at(self, start: int, at: int) -> None:
        """Continue at a token; those from `start` on did not parse."""
        if self._included:
            for token in self.tokens[start:at]:
                if token.kind in ("def", "thread") and token.line in self._included:
                    self.damaged.update(self._included[token.line].kept.words)
        super().resume_at(start, at)

    def _include(self, token: Token, program: Program, kept: Kept, lines_before: int) -> Statement:
        """Put in a def or thread, of which the first token and the last one have been read."""
        syntax = self.syntax
        moved = {
            name: replace(function, lines_before=function.lines_before + lines_before, kept=kept)
            for name, function in program.functions.items()
        }
        self._define(moved, token)
        syntax.globals |= program.globals
        syntax.labels += program.labels
        syntax.scopes += program.scopes[1:]
        return program.body[0]

    def _signature(self, token: Token) -> None:
        self.scope.name = self.expect("name", f"after {token.kind}").text
        self._parameters(token)
        self.expect(":", f"after the parameters of {self.scope.name}")

    def _parameters(self, token: Token) -> None:
        self.expect("(", f"after the name of the {token.kind}")
        if token.kind == "thread" and self.token.kind != ")":
            self.fail("a thread takes no parameters")
        if self.token.kind != ")":
            self._parameter()
            while self.another():
                self._parameter()
        self.expect(")", "to close the parameters")

    def _parameter(self) -> None:
        token = self.expect("name", "for a parameter")
        if token.text in self.scope.locals:
            self.fail(f"two parameters are called {token.text}", token)
        default = None
        if self.token.kind == "=":
            self.take()
            default = self.expression()
        elif self.scope.parameters and self.scope.parameters[-1].default is not None:
            self.fail("a parameter without a default cannot follow one with a default", token)
        self.scope.parameters.append(Parameter(token.line, token.column, token.text, default))
        self.scope.locals.add(token.text)


def _is_variable(target: Expression) -> bool:
    """True for a variable and for elements or members of one."""
    while isinstance(target, (Index, Member)):
        target = target.target
    return isinstance(target, Name)
