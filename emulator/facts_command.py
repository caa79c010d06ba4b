"""``ur-emulator facts``: what is known about a PolyScope version, what is guessed, and where it comes from."""

import json
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Final

import typer
from rich.table import Table

from urproto import robots
from urproto.commandline import application, completing, console
from urproto.facts import Certainty, Fact, Personality, Situation, description, release_of
from urproto.rtde.fields import INPUT_FIELDS, OUTPUT_FIELDS, Field, available_fields
from urproto.versions import PolyscopeVersion

_USAGE_ERROR: Final = 2
_FIELD_SOURCE: Final = {
    Certainty.DOCUMENT: "RTDE guide, version tables of public clients",
    Certainty.GUESS: "the RTDE guide gives no first version",
}

app = application(completion=False)


@app.command()
def _facts(
    model: Annotated[
        str | None,
        typer.Option(help="Arm model (default: as for ur-emulator).", autocompletion=completing(lambda: robots.MODELS)),
    ] = None,
    polyscope: Annotated[str | None, typer.Option(help="PolyScope version, for example 3.5.3.")] = None,
    personality: Annotated[
        Personality, typer.Option("--as", "--personality", help="Facts about a simulator, or about a real arm.")
    ] = Personality.URSIM,
    guesses: Annotated[bool, typer.Option("--guesses", help="Only what is guessed.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Print what is known and what is guessed about a PolyScope version, with sources."""
    try:
        situation = situation_of(model, polyscope, personality)
    except ValueError as error:
        typer.echo(f"ur-emulator facts: {error}", err=True)
        raise typer.Exit(_USAGE_ERROR) from error
    document = document_of(situation)
    if guesses:
        document["facts"] = [fact for fact in document["facts"] if fact["certainty"] == Certainty.GUESS]
    if as_json:
        typer.echo(json.dumps(document, indent=2, ensure_ascii=False))
    else:
        _show(document)


def situation_of(model: str | None, polyscope: str | None, personality: Personality) -> Situation:
    """The robot of these options. Raises ValueError for an unknown model, and for a version that it never had."""
    arm = robots.load_model((model or robots.default_model(polyscope)).lower())
    version = release_of(robots.choose_version(polyscope, arm)).version
    return Situation(version, arm.name, personality)


def document_of(situation: Situation) -> dict[str, Any]:
    """What ``--json`` prints: the robot, and a list of facts, each with value, unit, certainty and source."""
    facts = [*map(_entry, description(situation)), *_fields(situation.version)]
    return {
        "polyscope": str(situation.version),
        "model": situation.model,
        "personality": situation.personality.value,
        "facts": facts,
    }


def _entry(fact: Fact) -> dict[str, str]:
    return {
        "subject": fact.table,
        "name": fact.name,
        "value": fact.value,
        "unit": fact.unit,
        "certainty": fact.certainty.value,
        "source": fact.source,
        "meaning": fact.doc,
    }


def _fields(version: PolyscopeVersion) -> Iterator[dict[str, str]]:
    """The RTDE variables of a version; the fact is that it has them."""
    for subject, table in (("rtde outputs", OUTPUT_FIELDS), ("rtde inputs", INPUT_FIELDS)):
        yield from (_field(subject, field) for field in available_fields(table, version).values())


def _field(subject: str, field: Field) -> dict[str, str]:
    certainty = Certainty.GUESS if field.version_is_guess else Certainty.DOCUMENT
    return {
        "subject": subject,
        "name": field.name,
        "value": field.type.name,
        "unit": field.unit,
        "certainty": certainty.value,
        "source": _FIELD_SOURCE[certainty],
        "meaning": field.doc,
    }


def _show(document: Mapping[str, Any]) -> None:
    facts = document["facts"]
    guessed = sum(fact["certainty"] == Certainty.GUESS for fact in facts)
    for subject in dict.fromkeys(fact["subject"] for fact in facts):
        table = Table("fact", "value", "certainty", "source", title=subject, title_justify="left")
        for fact in (fact for fact in facts if fact["subject"] == subject):
            value = f"{fact['value']} {fact['unit']}".rstrip()
            table.add_row(fact["name"], value, fact["certainty"], fact["source"])
        console().print(table)
    robot = f"{document['model']}, PolyScope {document['polyscope']}, {document['personality']}"
    console().print(f"{robot}: {len(facts)} facts, {guessed} of them guessed.")
