"""Statements to Python. Every generator draws its work from the meter and parks when it is empty.

Compiling works in steps (`urscript.work`). Python compiles a function in one go, so a long
program body, whose variables are all global, becomes several: see `_BodyCompiler._metered`.
"""

import ast
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from urscript.analysis import FunctionPlan, lends_its_scope
from urscript.compile_expressions import ExpressionCompiler, Unit
from urscript.inference import is_number
from urscript.pycode import (
    Place,
    assign,
    attribute,
    call,
    charge,
    constant,
    function,
    load,
    place_of,
    subscript,
    yield_from,
)
from urscript.syntax import (
    Assign,
    Call,
    ExpressionStatement,
    FunctionDef,
    If,
    Index,
    Label,
    Name,
    Node,
    Return,
    Scope,
    Statement,
    ThreadControl,
    While,
    Word,
)
from urscript.work import Steps

STATEMENT = "statement"
"""Name in Python of the function that an interpreted statement becomes."""

_RUN_COST = 200
"""Most work between two looks at the meter, in its units: about 10 us."""

_LOOP_COST = 3

_WORK = 9  # of an expression, and so of a statement without its expressions
_SLICE = 12  # of these, at least, between two yields
_PIECE = 100  # of these, about, in a piece of the program body
_REST = 40  # of these, at least, in a piece at the end of a block

_OLD_SETTERS = {"digital_out": "set_digital_out"}
"""Arrays of signals from before there were functions for them; python-urx still writes one."""


@dataclass(frozen=True, slots=True)
class PythonFunction:
    """A function as Python's syntax tree. ``size``: the number of its statements and expressions."""

    code: ast.stmt
    size: int


def compile_main(unit: Unit) -> Steps[list[PythonFunction]]:
    """The program body as the generator function ``main``, and the functions it is divided into."""
    program = unit.program
    compiler = _BodyCompiler(unit, program.scope, charged=True, divided=True)
    place = place_of(program.body[0] if program.body else Node(1, 1))
    body = yield from compiler.body(program.body, place)
    return [*compiler.pieces, PythonFunction(function("main", [], body, place), compiler.inline)]


def compile_function(unit: Unit, plan: FunctionPlan) -> Steps[list[PythonFunction]]:
    """One def or thread as a Python function."""
    definition = plan.definition
    scope, place = definition.scope, place_of(definition)
    boxed = lends_its_scope(scope, unit.builtins)
    compiler = _BodyCompiler(unit, scope, charged=plan.generator, recursive=plan.recursive, boxed=boxed)
    parameters = [f"v_{parameter.name}" for parameter in scope.parameters]
    if plan.recursive:
        parameters.insert(0, "_depth")
    body = yield from compiler.body(definition.body, place)
    if boxed:
        body.insert(0, _boxed_locals(compiler, place))
    return [PythonFunction(function(plan.symbol, parameters, body, place), compiler.inline)]


def compile_interpreted(unit: Unit) -> Steps[list[PythonFunction]]:
    """Statements sent to a running program, as the generator function `STATEMENT` of the scope they run in.

    It is given the functions it is divided into, ``statement_1`` and so on, so that they need no lasting name.
    """
    program = unit.program
    place = place_of(program.body[0] if program.body else Node(1, 1))
    compiler = _BodyCompiler(unit, program.scope, charged=True, divided=True, boxed=True)
    body = yield from compiler.body(program.body, place)
    whole = function(STATEMENT, ["_locals", "_pieces"], body, place)
    return [*compiler.pieces, PythonFunction(whole, compiler.inline)]


def _boxed_locals(compiler: ExpressionCompiler, place: Place) -> ast.stmt:
    """``_locals = _Locals(("a", "b"), {"a": v_a})``: every variable of the function, and its arguments."""
    scope = compiler.scope
    names = tuple(sorted(name for name in scope.locals | scope.assigned if compiler.is_local(name)))
    given = [parameter.name for parameter in scope.parameters]
    arguments = ast.Dict(
        keys=[constant(name, place) for name in given], values=[load(f"v_{name}", place) for name in given], **place
    )
    return assign("_locals", call("_Locals", place, constant(names, place), arguments), place)


