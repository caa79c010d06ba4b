"""The expression half of the parser: a Pratt parser over the token list.

Precedence, loosest first (Script Manual chapter 3, and what the official control script relies
on): ``or xor`` · ``and`` · ``not`` · comparison · ``+ -`` · ``* / %`` · unary ``-`` · call,
index, member.
"""

from bisect import bisect_left
from collections.abc import Callable
from operator import attrgetter
from typing import Any, NoReturn

from urscript.errors import Cause, CompileError
from urscript.hints import end_with_word, joined_number, line_without, syntax_hint
from urscript.syntax import (
    Binary,
    Call,
    Constant,
    Expression,
    Index,
    ListLiteral,
    Member,
    MethodCall,
    Name,
    NumberList,
    PoseLiteral,
    Run,
    Scope,
    Unary,
)
from urscript.tokens import Token
from urscript.work import Steps

_BINARY_POWER = {
    "or": 1, "xor": 1, "and": 2,
    "==": 4, "!=": 4, "<": 4, ">": 4, "<=": 4, ">=": 4,
    "+": 5, "-": 5, "*": 6, "/": 6, "%": 6,
}  # fmt: skip
_NOT_POWER = 3
_UNARY_POWER = 7

BLOCK_ENDS = frozenset(["end", "else", "elif", "end of text"])

_CONSTANTS: dict[str, bool | None] = {"True": True, "False": False, "None": None}

_EXPECTED = {"name": "a name", "number": "a number", "string": "a string"}

CALL_COST = 30
"""Extra work of a call, in the units of the meter: a built-in takes a few microseconds."""

_MAX_DEPTH = 150
"""Deepest nesting of one expression: a guess, far above real programs and below the limit of Python's compiler."""


_MAX_TOKENS = 2_000
"""Longest expression [tokens], because it is read in one step. Each element of an assigned list may be as long."""

_MAX_LIST_TOKENS = 40_000
"""Longest list that is assigned [tokens]: more than the longest real list needs (a guess)."""

_SLICE = 64  # tokens of a long list between two yields
_WORK = 2  # per token
_VECTOR = 50  # numbers from which a list is kept as one constant


