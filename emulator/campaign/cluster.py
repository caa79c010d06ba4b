"""A Ray cluster that carries out runs (extra ``cluster``).

Ray brings the campaign's folder to each node, hands out the jobs, and gives a job whose node or process is gone to
another one. What it has given up on after some tries is lost, as the death of a process on one machine is.
"""

import logging
import os
from collections.abc import Callable
from typing import Any, Final

from emulator.campaign.jobs import Finished, Lost
from emulator.config import ConfigError

_TRIES: Final = 3  # guess: of a job whose node or process is gone, before its runs are tried one by one
_QUEUED: Final = 2  # jobs per core that Ray knows of: none waits for the campaign to hand it the next one


class RayWorkers:
    """The cluster at an address; "auto" finds one that runs on this machine, "local" starts one here.

    folder: of the campaign, with the files that runs need. Raises ConfigError.
    """

    folder = "."  # Ray starts its processes in its copy of the campaign's folder

    def __init__(self, address: str, folder: str) -> None:
        try:
            import ray
        except ImportError as error:
            raise ConfigError("a cluster needs Ray: pip install 'ur-emulator[cluster]'") from error
        self._ray: Any = ray
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a cluster that starts here reports to nobody
        try:
            ray.init(
                address=address, runtime_env={"working_dir": folder}, log_to_driver=False, logging_level=logging.ERROR
            )
        except (ConnectionError, ValueError, RuntimeError, TimeoutError) as error:
            raise ConfigError(f"no Ray cluster at {address}: {str(error).splitlines()[0]}") from error
        self._call = ray.remote(num_cpus=1, max_retries=_TRIES)(_call)
        self._jobs: dict[Any, int] = {}
        self._next = 0

    @property
    def size(self) -> int:
        """Cores of the nodes that are there now."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 0)))

    @property
    def room(self) -> int:
        """How many more jobs may be submitted now."""
        return _QUEUED * self.size - len(self._jobs)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> int:
        """Let a node call a function of a module that is installed there; the number of this job."""
        self._next += 1
        self._jobs[self._call.remote(function, arguments)] = self._next
        return self._next

    def finished(self, patience_s: float) -> list[Finished]:
        """What came of jobs that are done, waiting for the first of them for a while."""
        waiting = list(self._jobs)
        if not waiting:
            return []
        done, _ = self._ray.wait(waiting, num_returns=1, timeout=patience_s)
        if done:
            done, _ = self._ray.wait(waiting, num_returns=len(waiting), timeout=0)
        return [Finished(self._jobs.pop(job), self._value(job)) for job in done]

    def close(self) -> None:
        """Give up what is not done and leave the cluster; one that was started here ends."""
        for job in self._jobs:
            self._ray.cancel(job, force=True)
        self._jobs = {}
        self._ray.shutdown()

    def _value(self, job: Any) -> Any:
        errors = self._ray.exceptions
        try:
            return self._ray.get(job)
        except errors.RuntimeEnvSetupError as error:
            raise ConfigError(f"Ray cannot bring the campaign's folder to its nodes: {error}") from error
        except errors.RayError as error:
            return Lost(type(error).__name__)


def _call(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    try:
        return function(*arguments)
    except Exception as error:  # told to whoever waits for the job
        return error
