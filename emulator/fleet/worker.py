"""A process that runs several robots in one event loop.

One loop for many was measured against a process for each: half the processor time and a quarter of the memory a
robot, and no period later (docs/fleet.md).
"""

import asyncio
import logging
import os
import signal
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection

from emulator.app import Emulator
from emulator.config import ConfigError, EmulatorConfig
from emulator.logs import ERROR
from emulator.readiness import NotReady, check_ready
from emulator.realtime import RealTime, RealTimeRefused, claim_real_time, yield_under_overload

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Ready:
    """Every port of every robot has answered. ports: of each robot, by server."""

    ports: tuple[dict[str, int], ...]


@dataclass(frozen=True)
class Failed:
    """The robots cannot be there."""

    reason: str


@dataclass(frozen=True)
class Ended:
    """A client shut the controller of this robot down, counted within the process."""

    index: int


Report = Ready | Failed | Ended


def run(configs: Sequence[EmulatorConfig], link: Connection, inherited: Sequence[Connection]) -> None:
    """Run the robots until all have ended or nobody holds the other end of the link; tell over it what happens.

    inherited: ends of links that a fork brought along. They are closed, or no link would ever seem abandoned.
    """
    for other in inherited:
        other.close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C to all; the supervisor decides
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    with ERROR.in_background():
        asyncio.run(_Worker(configs, link).run())


def _claim(configs: Sequence[EmulatorConfig]) -> bool:
    """What all robots of this process want. Raises RealTimeRefused."""
    wanted = {config.realtime for config in configs}
    if RealTime.OFF in wanted or any(config.speed != 1.0 for config in configs):
        return bool(claim_real_time(RealTime.OFF))
    granted = claim_real_time(RealTime.ON if RealTime.ON in wanted else RealTime.AUTO)
    _logger.info("process %d: granted by the system: %s", os.getpid(), ", ".join(granted) or "nothing")
    return bool(granted)


class _Worker:
    def __init__(self, configs: Sequence[EmulatorConfig], link: Connection) -> None:
        self._link = link
        self._configs = configs
        self._emulators = [
            Emulator(replace(config, faults=())) for config in configs
        ]  # until it has proven to be ready
        self._starting = len(configs)
        self._leaving = False

    async def run(self) -> None:
        asyncio.get_running_loop().add_reader(self._link.fileno(), self._leave)
        watching: asyncio.Task[None] | None = None
        try:
            if _claim(self._configs):
                watching = asyncio.create_task(yield_under_overload())
            robots = [asyncio.create_task(self._live(index, each)) for index, each in enumerate(self._emulators)]
            try:
                await asyncio.gather(*robots)
            finally:  # one that fails takes the others along
                for robot in robots:
                    robot.cancel()
                await asyncio.gather(*robots, return_exceptions=True)
        except (OSError, NotReady, ConfigError, RealTimeRefused) as error:
            self._tell(Failed(getattr(error, "strerror", None) or str(error)))
        finally:
            if watching is not None:
                watching.cancel()

    def _leave(self) -> None:
        """The supervisor says nothing: the link is readable because it ended."""
        asyncio.get_running_loop().remove_reader(self._link.fileno())
        self._leaving = True
        for emulator in self._emulators:
            emulator.stop()

    async def _live(self, index: int, emulator: Emulator) -> None:
        config = emulator.config
        async with emulator:
            await check_ready(config.host, emulator.ports, elsewhere={"control": config.host_of("control")})
            emulator.inject(self._configs[index].faults)
            self._starting -= 1
            if not self._starting:
                self._tell(Ready(tuple(other.ports for other in self._emulators)))
            await emulator.stopped.wait()
        if not self._leaving:
            self._tell(Ended(index))

    def _tell(self, report: Report) -> None:
        with suppress(OSError):  # nobody listens any more
            self._link.send(report)
