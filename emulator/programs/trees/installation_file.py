"""What a program takes from the installation file."""

from dataclasses import dataclass

__all__ = ["InstallationFile"]


@dataclass(frozen=True, slots=True)
class InstallationFile:
    """An installation as the preamble of its programs needs it."""

    name: str = "default"
