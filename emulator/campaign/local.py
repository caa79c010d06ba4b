"""Executes runs in processes on this machine: one job at a time in each, so that a dead process identifies its job.

Each process has a link to the campaign, a pipe, and exits when the link is closed. So none outlives the campaign for
longer than its current job, however the campaign ends.
"""

import multiprocessing
import signal
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Final

from emulator.campaign.jobs import Finished, Lost

_FORKSERVER: Final = "forkserver"  # shares imported modules; no plain fork: the campaign's own process may have threads


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

    @property
    def pids(self) -> list[int]:
        """Process ids of the processes that have a job."""
        return [worker.process.pid or 0 for worker in self._busy]

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