class _BodyCompiler(ExpressionCompiler):
    def __init__(
        self,
        unit: Unit,
        scope: Scope,
        *,
        charged: bool,
        recursive: bool = False,
        divided: bool = False,
        boxed: bool = False,
    ) -> None:
        super().__init__(unit, scope, recursive=recursive, boxed=boxed)
        self.pieces: list[PythonFunction] = []
        self._elsewhere = 0  # how much of the size is in pieces
        self._counted = 0  # of the size, whose work was yielded
        self._charged = charged  # a generator, so that it can park
        self._divided = divided
        self._compilers: dict[type, Callable[[Any, Any, Place], list[ast.stmt]]] = {
            Assign: _BodyCompiler._assign,
            ExpressionStatement: _BodyCompiler._expression_statement,
            Return: _BodyCompiler._return,
            Word: _BodyCompiler._word,
            ThreadControl: _BodyCompiler._thread_control,
            Label: _BodyCompiler._label,
        }

    @property
    def inline(self) -> int:
        """Size of what is not in pieces."""
        return self.size - self._elsewhere

    def body(self, statements: list[Statement], place: Place) -> Steps[list[ast.stmt]]:
        """All of a function's Python body."""
        if self._charged:
            code = (yield from self._metered(statements)) or charge(1, place, park=True)
        else:
            code = [*charge(self.scope.cost, place, park=False), *(yield from self._plain(statements))]
            if self.unit.stepped and all(isinstance(statement, FunctionDef) for statement in statements):
                code.append(ast.Expr(value=self._step(place), **place))  # a generator like all others
        return self._with_globals(code, place)

    def _with_globals(self, code: list[ast.stmt], place: Place) -> list[ast.stmt]:
        if self.stored_globals:
            code.insert(0, ast.Global(names=sorted(self.stored_globals), **place))
        return code

    # blocks

    def _plain(self, statements: list[Statement]) -> Steps[list[ast.stmt]]:
        code: list[ast.stmt] = []
        for statement in statements:
            if isinstance(statement, FunctionDef):
                continue
            self.size += 1
            place = place_of(statement)
            if self.unit.stepped and not isinstance(statement, While):
                code.append(ast.Expr(value=self._step(place), **place))
            if isinstance(statement, If):
                code += yield from self._if(statement, place)
            elif isinstance(statement, While):
                code += yield from self._while(statement, place)
            else:
                code += self._compilers[statement.__class__](self, statement, place)
            if self.size >= self._counted + _SLICE:
                yield (self.size - self._counted) * _WORK
                self._counted = self.size
        return code

    def _metered(self, statements: list[Statement], extra: int = 0) -> Steps[list[ast.stmt]]:
        """The statements in runs of bounded work, each run charged before it starts, the first with extra work.

        When the body is divided, runs are moved into functions of their own as soon as there
        is enough for one, unless a return, break or continue leads out of them.
        """
        code: list[ast.stmt] = []
        movable: list[ast.stmt] = []
        start = self.inline
        outer, self.stored_globals = self.stored_globals, set[str]()  # each piece declares its own
        for run, work in _runs(statements, extra):
            charged = [*charge(work, place_of(run[0]), park=True), *(yield from self._plain(run))]
            if not self._divided or _leads_out(run):
                code += [*movable, *charged]
                outer |= self.stored_globals
                movable, start = [], self.inline
                continue
            movable += charged
            if self.inline >= start + _PIECE:
                code.append(self._piece(movable, self.inline - start, place_of(run[0])))
                movable, start = [], self.inline
        if self._divided and self.inline >= start + _REST:
            movable = [self._piece(movable, self.inline - start, place_of(run[0]))]
        self.stored_globals |= outer
        return code + movable

    def _piece(self, code: list[ast.stmt], size: int, place: Place) -> ast.stmt:
        """Move code into a generator function; what runs it instead."""
        number = len(self.pieces)
        name = f"{STATEMENT if self.boxed else 'main'}_{number + 1}"
        parameters = ["_locals"] if self.boxed else []
        self.pieces.append(PythonFunction(function(name, parameters, self._with_globals(code, place), place), size))
        self.stored_globals = set()
        self._elsewhere += size
        piece = subscript(load("_pieces", place), number, place) if self.boxed else load(name, place)
        run = ast.Call(piece, [load(parameter, place) for parameter in parameters], [], **place)
        return ast.Expr(value=yield_from(run, place), **place)

    def _step(self, place: Place) -> ast.expr:
        """``yield from _step(line, column)``: tell the host what is next, and wait as long as it wants."""
        line, column = constant(place["lineno"], place), constant(place["col_offset"] + 1, place)
        return yield_from(call("_step", place, line, column), place)

    def _inner(self, statements: list[Statement], heavy: bool) -> Steps[list[ast.stmt]]:
        return (yield from self._metered(statements) if heavy and self._charged else self._plain(statements))

    # statements

    def _assign(self, node: Assign, place: Place) -> list[ast.stmt]:
        target = node.target
        old_setter = self._old_setter(node)
        if old_setter is not None:
            return [ast.Expr(value=self.expression(old_setter), **place)]
        value = self.expression(node.value)
        if isinstance(target, Name):
            if self.is_local(target.name):
                return [self.bind(target.name, value, place)]
            return self._assign_global(target.name, value, place)
        stored = self.store(target, value, place)
        assert stored is not None, "the parser lets only variables and their parts be assigned"
        return [self.bind(*stored, place)]

    def _old_setter(self, node: Assign) -> Call | None:
        """The built-in call behind an assignment to an element of what is no variable, as ``digital_out[2] = True``."""
        target = node.target
        if not isinstance(target, Index) or not isinstance(target.target, Name) or self.known(target.target.name):
            return None
        setter = _OLD_SETTERS.get(target.target.name)
        if setter is None or setter not in self.unit.builtins:
            return None
        return Call(node.line, node.column, setter, [*target.positions, node.value], [])

    def _assign_global(self, target: str, value: ast.expr, place: Place) -> list[ast.stmt]:
        """A global keeps the type of its first value; checked here, in line, because it is so frequent.

        One that can only get numbers needs no check.
        """
        name = f"v_{target}"
        self.stored_globals.add(name)
        if is_number(self.unit.kinds.variable(self.scope, target)):
            return [assign(name, value, place)]
        if self.unit.fixed_lists:
            return [assign(name, call("_retype_fixed", place, load(name, place), value), place)]
        new, old = load("_new", place), load(name, place)
        same = ast.Compare(
            left=attribute(new, "__class__", place),
            ops=[ast.IsNot()],
            comparators=[attribute(old, "__class__", place)],
            **place,
        )
        retype = assign("_new", call("_retype", place, old, new), place)
        check = ast.If(test=same, body=[retype], orelse=[], **place)
        return [assign("_new", value, place), check, assign(name, load("_new", place), place)]

    def _expression_statement(self, node: ExpressionStatement, place: Place) -> list[ast.stmt]:
        return [ast.Expr(value=self.expression(node.value), **place)]

    def _if(self, node: If, place: Place) -> Steps[list[ast.stmt]]:
        heavy = _is_heavy(node)
        branches: list[tuple[ast.expr, list[ast.stmt]]] = []
        for condition, statements in node.branches:
            branches.append((self.condition(condition), (yield from self._inner(statements, heavy))))
        otherwise = yield from self._inner(node.otherwise, heavy)
        for (test, body), (source, _) in zip(reversed(branches), reversed(node.branches), strict=True):
            at = place_of(source)
            otherwise = [ast.If(test=test, body=body or [ast.Pass(**at)], orelse=otherwise, **at)]
        return otherwise

    def _while(self, node: While, place: Place) -> Steps[list[ast.stmt]]:
        test = self.condition(node.condition)
        if self.unit.stepped:  # before each pass; _step returns None
            passed = ast.UnaryOp(op=ast.Not(), operand=self._step(place), **place)
            test = ast.BoolOp(op=ast.And(), values=[passed, test], **place)
        body = (yield from self._metered(node.body, _LOOP_COST)) or charge(_LOOP_COST, place, park=True)
        return [ast.While(test=test, body=body, orelse=[], **place)]

    def _return(self, node: Return, place: Place) -> list[ast.stmt]:
        return [ast.Return(value=None if node.value is None else self.expression(node.value), **place)]

    def _word(self, node: Word, place: Place) -> list[ast.stmt]:
        match node.word:
            case "break":
                return [ast.Break(**place)]
            case "continue":
                return [ast.Continue(**place)]
            case "halt":
                return [ast.Raise(exc=load("_Halt", place), cause=None, **place)]
            case _:
                return [ast.Expr(value=call(f"_{node.word}", place), **place)]

    def _thread_control(self, node: ThreadControl, place: Place) -> list[ast.stmt]:
        code = call(f"_{node.word}", place, self.expression(node.handle))
        if node.word == "join":
            code = ast.YieldFrom(value=code, **place)
        return [ast.Expr(value=code, **place)]

    def _label(self, node: Label, place: Place) -> list[ast.stmt]:
        code = call("_label", place, constant(node.number, place), constant(node.text, place))
        return [ast.Expr(value=code, **place)]


