"""Compile statements to Python. Every generator draws its work from the meter and parks when it is empty.

A long body is divided into pieces while it is compiled (`urscript.pieces`), and so are long parts of an expression.
"""

import ast
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

from urscript.analysis import WHOLE, FunctionPlan, lends_its_scope
from urscript.compile_expressions import ExpressionCompiler, Unit
from urscript.inference import VECTOR, is_plain
from urscript.operators import UNSHARED_ITEM, UNSHARED_LOCAL
from urscript.pieces import Exit, Part, Pieces, PythonFunction
from urscript.pycode import (
    LOAD,
    Place,
    assign,
    attribute,
    call,
    charge,
    constant,
    function,
    load,
    place_of,
    script_position,
    yield_from,
)
from urscript.syntax import (
    Assign,
    Call,
    Constant,
    Expression,
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
    parts,
)
from urscript.work import Steps

STATEMENT = "statement"
"""Python name of the function compiled from an interpreted statement."""

_RUN_COST = 200
"""Maximum work between two checks of the meter [meter units]: about 10 us."""

_LOOP_COST = 3

_WORK = 8  # to compile an expression, or a statement without its expressions
_SLICE = 12  # minimum number of these between two yields
_PIECE = 100  # approximate number of these in a piece
_REST = 40  # minimum number of these in a piece at the end of a block
_BRANCH_WORK = 4  # to put a branch before those that follow, without its contents
_ROW = 20  # values from which a sequence is divided

_MAIN = "main"  # Python name of the function compiled from the program body

_OLD_SETTERS = {"digital_out": "set_digital_out"}
"""Arrays of signals that predate the functions for them; python-urx still writes one."""


def compile_main(unit: Unit) -> Steps[list[PythonFunction]]:
    """The program body as the generator function ``main``, and the pieces it is divided into."""
    program = unit.program
    costs = (statement.cost for statement in program.body if not isinstance(statement, FunctionDef))
    long = sum(islice(costs, WHOLE + 1)) > WHOLE  # each costs at least 1
    compiler = _BodyCompiler(unit, program.scope, _MAIN, charged=True, divided=unit.divided and long)
    place = place_of(program.body[0] if program.body else Node(1, 1))
    body = yield from compiler.body(program.body, place)
    main = function(_MAIN, [], body, compiler.used_globals, place)
    return [*compiler.pieces.functions, PythonFunction(main, compiler.inline)]


def compile_function(
    unit: Unit, definition: FunctionDef, plan: FunctionPlan, *, lasting: bool = True
) -> Steps[list[PythonFunction]]:
    """One def or thread as a Python function, and the pieces it is divided into when it is long.

    lasting: False for a function that may be removed while it is executed; it then refers to its pieces itself.
    """
    scope, place = definition.scope, place_of(definition)
    long = scope.cost > WHOLE and unit.divided
    lends = lends_its_scope(scope, unit.builtins)
    compiler = _BodyCompiler(
        unit,
        scope,
        plan.symbol,
        charged=plan.generator,
        recursive=plan.recursive,
        divided=long,
        boxed=long or lends,
        lasting=lasting,
    )
    parameters = [f"v_{parameter.name}" for parameter in scope.parameters]
    if plan.recursive:
        parameters.insert(0, "_depth")
    body = yield from compiler.body(definition.body, place)
    if compiler.pieces.functions and not lasting:
        pieces = ast.Tuple(elts=compiler.pieces.names(place), ctx=LOAD, **place)
        body.insert(0, assign("_pieces", pieces, place))
    if compiler.boxed:
        body.insert(0, _boxed_locals(compiler, place, lends))
    size = compiler.inline + len(parameters)
    whole = function(plan.symbol, parameters, body, compiler.used_globals, place)
    return [*compiler.pieces.functions, PythonFunction(whole, size)]


