"""A process that runs several robots in one event loop.

Compared with one process per robot, this takes half the processor time and a quarter of the memory per robot, and no
control period is later (docs/fleet.md).
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
    """The robots could not be started, or have failed."""

    reason: str


@dataclass(frozen=True)
class Ended:
    """A client shut down the controller of this robot. index: its number within the process."""

    index: int


Report = Ready | Failed | Ended


def run(configs: Sequence[EmulatorConfig], link: Connection, inherited: Sequence[Connection]) -> None:
    """Run the robots until all have ended or the link is closed, and report events over it.

    inherited: ends of links that the fork inherited. They are closed here; otherwise no link would ever appear closed.
    """
    for other in inherited:
        other.close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C to all processes; the supervisor decides
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    with ERROR.in_background():
        asyncio.run(_Worker(configs, link).run())


def _claim(configs: Sequence[EmulatorConfig]) -> bool:
    """Claim real time as far as all robots of this process request it. Raises RealTimeRefused."""
    wanted = {config.realtime for config in configs}
    if RealTime.OFF in wanted or any(config.speed != 1.0 for config in configs):
        return bool(claim_real_time(RealTime.OFF))
    granted = claim_real_time(_wanted(configs))
    _logger.info("process %d: granted by the system: %s", os.getpid(), ", ".join(granted) or "nothing")
    return bool(granted)


def _wanted(configs: Sequence[EmulatorConfig]) -> RealTime:
    return RealTime.ON if any(config.realtime is RealTime.ON for config in configs) else RealTime.AUTO


class _Worker:
    def __init__(self, configs: Sequence[EmulatorConfig], link: Connection) -> None:
        self._link = link
        self._configs = configs
        self._emulators = [
            Emulator(replace(config, faults=())) for config in configs
        ]  # faults begin once the robot has proven to be ready
        self._starting = len(configs)
        self._leaving = False

    async def run(self) -> None:
        asyncio.get_running_loop().add_reader(self._link.fileno(), self._leave)
        watching: asyncio.Task[None] | None = None
        try:
            if _claim(self._configs):
                watching = asyncio.create_task(yield_under_overload(_wanted(self._configs)))
            robots = [asyncio.create_task(self._live(index, each)) for index, each in enumerate(self._emulators)]
            try:
                await asyncio.gather(*robots)
            finally:  # if one robot fails, end the others too
                for robot in robots:
                    robot.cancel()
                await asyncio.gather(*robots, return_exceptions=True)
        except (OSError, NotReady, ConfigError, RealTimeRefused) as error:
            self._report(Failed(getattr(error, "strerror", None) or str(error)))
        finally:
            if watching is not None:
                watching.cancel()

    def _leave(self) -> None:
        """Stop all robots: the supervisor never sends, so a readable link has been closed."""
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
                self._report(Ready(tuple(other.ports for other in self._emulators)))
            await emulator.stopped.wait()
        if not self._leaving:
            self._report(Ended(index))

    def _report(self, report: Report) -> None:
        with suppress(OSError):  # the supervisor is gone
            self._link.send(report)
