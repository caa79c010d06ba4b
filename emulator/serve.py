"""One emulator in the foreground of a terminal: first screen, ready line, teach pendant, shutdown."""

import asyncio
import json
import signal
import sys
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path
from typing import TextIO, cast

from emulator.app import Emulator
from emulator.config import ConfigError, EmulatorConfig
from emulator.first_screen import first_screen, ready_line
from emulator.journal.replay import Replay
from emulator.journal.stops import StopJournals
from emulator.logs import ERROR, OUTPUT
from emulator.pendant_process import Pendant
from emulator.readiness import check_ready
from emulator.realtime import RealTime, claim_real_time, freeze_heap, yield_under_overload
from urproto.commandline import console
from urproto.durable import write_file


async def serve(
    config: EmulatorConfig,
    ports_file: Path | None,
    pendant_port: int | None,
    *,
    exit_when_ready: bool = False,
    replay: Replay | None = None,
) -> None:
    """Run the emulator until it is stopped, or until every port answers. pendant_port: None for no pendant.

    replay: a run to go on with. Raises ConfigError, NotReady, OSError.
    """
    screen = console(cast(TextIO, OUTPUT))
    without_faults = replace(config, faults=())  # they begin once the emulator has proven to be ready
    emulator = Emulator(without_faults, replay=replay)
    if config.stop_journals:
        emulator.stop_journals = StopJournals()
    async with AsyncExitStack() as running:
        running.enter_context(OUTPUT.in_background())
        running.enter_context(ERROR.in_background())
        granted = claim_real_time(config.realtime if config.speed == 1.0 else RealTime.OFF)
        await running.enter_async_context(emulator)
        if granted:
            watching = asyncio.create_task(yield_under_overload(config.realtime))
            running.callback(watching.cancel)
        _stop_on_signals(emulator.stop)
        screen.print(first_screen(emulator))
        await check_ready(config.host, emulator.ports, elsewhere={"control": config.host_of("control")})
        freeze_heap()  # again: the emulator has been created since the first time
        if ports_file is not None:
            write_ports(ports_file, emulator.ports)
        emulator.inject(config.faults)
        screen.print(ready_line(emulator, granted))
        if pendant_port is not None:
            # the robot runs already: it does not wait for the pendant
            pendant = Pendant(emulator.config, emulator.ports, pendant_port, screen.print)
            emulator.control.pendant_report = pendant.report
            await running.enter_async_context(pendant)
        if not exit_when_ready:
            await emulator.stopped.wait()
    screen.print("Stopped.")


def _stop_on_signals(stop: Callable[[], None]) -> None:
    """Stop cleanly on the first Ctrl-C; a second one interrupts."""
    loop = asyncio.get_running_loop()

    def stop_once(number: signal.Signals) -> None:
        loop.remove_signal_handler(number)
        stop()

    for number in (signal.SIGINT, signal.SIGTERM):
        if sys.platform != "win32":
            loop.add_signal_handler(number, stop_once, number)


def write_ports(path: Path, ports: object) -> None:
    """Write the file completely or not at all, because other processes wait for it. Raises ConfigError."""
    try:
        write_file(path, json.dumps(ports, indent=2) + "\n")
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}") from error
