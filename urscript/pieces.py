"""Divides long bodies: a group of statements large enough for one Python function becomes a function of its own.

Compiling works in steps (`urscript.work`), but Python compiles a function without interruption. Therefore, a long body
is divided into *pieces*, and a call takes the place of each. A piece shares the variables of the body, which are global
or items of ``_locals``. Its exits (return, break, continue) are passed to the caller as return values: see `Exit`.
"""

import ast
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

from urscript.pycode import LOAD, Place, assign, constant, function, load, subscript, yield_from


@dataclass(frozen=True, slots=True)
class PythonFunction:
    """A function as Python's syntax tree. ``size``: the number of its statements and expressions."""

    code: ast.stmt
    size: int


Exit: TypeAlias = ast.Return | ast.If
"""An exit of some code: a ``return``, or an ``if`` whose body is a ``break`` or ``continue``.

In a piece, they become ``return (value,)``, ``return True`` and ``return False``; a piece that runs to its end returns
None.
"""


@dataclass(slots=True)
class Part:
    """Code that may become a piece. exits: its exits, in their order."""

    code: list[ast.stmt] = field(default_factory=list)
    size: int = 0
    used_globals: set[str] = field(default_factory=set)
    exits: list[Exit] = field(default_factory=list)
    place: Place | None = None


def piece_name(symbol: str, number: int) -> str:
    """Python name of a piece of a function; pieces count from 0."""
    return f"p{number}_{symbol}"


class Pieces:
    """The pieces of one body.

    symbol: Python name of its function. shared: names of the Python variables that are passed to each piece. lasting:
    pieces are looked up by their names; otherwise they are items of ``_pieces``.
    """

    def __init__(self, symbol: str, shared: Sequence[str], *, lasting: bool) -> None:
        self.functions: list[PythonFunction] = []
        self.size = 0
        self._symbol = symbol
        self._shared = shared
        self._lasting = lasting

    def names(self, place: Place) -> list[ast.expr]:
        """The names of all pieces, as Python expressions."""
        return [load(piece_name(self._symbol, number), place) for number in range(len(self.functions))]

    def add(self, code: list[ast.stmt], size: int, used_globals: set[str], place: Place) -> ast.expr:
        """Create a piece; return the ``yield from`` that runs it."""
        number = len(self.functions)
        name = piece_name(self._symbol, number)
        # The unreachable yield makes it a generator, whatever it contains.
        code = [*code, ast.Return(value=None, **place), ast.Expr(ast.Yield(value=None, **place), **place)]
        self.functions.append(PythonFunction(function(name, list(self._shared), code, used_globals, place), size))
        self.size += size
        piece = load(name, place) if self._lasting else subscript(load("_pieces", place), number, place)
        return yield_from(ast.Call(piece, [load(shared, place) for shared in self._shared], [], **place), place)

    def move(self, part: Part, place: Place) -> Part:
        """Move code into a piece; return the code that calls it and passes on its exits, and that uses no globals."""
        exits = part.exits
        words = {exit_.body[0].__class__ for exit_ in exits if isinstance(exit_, ast.If)}
        for exit_ in exits:
            if isinstance(exit_, ast.If):
                exit_.body[0] = ast.Return(constant(isinstance(exit_.body[0], ast.Break), place), **place)
            else:
                exit_.value = ast.Tuple([exit_.value or constant(None, place)], LOAD, **place)
        run = self.add(part.code, part.size, part.used_globals, place)
        if not exits:
            return Part([ast.Expr(value=run, **place)], 1, place=place)
        code: list[ast.stmt] = [assign("_exit", run, place)]
        left: list[Exit] = []
        for word, value in ((ast.Break, True), (ast.Continue, False)):
            if word in words:
                passed_on = _exit_if(ast.Is(), value, word(**place), place)
                code.append(passed_on)
                left.append(passed_on)
        if any(isinstance(exit_, ast.Return) for exit_ in exits):
            back = ast.Return(subscript(load("_exit", place), 0, place), **place)
            code.append(_exit_if(ast.IsNot(), None, back, place))
            left.append(back)
        return Part(code, 1 + len(code), exits=left, place=place)


def _exit_if(test: ast.cmpop, value: bool | None, then: ast.stmt, place: Place) -> ast.If:
    """``if _exit is value: then``"""
    compared = ast.Compare(left=load("_exit", place), ops=[test], comparators=[constant(value, place)], **place)
    return ast.If(test=compared, body=[then], orelse=[], **place)
