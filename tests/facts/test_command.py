"""``ur-emulator facts``."""

import json
from typing import Any

import pytest
from typer.testing import CliRunner

from emulator.facts_command import app
from urproto.facts import ledger
from urproto.rtde.fields import OUTPUT_FIELDS, available_fields
from urproto.versions import PolyscopeVersion


def run(*arguments: str, status: int = 0) -> str:
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == status
    return done.output


def facts(*arguments: str) -> dict[str, dict[str, Any]]:
    return {fact["name"]: fact for fact in json.loads(run("--json", *arguments))["facts"]}


def test_json_has_every_fact_with_source_and_certainty() -> None:
    found = facts("--polyscope", "3.5.3", "--model", "ur10")
    assert {name for name, rows in ledger().items() if rows[0].value == "yes"} <= set(found)
    assert all(fact["source"] and fact["certainty"] and fact["meaning"] for fact in found.values())
    assert found["release.build"]["value"] == "10825"
    assert found["release.date"]["certainty"] == "guess"
    assert found["serial_number"]["value"] == "2018309999"
    assert (found["primary.safety"]["value"], found["primary.tool_mode"]["value"]) == ("yes", "no")
    assert ("timestamp" in found, "ft_raw_wrench" in found) == (True, False)


def test_a_version_has_the_variables_that_its_rtde_offers() -> None:
    offered = available_fields(OUTPUT_FIELDS, PolyscopeVersion(5, 26))
    assert set(offered) == set(facts("--polyscope", "5.26", "--model", "ur5e")) & set(OUTPUT_FIELDS)


def test_an_arm_differs_from_the_simulator() -> None:
    assert facts("--model", "ur5e", "--as", "arm")["serial_number"] != facts("--model", "ur5e")["serial_number"]


def test_only_guesses() -> None:
    guesses = facts("--polyscope", "5.12", "--guesses")
    assert {fact["certainty"] for fact in guesses.values()} == {"guess"}


def test_the_text_counts_what_is_guessed() -> None:
    assert "ur3, PolyScope 3.15.8.106339, ursim: " in run()


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [(("--polyscope", "x"), "is not a PolyScope version"), (("--model", "ur1"), "unknown robot model")],
)
def test_mistakes_are_one_line(arguments: tuple[str, ...], problem: str) -> None:
    output = run(*arguments, status=2)
    assert problem in output
    assert output.count("\n") == 1
