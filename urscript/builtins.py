"""Built-ins: each is a typed Python function declared in a library.

    motion = Library("motion", host=True)

    @motion.builtin(cb3="3.0", e="5.0")
    def stopj(host: ProgramHost, a: Num) -> Generator[None, None, None]:
        \"\"\"Decelerate the joints with `a` [rad/s2] until they stand still.\"\"\"
        while not host.stopped(a):
            yield

The signature of the function is the declaration: its parameter names are the keyword names, its defaults apply in
scripts, arguments are checked against its annotations from `urscript.values`, and its docstring is the documentation.
A function that takes physical time is a generator function: every bare ``yield`` ends the thread's frame, and the
return value is the value of the call.

A trailing underscore is dropped from function and parameter names (``type_`` is ``type``). `aliases` names a parameter
whose name is not valid in Python, or that has several names (``aliases={"t": ("t", "t_min")}``). Defaults must be None,
bool, int, float, str or a tuple of them; None stands for "not given". A result that is a tuple becomes a pose or a list
when the return annotation says so.
"""

import inspect
from collections.abc import Callable, Generator, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Annotated, Any, Literal, NoReturn, TypeAlias, TypeVar, get_args, get_origin, get_type_hints

from urproto.versions import Availability, PolyscopeVersion
from urscript.errors import RuntimeFault
from urscript.meter import METER
from urscript.values import (
    ANY,
    LIST,
    MAX_PHYSICAL,
    PLAIN_KINDS,
    Kind,
    KindMismatchError,
    NotPhysicalError,
    PhysicalKind,
    Pose,
    Value,
    cut_text,
    type_name,
)

Status: TypeAlias = Literal["supported", "partial", "refused"]
AnyFunction: TypeAlias = Callable[..., Any]
FunctionT = TypeVar("FunctionT", bound=AnyFunction)

OMITTED = object()
"""Placeholder in a compiled call for an argument that was not given."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter as seen by scripts."""

    names: tuple[str, ...]  # the first is the documented one
    kind: Kind
    optional: bool  # None is accepted without a check
    required: bool
    default: Value = None

    @property
    def text(self) -> str:
        """``q``, or ``t=0``."""
        return self.names[0] if self.required else f"{self.names[0]}={_default_text(self.default)}"


@dataclass(frozen=True, slots=True, eq=False)
class Builtin:
    """A function that every program can call."""

    name: str
    chapter: str
    function: AnyFunction
    host: bool
    takes_scope: bool  # its first argument is the caller's variables, which is hidden from scripts
    parameters: tuple[Parameter, ...]
    variadic: bool  # takes any number of arguments, positional or by keyword
    takes_time: bool
    result: Any  # the annotation of the return value, None when there is none
    returns: AnyFunction | None
    availability: Availability
    status: Status
    note: str
    doc: str
    work: int = 0  # extra work of a call [meter units]

    @property
    def signature(self) -> str:
        """``movej(q, a=1.4, v=1.05, t=0, r=0)``."""
        return f"{self.name}({'...' if self.variadic else ', '.join(p.text for p in self.parameters)})"

    @property
    def plain(self) -> bool:
        """True when a call does nothing but check the arguments and call the function."""
        return bool(self.parameters) and not self.takes_scope and not self.work and self.returns is None

    def unchecked(self, host: object) -> AnyFunction:
        """The function of a plain built-in, for calls whose arguments are known to be what it accepts."""
        return partial(self.function, host) if self.host else self.function

    def bind(self, host: object) -> AnyFunction:
        """The function that a running program calls with all arguments by position, and OMITTED for a default."""
        leading = (host,) if self.host else ()
        if self.takes_scope:
            return lambda scope, *arguments: self._bind(*leading, scope)(*arguments)
        return self._bind(*leading)

    def _bind(self, *leading: object) -> AnyFunction:
        function = partial(self.function, *leading) if leading else self.function
        if self.variadic:
            return function
        if not self.parameters and not self.work and self.returns is None:
            return function
        maker = _maker_of_callers(len(self.parameters), works=self.work > 0, converts=self.returns is not None)
        as_is = (parameter.kind.as_is for parameter in self.parameters)
        return maker(function, map(_acceptor, self.parameters), as_is, self._mismatch, self.work, self.returns)

    def _mismatch(self, arguments: list[Value]) -> NoReturn:
        for parameter, value in zip(self.parameters, arguments, strict=True):
            try:
                _acceptor(parameter)(value)
            except NotPhysicalError:
                most = f", with no number beyond {MAX_PHYSICAL:g}" if isinstance(value, list) else ""
                raise RuntimeFault(
                    f"argument '{parameter.names[0]}' of {self.name} must be finite{most}: it is {cut_text(value, 200)}"
                ) from None
            except KindMismatchError:
                raise RuntimeFault(
                    f"Type error: argument '{parameter.names[0]}' of {self.name} expected type "
                    f"'{parameter.kind.title}' but found '{type_name(value)}'"
                ) from None
        raise AssertionError("no argument mismatches")


