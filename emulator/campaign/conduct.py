"""Handing out the runs of a campaign until each has a result: nothing is lost, and nothing counts twice.

Runs are handed out in portions of some seconds, so that what handing out costs does not matter, and smaller ones in
the end, so that no core waits for another. A portion that is lost is tried again run by run; a run that is lost each
time has that as its result.
"""

from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final

from emulator.campaign.jobs import Lost, Workers
from emulator.campaign.journal import Journal
from emulator.campaign.minimise import kind_of
from emulator.campaign.plan import Plan, Run
from emulator.campaign.work import Result, Status, carry_out, simplify

_PORTION_S: Final = 2.0  # of work; handing one out takes milliseconds
_LARGEST: Final = 500  # runs of a portion: what is done again when a process dies
_TRIES: Final = 3  # of a run whose process died (guess)
_PATIENCE_S: Final = 0.5  # between two looks at the progress

Tell = Callable[[list[Result]], None]


@dataclass
class Conductor:
    """Carries out a plan's runs that have no result yet. tell: called with what is new, or with nothing meanwhile."""

    plan: Plan
    workers: Workers
    journal: Journal
    version: str
    tell: Tell
    _pending: dict[int, tuple[int, ...]] = field(default_factory=dict)  # runs of each job
    _again: deque[tuple[int, ...]] = field(default_factory=deque)
    _losses: Counter[int] = field(default_factory=Counter)
    _run_s: float = 0.0  # mean of the runs so far, the later ones counting more

    def run(self) -> None:
        """Until every run has a result. Raises ConfigError when the workers cannot do it at all."""
        missing = self.journal.missing
        while True:
            self._hand_out(missing)
            if not self._pending:
                return
            for finished in self.workers.finished(_PATIENCE_S):
                self._take(self._pending.pop(finished.job), finished.value)
            self.tell([])

    def _hand_out(self, missing: Iterator[int]) -> None:
        while self.workers.room > 0:
            portion = self._again.popleft() if self._again else self._next(missing)
            if not portion:
                return
            job = self.workers.submit(carry_out, self.plan, portion, self.version, self.workers.folder)
            self._pending[job] = portion

    def _next(self, missing: Iterator[int]) -> tuple[int, ...]:
        handed_out = sum(len(runs) for runs in self._pending.values())
        fair = (self.journal.left - handed_out) // (2 * self.workers.size)
        size = int(_PORTION_S / self._run_s) if self._run_s else 1
        wanted = max(1, min(size, fair, _LARGEST))
        return tuple(number for _, number in zip(range(wanted), missing, strict=False))

    def _take(self, runs: tuple[int, ...], value: Any) -> None:
        if isinstance(value, Exception):
            raise value
        if isinstance(value, Lost):
            self._lost(runs, value.why)
            return
        mean_s = sum(result.wall_s for result in value) / len(value)
        self._run_s = mean_s if not self._run_s else 0.8 * self._run_s + 0.2 * mean_s
        self.tell(self.journal.add(value))

    def _lost(self, runs: tuple[int, ...], why: str) -> None:
        if len(runs) > 1:
            self._again.extend((run,) for run in runs)
            return
        (run,) = runs
        self._losses[run] += 1
        if self._losses[run] < _TRIES:
            self._again.append(runs)
        else:
            self.tell(self.journal.add([Result(run, Status.LOST, why)]))


def failing_ones(journal: Journal, most: int) -> list[Result]:
    """The first failed run of each kind of failure, of at most so many kinds."""
    first: dict[str, Result] = {}
    for result in journal.results():
        if result.status is Status.FAILED:
            kind = kind_of(result.failure)
            if kind in first:
                if result.run < first[kind].run:
                    first[kind] = result
            elif len(first) < most:
                first[kind] = result
    return sorted(first.values(), key=lambda result: result.run)


def simplest(plan: Plan, workers: Workers, version: str, failed: list[Result]) -> dict[int, Run]:
    """Of each of these failed runs a simpler one that fails alike, if there is; by the number of the run."""
    jobs: dict[int, int] = {}
    found: dict[int, Run] = {}
    waiting = deque(failed)
    while waiting or jobs:
        while waiting and workers.room > 0:
            result = waiting.popleft()
            job = workers.submit(simplify, plan, result.run, result.failure, version, workers.folder)
            jobs[job] = result.run
        for finished in workers.finished(_PATIENCE_S):
            run = jobs.pop(finished.job)
            if isinstance(finished.value, Run) and finished.value.options != plan.run(run).options:
                found[run] = finished.value
    return found
