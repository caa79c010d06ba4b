"""Executes runs on a Ray cluster (extra ``cluster``).

Ray copies the campaign's folder to each node, distributes the jobs, and moves a job whose node or process has died to
another node. A job that Ray gives up after some attempts is lost, like that of a dead process on one machine.
"""

import logging
import os
from collections.abc import Callable
from typing import Any, Final

from emulator.campaign.jobs import Finished, Lost
from emulator.config import ConfigError
from urproto.extras import how_to_install

_TRIES: Final = 3  # guess: attempts at a job whose node or process died, before its runs are tried one by one
_QUEUED: Final = 2  # jobs per core submitted to Ray, so that no core waits for its next job


class RayWorkers:
    """The cluster at an address; "auto" finds one that runs on this machine, "local" starts one here.

    folder: the campaign's folder, with the files that runs need. Raises ConfigError.
    """

    folder = "."  # Ray starts its processes in its copy of the campaign's folder

    def __init__(self, address: str, folder: str) -> None:
        try:
            import ray
        except ImportError as error:
            raise ConfigError(f"--ray needs Ray: {how_to_install('cluster')}") from error
        self._ray: Any = ray
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a cluster started here sends no usage statistics
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
        """Number of cores of the current nodes."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 0)))

    @property
    def room(self) -> int:
        return _QUEUED * self.size - len(self._jobs)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> int:
        """Have a node call a function of a module that is installed there; return the number of this job."""
        self._next += 1
        self._jobs[self._call.remote(function, arguments)] = self._next
        return self._next

    def finished(self, patience_s: float) -> list[Finished]:
        """The results of completed jobs; waits up to ``patience_s`` for the first one."""
        waiting = list(self._jobs)
        if not waiting:
            return []
        done, _ = self._ray.wait(waiting, num_returns=1, timeout=patience_s)
        if done:
            done, _ = self._ray.wait(waiting, num_returns=len(waiting), timeout=0)
        return [Finished(self._jobs.pop(job), self._value(job)) for job in done]

    def close(self) -> None:
        """Cancel jobs that are not completed, and leave the cluster; stop it if it was started here."""
        for job in self._jobs:
            self._ray.cancel(job, force=True)
        self._jobs = {}
        self._ray.shutdown()

    def _value(self, job: Any) -> Any:
        errors = self._ray.exceptions
        try:
            return self._ray.get(job)
        except errors.RuntimeEnvSetupError as error:
            raise ConfigError(f"Ray cannot copy the campaign's folder to its nodes: {error}") from error
        except errors.RayError as error:
            return Lost(type(error).__name__)


def _call(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    try:
        return function(*arguments)
    except Exception as error:  # becomes the result of the job
        return error
