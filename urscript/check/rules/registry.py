"""The rules by their codes: 0xx errors, 1xx calls that fail, 2xx names, 3xx what a program does over time.

A rule with a function of its own is declared where that function stands; the others are what the compiler finds.
"""

from collections.abc import Callable, Iterable
from typing import Final, NamedTuple, TypeAlias

from urscript.check.subject import Body, Subject
from urscript.errors import CompileError, ScriptError, ScriptWarning
from urscript.syntax import Node

Find: TypeAlias = Callable[[Subject], Iterable[tuple[Body, Node, str]]]
"""Finds the places where a rule is violated, each with a message and the body it is in."""

FindInBody: TypeAlias = Callable[[Subject, Body], Iterable[tuple[Node, str]]]
"""Finds the places in one body. It depends on the body, on the facts of `urscript.dependencies` about the names in it,
and on which functions take time."""

SYNTAX: Final = "URS001"
_UNKNOWN: Final = "URS002"
_OTHER_VERSION: Final = "URS003"
BROKEN_NODE: Final = "URS004"
STALE: Final = "URS108"
_ELSEWHERE: Final = "not available in PolyScope"

_MISTAKES: Final = {
    "arguments": ("URS101", "argument-count", "a call has too few or too many arguments, or an unknown one"),
    "type": ("URS102", "argument-type", "a literal argument has a wrong type"),
    "sum": ("URS103", "text-plus-number", "a text is added to something that is not a text"),
    "units": ("URS104", "units", "degrees where radians are due, or millimetres where metres are"),
    "escape": ("URS105", "escape", "a text contains \\n, \\r, \\t or \\0: URScript has no escapes"),
    "method": ("URS106", "list-method", "a list method is called that this PolyScope version lacks"),
}
"""The compiler's warnings: their kind, and the rule."""


class Rule(NamedTuple):
    """A rule. error: a program that violates it does not start."""

    code: str
    name: str
    summary: str
    error: bool
    find: Find | None = None
    find_in_body: FindInBody | None = None


RULES: Final[dict[str, Rule]] = {}


def declare(code: str, name: str, summary: str, *, error: bool = False) -> None:
    """Add a rule to the registry."""
    _add(Rule(code, name, summary, error))


def rule(code: str, name: str) -> Callable[[Find], Find]:
    """Declare the decorated function as a rule on whole programs; its docstring is the summary."""

    def add(find: Find) -> Find:
        _add(Rule(code, name, _summary(find), error=False, find=find))
        return find

    return add


def body_rule(code: str, name: str) -> Callable[[FindInBody], FindInBody]:
    """Declare the decorated function as a rule on single bodies, which are looked at only when they have changed."""

    def add(find: FindInBody) -> FindInBody:
        _add(Rule(code, name, _summary(find), error=False, find_in_body=find))
        return find

    return add


def _add(new: Rule) -> None:
    assert new.code not in RULES
    RULES[new.code] = new


def _summary(find: Callable[..., object]) -> str:
    return " ".join((find.__doc__ or "").split())


declare(SYNTAX, "syntax-error", "the text is not a URScript program", error=True)
declare(_UNKNOWN, "unknown-name", "a variable, function or thread is not defined", error=True)
declare(_OTHER_VERSION, "other-version", "a function is not available in this PolyScope version", error=True)
declare(BROKEN_NODE, "broken-node", "a node of a program tree cannot be translated to a script", error=True)
for _mistake in _MISTAKES.values():
    declare(*_mistake)
declare(STALE, "stale-script", "the script next to a program tree was saved from another state of the program")


def code_of(problem: ScriptError) -> str:
    """The rule of a problem that the compiler or a rule found."""
    if isinstance(problem, ScriptWarning):
        return _MISTAKES[problem.kind][0] if problem.kind in _MISTAKES else problem.kind
    if isinstance(problem, CompileError) and problem.unknown_name:
        return _OTHER_VERSION if _ELSEWHERE in problem.message else _UNKNOWN
    return SYNTAX
