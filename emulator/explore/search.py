"""Decides which schedule to try next, and carries runs out in parallel, each from the nearest moment that is kept.

A schedule that has shown something new (lines and branches of the program, modes, codes, a smaller margin) is kept, and
others are made from it: with one more decision, or one that is moved in time or has another value. Decisions are placed
near moments at which something happened, since races are there. The next schedules are made from results in a fixed
order, whatever the number of processes: the same seed finds the same.
"""

from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from multiprocessing.connection import wait
from random import Random
from typing import Final

from emulator.branches import Copied, can_branch
from emulator.explore.choices import Decision, Schedule
from emulator.explore.plan import Plan
from emulator.explore.run import Feature, Run, Trail

_FEW: Final = 4  # simplifications that are tried at a time
_BATCH: Final = 8  # schedules made at a time: independent of the number of processes
_MOMENTS: Final = 9  # of a run, about, that are kept
_APART: Final = 500  # control periods, which take as long as the copy of a process
_KEPT_RUNS: Final = 10  # whose moments are kept; each is a process, which shares its memory with the others
_NEAR_NEW, _NEAR_EFFECT, _NEAR_DECISION, _NEAR_EVENT = 0.2, 0.2, 0.3, 0.1  # of decisions; others are at any time
_CLOSE: Final = 0.2  # of the new schedules are made from a run that has nearly broken a property
_RICH: Final = 0.5  # of the others are made from the richest run that shows something, by chance
_DELAYED: Final = 0.3  # of those to which a decision is added
_UNSEEN: Final = 0.5  # weight of a choice without effects; one that always has some has 1 more
_DRAWN: Final = 3  # moments, of which the one that is tried least is taken
_PARTS: Final = 20  # of a run, in which other moments are counted
_SEVERAL: Final = 0.6  # of those to which decisions are added may get more than one at a time
_AGAIN: Final = 0.7  # weight of a choice that is made already, next to others
_ADDED, _MOVED = 0.7, 0.2  # of the new schedules; in the others, a decision has other values, or is left out
_BEFORE: Final = 0.5  # of those near a moment are before it
_FARTHEST: Final = 5  # powers of two of control periods from a moment; near ones are as frequent as far ones


@dataclass
class Entry:
    """A run. new: features that it was first to show. moments: copies of it by period, from which runs can go on."""

    trail: Trail
    new: list[Feature] = field(default_factory=list)
    moments: dict[int, Copied] = field(default_factory=dict)
    children: int = 0

    def close(self) -> None:
        for copy in self.moments.values():
            copy.close()
        self.moments.clear()


@dataclass
class _Job:
    """A run that is being carried out. made: decisions that it has made. stops: periods at which it is copied."""

    number: int
    schedule: Schedule
    copy: Copied
    made: int
    stops: list[int]
    moments: dict[int, Copied] = field(default_factory=dict)

    def start(self) -> None:
        """Let it go on to the next stop, or to its end."""
        if not self.stops:
            self.copy.start("finish", self.schedule, self.made)
            return
        due = tuple(one for one in self.schedule[self.made :] if one.period < self.stops[0])
        self.made += len(due)
        self.copy.start("advance", due, self.stops[0])

    def take(self) -> Trail | None:
        """It has come to a stop, or to its end: then, what the run was like."""
        result = self.copy.result()
        if isinstance(result, Trail):
            return result
        self.moments[self.stops.pop(0)] = self.copy.copy()
        return None


