"""The ledger against tests/golden/facts.tsv: what ports send, held against public material.

A wrong row of the ledger fails here, because its golden row states independently what a client saw; and each row that
is not a guess must have one.
"""

from collections.abc import Iterator
from pathlib import Path
from types import MappingProxyType

import pytest
from observe import observe

from tests.rows import each_row
from urproto.facts import Fact, Personality, Situation, known, ledger, releases, tables
from urproto.versions import PolyscopeVersion

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "facts.tsv"
ROWS = [line.split("\t") for line in GOLDEN.read_text().splitlines() if not line.startswith("#")]
# facts that an emulator does not show, or shows in tests elsewhere
NOT_OBSERVED = {
    "primary.singularity": "no capture contains the sub-package, so it is not sent",
}


def situation_of(row: list[str]) -> Situation:
    _, model, version, personality, *_ = row
    return Situation(PolyscopeVersion.parse(version), model, Personality(personality))


@each_row("row", ROWS, ids=lambda row: " ".join(row[:5]))
def test_clients_see_what_they_saw(row: list[str]) -> None:
    *_, name, value, _ = row
    assert observe(name, situation_of(row)) == value


def certain() -> Iterator[Fact]:
    for name, rows in ledger().items():
        if name not in NOT_OBSERVED:
            yield from (fact for fact in rows if not fact.is_guess)


def test_every_certain_fact_has_a_golden_row() -> None:
    golden = {known(row[0], situation_of(row)) for row in ROWS}
    golden |= {row[0] for row in ROWS if row[0].startswith("primary.")}  # a state without it counts as well
    missing = [fact for fact in certain() if fact not in golden and fact.name not in golden]
    assert missing == []
    assert set(NOT_OBSERVED) <= set(ledger())


def test_every_golden_row_is_of_a_fact_and_has_an_origin() -> None:
    for fact, *_, origin in ROWS:
        assert fact in ledger()
        assert origin


PLANTED = {
    "release.build": ("5.11.9", "1010453"),
    "release.date": ("3.15.8", "2022-06-21"),
    "release.compiled": ("3.3.1", "2016-07-08 16:07:21"),
    "serial_number": ("cb3 ur10 ursim", "2018359999"),
    "start_q": ("ur10e ursim", "[0, -1.5, 0, -1.5, 0, 0]"),
    "robot_current": ("ursim", "measured"),
    "message_twelve": ("cb3 >=3.3; e >=5.0", "[0, 0, 2]"),
}  # a scope of the fact, and a value that nobody has seen


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_wrong_row_is_found(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scope, wrong = PLANTED[name]
    rows = tuple(row._replace(value=wrong) if row.scope == scope else row for row in ledger()[name])
    assert rows != ledger()[name]
    planted = MappingProxyType({**ledger(), name: rows})
    monkeypatch.setattr(tables, "ledger", lambda: planted)
    releases._release.cache_clear()
    try:
        assert [row for row in ROWS if row[0] == name and observe(row[4], situation_of(row)) != row[5]]
    finally:
        releases._release.cache_clear()
