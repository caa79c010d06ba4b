"""The rules by their codes: 0xx errors, 1xx calls that fail, 2xx names, 3xx what a program does over time.

A rule with a function of its own is declared where that function stands; the others are what the compiler finds.
"""

from collections.abc import Callable, Iterable
from typing import Final, NamedTuple, TypeAlias

from urscript.check.subject import Body, Subject
from urscript.syntax import Node

Find: TypeAlias = Callable[[Subject], Iterable[tuple[Body, Node, str]]]
"""Finds the places where a rule is violated, each with a message and the body it is in."""

FindInBody: TypeAlias = Callable[[Subject, Body], Iterable[tuple[Node, str]]]
"""Finds the places in one body. It depends on the body, on the facts of `urscript.dependencies` about the names in it,
and on which functions take time."""


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