class Runner:
    """Carries out schedules of a plan, in several processes. Use it with ``with``. runs: their number so far."""

    def __init__(self, plan: Plan, workers: int) -> None:
        self._plan = plan
        self._workers = workers
        self._kept: list[Entry] = []
        self._first: Copied | None = None
        self._periods = 0  # of a run
        self.runs = 0

    def __enter__(self) -> "Runner":
        if can_branch():
            run = Run(self._plan)
            self._first, self._periods = Copied.of(run), run.last
        return self

    def __exit__(self, *_: object) -> None:
        for entry in self._kept:
            entry.close()
        if self._first is not None:
            self._first.close()

    def keep(self, entry: Entry) -> None:
        """Keep the moments of a run, from which others go on; the run with the fewest gives way to it."""
        if not entry.moments:
            return
        self._kept.append(entry)
        if len(self._kept) > _KEPT_RUNS:
            oldest = min(self._kept[1:], key=lambda one: one.children)
            self._kept.remove(oldest)
            oldest.close()

    def carry_out(self, schedules: Sequence[Schedule], *, keeping: bool = True) -> list[Entry]:
        """Run some schedules; the results are in their order. keeping: whether moments may be kept.

        Raises what a run raises.
        """
        self.runs += len(schedules)
        if self._first is None:
            return [Entry(Run(self._plan).finish(schedule)) for schedule in schedules]
        results: dict[int, Entry] = {}
        waiting = list(enumerate(schedules))
        running: list[_Job] = []
        with ExitStack() as ending:
            while waiting or running:
                while waiting and len(running) < self._workers:
                    job = self._job(*waiting.pop(0), keeping)
                    ending.callback(job.copy.close)
                    job.start()
                    running.append(job)
                ready = wait([job.copy.connection for job in running])
                for job in [job for job in running if job.copy.connection in ready]:
                    if (trail := job.take()) is None:
                        job.start()
                        continue
                    running.remove(job)
                    job.copy.close()
                    results[job.number] = Entry(trail, moments=job.moments)
        return [results[number] for number in range(len(schedules))]

    def _job(self, number: int, schedule: Schedule, keeping: bool) -> _Job:
        """A run of the schedule, from the latest kept moment of a run with the same decisions before it."""
        assert self._first is not None
        best, made, since = self._first, 0, 0
        for entry in self._kept:
            for period, copy in entry.moments.items():
                before = tuple(one for one in entry.trail.schedule if one.period < period)
                own = tuple(one for one in schedule if one.period < period)
                if before == own and period > since:
                    best, made, since = copy, len(own), period
        last = self._periods
        apart = max(last // _MOMENTS, _APART)
        stops = [stop for stop in range(apart, last, apart) if stop > since and keeping]
        return _Job(number, schedule, best.copy(), made, stops)


class Search:
    """A search with one seed. features: all that has been seen. broken: by property, the first run that broke it."""

    def __init__(self, plan: Plan, runner: Runner, seed: int = 0) -> None:
        self._plan = plan
        self._runner = runner
        self._chance = Random(f"explore {seed}")
        self._corpus: list[Entry] = []
        self._richest: dict[Feature, Entry] = {}  # the run with most features that has this one
        self._tried: set[Schedule] = set()
        self._closest: dict[str, Entry] = {}  # the run with the least margin of each property
        self._base: dict[Feature, int] = {}  # of the run without any decision
        self._related: Counter[Hashable] = Counter()  # how often a choice was tried so near to something
        self._added: Counter[str] = Counter()  # how often a choice was added to a run
        self._effective: Counter[str] = Counter()  # and how often that run then did something else
        self.features: set[Feature] = set()
        self.broken: dict[str, Trail] = {}
        self.refused: Counter[str] = Counter()
        self.exhausted = False  # whether there is no schedule left that was not tried

    def begin(self) -> Trail:
        """The run without any decision."""
        (base,) = self._runner.carry_out([()])
        self._tried.add(())
        self._base = base.trail.features
        self._learn(base)
        return base.trail

    def go_on(self) -> None:
        made = list(self._schedules(_BATCH))
        self.exhausted = not made
        entries = self._runner.carry_out([schedule for schedule, _, _ in made])
        for entry, (_, parent, added) in zip(entries, made, strict=True):
            self._added[added] += 1
            self._effective[added] += entry.trail.features.keys() != parent.trail.features.keys()
            self._learn(entry)

    def _learn(self, entry: Entry) -> None:
        trail = entry.trail
        self.refused.update(text.partition(":")[0] for text in trail.refused)
        new = trail.features.keys() - self.features
        self.features |= new
        entry.new = [feature for feature in trail.features if feature in new]
        for name, margin in trail.margins.items():
            if name not in self._closest or (margin < self._closest[name].trail.margins[name] and not trail.broken):
                self._closest[name] = entry
        for name in trail.broken:
            self.broken.setdefault(name, trail)
        if (new and not trail.broken) or not self._corpus:
            self._corpus.append(entry)
            for feature in trail.features:
                richest = self._richest.setdefault(feature, entry)
                if len(trail.features) > len(richest.trail.features):
                    self._richest[feature] = entry
            self._runner.keep(entry)
        else:
            entry.close()

    def _schedules(self, number: int) -> Iterator[tuple[Schedule, Entry, str]]:
        """New schedules, each with the run it is made from and the choice that is added to it, "" for none.

        Fewer if nothing new is found in many attempts.
        """
        left = number
        for _ in range(50 * number):
            parent = self._parent()
            schedule, added = self._changed(parent)
            if schedule in self._tried:
                continue
            parent.children += 1
            self._tried.add(schedule)
            yield schedule, parent, added
            left -= 1
            if not left:
                return

    def _parent(self) -> Entry:
        close = [entry for entry in self._closest.values() if entry.trail.schedule]
        if close and self._chance.random() < _CLOSE:
            return self._chance.choice(close)
        entries = list(self._richest.values()) if self._chance.random() < _RICH else self._corpus
        return min(self._chance.sample(entries, min(3, len(entries))), key=lambda one: one.children)

    def _changed(self, entry: Entry) -> tuple[Schedule, str]:
        schedule, added = list(entry.trail.schedule), ""
        what = self._chance.random()
        if not schedule or what < _ADDED:
            full = len(schedule) >= self._plan.at_most
            if full:
                weights = [1.0 / self._weight(one.choice) for one in schedule]
                schedule.remove(self._chance.choices(schedule, weights)[0])
            by, room = self._delay(schedule), self._plan.at_most - len(schedule)
            number = self._chance.randint(1, room) if self._chance.random() < _SEVERAL else 1
            schedule = [replace(one, period=one.period + by) for one in schedule]
            for _ in range(number):
                name = self._name(schedule)
                values = self._plan.choices[name].draw(self._chance)
                schedule.append(Decision(self._moment(entry, name, schedule, by), name, tuple(values.items())))
            added = schedule[-1].choice if number == 1 and not full else ""
        else:
            place = self._chance.randrange(len(schedule))
            old = schedule.pop(place)
            if what < _ADDED + _MOVED:
                schedule.append(replace(old, period=self._moment(entry, old.choice, schedule)))
            elif not schedule or self._chance.random() < 0.5:
                values = self._plan.choices[old.choice].draw(self._chance)
                schedule.append(replace(old, values=tuple(values.items())))
        settled = (replace(one, period=self._plan.choices[one.choice].kind.settled(one.period)) for one in schedule)
        return tuple(sorted(settled, key=lambda one: (one.period, one.choice))), added

    def _delay(self, schedule: Sequence[Decision]) -> int:
        """By how many periods all decisions happen later, so that there is a time for others before and after them."""
        if not schedule or self._chance.random() >= _DELAYED:
            return 0
        bounds = [(one.period, *self._bounds(one.choice)) for one in schedule]
        return self._chance.randint(max(low - at for at, low, _ in bounds), min(high - at for at, _, high in bounds))

    def _bounds(self, name: str) -> tuple[int, int]:
        """The first and last control period for a choice."""
        span, period_s = self._plan.choices[name].at, self._plan.period_s
        last = min(round(span.high / period_s), round(self._plan.lasts_s / period_s) - 1)
        return min(round(span.low / period_s), last), last

    def _name(self, others: Sequence[Decision]) -> str:
        """The choice to add: rather one that has had effects, and one that is not among the others."""
        names = list(self._plan.choices)
        present = {one.choice for one in others}
        weights = [self._weight(name) * (_AGAIN if name in present else 1.0) for name in names]
        return self._chance.choices(names, weights)[0]

    def _weight(self, name: str) -> float:
        return _UNSEEN + (1 + self._effective[name]) / (2 + self._added[name])

    def _moment(self, entry: Entry, name: str, others: Sequence[Decision], by: int = 0) -> int:
        """A control period for a choice: near one in which something happened or another decision acts, or any.

        Of a few that are drawn, it is the one that has been tried least in relation to what it is near.
        by: how many periods later than in the entry the others are.
        """
        first, last = self._bounds(name)
        features, base = entry.trail.features, self._base
        anchors: list[tuple[float, dict[int, Hashable]]] = [
            (_NEAR_NEW, {features[feature] + by: feature for feature in entry.new}),
            (_NEAR_EFFECT, {at + by: feature for feature, at in features.items() if base.get(feature) != at}),
            (
                _NEAR_DECISION,
                {
                    one.period + round(delay_s / self._plan.period_s): (one.choice, number)
                    for one in others
                    for number, (delay_s, _, _) in enumerate(self._plan.choices[one.choice].actions(dict(one.values)))
                },
            ),
            (_NEAR_EVENT, {at: feature for feature, at in base.items()}),
        ]

        def draw() -> tuple[Hashable, int]:
            what = self._chance.random()
            for share, moments in anchors:
                what -= share
                if what < 0.0 and moments:
                    at, anchor = self._chance.choice(list(moments.items()))
                    offset = self._offset()
                    return (name, anchor, offset), max(first, min(at + offset, last))
            at = self._chance.randint(first, last)
            return (name, at * _PARTS // (last + 1)), at

        relation, at = min((draw() for _ in range(_DRAWN)), key=lambda one: self._related[one[0]])
        self._related[relation] += 1
        return at

    def _offset(self) -> int:
        distance = int(2.0 ** self._chance.uniform(0.0, _FARTHEST)) - 1
        return -distance if self._chance.random() < _BEFORE else distance


@dataclass(frozen=True)
class Found:
    """A property and the simplest run found that breaks it. runs: after which it was broken first."""

    property: str
    trail: Trail
    runs: int


def explored(
    plan: Plan,
    runner: Runner,
    seed: int,
    enough: Callable[[], bool],
    tell: Callable[[str], object] = lambda text: None,
) -> tuple[dict[str, Found], Search]:
    """Search until every property is broken, nothing is left to try, it is ``enough``, or somebody interrupts.

    Returns what was found, simplified, by property. tell: takes lines about the progress.
    """
    search, found = Search(plan, runner, seed), dict[str, Found]()
    try:
        search.begin()
        while True:
            for name, trail in search.broken.items():
                if name not in found:
                    tell(f"{name}: broken in run {runner.runs}; simplifying")
                    found[name] = Found(name, trail, runner.runs)
                    found[name] = replace(found[name], trail=simplest(plan, trail, name, runner))
            if len(found) == len(plan.properties) or search.exhausted or enough():
                break
            search.go_on()
    except KeyboardInterrupt:
        tell("interrupted: this is what was found so far")
    return found, search


def simplest(plan: Plan, trail: Trail, name: str, runner: Runner) -> Trail:
    """The simplest run found that breaks the same property: with fewer decisions, and simpler values.

    It tries each simplification once for each run that is simpler than the one before.
    """
    best = trail
    tried: set[Schedule] = set()
    while True:
        candidates = [one for one in _simpler(plan, best.schedule) if one not in tried]
        better = None
        for first in range(0, len(candidates), _FEW):
            tried |= set(some := candidates[first : first + _FEW])
            trails = [entry.trail for entry in runner.carry_out(some, keeping=False)]
            if better := next((one for one in trails if name in one.broken), None):
                break
        if better is None:
            return best
        best = better


def _simpler(plan: Plan, schedule: Schedule) -> Iterator[Schedule]:
    for place in range(len(schedule)):
        yield schedule[:place] + schedule[place + 1 :]
    for place, decision in enumerate(schedule):
        values = dict(decision.values)
        for name, domain in plan.choices[decision.choice].parameters.items():
            for value in domain.simpler(values[name]):
                changed = replace(decision, values=tuple({**values, name: value}.items()))
                yield (*schedule[:place], changed, *schedule[place + 1 :])
