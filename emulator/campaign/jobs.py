"""What carries out jobs for a campaign, and what comes of one: the same for processes and for a cluster."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol


@dataclass(frozen=True)
class Lost:
    """Whoever carried the job out is gone."""

    why: str


@dataclass(frozen=True)
class Finished:
    """A job by its number. value: what the function returned, the exception that it raised, or Lost."""

    job: int
    value: Any


class Workers(Protocol):
    """Where jobs are carried out."""

    @property
    def folder(self) -> str:
        """Where paths of the plan begin there."""
        ...

    @property
    def size(self) -> int:
        """How many jobs are carried out at a time."""
        ...

    @property
    def room(self) -> int:
        """How many more jobs may be submitted now."""
        ...

    def submit(self, function: Callable[..., Any], *arguments: Any) -> int:
        """Let a function of a module be called; the number of this job."""
        ...

    def finished(self, patience_s: float) -> list[Finished]:
        """What came of jobs that are done, waiting for the first of them for a while."""
        ...

    def close(self) -> None:
        """Give up what is not done."""
        ...
