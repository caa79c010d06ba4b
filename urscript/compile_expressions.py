"""Compile expressions to Python: arithmetic and element access become calls of `urscript.operators`."""

import ast
import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from urproto.versions import Availability, PolyscopeVersion
from urscript import hints, values
from urscript.analysis import MAX_CALL_DEPTH, FunctionPlan
from urscript.arguments import BindingError, Slot, bind_arguments
from urscript.builtins import Builtin, Parameter
from urscript.errors import CompileError, ScriptWarning
from urscript.inference import (
    BOOL,
    FLOAT,
    INT,
    NUMBER,
    STRING,
    Kinds,
    KindSet,
    arithmetic,
    is_list,
    is_local,
    is_number,
    is_ordered,
    is_vector,
)
from urscript.literals import Mistake, call_problems
from urscript.methods import METHOD_HINTS
from urscript.number_code import ARITHMETIC_HELPERS, ROUNDING, kept, number_arithmetic, rounded, within
from urscript.pycode import (
    LOAD,
    STORE,
    Place,
    assign,
    attribute,
    call,
    constant,
    item,
    load,
    place_of,
    subscript,
    yield_from,
)
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
    Node,
    NumberList,
    PoseLiteral,
    Program,
    Run,
    Scope,
    Unary,
    parts,
)
from urscript.values import MAX_STRING
from urscript.work import Steps

MUTATORS = frozenset(["append", "clear", "extend", "insert", "pop", "remove"])
"""List methods that modify the list: the variable is rebound to the list they return."""

_ORDER: dict[str, tuple[str, type[ast.cmpop]]] = {
    "<": ("_lt", ast.Lt),
    "<=": ("_le", ast.LtE),
    ">": ("_gt", ast.Gt),
    ">=": ("_ge", ast.GtE),
}
_LOGIC: dict[str, type[ast.boolop]] = {"and": ast.And, "or": ast.Or}
_MAX_ERRORS = 1000
"""Unknown names that are reported; beyond them, only one that comes before the first error so far."""

_MAX_OWNERS = 50
"""Errors after which an unknown variable is no longer searched for among the locals of all functions."""

_ACCEPTED: dict[values.Kind, KindSet] = {
    values.NUMBER: NUMBER,
    values.INT: INT,
    values.BOOL: BOOL,
    values.STRING: STRING,
}
"""The kinds that a parameter takes as they are; other kinds of parameters look at each value."""

_TRUTH_OPERATORS = frozenset(["and", "or", "xor", "==", "!=", "<", "<=", ">", ">="])


@dataclass(slots=True)
class Unit:
    """State that all bodies of one program share while it is compiled."""

    program: Program
    source: str
    builtins: Mapping[str, Builtin]
    plans: Mapping[str, FunctionPlan]
    kinds: Kinds
    elsewhere: Mapping[str, Availability]  # functions that only other versions have
    version: PolyscopeVersion
    structs: bool  # whether this version has struct()
    fixed_lists: bool  # whether list variables keep their length in this version
    stepped: bool = False  # whether every statement asks the host first
    divided: bool = True  # whether long bodies become pieces; not needed to find errors
    used: dict[str, Builtin] = field(default_factory=dict)
    errors: list[CompileError] = field(default_factory=list)
    first_error: tuple[float, float] = (math.inf, math.inf)  # line and column
    unexplained: dict[int, tuple[str, Callable[[], list[str]]]] = field(default_factory=dict)  # names, by error's id
    warnings: list[ScriptWarning] = field(default_factory=list)  # of calls that will fail when executed
    misfits: int = 0  # names that are not defined, and calls with wrong arguments, whether they are reported or not

    def name_not_found(self, name: str, node: Node, kind: str, hint: str, candidates: Callable[[], list[str]]) -> None:
        """Record the error; a program can contain thousands."""
        if len(self.errors) >= _MAX_ERRORS and (node.line, node.column) > self.first_error:
            return  # only the first error in the text matters then
        message = f"{kind} '{name}' is not defined" + (f"; {hint}" if hint else "")
        self.first_error = min(self.first_error, (node.line, node.column))
        error = CompileError.name_not_found(name, message, node.line, node.column, self.source)
        self.errors.append(error)
        if not hint:
            self.unexplained[id(error)] = name, candidates

    def warn(self, kind: Mistake, message: str, node: Node) -> None:
        """Record a call that will fail when it is executed."""
        self.warnings.append(ScriptWarning(message, node.line, node.column, self.source, kind))

    @property
    def has_handles(self) -> bool:
        """Whether the program makes proxies, whose methods may have any name."""
        return any(call.name.endswith("_factory") for scope in self.program.scopes for call in scope.calls)

    def explain(self, error: CompileError) -> Steps[None]:
        """Add "did you mean ...?" to the message for an unknown name; the search for a similar name takes steps."""
        name, candidates = self.unexplained.pop(id(error), ("", list[str]))
        closest = (yield from hints.closest_name(name, candidates())) if name else ""
        if closest:
            error.message += f"; did you mean '{closest}'?"
            error.args = (error.message,)


