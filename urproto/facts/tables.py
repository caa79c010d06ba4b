"""The tables of facts, and how they are read.

Every table has the same columns:

    name       what the fact is about; several rows may have one name, and the first one whose scope holds is used
    value      a number, a list of numbers in brackets, or text
    unit       of the value; empty for a text or a plain number
    holds      the scope (``urproto.facts.scope``)
    certainty  document, recording, report or guess
    source     where the value comes from; for a guess, why it was chosen
    doc        one line about the fact; the first row of a name has it

A fact becomes certain by an edit of its row, and nowhere else.
"""

import csv
import json
import re
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

from urproto.compat import StrEnum
from urproto.facts.scope import Scope, Situation, parse_scope
from urproto.vectors import Vector6, as_six
from urproto.versions import Availability

TABLES: Final = ("releases", "primary", "identity", "codes", "latencies", "language")
COLUMNS: Final = ("name", "value", "unit", "holds", "certainty", "source", "doc")


class Certainty(StrEnum):
    """How well a fact is known: by a document, a recording of a controller, somebody's report, or not at all."""

    DOCUMENT = "document"
    RECORDING = "recording"
    REPORT = "report"
    GUESS = "guess"


class UnknownFactError(LookupError):
    """No row has this name, or none of its rows holds for this robot."""


class Fact(NamedTuple):
    """A row of a table. ``table``: the table's name."""

    name: str
    value: str
    unit: str
    scope: str
    certainty: Certainty
    source: str
    doc: str
    table: str

    @property
    def holds(self) -> Scope:
        """What the fact holds for. Raises ValueError for a scope that cannot be read, with the fact's name."""
        try:
            return parse_scope(self.scope)
        except ValueError as error:
            raise ValueError(f"{self.table}.csv, {self.name}: {error}") from error

    @property
    def is_guess(self) -> bool:
        """Whether no source is known."""
        return self.certainty is Certainty.GUESS

    @property
    def number(self) -> float:
        """The value as a number. Raises ValueError for another value."""
        return float(self.value)

    @property
    def integer(self) -> int:
        """The value as a whole number. Raises ValueError for another value."""
        return int(self.value)

    @property
    def numbers(self) -> tuple[float, ...]:
        """The value as a list of numbers. Raises ValueError for another value."""
        values = json.loads(self.value)
        if not isinstance(values, list):
            raise ValueError(f"{self.name} is not a list: {self.value}")
        return tuple(map(float, values))

    @property
    def six(self) -> Vector6:
        """The value as one number for each joint. Raises ValueError for another value."""
        return as_six(self.numbers)


@cache
def ledger() -> Mapping[str, tuple[Fact, ...]]:
    """All facts, by name, in the order of their rows. Raises ValueError for a wrong row, with table and line.

    Scopes are parsed when they are used.
    """
    found = dict[str, list[Fact]]()
    for table in TABLES:
        for fact in _read(table):
            found.setdefault(fact.name, []).append(fact)
    return MappingProxyType({name: tuple(facts) for name, facts in found.items()})


def _read(table: str) -> Iterator[Fact]:
    lines = csv.reader(Path(__file__).with_name(f"{table}.csv").read_text("utf-8").splitlines())
    if (head := tuple(next(lines))) != COLUMNS:
        raise ValueError(f"{table}.csv: its columns are {', '.join(head)}, not {', '.join(COLUMNS)}")
    for number, row in enumerate(lines, start=2):
        try:
            name, value, unit, scope, certainty, source, doc = row
            yield Fact(name, value, unit, scope, Certainty(certainty), source, doc, table)
        except ValueError as error:
            raise ValueError(f"{table}.csv, line {number}: {error}") from error


def rows(name: str) -> tuple[Fact, ...]:
    """All rows of a name. Raises UnknownFactError."""
    facts = ledger()
    if name not in facts:
        from difflib import get_close_matches  # only a mistake needs it

        close = " or ".join(get_close_matches(name, facts, 3, 0.6))
        raise UnknownFactError(f"no fact is called {name!r}" + (f": did you mean {close}?" if close else ""))
    return facts[name]


def known(name: str, situation: Situation) -> Fact | None:
    """The fact that holds for a robot, or None. Raises UnknownFactError if there is no such name."""
    return next((fact for fact in rows(name) if fact.holds.covers(situation)), None)


def find(name: str, situation: Situation) -> Fact:
    """The fact that holds for a robot. Raises UnknownFactError."""
    if (fact := known(name, situation)) is not None:
        return fact
    robot = " ".join(filter(None, (situation.model, situation.version.short, situation.personality)))
    scopes = ", ".join(fact.scope for fact in rows(name))
    raise UnknownFactError(f"{name} is not known for {robot}: its rows hold for {scopes}")


def availability(name: str) -> Availability:
    """The first versions with something, whose existence is the fact. Raises UnknownFactError."""
    return rows(name)[0].holds.availability


def code_of(situation: str) -> tuple[int, int]:
    """Code and argument of a row such as ``code.busy_program``.

    Raises UnknownFactError, and ValueError for a value of another form.
    """
    fact = rows(f"code.{situation}")[0]
    match = re.fullmatch(r"C(\d+)A(\d+)", fact.value)
    if match is None:
        raise ValueError(f"{fact.table}.csv: {fact.name} is {fact.value!r}: a code has the form C209A0")
    return int(match[1]), int(match[2])


def facts_for(situation: Situation) -> Iterator[Fact]:
    """For each name the fact that holds for a robot; names without one are left out."""
    for name in ledger():
        if (fact := known(name, situation)) is not None:
            yield fact
