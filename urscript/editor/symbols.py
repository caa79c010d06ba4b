"""The names in a text: where each is defined and used, and in which scope.

They are found in the tokens rather than in the syntax tree, because a text that is being typed rarely parses: a missing
``end`` shifts a scope, and hides nothing. Scopes follow the rules of the language: an assignment at the top level of a
program, or declared ``global``, makes a name global; any other one is local to its def or thread.
"""

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Final, Literal, NamedTuple, TypeAlias

from urscript.expressions import BLOCK_ENDS
from urscript.tokens import IN_EXPRESSIONS, KEYWORDS, Token

Role: TypeAlias = Literal["function", "thread", "variable", "parameter", "argument", "member", "method"]
Key: TypeAlias = tuple[int, str, int, str]
"""What a name refers to: unit, function or variable, scope (-1 for the whole unit), name."""

_SCOPES: Final = frozenset(["def", "sec", "thread"])
_BLOCKS: Final = _SCOPES | {"if", "while"}
_STATEMENTS: Final = KEYWORDS - IN_EXPRESSIONS
"""Keywords that end a bracket which was never closed."""
_EVERYWHERE: Final = -1


@dataclass(eq=False)
class Scope:
    """A program, def or thread. first, last: its tokens; unit: the scope of the program it belongs to."""

    number: int
    kind: str
    name: str
    first: int
    outer: "Scope | None" = None
    unit: "Scope" = field(init=False)
    last: int = 0
    parameters: list[str] = field(default_factory=list)
    locals: set[str] = field(default_factory=set)
    assigned: set[str] = field(default_factory=set)
    globals: set[str] = field(default_factory=set)  # of a unit
    functions: dict[str, "Scope"] = field(default_factory=dict)  # of a unit

    def owns(self, name: str) -> bool:
        """Whether a variable is local to the scope."""
        return name in self.locals or (name in self.assigned and name not in self.unit.globals)

    @property
    def variables(self) -> set[str]:
        """The variables that can be used here."""
        return {*self.unit.globals, *self.locals, *self.assigned}


class Occurrence(NamedTuple):
    """A name in the text. token: its index; of: the function whose parameter it names."""

    token: int
    name: str
    role: Role
    scope: Scope
    defines: bool = False
    of: str = ""


class Block(NamedTuple):
    """The indices of the first and the last token of a block."""

    first: int
    last: int


