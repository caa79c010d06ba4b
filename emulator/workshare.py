"""The share of every control period for work that clients, their programs and their files cause.

Everything is paid for in units of work (`urscript.work`) and not in time, so that a script starts in the same period on
every computer. Commands have half of the share, and jobs, which take many periods, the rest: each of those under way
gets the same part of it. What a piece of work costs beyond the share is deducted from the following periods.
"""

from collections.abc import Generator
from typing import Final, Generic, TypeVar

from urscript.work import Steps, gc_paused

WORK_PER_SECOND: Final = 400_000
"""Work per second of controller time [units of `urscript.work`], divided equally among the periods.

This is about a third of a period on an idle computer. The official control script (48 kB) takes a quarter of a second;
its driver expects the program to call back within 0.5 s.
"""

ResultT = TypeVar("ResultT")


class Job(Generic[ResultT]):
    """Work in steps, and its result once a `WorkShare` has completed it."""

    def __init__(self, steps: Steps[ResultT]) -> None:
        self.steps = steps
        self.price = 0  # cost of the next step
        self.part = self.credit = 0  # of the period: all that it got, and what it may still spend
        self.period = -1  # for which it got its part
        self.result: ResultT | None = None


class WorkShare:
    """The budget of a robot. used: units spent since the start. deferred: how often work had to wait for a period."""

    def __init__(self, period_s: float) -> None:
        self._share = self._left = round(WORK_PER_SECOND * period_s)
        self._for_commands = self._share // 2
        self._unfinished: set[Job[object]] = set()
        self._expected = 0  # jobs that have not had their turn in this period, of those that the last one left over
        self._period = 0
        self.used = self.deferred = 0

    def new_period(self) -> None:
        """Start a control period with a new share, from which any overdraft is deducted first."""
        self._period += 1
        self._left = min(self._share, self._left + self._share)
        self._for_commands = min(self._share // 2, self._for_commands + self._share // 2)
        self._expected = len(self._unfinished)
        self._unfinished.clear()

    def take(self, price: int) -> bool:
        """Pay for a command before it is carried out; returns False if it has to wait for another period."""
        if price and self._for_commands <= 0:
            self.deferred += 1
            return False
        self._for_commands -= price
        self._spend(price)
        return True

    def work(self, job: Job[ResultT]) -> bool:
        """Continue a job; returns True when it is done, False if it needs another period. Raises what the job raises.

        A step larger than the job's part of a period is done at its beginning, and no work in the following ones.
        """
        if job.period != self._period:
            job.period, job.part = self._period, max(0, self._left) // max(1, self._expected)
            job.credit = min(job.part, job.credit + job.part)
            self._expected -= 1
        while self._left > 0 and (job.price <= job.credit or job.credit == job.part):
            self._spend(job.price)
            job.credit -= job.price
            try:
                job.price = next(job.steps)
            except StopIteration as end:
                job.result = end.value
                return True
        self.deferred += 1
        self._unfinished.add(job)  # type: ignore[arg-type]  # of any result
        return False

    def _spend(self, price: int) -> None:
        self._left -= price
        self.used += price


def in_periods(steps: Steps[ResultT], share: WorkShare) -> Generator[None, None, ResultT | None]:
    """Do work as a job of a robot: yields once per control period and returns the result."""
    job = Job(steps)
    with gc_paused():
        while not share.work(job):
            yield
    return job.result