class Library:
    """The built-ins of one chapter, in the order of their declaration."""

    def __init__(
        self, chapter: str, *, host: bool = False, physical: bool = False, faults: tuple[type[Exception], ...] = ()
    ) -> None:
        """host: the first parameter of every function is the program's host, which is hidden from scripts.

        physical: numbers are physical quantities, so infinite and excessively large ones stop the program. faults:
        errors by which functions refuse their arguments; they stop the program with their text.
        """
        self.chapter = chapter
        self.host = host
        self.physical = physical
        self.faults = faults
        self.builtins: dict[str, Builtin] = {}

    def builtin(
        self,
        *,
        cb3: str | None = "3.0",
        e: str | None = "5.0",
        x: str | None = "",
        status: Status = "supported",
        note: str = "",
        aliases: Mapping[str, str | tuple[str, ...]] | None = None,
        takes_scope: bool = False,
        work: int = 0,
    ) -> Callable[[FunctionT], FunctionT]:
        """Declare the decorated function as a built-in.

        cb3, e: the first version that has it, None if no version of the series does. x: the first PolyScope X, by
        default the one that corresponds to e.
        takes_scope: the parameter after the host is the caller's variables (`urscript.interpreter.Locals`).
        work: extra work of a call [units of `urscript.meter`], so that calls in a loop slow the loop.
        Raises TypeError when scripts cannot call a function with this signature.
        """

        def declare(function: FunctionT) -> FunctionT:
            availability = Availability.since(cb3, e, x)
            described = _describe(self, function, availability, status, note, aliases or {}, takes_scope=takes_scope)
            self._add(replace(described, work=work, function=self._refusing(function)))
            return function

        return declare

    def refuse(self, name: str, *, cb3: str | None = "3.0", e: str | None = "5.0", note: str = "") -> None:
        """Declare a name that programs may contain, but that stops them with an error when it is called."""

        def refused(*_arguments: Any) -> NoReturn:
            raise RuntimeFault(f"{name} is not emulated" + (f": {note}" if note else ""))

        availability = Availability.since(cb3, e)
        self._add(
            Builtin(
                name=name,
                chapter=self.chapter,
                function=refused,
                host=False,
                takes_scope=False,
                parameters=(),
                variadic=True,
                takes_time=False,
                result=None,
                returns=None,
                availability=availability,
                status="refused",
                note=note,
                doc="",
            )
        )

    def _refusing(self, function: AnyFunction) -> AnyFunction:
        """The function with ``faults`` as runtime faults."""
        if not self.faults:
            return function

        def call(*arguments: Any) -> Any:
            try:
                return function(*arguments)
            except self.faults as error:
                raise RuntimeFault(str(error)) from error

        def steps(*arguments: Any) -> Generator[Any, Any, Any]:
            try:
                return (yield from function(*arguments))
            except self.faults as error:
                raise RuntimeFault(str(error)) from error

        return steps if inspect.isgeneratorfunction(function) else call

    def _add(self, builtin: Builtin) -> None:
        if builtin.name in self.builtins:
            raise TypeError(f"built-in {builtin.name} is declared twice in {self.chapter}")
        self.builtins[builtin.name] = builtin


class LibrarySet:
    """The libraries that a program is compiled against."""

    def __init__(self, libraries: Iterable[Library]) -> None:
        self._builtins: dict[str, Builtin] = {}
        self._available: dict[PolyscopeVersion, Mapping[str, Builtin]] = {}
        for library in libraries:
            for name, builtin in library.builtins.items():
                if name in self._builtins:
                    raise TypeError(
                        f"built-in {name} is declared in {self._builtins[name].chapter} and in {library.chapter}"
                    )
                self._builtins[name] = builtin

    @property
    def builtins(self) -> Mapping[str, Builtin]:
        """The built-ins of all versions."""
        return self._builtins

    def available(self, version: PolyscopeVersion) -> Mapping[str, Builtin]:
        """The built-ins a controller of this version has, by name."""
        if version not in self._available:
            self._available[version] = {n: b for n, b in self._builtins.items() if b.availability.covers(version)}
        return self._available[version]

    def elsewhere(self, version: PolyscopeVersion) -> dict[str, Availability]:
        """The built-ins that only controllers of other versions have, with those versions."""
        return {n: b.availability for n, b in self._builtins.items() if not b.availability.covers(version)}