class Symbols:
    """The scopes, names and blocks of a text. inlined: it is the text of a Script node, whose defs share names."""

    def __init__(self, tokens: list[Token], *, inlined: bool) -> None:
        self._tokens = tokens
        root = Scope(0, "file", "", 0, last=len(tokens) - 1)
        root.unit = root
        self.scopes = [root]
        self.occurrences: list[Occurrence] = []
        self.blocks: list[Block] = []
        self._read(root, inlined=inlined)

    def _read(self, scope: Scope, *, inlined: bool) -> None:
        opened: list[tuple[int, Scope | None, Scope]] = []  # blocks: first token, own scope, scope around
        calls: list[str] = []  # for each open bracket, the function that is called, or ""
        header = False  # within the parameters of a def
        for at, token in enumerate(self._tokens):
            kind = token.kind
            if kind == "name":
                self._name(at, scope, calls, header=header)
            elif kind in ("(", "["):
                before = self._tokens[at - 1]
                called = kind == "(" and at > 0 and before.kind == "name" and not token.after_newline
                calls.append(before.text if called else "")
            elif kind in (")", "]"):
                del calls[-1:]
                header = header and bool(calls)
            elif kind in _STATEMENTS:
                calls.clear()
                header = kind in _SCOPES
                if kind in _SCOPES:
                    opened.append((at, (inner := self._scope(at, scope, inlined=inlined)), scope))
                    scope = inner
                elif kind in _BLOCKS:
                    opened.append((at, None, scope))
                elif kind in ("else", "elif") and opened:
                    first, own, outer = opened[-1]
                    self.blocks.append(Block(first, at - 1))
                    opened[-1] = (at, own, outer)
                elif kind == "end" and opened:
                    first, own, scope = opened.pop()
                    self._close(first, at, own)
        for first, own, _ in opened:
            self._close(first, len(self._tokens) - 1, own)

    def _scope(self, at: int, outer: Scope, *, inlined: bool) -> Scope:
        named = self._tokens[at + 1]
        scope = Scope(len(self.scopes), self._tokens[at].kind, named.text if named.kind == "name" else "", at, outer)
        program = outer.kind == "file" and not inlined and scope.kind != "thread"
        scope.unit = scope if program else outer.unit
        scope.unit.functions.setdefault(scope.name, scope)
        self.scopes.append(scope)
        return scope

    def _close(self, first: int, last: int, scope: Scope | None) -> None:
        self.blocks.append(Block(first, last))
        if scope is not None:
            scope.last = last

    def _name(self, at: int, scope: Scope, calls: list[str], *, header: bool) -> None:
        tokens = self._tokens
        name, before, after = tokens[at].text, tokens[at - 1].kind if at else "", tokens[at + 1]
        called = after.kind == "(" and not after.after_newline
        role: Role = "function" if called else "variable"
        defines, of = False, ""
        if before in _SCOPES:
            role, defines = ("thread" if before == "thread" else "function"), True
        elif before == ".":
            role = "method" if called else "member"
        elif before == "run":
            role = "thread"
        elif header and len(calls) == 1 and before in ("(", ","):
            role, defines = "parameter", True
            scope.parameters.append(name)
            scope.locals.add(name)
        elif after.kind == "=" and calls:
            role, of = "argument", calls[-1]
        elif after.kind == "=":
            defines = True
            if before == "global" or scope is scope.unit:
                scope.unit.globals.add(name)
            elif before == "local":
                scope.locals.add(name)
            else:
                scope.assigned.add(name)
        elif name == "p" and after.kind == "[":
            return  # nearly always a pose
        self.occurrences.append(Occurrence(at, name, role, scope, defines, of))

    # questions

    def at_token(self, at: int) -> Occurrence | None:
        """The name that is a token."""
        place = bisect_left(self.occurrences, at, key=attrgetter("token"))
        found = self.occurrences[place] if place < len(self.occurrences) else None
        return found if found and found.token == at else None

    def scope_at(self, at: int) -> Scope:
        """The innermost scope around a token."""
        return next(scope for scope in reversed(self.scopes) if scope.first <= at <= scope.last or not scope.number)

    def key(self, found: Occurrence) -> Key | None:
        """What a name refers to; None for members."""
        unit = found.scope.unit
        match found.role:
            case "function" | "thread":
                return unit.number, "function", _EVERYWHERE, found.name
            case "argument":
                owner = unit.functions.get(found.of)
                return (unit.number, "variable", owner.number, found.name) if owner else None
            case "variable" | "parameter":
                scope = found.scope
                own = scope.number if scope is not unit and scope.owns(found.name) else _EVERYWHERE
                return unit.number, "variable", own, found.name
        return None

    def defines(self, key: Key) -> bool:
        """Whether this text defines what a key stands for."""
        unit = self.scopes[key[0]]
        return key[2] != _EVERYWHERE or key[3] in (unit.functions if key[1] == "function" else unit.globals)

    def uses(self, key: Key) -> Iterator[Occurrence]:
        """All places where a thing is defined or used."""
        return (found for found in self.occurrences if found.name == key[3] and self.key(found) == key)

    def outside(self, kind: str, name: str, *, defined: bool) -> Iterator[Occurrence]:
        """The places of a name that other files define or, with defined, that this file gives to others."""
        for found in self.occurrences:
            key = self.key(found) if found.name == name else None
            if key is not None and key[1:3] == (kind, _EVERYWHERE) and self.defines(key) == defined:
                yield found


def call_at(tokens: list[Token], at: int) -> tuple[int, int] | None:
    """The call around the place before a token: the index of the function's name, and the number of the argument."""
    depth = commas = 0
    for place in range(at - 1, 0, -1):
        kind = tokens[place].kind
        if kind in (")", "]"):
            depth += 1
        elif kind in ("(", "[") and depth:
            depth -= 1
        elif kind == "(" and tokens[place - 1].kind == "name":
            return place - 1, commas
        elif kind in ("(", "["):
            commas = 0
        elif kind == "," and not depth:
            commas += 1
        elif kind in _STATEMENTS or kind in BLOCK_ENDS:
            return None
    return None