class ExpressionCompiler:
    """Compiles the expressions of one body."""

    def __init__(self, unit: Unit, scope: Scope, *, recursive: bool = False, boxed: bool = False) -> None:
        """boxed: keep the body's variables as items of ``_locals``, so that statements sent later can share them."""
        self.unit = unit
        self.boxed = boxed
        self.scope = scope
        self.recursive = recursive
        self.used_globals: set[str] = set()  # Python names of the global variables in the code
        self.size = 0  # expressions compiled so far
        self.hoisted: dict[int, tuple[int, ast.expr]] = {}  # runs of values compiled in advance, by the first one's id
        self._kinds: dict[int, KindSet] = {}  # of arithmetic already compiled, by the node's id
        # Functions, not bound methods: those would form a reference cycle, which keeps the whole tree alive until the
        # garbage collector runs.
        self._handlers: dict[type, Callable[[Any, Any, Place], ast.expr]] = {
            Constant: ExpressionCompiler._constant,
            Name: ExpressionCompiler._name,
            ListLiteral: ExpressionCompiler._list,
            NumberList: ExpressionCompiler._number_list,
            PoseLiteral: ExpressionCompiler._pose,
            Unary: ExpressionCompiler._unary,
            Binary: ExpressionCompiler._binary,
            Index: ExpressionCompiler._index,
            Member: ExpressionCompiler._member,
            Call: ExpressionCompiler._call,
            MethodCall: ExpressionCompiler._method,
            Run: ExpressionCompiler._run,
        }

    def expression(self, node: Expression) -> ast.expr:
        """The Python code for the value of an expression."""
        if id(node) in self.hoisted:
            return self.hoisted[id(node)][1]
        self.size += 1
        return self._handlers[node.__class__](self, node, place_of(node))

    def values(self, nodes: Sequence[Expression]) -> list[ast.expr]:
        """The Python code for a sequence of values, runs of which may have been compiled in advance."""
        code: list[ast.expr] = []
        at = 0
        while at < len(nodes):
            together = self.hoisted.get(id(nodes[at]))
            code.append(self.expression(nodes[at]))
            at += together[0] if together else 1
        return code

    def condition(self, node: Expression) -> ast.expr:
        """The Python code for an expression used as a condition; it evaluates to a Python bool."""
        code = self.expression(node)
        kind = BOOL if _is_truth(node) else self.kind(node)
        if kind == BOOL:
            return code
        if is_number(kind):
            return _compare(code, ast.NotEq(), constant(0, place_of(node)), place_of(node))
        return call("_truth", place_of(node), code)

    # names

    def is_local(self, name: str) -> bool:
        """True for parameters, names declared local, and names only ever assigned here."""
        return is_local(self.unit.program, self.scope, name)

    def known(self, name: str) -> bool:
        """True when the name is a variable here."""
        return name in self.unit.program.globals or self.is_local(name)

    def variable(self, name: str, place: Place) -> ast.expr:
        """The Python code for the value of a variable."""
        if not self.is_local(name):
            self.used_globals.add(f"v_{name}")
        elif self.boxed:
            return item("_locals", name, LOAD, place)
        return load(f"v_{name}", place)

    def bind(self, name: str, value: ast.expr, place: Place) -> ast.stmt:
        """The Python statement that assigns to a variable."""
        if not self.is_local(name):
            self.used_globals.add(f"v_{name}")
        elif self.boxed:
            return ast.Assign(targets=[item("_locals", name, STORE, place)], value=value, **place)
        return assign(f"v_{name}", value, place)

    def bind_within(self, name: str, value: ast.expr, place: Place) -> ast.expr:
        """Like `bind`, as an expression."""
        if not self.is_local(name):
            self.used_globals.add(f"v_{name}")
        elif self.boxed:
            store = attribute(load("_locals", place), "__setitem__", place)
            return ast.Call(store, [constant(name, place), value], [], **place)
        return ast.NamedExpr(target=ast.Name(id=f"v_{name}", ctx=STORE, **place), value=value, **place)

    def name_not_found(self, name: str, node: Expression, kind: str) -> None:
        """Record the error; the first one in the text is raised in the end."""
        unit, scope = self.unit, self.scope
        unit.misfits += 1
        if name in unit.program.damaged:
            return
        if kind == "variable":
            hint = self._variable_hint(name) if len(unit.errors) < _MAX_OWNERS else ""
            unit.name_not_found(name, node, kind, hint, lambda: [*unit.program.globals, *scope.locals, *scope.assigned])
        else:
            hint = self._function_hint(name, kind)
            unit.name_not_found(name, node, kind, hint, lambda: [*unit.plans, *unit.builtins])

    def _variable_hint(self, name: str) -> str:
        """A hint for a name that is not a variable here: what it is instead."""
        unit = self.unit
        if name in unit.plans and unit.plans[name].is_thread:
            return f"it is a thread: 'handle = run {name}()' starts it, and join and kill take the handle"
        if name in unit.plans or name in unit.builtins:
            return f"it is a function: {name}() calls it"
        if name in hints.VARIABLES:
            return hints.VARIABLES[name]
        owner = next((n for n, f in unit.program.functions.items() if name in f.scope.locals | f.scope.assigned), None)
        return f"it is local to '{owner}': declare it there with 'global {name} = ...'" if owner else ""

    def _function_hint(self, name: str, kind: str) -> str:
        """A hint for a name that cannot be called or run: what it is instead."""
        unit = self.unit
        plan = unit.plans.get(name)
        if plan is not None:
            a_thread = plan.is_thread
            return f"it is a thread: 'run {name}()' starts it" if a_thread else f"it is a function: {name}() calls it"
        if kind == "thread" and name in unit.builtins:
            return f"it is a function: {name}() calls it"
        availability = unit.elsewhere.get(name)
        if availability is not None:
            return f"not available in PolyScope {unit.version.short} ({availability})"
        if self.known(name):
            return f"it is a variable: {name}[0] is its first element"
        return hints.function_hint(name)

    # leaves

    def _constant(self, node: Constant, place: Place) -> ast.expr:
        return constant(node.value, place)

    def _name(self, node: Name, place: Place) -> ast.expr:
        if not self.known(node.name):
            self.name_not_found(node.name, node, "variable")
        return self.variable(node.name, place)

    def _list(self, node: ListLiteral, place: Place) -> ast.expr:
        items = self.values(node.items)
        texts = any(_is_text(item) for item in node.items)
        if all(isinstance(item, Constant) for item in node.items) and not (texts and self.unit.fixed_lists):
            return ast.List(elts=items, ctx=ast.Load(), **place)
        return call("_list", place, *items)

    def _number_list(self, node: NumberList, place: Place) -> ast.expr:
        """A list of numbers as bytes, because Python's compiler takes long for constants with many elements."""
        self.size += len(node.values) // 32
        layout = "<" + "".join("i" if value.__class__ is int else "d" for value in node.values)
        return call("_numbers", place, constant(layout, place), constant(struct.pack(layout, *node.values), place))

    def _pose(self, node: PoseLiteral, place: Place) -> ast.expr:
        if all(map(_is_number, node.items)):
            constants = [item for item in node.items if isinstance(item, Constant)]
            numbers = tuple(float(item.value) for item in constants if item.value is not None)
            return call("_new_pose", place, constant(numbers, place))
        return call("_pose", place, *[self.expression(item) for item in node.items])

    # operators

    def _unary(self, node: Unary, place: Place) -> ast.expr:
        if node.operator == "not":
            return ast.UnaryOp(op=ast.Not(), operand=self.condition(node.operand), **place)
        if node.operator == "-" and self.kind(node.operand) == FLOAT:
            return ast.UnaryOp(op=ast.USub(), operand=self.expression(node.operand), **place)
        return call("_neg" if node.operator == "-" else "_pos", place, self.expression(node.operand))

    def _binary(self, node: Binary, place: Place) -> ast.expr:
        operator = node.operator
        if operator in _LOGIC:
            return self._logic(node, place)
        if operator == "xor":
            return _compare(self.condition(node.left), ast.IsNot(), self.condition(node.right), place)
        left, right = self.expression(node.left), self.expression(node.right)
        kinds = self.kind(node.left), self.kind(node.right)
        if operator in ARITHMETIC_HELPERS:
            if operator == "+" and _is_text(node.left) != _is_text(node.right):
                self._warn_of_sum(node, kinds)
            self._kinds[id(node)] = kind = arithmetic(operator, *kinds)
            if is_number(kind):
                self.size += kind != FLOAT  # code for the wrap at 32 bits
                return number_arithmetic(node, kind, left, right, place)
            return call(ARITHMETIC_HELPERS[operator], place, left, right)
        ordered = all(map(is_ordered, kinds))
        if operator in _ORDER:
            helper, native = _ORDER[operator]
            # Python itself compares a number literal with any number and refuses anything else.
            simple = ordered or _is_number(node.left) or _is_number(node.right)
            return _compare(left, native(), right, place) if simple else call(helper, place, left, right)
        if ordered or _is_short(node.left) or _is_short(node.right):
            return _compare(left, ast.Eq() if operator == "==" else ast.NotEq(), right, place)
        return call("_eq" if operator == "==" else "_ne", place, left, right)

    def _logic(self, node: Binary, place: Place) -> ast.expr:
        """``a and b and c``, or with ``or``: each condition is evaluated if those before it have the same result."""
        conditions = [node.right]
        left = node.left
        while isinstance(left, Binary) and left.operator == node.operator and id(left) not in self.hoisted:
            self.size += 1
            conditions.append(left.right)
            left = left.left
        conditions.append(left)
        code = [self.condition(condition) for condition in reversed(conditions)]
        return ast.BoolOp(op=_LOGIC[node.operator](), values=code, **place)

    def _constant_behind(self, node: Expression) -> Expression:
        """The value assigned to a global that is assigned only once; any other expression unchanged."""
        if isinstance(node, Name) and not self.is_local(node.name):
            return self.unit.kinds.constants.get(node.name, node)
        return node

    def _warn_of_sum(self, node: Binary, kinds: tuple[KindSet, KindSet]) -> None:
        """Warn of a sum of a string and a value that can only be a number or a list."""
        other, kind = (node.right, kinds[1]) if _is_text(node.left) else (node.left, kinds[0])
        if is_number(kind) or is_vector(kind) or isinstance(other, (Constant, ListLiteral, NumberList, PoseLiteral)):
            message = (
                "Type error: a string can only be added to a string: str_cat() joins any two values, "
                "to_str() converts to a string"
            )
            self.unit.warn("sum", message, node)

    def kind(self, node: Expression) -> KindSet:
        """The kinds of value an expression may have; cached for arithmetic that is already compiled."""
        known = self._kinds.get(id(node))
        return self.unit.kinds.expression(self.scope, node) if known is None else known

    def _index(self, node: Index, place: Place) -> ast.expr:
        positions = [self.expression(position) for position in node.positions]
        target = self.expression(node.target)
        if len(positions) == 2:
            return call("_cell", place, target, *positions)
        if not self.is_quick(node):
            return call("_index", place, target, positions[0])
        self.size += 4
        first, again = kept(node.positions[0], positions[0], place)
        element = ast.Subscript(value=target, slice=again, ctx=LOAD, **place)
        return ast.IfExp(within(first, target, place), element, call("_index", place, target, again), **place)

    def is_quick(self, node: Index) -> bool:
        """True for an element of a variable that can only be a list, at a position that is an int."""
        target, position = node.target, node.positions[0]
        if len(node.positions) > 1 or not isinstance(target, Name) or not self.known(target.name):
            return False
        simple = isinstance(position, (Constant, Name)) or (
            isinstance(position, Binary) and self.is_kept_by(position, target.name)
        )
        return simple and self.kind(position) == INT and is_list(self.kind(target))

    def is_kept_by(self, node: Expression, name: str) -> bool:
        """True when no call in an expression can change a variable."""
        return self.is_local(name) or _calls_nothing(node)

    def _member(self, node: Member, place: Place) -> ast.expr:
        return call("_member", place, self.expression(node.target), constant(node.name, place))

    # calls

    def _call(self, node: Call, place: Place) -> ast.expr:
        plan = self.unit.plans.get(node.name)
        builtin = self.unit.builtins.get(node.name)
        try:
            if plan is not None and not plan.is_thread:
                return self._user_call(node, plan, place)
            if node.name == "struct" and self.unit.structs:
                return self._struct(node, place)
            if builtin is not None:
                return self._builtin_call(node, builtin, place)
        except BindingError as error:
            self._check_arguments(node)
            self.unit.misfits += 1
            if node.name not in self.unit.program.damaged:
                self.unit.warn("arguments", str(error), node)
            return call("_fault", place, constant(str(error), place))
        self.name_not_found(node.name, node, "function")
        self._check_arguments(node)
        return constant(None, place)

    def _check_arguments(self, node: Call) -> None:
        """Find the errors in the arguments of a call that itself cannot be compiled."""
        for argument in [*node.arguments, *[value for _, value in node.keywords]]:
            self.expression(argument)

    def _user_call(self, node: Call, plan: FunctionPlan, place: Place) -> ast.expr:
        parameters = plan.parameters
        bound = bind_arguments(node, [Slot((p.name,), p.default is None) for p in parameters])
        defaults = ExpressionCompiler(self.unit, Scope(""))  # a default value can only use globals
        defaults.used_globals = self.used_globals
        given = len(node.arguments)
        arguments = self.values(node.arguments)
        for value, parameter in zip(bound[given:], parameters[given:], strict=True):
            if value is not None:
                arguments.append(self.expression(value))
            elif parameter.default is not None:
                arguments.append(defaults.expression(parameter.default))
        if plan.recursive:
            arguments.insert(0, _deeper(place) if self.recursive else constant(1, place))
        code = call(plan.symbol, place, *arguments)
        return yield_from(code, place) if plan.generator or self.unit.stepped else code

    def _builtin_call(self, node: Call, builtin: Builtin, place: Place) -> ast.expr:
        self.unit.used[builtin.name] = builtin
        checked = True
        if builtin.variadic:
            arguments = self.values([*node.arguments, *[value for _, value in node.keywords]])
        else:
            bound = bind_arguments(node, [Slot(p.names, p.required) for p in builtin.parameters])
            for kind, message, argument in call_problems(builtin, bound, self._constant_behind):
                self.unit.warn(kind, message, argument)
            arguments = self.values(node.arguments)
            checked = not builtin.plain or not all(map(self._is_accepted, builtin.parameters, bound))
            given = len(node.arguments)
            for value, parameter in zip(bound[given:], builtin.parameters[given:], strict=True):
                if value is not None:
                    arguments.append(self.expression(value))
                else:
                    arguments.append(load("_omitted", place) if checked else constant(parameter.default, place))
        if builtin.takes_scope:
            arguments.insert(0, load("_locals", place))
        if not checked and builtin.name in ROUNDING:
            return rounded(builtin.name, arguments[0], place)
        code = call(f"{'b' if checked else 'u'}_{builtin.name}", place, *arguments)
        return yield_from(code, place) if builtin.takes_time else code

    def _is_accepted(self, parameter: Parameter, argument: Expression | None) -> bool:
        """True when a parameter takes an argument as it is: no test at run time can refuse or convert it."""
        if argument is None:
            return not isinstance(parameter.default, tuple)
        if parameter.kind is values.ANY:
            return True
        kind = self.kind(argument)
        return kind > 0 and not kind & ~_ACCEPTED.get(parameter.kind, 0)

    def _struct(self, node: Call, place: Place) -> ast.expr:
        names = tuple(name for name, _ in node.keywords)
        if node.arguments or len(set(names)) != len(names):
            raise BindingError("Type error: struct takes members as name=value, each name once")
        return call("_struct", place, constant(names, place), *self.values([value for _, value in node.keywords]))

    def _method(self, node: MethodCall, place: Place) -> ast.expr:
        """``(yield from _method(...))[1]``; item 0 is the target after the call."""
        if self.unit.fixed_lists and node.name in METHOD_HINTS and not self.unit.has_handles:
            message = f"lists have no method '{node.name}' before PolyScope 5.15; {METHOD_HINTS[node.name]}"
            self.unit.warn("method", message, node)
        arguments = [self.expression(node.target), constant(node.name, place), *self.values(node.arguments)]
        pair = yield_from(call("_method", place, *arguments), place)
        if node.name not in MUTATORS:
            return subscript(pair, 1, place)
        keep = ast.NamedExpr(target=ast.Name(id="_pair", ctx=STORE, **place), value=pair, **place)
        store = self.store(node.target, subscript(keep, 0, place), place)
        if store is None:
            return subscript(pair, 1, place)
        bind = self.bind_within(*store, place)
        result = subscript(load("_pair", place), 1, place)
        return subscript(ast.Tuple(elts=[bind, result], ctx=ast.Load(), **place), 1, place)

    def store(self, target: Expression, value: ast.expr, place: Place) -> tuple[str, ast.expr] | None:
        """The variable to bind and the Python value to bind it to, so that `target` gets `value`.

        None when the target is neither a variable nor a part of one.
        """
        path: list[ast.expr] = []
        while not isinstance(target, Name):
            if isinstance(target, Index):
                keys = [self.expression(position) for position in target.positions]
                path.insert(0, keys[0] if len(keys) == 1 else ast.Tuple(elts=keys, ctx=ast.Load(), **place))
            elif isinstance(target, Member):
                path.insert(0, constant(target.name, place))
            else:
                return None
            target = target.target
        if not self.known(target.name):
            self.name_not_found(target.name, target, "variable")
        root = self.variable(target.name, place)
        if len(path) == 1:
            return target.name, call("_set_item", place, root, path[0], value)
        keys_code = ast.Tuple(elts=path, ctx=ast.Load(), **place)
        return target.name, call("_set_path", place, root, keys_code, value) if path else value

    def _run(self, node: Run, place: Place) -> ast.expr:
        plan = self.unit.plans.get(node.name)
        if plan is None or not plan.is_thread:
            self.name_not_found(node.name, node, "thread")
            return constant(None, place)
        return call("_run", place, load(plan.symbol, place), constant(node.name, place))