def _describe(
    library: Library,
    function: AnyFunction,
    availability: Availability,
    status: Status,
    note: str,
    aliases: Mapping[str, str | tuple[str, ...]],
    *,
    takes_scope: bool,
) -> Builtin:
    hints = get_type_hints(function, include_extras=True)
    declared = list(inspect.signature(function).parameters.values())[library.host + takes_scope :]
    variadic = any(p.kind is p.VAR_POSITIONAL for p in declared)
    takes_time = inspect.isgeneratorfunction(function)
    returned = hints.get("return")
    return Builtin(
        name=function.__name__.rstrip("_"),
        chapter=library.chapter,
        function=function,
        host=library.host,
        takes_scope=takes_scope,
        parameters=() if variadic else tuple(_parameter(p, hints, aliases, library.physical) for p in declared),
        variadic=variadic,
        takes_time=takes_time,
        result=get_args(returned)[2] if takes_time else returned,
        returns=None if takes_time else _result_converter(returned),
        availability=availability,
        status=status,
        note=note,
        doc=inspect.getdoc(function) or "",
    )


def _parameter(
    declared: inspect.Parameter,
    hints: Mapping[str, Any],
    aliases: Mapping[str, str | tuple[str, ...]],
    physical: bool,
) -> Parameter:
    if declared.kind is not declared.POSITIONAL_OR_KEYWORD or declared.name not in hints:
        raise TypeError(f"parameter {declared.name} of a built-in must be a plain, annotated parameter")
    names = aliases.get(declared.name, declared.name.rstrip("_"))
    kind, optional = _kind_of(hints[declared.name])
    required = declared.default is declared.empty
    default = None if required else declared.default
    if not isinstance(default, (type(None), bool, int, float, str, tuple)):
        raise TypeError(f"the default of parameter {declared.name} must be a scalar or a tuple, not {default!r}")
    if default is not None and not optional and kind is not ANY and not isinstance(default, tuple):
        kind.accept(default)
    names = (names,) if isinstance(names, str) else names
    if physical:
        kind = PhysicalKind(kind.title, kind)
    return Parameter(names, kind, optional or (not required and default is None), required, default)


def _kind_of(annotation: Any) -> tuple[Kind, bool]:
    """The kind that an annotation stands for, and whether None is allowed as well."""
    if get_origin(annotation) is Annotated:
        return next(item for item in get_args(annotation) if isinstance(item, Kind)), False
    if annotation in PLAIN_KINDS:
        return PLAIN_KINDS[annotation], False
    if annotation is list or get_origin(annotation) is list:
        return LIST, False
    members = [item for item in get_args(annotation) if item is not type(None)]
    if len(members) == 1:
        return _kind_of(members[0])[0], True
    raise TypeError(f"{annotation!r} is not an annotation for a built-in: use the aliases of urscript.values")


def _result_converter(annotation: Any) -> AnyFunction | None:
    origin = get_args(annotation)[0] if get_origin(annotation) is Annotated else annotation
    if origin is Pose:
        return lambda result: Pose(result) if result.__class__ is tuple else result
    if origin is list or get_origin(origin) is list:
        return lambda result: list(result) if result.__class__ is tuple else result
    return None


def _acceptor(parameter: Parameter) -> Callable[[Value], Value]:
    accept = parameter.kind.accept
    if parameter.required and not parameter.optional:
        return accept
    default, optional = parameter.default, parameter.optional
    return lambda value: default if value is OMITTED else value if optional and value is None else accept(value)


@cache
def _maker_of_callers(parameters: int, *, works: bool, converts: bool) -> Callable[..., AnyFunction]:
    """``make(function, accepts, as_is, mismatch, work, returns)``: makes the function that tests arguments and calls.

    Its text is written for the number of parameters: a call takes half as long as with ``*arguments``.
    """
    names = ("value", "accepted", "accept", "classes")
    values, accepted, accepts, as_is = ([f"{name}_{n}" for n in range(parameters)] for name in names)
    accepting = zip(accepted, values, as_is, accepts, strict=True)
    result = f"function({', '.join(accepted)})"
    tests = [
        "    try:",
        *(f"      {a} = {v} if {v}.__class__ in {plain} else {accept}({v})" for a, v, plain, accept in accepting),
        "    except KindMismatchError:",
        f"      mismatch([{', '.join(values)}])",
    ]
    lines = [
        "def make(function, accepts, as_is, mismatch, work, returns):",
        f"  [{', '.join(accepts)}] = accepts",
        f"  [{', '.join(as_is)}] = as_is",
        f"  def call({', '.join(values)}):",
        *(["    meter.left -= work"] if works else []),
        *(tests if parameters else []),
        f"    return {f'returns({result})' if converts else result}",
        "  return call",
    ]
    namespace: dict[str, Any] = {"meter": METER, "KindMismatchError": KindMismatchError}
    exec("\n".join(lines), namespace)
    maker: Callable[..., AnyFunction] = namespace["make"]
    return maker


def _default_text(value: Value) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(str, value))}]"
    return f'"{value}"' if isinstance(value, str) else str(value)
