"""What a check found, and what mends it."""

from dataclasses import dataclass
from enum import StrEnum

__all__ = ["Finding", "Grade", "exit_status"]


class Grade(StrEnum):
    """How bad it is."""

    GOOD = "good"
    UNKNOWN = "cannot be seen"
    WEAK = "weak"  # works, but less well than it could
    BROKEN = "broken"  # something will not work


@dataclass(frozen=True, slots=True)
class Finding:
    """``mend``: the command, or what to do, where it is not good."""

    grade: Grade
    subject: str
    text: str
    mend: str = ""


def exit_status(findings: list[Finding]) -> int:
    """1 when something will not work, else 0."""
    return int(any(finding.grade is Grade.BROKEN for finding in findings))
