"""The statement half of the parser, and the entry `parse`.

It works in steps: statements with blocks inside are read by generators, which yield after each statement.

A statement ends where its grammar can no longer continue: PolyScope and several vendors write
two statements on one line, or a statement and its ``end``, with nothing between them.
"""

import re
from collections.abc import Callable

from urscript.expressions import ExpressionParser
from urscript.syntax import (
    Assign,
    Call,
    Expression,
    ExpressionStatement,
    FunctionDef,
    If,
    Index,
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
from urscript.work import Steps

__all__ = ["is_secondary", "normalize", "parse"]

_LEADING = re.compile(r"(?:[ \t\r\f\v\n]|#[^\n]*)*")
_SECONDARY = re.compile(r"\s*sec\b")
_BLOCK_ENDS = frozenset(["end", "else", "elif", "end of text"])
_MAX_BLOCKS = 60
"""Deepest nesting of blocks: a guess, above real programs and below what Python's compiler bears."""


def normalize(text: str) -> str:
    """The text from the first line with code on: the controller does not count what comes before it."""
    text = text.removeprefix("\ufeff")
    leading = _LEADING.match(text)
    first = leading.end() if leading else 0
    return text[text.rfind("\n", 0, first) + 1 :]


def is_secondary(text: str) -> bool:
    """Whether a text, which may have errors, begins like a secondary program."""
    return _SECONDARY.match(normalize(text)) is not None


def parse(source: str) -> Steps[Program]:
    """The syntax tree of one normalized program.

    Raises CompileError for text that is not one program: ``def name(): … end``,
    ``sec name(): … end``, or statements.
    """
    tokens = yield from tokenize(source)
    return (yield from _Parser(source, tokens).program())


class _Parser(ExpressionParser):
    def __init__(self, source: str, tokens: list[Token]) -> None:
        super().__init__(source, tokens)
        self._program = Program("statement", "", [], self.scope, {}, {}, [])
        self._blocks = 0
        self._loops = 0
        self._counted = 0  # tokens whose work was yielded
        self._compounds: dict[str, Callable[[Token], Steps[Statement]]] = {
            "def": self._function,
            "thread": self._function,
            "if": self._if,
            "while": self._while,
        }
        self._statements: dict[str, Callable[[Token], Statement]] = {
            "return": self._return,
            "global": self._declaration,
            "local": self._declaration,
            "break": self._loop_word,
            "continue": self._loop_word,
            "halt": self._word,
            "enter_critical": self._word,
            "exit_critical": self._word,
            "join": self._thread_control,
            "kill": self._thread_control,
            "$": self._label,
        }

    def program(self) -> Steps[Program]:
        program = self._program
        if self.token.kind in ("def", "sec"):
            program.kind = _PROGRAM_KINDS[self.take().kind]
            program.name = self.expect("name", "the name of the program").text
            self.expect("(", "after the name of the program")
            self.expect(")", "a program takes no parameters")
            self.expect(":", "after ')'")
            program.body = yield from self._block("to close the program")
        else:
            while self.token.kind != "end of text":
                program.body.append((yield from self._statement()))
        if self.token.kind != "end of text":
            self.fail("the program ended before this")
        return program

    # blocks

    def _block(self, where: str) -> Steps[list[Statement]]:
        body = yield from self._open_block()
        self.expect("end", where)
        return body

    def _open_block(self) -> Steps[list[Statement]]:
        """Statements up to the word that ends the block, which is left for the caller."""
        self._blocks += 1
        if self._blocks > _MAX_BLOCKS:
            self.fail(f"blocks are nested more than {_MAX_BLOCKS} deep")
        body: list[Statement] = []
        while self.token.kind not in _BLOCK_ENDS:
            body.append((yield from self._statement()))
        self._blocks -= 1
        return body

    def _statement(self) -> Steps[Statement]:
        """One statement; its cost is the number of its tokens and the surcharges of its calls."""
        first, surcharge = self.at, self.scope.cost
        kind = self.token.kind
        self.started = first
        if kind in self._compounds:
            statement = yield from self._compounds[kind](self.take())
        else:
            handler = self._statements.get(kind)
            statement = handler(self.take()) if handler else self._assignment_or_call(None)
            if self.at >= self._counted + _SLICE:
                yield (self.at - self._counted) * _WORK
                self._counted = self.at
        if isinstance(statement, FunctionDef):
            return statement
        statement.cost = self.at - first + self.scope.cost - surcharge
        return statement

    # simple statements

    def _declaration(self, token: Token) -> Statement:
        return self._assignment_or_call(token.kind)

    def _assignment_or_call(self, declared: str | None) -> Statement:
        start = self.token
        if start.kind not in ("name", "run"):
            self.fail("expected a statement")
        value = self.expression(_ABOVE_OPERATORS)
        if self.token.kind == "=":
            return self._assign(value, start, declared)
        if declared:
            self.fail(f"'{declared}' needs an assignment")
        if not isinstance(value, (Call, MethodCall, Run)):
            self.fail("this is neither an assignment nor a call" if self.token.kind in _BLOCK_ENDS else "expected '='")
        return ExpressionStatement(value.line, value.column, value)

    def _assign(self, target: Expression, start: Token, declared: str | None) -> Statement:
        if not isinstance(target, (Name, Index, Member)) or not _is_variable(target):
            self.fail("this cannot be assigned to", start)
        self.take()
        if isinstance(target, Name):
            self._bind(target.name, declared)
        return Assign(target.line, target.column, target, self.expression())

    def _bind(self, name: str, declared: str | None) -> None:
        at_program_level = self.scope is self._program.scope
        if at_program_level or declared == "global":
            self._program.globals.setdefault(name)
        elif declared == "local":
            self.scope.locals.add(name)
        else:
            self.scope.assigned.add(name)

    def _return(self, token: Token) -> Statement:
        following = self.token
        bare = following.after_newline or following.kind in _BLOCK_ENDS
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
        number = self.expect("number", "of the program label").text
        if not number.isdigit() or len(number) > 9:
            self.fail("a program label has a whole number", token)
        text = self.expect("string", "of the program label").text[1:-1]
        option = self.take().text[1:-1] if self.token.kind == "string" else ""
        label = Label(token.line, token.column, int(number), text, option)
        self._program.labels.append(label)
        return label

    # compound statements

    def _if(self, token: Token) -> Steps[Statement]:
        outer_loops, self.scope.loops = self.scope.loops, False
        branches = [(yield from self._branch("if"))]
        while self.token.kind == "elif":
            self.take()
            branches.append((yield from self._branch("elif")))
        otherwise: list[Statement] = []
        if self.token.kind == "else":
            self.take()
            self.expect(":", "after else")
            otherwise = yield from self._open_block()
        self.expect("end", f"to close the if of line {token.line}")
        loops = self.scope.loops
        self.scope.loops = loops or outer_loops
        return If(token.line, token.column, branches, otherwise, loops)

    def _branch(self, word: str) -> Steps[tuple[Expression, list[Statement]]]:
        condition = self.expression()
        self.expect(":", f"after the condition of {word}")
        return condition, (yield from self._open_block())

    def _while(self, token: Token) -> Steps[Statement]:
        condition = self.expression()
        self.expect(":", "after the condition of while")
        self._loops += 1
        if self._loops > _MAX_LOOPS:
            self.fail(f"loops are nested more than {_MAX_LOOPS} deep", token)
        body = yield from self._block(f"to close the while of line {token.line}")
        self._loops -= 1
        self.scope.loops = True
        return While(token.line, token.column, condition, body)

    def _function(self, token: Token) -> Steps[Statement]:
        name = self.expect("name", f"after {token.kind}").text
        outer, outer_loops = self.scope, self._loops
        self.scope, self._loops = Scope(name, is_thread=token.kind == "thread"), 0
        self._parameters(token)
        self.expect(":", f"after the parameters of {name}")
        first = self.at
        body = yield from self._block(f"to close the {token.kind} of line {token.line}")
        self.scope.cost += self.at - first
        function = FunctionDef(token.line, token.column, self.scope, body)
        if len(self._program.functions) >= _MAX_FUNCTIONS:
            self.fail(f"the program has more than {_MAX_FUNCTIONS} defs and threads", token)
        self._program.functions[name] = function  # a second def of a name replaces the first
        self.scope, self._loops = outer, outer_loops
        return function

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
        token = self.expect("name", "the name of a parameter")
        if token.text in self.scope.locals:
            self.fail(f"two parameters are called {token.text}", token)
        default = None
        if self.token.kind == "=":
            self.take()
            default = self.expression()
        elif self.scope.parameters and self.scope.parameters[-1].default is not None:
            self.fail("a parameter without default cannot follow one with a default", token)
        self.scope.parameters.append(Parameter(token.line, token.column, token.text, default))
        self.scope.locals.add(token.text)


_PROGRAM_KINDS: dict[str, ProgramKind] = {"def": "program", "sec": "secondary"}

_MAX_LOOPS = 20
"""Deepest nesting of loops: what Python's compiler bears."""

_MAX_FUNCTIONS = 5000
"""Most defs and threads of a program, which are planned in one step: ten times those of the largest seen (a guess)."""

_WORK = 2  # of a token
_SLICE = 32  # tokens, at least, between two yields

_ABOVE_OPERATORS = 10
"""A statement starts with a target or a call, so no binary operator may be taken with it."""


def _is_variable(target: Expression) -> bool:
    """True for a variable and for parts of one."""
    while isinstance(target, (Index, Member)):
        target = target.target
    return isinstance(target, Name)
