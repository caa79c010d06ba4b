"""Executes jobs of a campaign: in processes on this machine, or on a Ray cluster (extra ``cluster``).

On this machine, each process executes one job at a time, so that a dead process identifies its job. It has a link to
the campaign, a pipe, and exits when the link is closed: none outlives the campaign for longer than its current job,
however the campaign ends.

Ray copies the campaign's folder to each node, distributes the jobs, and moves a job whose node or process has died to
another node. A job that Ray gives up after some attempts is lost, like that of a dead process on one machine.
"""

import logging
import multiprocessing
import os
import signal
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Final, Protocol

from emulator.config import ConfigError
from urproto.extras import how_to_install

_FORKSERVER: Final = "forkserver"  # shares imported modules; no plain fork: the campaign's own process may have threads
_TRIES: Final = 3  # guess: attempts at a job whose node or process died, before its runs are tried one by one
_QUEUED: Final = 2  # jobs per core submitted to Ray, so that no core waits for its next job


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

    @property
    def size(self) -> int:
        """Number of jobs that are executed at the same time."""

    @property
    def room(self) -> int:
        """Number of further jobs that may be submitted now."""

    def submit(self, function: Callable[..., Any], *arguments: Any) -> int:
        """Have a function of a module called; return the number of this job."""

    def finished(self, patience_s: float) -> list[Finished]:
        """The results of completed jobs; waits up to ``patience_s`` for the first one."""

    def close(self) -> None:
        """Cancel jobs that are not completed."""


class LocalWorkers:
    """A number of worker processes. folder: the folder to which paths of the plan are relative."""

    def __init__(self, folder: str, processes: int) -> None:
        self.folder = folder
        self._processes = processes
        methods = multiprocessing.get_all_start_methods()
        self._context: Any = multiprocessing.get_context(_FORKSERVER if _FORKSERVER in methods else "spawn")
        if _FORKSERVER in methods:
            self._context.set_forkserver_preload(["emulator.campaign.work"])
        self._idle: list[_Worker] = []
        self._busy: list[_Worker] = []
        self._next = 0

    @property
    def size(self) -> int:
        return self._processes

    @property
    def room(self) -> int:
        return self._processes - len(self._busy)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> int:
        worker = self._idle.pop() if self._idle else self._start()
        self._next += 1
        worker.job = self._next
        self._busy.append(worker)
        with suppress(OSError):  # it has died, which waiting for it reports
            worker.link.send((function, arguments))
        return self._next

    def finished(self, patience_s: float) -> list[Finished]:
        """The results of completed jobs; waits up to ``patience_s`` for the first one."""
        links = {worker.link: worker for worker in self._busy}
        done = []
        for link in wait(list(links), patience_s):
            assert isinstance(link, Connection)
            worker = links[link]
            self._busy.remove(worker)
            try:
                done.append(Finished(worker.job, link.recv()))
            except (EOFError, OSError):
                worker.end()
                done.append(Finished(worker.job, Lost(f"its process died with status {worker.process.exitcode}")))
            else:
                self._idle.append(worker)
        return done

    def close(self) -> None:
        """End all processes, even if they have a job."""
        for worker in (*self._idle, *self._busy):
            worker.end()
        self._idle, self._busy = [], []

    def _start(self) -> "_Worker":
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=_serve, args=(theirs,), daemon=True)
        process.start()
        theirs.close()
        return _Worker(process, ours)


@dataclass(eq=False)
class _Worker:
    process: BaseProcess
    link: Connection
    job: int = 0

    def end(self) -> None:
        self.link.close()
        self.process.kill()
        self.process.join()


def _serve(link: Connection) -> None:
    """Execute jobs until the link is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C to all processes; the campaign decides
    while True:
        try:
            function, arguments = link.recv()
        except (EOFError, OSError):
            return
        try:
            answer = function(*arguments)
        except Exception as error:  # becomes the result of the job
            answer = error
        try:
            link.send(answer)
        except OSError:
            return


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