def _deeper(place: Place) -> ast.expr:
    """``_depth + 1 if _depth < MAX_CALL_DEPTH else _too_deep()``."""
    depth = load("_depth", place)
    return ast.IfExp(
        test=_compare(depth, ast.Lt(), constant(MAX_CALL_DEPTH, place), place),
        body=ast.BinOp(left=depth, op=ast.Add(), right=constant(1, place), **place),
        orelse=call("_too_deep", place),
        **place,
    )


def _compare(left: ast.expr, operator: ast.cmpop, right: ast.expr, place: Place) -> ast.expr:
    return ast.Compare(left=left, ops=[operator], comparators=[right], **place)


def _is_number(node: Expression) -> bool:
    return isinstance(node, Constant) and node.value.__class__ in (int, float)


def _is_short(node: Expression) -> bool:
    """True for a literal that is quickly compared with any value."""
    return isinstance(node, Constant) and (node.value.__class__ is not str or len(str(node.value)) <= MAX_STRING)


def _calls_nothing(node: Expression) -> bool:
    alone, row = parts(node)
    return not isinstance(node, (Call, MethodCall)) and all(map(_calls_nothing, (*alone, *row)))


def _is_text(node: Expression) -> bool:
    return isinstance(node, Constant) and node.value.__class__ is str


def _is_truth(node: Expression) -> bool:
    """True when the Python code for this expression can only evaluate to a bool."""
    if isinstance(node, Constant):
        return node.value.__class__ is bool
    if isinstance(node, Unary):
        return node.operator == "not"
    return isinstance(node, Binary) and node.operator in _TRUTH_OPERATORS
