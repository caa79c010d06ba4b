"""Starts the processes of a fleet and watches them.

    with Supervisor(configs, processes=2) as supervisor:
        for event in supervisor.watch():
            print(event)

Synchronous, without threads: a process that has any must not fork, and the workers are forks, which share what is
imported. Each worker has a link, a pipe, whose end it takes for the order to leave; so none outlives the supervisor,
however that ends.
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

import urproto.robots.dynamics  # noqa: F401 # loaded here, Pinocchio is shared by the forks
from emulator.config import EmulatorConfig
from emulator.fleet import worker
from emulator.fleet.worker import Ended, Failed, Ready
from urproto.compat import Self

_PAUSE_S: Final = 1.0  # before a process is started again: its ports may need it (guess)
_MOST_TRIES: Final = 5  # to bring a process back, without a success in between
_LEAVE_S: Final = 5.0  # for closing the ports, before a process is ended by force (guess)


@dataclass(frozen=True)
class AllReady:
    """Every port of every robot has answered."""


@dataclass(frozen=True)
class ShutDown:
    """A client shut this robot down."""

    robot: int


@dataclass(frozen=True)
class Died:
    """A process ended without being told to, and its robots with it."""

    pid: int
    robots: tuple[int, ...]
    how: str


@dataclass(frozen=True)
class Restarted:
    """The robots of a process that had died answer again, with the state of new ones."""

    robots: tuple[int, ...]


@dataclass(frozen=True)
class GivenUp:
    """These robots cannot be started, at first or again."""

    robots: tuple[int, ...]
    reason: str


Event = AllReady | ShutDown | Died | Restarted | GivenUp


@dataclass(eq=False)
class _Crew:
    """Robots that share a process."""

    robots: tuple[int, ...]
    process: BaseProcess
    link: Connection
    ready: bool = False
    tries: int = 0
    failure: str = ""


class Supervisor:
    """A fleet while the context is entered. Robots are counted from 0, as their configurations.

    ports: of each robot, by server; empty before it is ready. processes: at most that many. restart: start
    the robots of a process anew that died. pids: the process of each robot.
    """

    def __init__(self, configs: Sequence[EmulatorConfig], processes: int, *, restart: bool = False) -> None:
        self._configs = configs
        self._shares = share_out(configs, processes)
        self._restart = restart
        self._forks = sys.platform == "linux"
        self._context: Any = multiprocessing.get_context("fork" if self._forks else "spawn")
        self._crews: list[_Crew] = []
        self._waiting: list[_Crew] = []  # for being started again
        self._stop_read, self._stop_write = os.pipe()
        self._announced = False
        self.ports: list[dict[str, int]] = [{} for _ in configs]
        self.pids = [0 for _ in configs]

    def __enter__(self) -> Self:
        gc.collect()
        gc.freeze()  # what the collector never looks at stays shared with the forks
        for robots in self._shares:
            self._start(robots)
        return self

    def __exit__(self, *reason: object) -> None:
        for crew in self._crews:
            crew.link.close()
        for crew in self._crews:
            _see_off(crew.process)
        os.close(self._stop_read)
        os.close(self._stop_write)

    def stop(self) -> None:
        """Let ``watch`` end. A signal handler may call this."""
        os.write(self._stop_write, b"!")

    def watch(self) -> Iterator[Event]:
        """What happens, until ``stop`` or until no robot is left."""
        while self._crews or self._waiting:
            links = {crew.link: crew for crew in self._crews if not crew.link.closed}
            ends = {crew.process.sentinel: crew for crew in self._crews}
            happened = wait([self._stop_read, *links, *ends], _PAUSE_S if self._waiting else None)
            if self._stop_read in happened:
                return
            if not happened:
                self._start_again()
            for thing in happened:
                if isinstance(thing, Connection):
                    yield from self._hear(links[thing])
            for thing in happened:
                if isinstance(thing, int) and ends[thing] in self._crews:
                    yield from self._ended(ends[thing])

    def _start(self, robots: tuple[int, ...], tries: int = 0) -> None:
        ours, theirs = self._context.Pipe()
        inherited = [ours, *(crew.link for crew in self._crews if not crew.link.closed)] if self._forks else []
        configs = [self._configs[index] for index in robots]
        process = self._context.Process(target=worker.run, args=(configs, theirs, inherited), daemon=True)
        process.start()
        theirs.close()
        for index in robots:
            self.pids[index] = process.pid or 0
        self._crews.append(_Crew(robots, process, ours, tries=tries))

    def _start_again(self) -> None:
        waiting, self._waiting = self._waiting, []
        for crew in waiting:
            self._start(crew.robots, crew.tries + 1)

    def _hear(self, crew: _Crew) -> Iterator[Event]:
        """Everything a worker has said so far."""
        try:
            while crew.link.poll():
                report = crew.link.recv()
                if isinstance(report, Failed):
                    crew.failure = report.reason
                elif isinstance(report, Ended):
                    yield ShutDown(crew.robots[report.index])
                elif isinstance(report, Ready):
                    yield from self._came_up(crew, report)
        except (EOFError, OSError):
            crew.link.close()

    def _came_up(self, crew: _Crew, report: Ready) -> Iterator[Event]:
        for index, ports in zip(crew.robots, report.ports, strict=True):
            self.ports[index] = ports
        crew.ready = True
        if crew.tries:
            crew.tries = 0
            yield Restarted(crew.robots)
        if not self._announced and all(self.ports):
            self._announced = True
            yield AllReady()

    def _ended(self, crew: _Crew) -> Iterator[Event]:
        if not crew.link.closed:
            yield from self._hear(crew)
        crew.process.join()
        crew.link.close()
        self._crews.remove(crew)
        if crew.ready and not crew.process.exitcode:
            return  # all its robots were shut down
        yield from self._lost(crew)

    def _lost(self, crew: _Crew) -> Iterator[Event]:
        how = crew.failure or _how(crew.process.exitcode)
        if crew.ready:
            yield Died(crew.process.pid or 0, crew.robots, how)
        if self._restart and self._announced and crew.tries < _MOST_TRIES:
            self._waiting.append(crew)
        elif not crew.ready:
            yield GivenUp(crew.robots, how)


def share_out(configs: Sequence[EmulatorConfig], processes: int) -> list[tuple[int, ...]]:
    """Which robots share a process, so that each of at most that many has as many control periods a second."""
    loads = [0.0] * min(processes, len(configs))
    shares: list[list[int]] = [[] for _ in loads]
    rates = [config.speed * config.controller.model.series.frequency_hz for config in configs]
    for index in sorted(range(len(configs)), key=lambda index: -rates[index]):
        lightest = loads.index(min(loads))
        shares[lightest].append(index)
        loads[lightest] += rates[index]
    return [tuple(sorted(share)) for share in shares]


def _how(status: int | None) -> str:
    if status is not None and status < 0:
        return f"ended by {signal.Signals(-status).name}"
    return f"ended with status {status}"


def _see_off(process: BaseProcess) -> None:
    """Its link is closed: wait for its end, and in the end do not."""
    process.join(_LEAVE_S)
    if process.exitcode is None:
        process.kill()
        process.join()
