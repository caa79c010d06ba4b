"""What a release says of itself: ``python .github/release.py v1.2.3`` prints the section of CHANGELOG.md.

It ends with status 1, and a line that says why, unless the tag is the version of pyproject.toml and CHANGELOG.md has a
section of that version with something in it.
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


class NotReadyError(Exception):
    """This commit cannot be released under that tag."""


def notes(tag: str, version: str, changelog: str) -> str:
    """The section of a version.

    Args:
        tag: such as v1.2.3.
        version: of pyproject.toml, such as 1.2.3.
        changelog: text of CHANGELOG.md.

    Raises:
        NotReadyError: the tag is of another version, or there is no such section, or it is empty.
    """
    if tag != f"v{version}":
        raise NotReadyError(f"the tag is {tag} and pyproject.toml says {version}: one of them has to change")
    sections = re.split(r"^## ", changelog, flags=re.MULTILINE)[1:]
    for section in sections:
        title, _, text = section.partition("\n")
        if title.startswith(f"[{version}]"):
            if not text.strip():
                raise NotReadyError(f"CHANGELOG.md: the section of {version} is empty")
            return text.strip() + "\n"
    raise NotReadyError(f"CHANGELOG.md has no section [{version}]: move what is under [Unreleased] there, dated")


def main() -> int:
    """Print the notes for the tag that the command line names; the exit status."""
    if len(sys.argv) != 2:
        sys.stderr.write("usage: release.py vX.Y.Z\n")
        return 2
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    version = re.search(r'^version = "(.+)"$', project, re.MULTILINE)
    assert version is not None, "pyproject.toml names a version"
    try:
        sys.stdout.write(notes(sys.argv[1], version[1], (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")))
    except NotReadyError as problem:
        sys.stderr.write(f"{problem}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
