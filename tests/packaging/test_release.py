"""Release notes of a version, and versions that the release workflow refuses."""

import runpy
from pathlib import Path

import pytest

from tests.rows import each_row

RELEASE = runpy.run_path(str(Path(__file__).resolve().parents[2] / ".github" / "release.py"))
notes, NotReadyError = RELEASE["notes"], RELEASE["NotReadyError"]
CHANGELOG = """# Changelog

## [Unreleased]

## [1.2.0] - 2027-01-01

### Added

- a thing

## [1.1.0] - 2026-12-01

- older
"""


def test_release_notes_are_the_section_of_the_version() -> None:
    assert notes("v1.2.0", "1.2.0", CHANGELOG) == "### Added\n\n- a thing\n"


@each_row(
    ("tag", "version", "problem"),
    [
        ("v1.3.0", "1.2.0", "the tag is v1.3.0 and pyproject.toml says 1.2.0"),
        ("1.2.0", "1.2.0", "the tag is 1.2.0"),
        ("v1.3.0", "1.3.0", "no section [1.3.0]"),
        ("vUnreleased", "Unreleased", "is empty"),
    ],
)
def test_unready_releases_are_refused(tag: str, version: str, problem: str) -> None:
    with pytest.raises(NotReadyError, match=problem.replace("[", r"\[")):
        notes(tag, version, CHANGELOG)