class ExpressionParser:
    """Reads expressions; the statement parser builds on it."""

    def __init__(self, source: str, tokens: list[Token]) -> None:
        self.source = source
        self.tokens = tokens
        self.at = 0
        self.started = 0  # index of the statement's first token
        self.measured = 0  # index of the first token of the expression or element whose length is limited
        self.end_with_word_at: int | None = None  # index of the first ``end if``, ``end while`` or similar
        self.scope = Scope("")
        self._depth = 0
        self._operands: dict[str, Callable[[Any, Token], Expression]] = {  # not bound methods: see `ExpressionCompiler`
            "name": ExpressionParser._name,
            "number": ExpressionParser._number,
            "string": ExpressionParser._string,
            "True": ExpressionParser._constant,
            "False": ExpressionParser._constant,
            "None": ExpressionParser._constant,
            "(": ExpressionParser._parenthesis,
            "[": ExpressionParser._list,
            "-": ExpressionParser._unary,
            "+": ExpressionParser._unary,
            "not": ExpressionParser._not,
            "!": ExpressionParser._not,
            "run": ExpressionParser._run,
        }

    # tokens

    @property
    def token(self) -> Token:
        """The next token."""
        return self.tokens[self.at]

    def take(self) -> Token:
        """Return the next token and step past it."""
        token = self.tokens[self.at]
        self.at += 1
        return token

    def expect(self, kind: str, where: str) -> Token:
        """Step past a token of this kind; a syntax error when another one follows."""
        if self.tokens[self.at].kind != kind:
            what = _EXPECTED.get(kind) or repr(kind)
            lacking = f"',' or {what}" if kind in (")", "]") and self._spans_lines() else what
            self.fail(f"expected {what} {where}", None, line_without(lacking, self.tokens, self.at))
        return self.take()

    def _spans_lines(self) -> bool:
        """Whether the statement began on an earlier line than the last token that was read."""
        return self.tokens[self.started].line < self.tokens[max(self.at - 1, 0)].line

    def fail(self, problem: str, token: Token | None = None, blamed: Cause | None = None) -> NoReturn:
        """Raise a syntax error at the next token, or at the given one. blamed: where the mistake was made."""
        token = token or self.token
        if token.text == '"':
            problem = "the string that starts here is never closed"
        found = f"'{token.text}'" if token.text else token.kind
        string = self.string_before(token.line)
        cause: Cause | None = None
        if string is not None:
            problem += f"; the string that starts on line {string.line} is closed only here"
            cause = Cause(
                string.line, string.column, f"the string that starts here is closed only on line {token.line}"
            )
        else:
            at = bisect_left(self.tokens, (token.line, token.column), key=attrgetter("line", "column"))
            odd = self.end_with_word_at is not None and self.end_with_word_at < at - 1
            if odd:
                cause = end_with_word(self.tokens, self.end_with_word_at or 0)
            else:
                cause = joined_number(self.tokens, at, self.started) or blamed
            hint = cause.text if cause else syntax_hint(self.tokens, at, self.started)
            problem += f"; {hint}" if hint else ""
        message = f"syntax error at {found}: {problem}"
        raise CompileError.syntax(message, token.line, token.column, self.source, cause)

    def string_before(self, line: int) -> Token | None:
        """The string that begins on an earlier line and ends on this one, if there is one."""
        at = bisect_left(self.tokens, line, key=attrgetter("line")) - 1
        before = self.tokens[max(at, 0)]
        spans = before.kind == "string" and before.line < line == before.line + before.text.count("\n")
        return before if spans else None

    def another(self) -> bool:
        """Step past a comma of a sequence of any length; False when there is none."""
        if self.token.kind != ",":
            return False
        if self.at - self.measured > _MAX_TOKENS:
            self.fail(f"the expression is longer than {_MAX_TOKENS} tokens: assign lists to variables first")
        self.take()
        return True

    # expressions

    def expression(self, power: int = 0) -> Expression:
        """Read one expression whose operators bind tighter than `power`."""
        depth = self._depth
        self._count_depth()
        operand = self._operands.get(self.token.kind)
        if operand is None:
            self.fail("expected an expression")
        left = self._operators(operand(self, self.take()), power)
        self._depth = depth
        return left

    def _operators(self, left: Expression, power: int) -> Expression:
        """Continue after the first operand of an expression."""
        while (binding := _BINARY_POWER.get(self.token.kind, 0)) > power:
            self._count_depth()
            operator = self.take()
            left = Binary(operator.line, operator.column, operator.kind, left, self.expression(binding))
        return left

    def long_list(self) -> Steps[Expression]:
        """Like `expression`, for an expression that begins with a list, which may be long."""
        depth = self._depth
        opening = self.take()
        self._count_depth()
        items: list[Expression] = []
        counted = self.at
        while self.token.kind != "]" or items:
            self.measured = self.at
            items.append(self.expression())
            if self.at >= counted + _SLICE:
                yield (self.at - counted) * _WORK
                counted = self.at
            if self.at - self.started > _MAX_LIST_TOKENS:
                self.fail(f"the list is longer than {_MAX_LIST_TOKENS} tokens")
            if not self.another():
                break
        self.expect("]", "to close '['")
        self.measured = self.at
        left = self._operators(self._postfix(_list_of(opening, items)), 0)
        self._depth = depth
        return left

    def _count_depth(self) -> None:
        """Count a level of nesting. A chain of operators counts too, because the code compiled from it nests."""
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            self.fail(f"operators or brackets are nested more than {_MAX_DEPTH} deep: use several statements")

    def _constant(self, token: Token) -> Expression:
        return Constant(token.line, token.column, _CONSTANTS[token.kind])

    def _number(self, token: Token) -> Expression:
        text = token.text
        if text.isdigit() and len(text) <= 10 and (whole := int(text)) < 2**31:
            return Constant(token.line, token.column, whole)
        # A guess: an integer literal beyond 32 bits becomes a float.
        return Constant(token.line, token.column, float(text))

    def _string(self, token: Token) -> Expression:
        return Constant(token.line, token.column, token.text[1:-1])

    def _unary(self, token: Token) -> Expression:
        if token.kind == "-" and self.token.text == "2147483648":
            return Constant(
                token.line, token.column, -int(self.take().text)
            )  # the one int without a positive counterpart
        operand = self.expression(_UNARY_POWER)
        if isinstance(operand, Constant) and operand.value.__class__ in (int, float) and token.kind == "-":
            value = operand.value  # of which one has no positive counterpart in 32 bits
            return Constant(token.line, token.column, value if value.__class__ is int and value == -(2**31) else -value)
        return Unary(token.line, token.column, token.kind, operand)

    def _not(self, token: Token) -> Expression:
        return Unary(token.line, token.column, "not", self.expression(_NOT_POWER))

    def _run(self, token: Token) -> Expression:
        name = self.expect("name", "after run: the thread to start").text
        if self.token.kind != "(":
            text = f"a thread is started with brackets: run {name}()"
            self.fail("expected '(' after the thread's name", None, Cause(token.line, token.column, text))
        self.take()
        self.expect(")", "because a thread takes no arguments")
        return Run(token.line, token.column, name)

    def _parenthesis(self, opening: Token) -> Expression:
        items = self._items(")", "to close '('")
        if len(items) == 1:
            return self._postfix(items[0])
        # python-urx sends a list in round brackets: set_payload(m, (x, y, z)).
        return self._postfix(ListLiteral(opening.line, opening.column, items))

    def _list(self, opening: Token) -> Expression:
        if self.token.kind == "]":
            self.take()
            return self._postfix(ListLiteral(opening.line, opening.column, []))
        return self._postfix(ListLiteral(opening.line, opening.column, self._items("]", "to close '['")))

    def _items(self, closing: str, where: str) -> list[Expression]:
        items = [self.expression()]
        while self.another():
            items.append(self.expression())
        self.expect(closing, where)
        return items

    def _name(self, token: Token) -> Expression:
        following = self.token
        if following.kind == "(" and not following.after_newline:
            return self._postfix(self._call(token))
        if token.text == "p" and following.kind == "[" and not following.after_newline:
            return self._postfix(self._pose_or_index(token))
        return self._postfix(Name(token.line, token.column, token.text))

    def _pose_or_index(self, token: Token) -> Expression:
        """``p[`` is a pose when six expressions follow, otherwise an index into a variable called p."""
        opening = self.take()
        items = self._items("]", "to close 'p['")
        if len(items) == 6:
            return PoseLiteral(token.line, token.column, items)
        if len(items) > 2:
            self.fail(f"a pose has six elements, not {len(items)}", opening)
        return Index(opening.line, opening.column, Name(token.line, token.column, "p"), items)

    def _call(self, token: Token) -> Call:
        self.take()
        call = Call(token.line, token.column, token.text, [], [])
        self.scope.calls.append(call)
        self.scope.cost += CALL_COST
        if self.token.kind != ")":
            self._argument(call)
            while self.another():
                self._argument(call)
        self.expect(")", f"to close the call of {token.text}")
        return call

    def _argument(self, call: Call) -> None:
        if self.token.kind == "name" and self.tokens[self.at + 1].kind == "=":
            name = self.take().text
            self.take()
            call.keywords.append((name, self.expression()))
        elif call.keywords:
            self.fail("a positional argument cannot follow a keyword argument")
        else:
            call.arguments.append(self.expression())

    def _postfix(self, value: Expression) -> Expression:
        depth = self._depth
        while True:
            token = self.token
            if token.kind == "[" and not token.after_newline:
                self.take()
                positions = self._items("]", "to close '['")
                if len(positions) > 2:
                    self.fail("an index takes one position, or two for a matrix", token)
                value = Index(token.line, token.column, value, positions)
            elif token.kind == ".":
                self.take()
                word = "sec" if self.token.kind == "sec" else "name"  # a member of what time() returns
                value = self._member(value, self.expect(word, "after '.'"))
            else:
                break
            self._count_depth()
        self._depth = depth
        return value

    def _member(self, target: Expression, name: Token) -> Expression:
        if self.token.kind != "(" or self.token.after_newline:
            return Member(name.line, name.column, target, name.text)
        self.take()
        self.scope.waits = True
        self.scope.cost += CALL_COST
        arguments: list[Expression] = []
        if self.token.kind == ")":
            self.take()
        else:
            arguments = self._items(")", f"to close the call of {name.text}")
        method = MethodCall(name.line, name.column, target, name.text, arguments)
        self.scope.methods.append(method)
        return method


def _list_of(opening: Token, items: list[Expression]) -> Expression:
    """A list node; a list of many numbers becomes a constant, which no later stage iterates over."""
    values = [item.value for item in items if isinstance(item, Constant)]
    numbers = tuple(value for value in values if isinstance(value, (int, float)) and value.__class__ is not bool)
    if len(items) < _VECTOR or len(numbers) < len(items):
        return ListLiteral(opening.line, opening.column, items)
    return NumberList(opening.line, opening.column, numbers)
