"""What is known about real controllers, as data: values with their scope, their source and how certain they are.

Code that needs such a value asks for it by name, so that a better source is an edit of one row of a table:

    find("serial_number", Situation(version, "ur10")).value
    availability("primary.kinematics").covers(version)
    release_of(PolyscopeVersion.parse("5.11.9")).version

``ur-emulator facts --polyscope 5.11.9`` prints what holds for a version.
"""

from urproto.facts.releases import Release, description, known_releases, release_of
from urproto.facts.scope import Personality, Scope, Situation, parse_scope
from urproto.facts.tables import (
    Certainty,
    Fact,
    UnknownFactError,
    availability,
    code_of,
    facts_for,
    find,
    known,
    ledger,
    rows,
)

__all__ = [
    "Certainty",
    "Fact",
    "Personality",
    "Release",
    "Scope",
    "Situation",
    "UnknownFactError",
    "availability",
    "code_of",
    "description",
    "facts_for",
    "find",
    "known",
    "known_releases",
    "ledger",
    "parse_scope",
    "release_of",
    "rows",
]