def compile_interpreted(unit: Unit) -> Steps[list[PythonFunction]]:
    """Statements sent to a running program, as the generator function `STATEMENT` of the scope they run in.

    Its pieces are passed as an argument, so they need no lasting names.
    """
    program = unit.program
    place = place_of(program.body[0] if program.body else Node(1, 1))
    compiler = _BodyCompiler(unit, program.scope, STATEMENT, charged=True, divided=True, boxed=True, lasting=False)
    body = yield from compiler.body(program.body, place)
    whole = function(STATEMENT, ["_locals", "_pieces"], body, compiler.used_globals, place)
    return [*compiler.pieces.functions, PythonFunction(whole, compiler.inline)]


def _boxed_locals(compiler: ExpressionCompiler, place: Place, lends: bool) -> ast.stmt:
    """``_locals = _Locals(("a", "b"), {"a": v_a})``: the names of all variables if the function lends them to
    interpreted statements, and the values of its arguments."""
    scope = compiler.scope
    names = tuple(sorted(name for name in scope.locals | scope.assigned if compiler.is_local(name))) if lends else ()
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
        symbol: str,
        *,
        charged: bool,
        recursive: bool = False,
        divided: bool = False,
        boxed: bool = False,
        lasting: bool = True,
    ) -> None:
        super().__init__(unit, scope, recursive=recursive, boxed=boxed)
        shared = [
            *(["_locals"] if boxed else []),
            *([] if lasting else ["_pieces"]),
            *(["_depth"] if recursive else []),
        ]
        self.pieces = Pieces(symbol, shared, lasting=lasting)
        self._exits: list[Exit] = []  # exits of the code being compiled, like `used_globals`
        self._counted = 0  # the part of the size whose work has been yielded
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
        """Size of the code that is not in pieces."""
        return self.size - self.pieces.size

    def body(self, statements: list[Statement], place: Place) -> Steps[list[ast.stmt]]:
        """The complete Python body of the function."""
        if self._charged:
            code = (yield from self._metered(statements)) or charge(1, place, park=True)
        else:
            code = [*charge(self.scope.cost, place, park=False), *(yield from self._plain(statements))]
            if self.unit.stepped and all(isinstance(statement, FunctionDef) for statement in statements):
                code.append(ast.Expr(value=self._step(place), **place))  # a generator like all others
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
            if isinstance(statement, If | While):
                if isinstance(statement, If):
                    code += yield from self._if(statement, place)
                else:
                    code += yield from self._while(statement, place)
            else:
                if self._divided and statement.cost > _PIECE:
                    yield from self._divide_expressions(statement)
                code += self._compilers[statement.__class__](self, statement, place)
            yield from self._count()
        return code

    def _count(self) -> Steps[None]:
        if self.size >= self._counted + _SLICE:
            yield (self.size - self._counted) * _WORK
            self._counted = self.size

    def _metered(self, statements: list[Statement], extra: int = 0) -> Steps[list[ast.stmt]]:
        """Compile statements in runs of bounded work. Each run is charged before it starts; the first includes `extra`.

        When the body is divided, statements move into a piece as soon as there are enough for one, and so do the calls
        of pieces.
        """
        outer, outer_exits = self.used_globals, self._exits
        levels = [Part()]  # statements, calls of pieces, calls of pieces of such, ...
        for run, work in _runs(statements, extra):
            levels[0].code += charge(work, place_of(run[0]), park=True)
            for statement in run:
                part, before = levels[0], self.inline
                part.place = part.place or place_of(statement)
                self.used_globals, self._exits = part.used_globals, part.exits
                part.code += yield from self._plain([statement])
                part.size += self.inline - before
                if self._divided:
                    self._move(levels, _PIECE)
        if self._divided:
            self._move(levels, _REST)
        self.used_globals, self._exits = outer, outer_exits
        code: list[ast.stmt] = []
        for part in reversed(levels):
            code += part.code
            outer |= part.used_globals
            outer_exits += part.exits
        return code

    def _move(self, levels: list[Part], enough: int) -> None:
        """Turn the levels that are large enough into pieces, starting with the statements."""
        for level, part in enumerate(levels):
            if part.size < enough or part.place is None:
                continue
            if level + 1 == len(levels):
                if enough == _REST:
                    levels[level] = self._moved(part, part.place)
                    return
                levels.append(Part())
            above, run = levels[level + 1], self._moved(part, part.place)
            above.place = above.place or part.place
            above.code += run.code
            above.exits += run.exits
            above.size += run.size
            levels[level] = Part()

    def _moved(self, part: Part, place: Place) -> Part:
        """Move code into a piece; return the code that calls it."""
        calling = self.pieces.move(part, place)
        self.size += calling.size
        return calling

    # long expressions

    def _divide_expressions(self, statement: Statement) -> Steps[None]:
        """Move the long parts of a statement's expressions into pieces, so that its own code is short."""
        match statement:
            case Assign():
                for position in [position for group in parts(statement.target) for position in group]:
                    yield from self._divide(position)
                yield from self._divide(statement.value)
            case ExpressionStatement():
                yield from self._divide(statement.value)
            case Return(value=value) if value is not None:
                yield from self._divide(value)
            case ThreadControl():
                yield from self._divide(statement.handle)

    def _divide(self, node: Expression) -> Steps[int]:
        """Move an expression, or long parts of it, into pieces; returns the remaining size."""
        if isinstance(node, (Constant, Name)):
            return 1
        size, start, enough = 1, 0, 0
        alone, row = parts(node)
        for part in alone:
            size += yield from self._divide(part)
        for number, part in enumerate(row, 1):
            enough += yield from self._divide(part)
            if enough >= _PIECE // 2 and len(row) >= _ROW:
                yield from self._hoist(row[start:number])
                size, start, enough = size + 1, number, 0
        size += enough
        if size < _PIECE:
            return size
        yield from self._hoist([node])
        return 1

    def _hoist(self, nodes: list[Expression]) -> Steps[None]:
        """Move an expression, or a run of values, into a piece."""
        outer, self.used_globals = self.used_globals, set[str]()
        place, before = place_of(nodes[0]), self.inline
        values = self.values(nodes)
        alone = len(nodes) == 1
        returned = values[0] if alone else ast.Tuple(elts=values, ctx=LOAD, **place)
        code: list[ast.stmt] = [ast.Return(value=returned, **place)]
        run = self.pieces.add(code, self.inline - before, self.used_globals, place)
        self.size += 1
        self.used_globals = outer
        self.hoisted[id(nodes[0])] = (len(nodes), run if alone else ast.Starred(value=run, ctx=LOAD, **place))
        yield from self._count()

    def _step(self, place: Place) -> ast.expr:
        """``yield from _step(line, column)``: report the next statement to the host, and wait while it says so."""
        line, column = script_position(place)
        return yield_from(call("_step", place, constant(line, place), constant(column, place)), place)

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
        if isinstance(target, Index) and self._is_quick_to_write(target, node.value):
            return self._assign_element(target, node.value, value, place)
        stored = self.store(target, value, place)
        assert stored is not None, "the parser allows assignment only to variables and their parts"
        return [self.bind(*stored, place)]

    def _is_quick_to_write(self, target: Index, item: Expression) -> bool:
        """True for a scalar that becomes an element of a list; no call in it can change that variable."""
        name = target.target.name if isinstance(target.target, Name) else ""
        return self.is_quick(target) and self.is_kept_by(item, name) and is_plain(self.kind(item))

    def _assign_element(self, target: Index, item: Expression, value: ast.expr, place: Place) -> list[ast.stmt]:
        """Write a scalar into a list in place if nothing else refers to it; otherwise, `_set_item` creates a copy, or
        refuses the position."""
        assert isinstance(target.target, Name), "only elements of variables are quick"
        name, position = target.target.name, target.positions[0]
        code: list[ast.stmt] = []
        key = self.expression(position)
        if not isinstance(position, Name | Constant):
            code.append(assign("_key", key, place))
            key = load("_key", place)
        if not isinstance(item, Name | Constant):
            code.append(assign("_new", value, place))
            value = load("_new", place)
        whole = self.variable(name, place)
        fast = self.is_local(name) and not self.boxed
        alone = ast.Compare(
            left=call("_references", place, whole),
            ops=[ast.Eq()],
            comparators=[constant(UNSHARED_LOCAL if fast else UNSHARED_ITEM, place)],
            **place,
        )
        tests: list[ast.expr] = [alone]
        if not isinstance(key, ast.Constant):
            tests.append(ast.Compare(left=key, ops=[ast.GtE()], comparators=[constant(0, place)], **place))
        if self.kind(target.target) & VECTOR:  # a pose keeps its type
            plain = ast.Compare(
                left=attribute(whole, "__class__", place), ops=[ast.Is()], comparators=[load("_List", place)], **place
            )
            tests.insert(0, plain)
        self.size += 8
        element = ast.Subscript(value=whole, slice=key, ctx=ast.Store(), **place)
        in_place = ast.Assign(targets=[element], value=value, **place)
        test = ast.BoolOp(op=ast.And(), values=tests, **place) if len(tests) > 1 else alone
        other = self.bind(name, call("_set_item", place, whole, key, value), place)
        write = ast.If(test=test, body=[in_place], orelse=[other], **place)
        beyond = ast.ExceptHandler(type=load("_IndexError", place), name=None, body=[other], **place)
        return [*code, ast.Try(body=[write], handlers=[beyond], orelse=[], finalbody=[], **place)]

    def _old_setter(self, node: Assign) -> Call | None:
        """The built-in call that replaces an assignment such as ``digital_out[2] = True``, where the array is not a
        variable; None for any other assignment."""
        target = node.target
        if not isinstance(target, Index) or not isinstance(target.target, Name) or self.known(target.target.name):
            return None
        setter = _OLD_SETTERS.get(target.target.name)
        if setter is None or setter not in self.unit.builtins:
            return None
        return Call(node.line, node.column, setter, [*target.positions, node.value], [])

    def _assign_global(self, target: str, value: ast.expr, place: Place) -> list[ast.stmt]:
        """Assign to a global, which keeps the type of its first value. The check is inlined because it is so frequent.

        A global that only ever receives numbers, bools or strings needs no check, and its first value none either.
        """
        if is_plain(self.unit.kinds.variable(self.scope, target)):
            return [self.bind(target, value, place)]
        new, old = load("_new", place), self.variable(target, place)
        same = ast.Compare(
            left=attribute(new, "__class__", place),
            ops=[ast.IsNot()],
            comparators=[attribute(old, "__class__", place)],
            **place,
        )
        fixed = self.unit.fixed_lists
        check: ast.stmt = assign("_new", call("_retype_fixed" if fixed else "_retype", place, old, new), place)
        if not fixed:
            check = ast.If(test=same, body=[check], orelse=[], **place)
        first = ast.ExceptHandler(type=load("_NameError", place), name=None, body=[ast.Pass(**place)], **place)
        check = ast.Try(body=[check], handlers=[first], orelse=[], finalbody=[], **place)
        self.size += 4
        return [assign("_new", value, place), check, self.bind(target, new, place)]

    def _expression_statement(self, node: ExpressionStatement, place: Place) -> list[ast.stmt]:
        return [ast.Expr(value=self.expression(node.value), **place)]

    def _if(self, node: If, place: Place) -> Steps[list[ast.stmt]]:
        """Compile an if. In a long chain of branches, the last become a piece, then those before them, and so on."""
        heavy = _is_heavy(node)
        outer, outer_exits = self.used_globals, self._exits
        branches: list[tuple[ast.expr, Part]] = []
        for condition, statements in [*node.branches, (None, node.otherwise)]:
            part, before = Part(), self.inline
            self.used_globals, self._exits = part.used_globals, part.exits
            if condition is not None:
                if self._divided and node.cost > _PIECE:
                    yield from self._divide(condition)
                branches.append((self.condition(condition), part))
                part.place = place_of(condition)
            part.code = yield from self._inner(statements, heavy)
            part.size = self.inline - before
        self.used_globals, self._exits = outer, outer_exits
        rest = part  # of the else
        for (test, part), (source, _) in zip(reversed(branches), reversed(node.branches), strict=True):
            at = place_of(source)
            if self._divided and rest.size >= _PIECE and rest.place is not None:
                rest = self._moved(rest, rest.place)
            branch = ast.If(test=test, body=part.code or [ast.Pass(**at)], orelse=rest.code, **at)
            stored = part.used_globals | rest.used_globals
            rest = Part([branch], part.size + rest.size, stored, part.exits + rest.exits, at)
            yield _BRANCH_WORK
        self.used_globals |= rest.used_globals
        self._exits += rest.exits
        return rest.code

    def _while(self, node: While, place: Place) -> Steps[list[ast.stmt]]:
        if self._divided:
            yield from self._divide(node.condition)
        test = self.condition(node.condition)
        if self.unit.stepped:  # before each pass; _step returns None
            passed = ast.UnaryOp(op=ast.Not(), operand=self._step(place), **place)
            test = ast.BoolOp(op=ast.And(), values=[passed, test], **place)
        outer, self._exits = self._exits, []
        body = (yield from self._metered(node.body, _LOOP_COST)) or charge(_LOOP_COST, place, park=True)
        outer += [exit_ for exit_ in self._exits if isinstance(exit_, ast.Return)]
        self._exits = outer
        return [ast.While(test=test, body=body, orelse=[], **place)]

    def _return(self, node: Return, place: Place) -> list[ast.stmt]:
        back = ast.Return(value=None if node.value is None else self.expression(node.value), **place)
        self._exits.append(back)
        return [back]

    def _word(self, node: Word, place: Place) -> list[ast.stmt]:
        match node.word:
            case "break" | "continue":
                leave = ast.Break(**place) if node.word == "break" else ast.Continue(**place)
                exit_ = ast.If(test=constant(True, place), body=[leave], orelse=[], **place)  # Python drops the test
                self._exits.append(exit_)
                return [exit_]
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
        """``while _label(number, text, option): yield``: report the label to the host, and wait while it says so."""
        self.size += 1
        words = [constant(word, place) for word in (node.number, node.text, node.option)]
        wait = ast.Expr(value=ast.Yield(value=None, **place), **place)
        return [ast.While(test=call("_label", place, *words), body=[wait], orelse=[], **place)]


def _is_heavy(statement: Statement) -> bool:
    """True when the blocks inside draw their own work."""
    return isinstance(statement, While) or (isinstance(statement, If) and statement.cost > _RUN_COST)


def _own_cost(statement: Statement) -> int:
    """The work of a statement, apart from what blocks inside draw."""
    if _is_heavy(statement):
        return _LOOP_COST
    return statement.own_cost if isinstance(statement, If) else statement.cost


def _runs(statements: list[Statement], extra: int) -> Iterator[tuple[list[Statement], int]]:
    """The statements in groups, each with its work, which is bounded unless the group is a single statement.

    extra: additional work of the first group.
    """
    run: list[Statement] = []
    work = extra
    for statement in statements:
        if isinstance(statement, FunctionDef):
            continue
        cost = _own_cost(statement)
        if run and work + cost > _RUN_COST:
            yield run, work
            run, work = [], 0
        run.append(statement)
        work += cost
    if run:
        yield run, work
