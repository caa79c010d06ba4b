"""The interface to workers that execute jobs for a campaign: processes or a cluster."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol


@dataclass(frozen=True)
class Lost:
    """The process or node that executed the job has died."""

    why: str


@dataclass(frozen=True)
class Finished:
    """A completed job, by its number. value: the function's return value, the exception that it raised, or Lost."""

    job: int
    value: Any


class Workers(Protocol):
    """Executes jobs."""

    @property
    def folder(self) -> str:
        """The folder there to which paths of the plan are relative."""
        ...

    @property
    def size(self) -> int:
        """Number of jobs that are executed at the same time."""
        ...

    @property
    def room(self) -> int:
        """Number of further jobs that may be submitted now."""
        ...

    def submit(self, function: Callable[..., Any], *arguments: Any) -> int:
        """Have a function of a module called; return the number of this job."""
        ...

    def finished(self, patience_s: float) -> list[Finished]:
        """The results of completed jobs; waits up to ``patience_s`` for the first one."""
        ...

    def close(self) -> None:
        """Cancel jobs that are not completed."""
        ...
