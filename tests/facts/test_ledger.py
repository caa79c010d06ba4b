"""The ledger's form: scopes, errors, typed values, and releases that are not in it."""

import subprocess
import sys

import pytest

from tests.rows import each_row
from urproto import facts
from urproto.facts import Certainty, Personality, Situation, UnknownFactError, find, ledger, parse_scope, release_of
from urproto.facts.tables import TABLES
from urproto.robots import MODELS, load_model
from urproto.versions import PolyscopeVersion

V = PolyscopeVersion.parse


def at(version: str, model: str = "ur5e", personality: Personality = Personality.URSIM) -> Situation:
    return Situation(V(version), model, personality)


@each_row(
    ("scope", "holds", "does_not"),
    [
        ("all", at("3.0", "ur5"), None),
        ("cb3", at("3.15", "ur5"), at("5.0")),
        ("x", at("10.12"), at("5.25")),
        ("e", at("5.25"), at("10.12")),
        ("5.4", at("5.4.2.76197"), at("5.3")),
        ("5.1", at("5.1.1"), at("5.11")),
        ("5.11.9", at("5.11.9.1010452"), at("5.11.11")),
        ("cb3 >=3.3 <3.10", at("3.9.1", "ur5"), at("3.10", "ur5")),
        ("e <=5.0.5", at("5.0.5.30612"), at("5.0.6")),
        ("cb3 >=3.10; e >=5.4", at("5.4"), at("5.3")),
        ("ur10e ursim", at("5.4", "ur10e"), at("5.4", "ur10e", Personality.ARM)),
    ],
)
def test_scopes(scope: str, holds: Situation, does_not: Situation | None) -> None:
    assert parse_scope(scope).covers(holds)
    assert does_not is None or not parse_scope(scope).covers(does_not)


@each_row(
    ("scope", "problem"),
    [("cb4", "'cb4' is neither"), (">=3.3", "needs its line"), ("cb3;", "is empty"), ("e => 5.0", "'=>' is neither")],
)
def test_wrong_scopes(scope: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        parse_scope(scope)


def test_every_row_can_be_read_and_is_documented() -> None:
    for name, rows in ledger().items():
        assert rows[0].doc, f"{name} has no description"
        for fact in rows:
            assert fact.holds.alternatives
            assert fact.source, f"{name}, {fact.scope} has no source"
            assert {alternative.model for alternative in fact.holds.alternatives} <= {"", *MODELS}


def test_no_row_is_hidden_by_an_earlier_one() -> None:
    """Each row decides for some robot."""
    versions = {
        V(text) for text in ("3.0", "3.4", "3.5", "3.12", "5.0", "5.2", "5.6", "5.25", "10.11", "10.12", "10.13")
    }
    versions |= set(facts.known_releases())
    robots = [
        Situation(version, name, personality)
        for version in sorted(versions)
        for name in MODELS
        if load_model(name).series is version.series
        for personality in Personality
    ]
    for name in ledger():
        used = {facts.known(name, robot) for robot in robots}
        assert not [fact for fact in ledger()[name] if fact not in used]


def test_an_unknown_name_suggests_similar_ones() -> None:
    with pytest.raises(UnknownFactError, match="no fact is called 'serial_numbr': did you mean serial_number"):
        find("serial_numbr", at("5.12"))


def test_a_fact_that_is_not_known_for_a_robot_says_for_which_it_is() -> None:
    with pytest.raises(
        UnknownFactError, match=r"message_twelve is not known for ur5 3.2.0 ursim: its rows hold for cb3 >=3.3"
    ):
        find("message_twelve", at("3.2", "ur5"))


def test_values_have_types() -> None:
    start = find("start_q", at("5.24"))
    assert start.six[0] == -1.6007
    with pytest.raises(ValueError, match="could not convert"):
        _ = start.number
    with pytest.raises(ValueError, match="is not a list"):
        _ = find("main_voltage", at("5.24")).numbers
    assert facts.code_of("busy_program") == (271, 1)


def test_a_release_without_a_row_gets_the_build_of_the_nearest_one() -> None:
    unknown, nearest = release_of(V("5.12.3")), release_of(V("5.12.2"))
    assert (unknown.version.build, unknown.date) == (nearest.version.build, nearest.date)
    assert unknown.build.certainty is Certainty.GUESS
    assert unknown.build.source == "that of 5.12.2, the nearest release that is known"
    assert nearest.build.certainty is Certainty.REPORT
    assert all(release_of(V(text)).version.build for text in ("3.3", "3.8", "3.15.9", "5.0", "5.26.1", "10.7", "10.13"))


@each_row(
    ("text", "shown"), [("3.0", "3.0.15547"), ("3.2", "3.2.18654"), ("3.2.20175", "3.2.20175"), ("3.2.1", "3.2.1")]
)
def test_before_3_3_the_third_number_is_the_build(text: str, shown: str) -> None:
    assert str(release_of(V(text)).version) == shown


def test_a_build_that_is_asked_for_is_kept() -> None:
    assert str(release_of(V("5.12.0.7")).version) == "5.12.0.7"


def test_reading_the_tables_is_quick() -> None:
    """Under 5 ms, which every start-up pays; the best of several, because of load."""
    code = (
        "import time, urproto.facts as f\n"
        "took = []\n"
        "for _ in range(10):\n"
        "    f.ledger.cache_clear()\n"
        "    begun = time.process_time()\n"
        "    f.ledger()\n"
        "    took.append(time.process_time() - begun)\n"
        "print(min(took))\n"
    )
    took = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert float(took) < 0.005
    assert len(TABLES) == len({fact.table for rows in ledger().values() for fact in rows})
