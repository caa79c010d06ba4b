"""Distributes the runs of a campaign until each has a result: no run is lost, and none counts twice.

Runs are distributed in portions of some seconds, so that the cost of distribution does not matter; towards the end
they are smaller, so that no core waits for another. A portion that is lost is tried again run by run. A run that is
lost each time has that as its result.
"""

from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final

from emulator.campaign.journal import Journal
from emulator.campaign.minimise import kind_of
from emulator.campaign.plan import Plan, Run
from emulator.campaign.work import Result, Status, carry_out, simplify
from emulator.campaign.workers import Lost, Workers

_PORTION_S: Final = 2.0  # of work; distributing one takes milliseconds
_LARGEST: Final = 500  # runs in a portion, which are repeated when a process dies
_TRIES: Final = 3  # attempts at a run whose process dies (guess)
_PATIENCE_S: Final = 0.5  # interval between reports of progress

OnResults = Callable[[list[Result]], None]


@dataclass
class Conductor:
    """Executes the runs of a plan that have no result yet.

    on_results: called with new results, or none, for progress.
    """

    plan: Plan
    workers: Workers
    journal: Journal
    version: str
    on_results: OnResults
    _pending: dict[int, tuple[int, ...]] = field(default_factory=dict)  # runs of each job
    _again: deque[tuple[int, ...]] = field(default_factory=deque)
    _losses: Counter[int] = field(default_factory=Counter)
    _run_s: float = 0.0  # mean duration of runs so far, with more weight on later ones

    def run(self) -> None:
        """Work until every run has a result. Raises ConfigError if the workers cannot execute runs at all."""
        missing = self.journal.missing
        while True:
            self._hand_out(missing)
            if not self._pending:
                return
            for finished in self.workers.finished(_PATIENCE_S):
                self._take(self._pending.pop(finished.job), finished.value)
            self.on_results([])

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
        self.on_results(self.journal.add(value))

    def _lost(self, runs: tuple[int, ...], why: str) -> None:
        if len(runs) > 1:
            self._again.extend((run,) for run in runs)
            return
        (run,) = runs
        self._losses[run] += 1
        if self._losses[run] < _TRIES:
            self._again.append(runs)
        else:
            self.on_results(self.journal.add([Result(run, Status.LOST, why)]))


def first_failures(journal: Journal, most: int) -> list[Result]:
    """The first failed run of each kind of failure, for at most this many kinds."""
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
    """Simpler runs that fail in the same way as these, by the number of the original run, if there are any."""
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
