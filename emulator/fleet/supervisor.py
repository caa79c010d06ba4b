"""Starts the processes of a fleet and watches them.

    with Supervisor(configs, processes=2) as supervisor:
        for event in supervisor.watch():
            print(event)

It is synchronous, without threads, because a process with threads must not fork, and the workers are forks, which share
imported modules. Each worker has a link to the supervisor, a pipe. A worker exits when its link is closed, so none
outlives the supervisor, however that ends.
"""

import gc
import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Final

import urproto.robots.dynamics  # noqa: F401 # imported here so that the forks share Pinocchio
from emulator.config import EmulatorConfig
from emulator.fleet import worker
from emulator.fleet.worker import Ended, Failed, Ready
from urproto.compat import Self

_PAUSE_S: Final = 1.0  # before a process is restarted: its ports may need it (guess)
_MAX_TRIES: Final = 5  # consecutive attempts to restart a process
_LEAVE_S: Final = 5.0  # time limit for closing the ports, before a process is killed (guess)


@dataclass(frozen=True)
class AllReady:
    """Every port of every robot has answered."""


@dataclass(frozen=True)
class ShutDown:
    """A client shut this robot down."""

    robot: int


@dataclass(frozen=True)
class Died:
    """A process ended unexpectedly, and its robots with it."""

    pid: int
    robots: tuple[int, ...]
    how: str


@dataclass(frozen=True)
class Restarted:
    """The robots of a process that had died answer again, in the state of new ones."""

    robots: tuple[int, ...]


@dataclass(frozen=True)
class GivenUp:
    """These robots cannot be started, or restarted."""

    robots: tuple[int, ...]
    reason: str


Event = AllReady | ShutDown | Died | Restarted | GivenUp


@dataclass(eq=False)
class _Group:
    """Robots that share a process."""

    robots: tuple[int, ...]
    process: BaseProcess
    link: Connection
    ready: bool = False
    tries: int = 0
    failure: str = ""


class Supervisor:
    """A fleet while the context is entered. Robots are numbered from 0, like their configurations.

    processes: maximum number of processes. restart: whether to restart the robots of a process that died.
    ports: ports of each robot, by server; empty until it is ready. pids: process id of each robot.
    """

    def __init__(self, configs: Sequence[EmulatorConfig], processes: int, *, restart: bool = False) -> None:
        self._configs = configs
        self._shares = share_out(configs, processes)
        self._restart = restart
        self._forks = sys.platform == "linux"
        self._context: Any = multiprocessing.get_context("fork" if self._forks else "spawn")
        self._groups: list[_Group] = []
        self._waiting: list[_Group] = []  # to be restarted
        self._stop_read, self._stop_write = os.pipe()
        self._announced = False
        self.ports: list[dict[str, int]] = [{} for _ in configs]
        self.pids = [0 for _ in configs]

    def __enter__(self) -> Self:
        gc.collect()
        gc.freeze()  # memory that the garbage collector does not touch stays shared with the forks
        for robots in self._shares:
            self._start(robots)
        return self

    def __exit__(self, *reason: object) -> None:
        for group in self._groups:
            group.link.close()
        for group in self._groups:
            join_or_kill(group.process)
        os.close(self._stop_read)
        os.close(self._stop_write)

    def stop(self) -> None:
        """End ``watch``. May be called by a signal handler."""
        os.write(self._stop_write, b"!")

    def watch(self) -> Iterator[Event]:
        """Yield events until ``stop``, or until no robot is left."""
        while self._groups or self._waiting:
            links = {group.link: group for group in self._groups if not group.link.closed}
            ends = {group.process.sentinel: group for group in self._groups}
            happened = wait([self._stop_read, *links, *ends], _PAUSE_S if self._waiting else None)
            if self._stop_read in happened:
                return
            if not happened:
                self._restart_waiting()
            for source in happened:
                if isinstance(source, Connection):
                    yield from self._receive(links[source])
            for source in happened:
                if isinstance(source, int) and ends[source] in self._groups:
                    yield from self._on_end(ends[source])

    def _start(self, robots: tuple[int, ...], tries: int = 0) -> None:
        ours, theirs = self._context.Pipe()
        inherited = [ours, *(group.link for group in self._groups if not group.link.closed)] if self._forks else []
        configs = [self._configs[index] for index in robots]
        process = self._context.Process(target=worker.run, args=(configs, theirs, inherited), daemon=True)
        process.start()
        theirs.close()
        for index in robots:
            self.pids[index] = process.pid or 0
        self._groups.append(_Group(robots, process, ours, tries=tries))

    def _restart_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        for group in waiting:
            self._start(group.robots, group.tries + 1)

    def _receive(self, group: _Group) -> Iterator[Event]:
        """Handle everything that a worker has reported so far."""
        try:
            while group.link.poll():
                report = group.link.recv()
                if isinstance(report, Failed):
                    group.failure = report.reason
                elif isinstance(report, Ended):
                    yield ShutDown(group.robots[report.index])
                elif isinstance(report, Ready):
                    yield from self._on_ready(group, report)
        except (EOFError, OSError):
            group.link.close()

    def _on_ready(self, group: _Group, report: Ready) -> Iterator[Event]:
        for index, ports in zip(group.robots, report.ports, strict=True):
            self.ports[index] = ports
        group.ready = True
        if group.tries:
            group.tries = 0
            yield Restarted(group.robots)
        if not self._announced and all(self.ports):
            self._announced = True
            yield AllReady()

    def _on_end(self, group: _Group) -> Iterator[Event]:
        if not group.link.closed:
            yield from self._receive(group)
        group.process.join()
        group.link.close()
        self._groups.remove(group)
        if group.ready and not group.process.exitcode:
            return  # all its robots were shut down
        yield from self._on_loss(group)

    def _on_loss(self, group: _Group) -> Iterator[Event]:
        how = group.failure or _describe_exit(group.process.exitcode)
        if group.ready:
            yield Died(group.process.pid or 0, group.robots, how)
        if self._restart and self._announced and group.tries < _MAX_TRIES:
            self._waiting.append(group)
        elif not group.ready:
            yield GivenUp(group.robots, how)


def share_out(configs: Sequence[EmulatorConfig], processes: int) -> list[tuple[int, ...]]:
    """Distribute robots over at most this many processes, so that each has about as many control periods per second."""
    loads = [0.0] * min(processes, len(configs))
    shares: list[list[int]] = [[] for _ in loads]
    rates = [config.speed * config.controller.model.series.frequency_hz for config in configs]
    for index in sorted(range(len(configs)), key=lambda index: -rates[index]):
        lightest = loads.index(min(loads))
        shares[lightest].append(index)
        loads[lightest] += rates[index]
    return [tuple(sorted(share)) for share in shares]


def _describe_exit(status: int | None) -> str:
    if status is not None and status < 0:
        return f"ended by {signal.Signals(-status).name}"
    return f"ended with status {status}"


def join_or_kill(process: BaseProcess) -> None:
    """Wait for a process whose link is closed; kill it after a time limit."""
    process.join(_LEAVE_S)
    if process.exitcode is None:
        process.kill()
        process.join()
