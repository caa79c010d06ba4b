"""The rules by their codes: 0xx errors, 1xx calls that fail, 2xx names, 3xx what a program does over time.

A rule with a function of its own is declared where that function stands; the others are what the compiler finds.
"""

from collections.abc import Callable, Iterable
from typing import Final, NamedTuple, TypeAlias

from urscript.check.subject import Subject
from urscript.syntax import Node

Find: TypeAlias = Callable[[Subject], Iterable[tuple[Node, str]]]
"""Finds the places where a rule is violated, each with a message."""


class Rule(NamedTuple):
    """A rule. error: a program that violates it does not start."""

    code: str
    name: str
    summary: str
    error: bool
    find: Find | None


RULES: Final[dict[str, Rule]] = {}


def declare(code: str, name: str, summary: str, *, error: bool = False, find: Find | None = None) -> None:
    """Add a rule to the registry."""
    assert code not in RULES
    RULES[code] = Rule(code, name, summary, error, find)


def rule(code: str, name: str) -> Callable[[Find], Find]:
    """Declare the decorated function as a rule; its docstring is the summary."""

    def add(find: Find) -> Find:
        declare(code, name, " ".join((find.__doc__ or "").split()), find=find)
        return find

    return add