def _is_heavy(statement: Statement) -> bool:
    """True when the blocks inside charge their own work."""
    return isinstance(statement, While) or (
        isinstance(statement, If) and (statement.loops or statement.cost > _RUN_COST)
    )


def _runs(statements: list[Statement], extra: int) -> Iterator[tuple[list[Statement], int]]:
    """The statements in groups, each with its work: bounded, unless it is that of a single statement.

    The first group has extra work.
    """
    run: list[Statement] = []
    work = extra
    for statement in statements:
        if isinstance(statement, FunctionDef):
            continue
        cost = _LOOP_COST if _is_heavy(statement) else statement.cost
        if run and work + cost > _RUN_COST:
            yield run, work
            run, work = [], 0
        run.append(statement)
        work += cost
    if run:
        yield run, work


def _leads_out(statements: list[Statement], *, in_loop: bool = False) -> bool:
    """True when a return, or a break or continue of a loop around the statements, is among them."""
    for statement in statements:
        match statement:
            case Return():
                return True
            case Word(word="break" | "continue") if not in_loop:
                return True
            case While() if _leads_out(statement.body, in_loop=True):
                return True
            case If():
                blocks = [*(body for _, body in statement.branches), statement.otherwise]
                if any(_leads_out(block, in_loop=in_loop) for block in blocks):
                    return True
    return False
