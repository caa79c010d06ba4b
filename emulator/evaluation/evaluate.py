"""Distributes the episodes of an evaluation to processes, and decides when there are enough."""

from collections.abc import Callable, Sequence
from contextlib import closing

from emulator.campaign.workers import LocalWorkers, Lost
from emulator.evaluation.episodes import Episode, EvaluationError, Setting, play
from emulator.evaluation.report import Report, decided


def evaluate(
    setting: Setting,
    seeds: Sequence[int],
    processes: int,
    between: tuple[float, float] | None = None,
    on_episode: Callable[[Episode], None] = lambda _: None,
) -> Report:
    """Play an episode for each seed, at most. between: two success rates, between which a sequential test decides;
    then no more are played. on_episode: called with each that is over, in any order. The report does not depend on
    the number of processes. Raises EvaluationError.
    """
    if processes == 1:
        results = {}
        for seed in seeds:
            results[seed] = play(setting, seed)
            on_episode(results[seed])
            if _prefix(seeds, results, between) is not None:
                break
    else:
        results = _distributed(setting, seeds, processes, between, on_episode)
    count = _prefix(seeds, results, between)
    return Report(setting, [results[seed] for seed in seeds[: len(seeds) if count is None else count]], between)


def _distributed(
    setting: Setting,
    seeds: Sequence[int],
    processes: int,
    between: tuple[float, float] | None,
    on_episode: Callable[[Episode], None],
) -> dict[int, Episode]:
    waiting, results = [*seeds], dict[int, Episode]()
    jobs: dict[int, int] = {}
    with closing(LocalWorkers(".", processes)) as workers:
        while waiting or jobs:
            while waiting and workers.room:
                seed = waiting.pop(0)
                jobs[workers.submit(play, setting, seed)] = seed
            for finished in workers.finished(1.0):
                seed = jobs.pop(finished.job)
                if isinstance(finished.value, Lost):
                    raise EvaluationError(f"the process of episode {seed} is gone: {finished.value.why}")
                if isinstance(finished.value, Exception):
                    raise finished.value
                results[seed] = finished.value
                on_episode(finished.value)
            if _prefix(seeds, results, between) is not None:
                break
    return results


def _prefix(seeds: Sequence[int], results: dict[int, Episode], between: tuple[float, float] | None) -> int | None:
    """How many episodes, in the order of the seeds, the sequential test needs; None if there are not enough yet."""
    if between is None:
        return None
    outcomes = []
    for seed in seeds:
        if seed not in results:
            break
        outcomes.append(results[seed].success)
    count, decision = decided(outcomes, *between)
    return None if decision is None else count
