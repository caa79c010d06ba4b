"""How many robots a core carries, each with a streaming RTDE client, and what one more robot costs.

The robots' processes share one core, the clients another where there is one. The two layouts are those of
``ur-emulator fleet``: one process for all robots of a core, or one for each. Growth is that of the first layout on all
cores, which the clients share. In virtual time there are no clients: as many controllers as fast as one core goes.

``fleet.py --quick`` says in a minute or so whether all of it works; its numbers are of little worth.
"""

import argparse
import asyncio
import gc
import json
import multiprocessing
import os
import resource
import select
import socket
import sys
import time
from collections.abc import Sequence
from contextlib import AsyncExitStack
from multiprocessing.connection import Connection
from typing import Any

import jitter
from processes import shared_mib
from table import Table
from tick_rate import SWING

from emulator.app import Emulator
from emulator.clock import ClockStatistics, RealClock
from emulator.commands.requests import ScriptUnit
from emulator.config import EmulatorConfig
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from emulator.realtime import claim_real_time
from urproto.robots import load_model

SECONDS = 10.0
ROBOTS = (1, 4, 8, 16, 24, 40)
GROWTH = (25, 50, 75, 100, 150, 200)
QUICK_SECONDS, QUICK_ROBOTS = 2.0, (1, 4)
VIRTUAL_TICKS = 4_000  # of all controllers together
_OVERLOADED = 0.5  # of the periods are missed: more robots tell nothing more
_BAR = 40  # characters of the longest bar
MODEL = "ur3"
LAYOUTS = {"one process for all": False, "one process each": True}
CORES = sorted(os.sched_getaffinity(0))
_SETTLE_S = 1.0  # the first periods pay for first-time costs


def measure(seconds: float = SECONDS, numbers: Sequence[int] = ROBOTS) -> Table:
    """One row for each layout and number of robots."""
    _stay_on({CORES[-1]})
    rows = []
    for layout, apart in LAYOUTS.items():
        for robots in numbers:
            crews = [[index] for index in range(robots)] if apart else [list(range(robots))]
            run = _run(crews, [CORES[0]] * len(crews), seconds)
            rows.append([layout, str(robots), *_cells(run, robots), f"{run['lost']:.0f}", run["bare"]])
    note = (
        f"Robots on one core at {1 / _period_s():.0f} Hz over {seconds:g} s, each with an RTDE client that reads "
        f"{len(jitter.NAMES)} variables at the full rate. Memory: proportional set size. Bare loop: periods missed by "
        "a loop that only sleeps, at the same time on the clients' core."
    )
    columns = [
        "layout",
        "robots",
        "missed",
        "worst",
        "core used",
        "core per robot",
        "memory per robot",
        "lost",
        "bare loop",
    ]
    return Table("Fleet", note, columns, rows)


def measure_growth(seconds: float = SECONDS, numbers: Sequence[int] = GROWTH) -> Table:
    """One row for each number of robots on the machine, until it is too much for it."""
    _stay_on(set(CORES))
    runs: dict[int, dict[str, Any]] = {}
    for robots in numbers:
        crews = [list(range(first, robots, len(CORES))) for first in range(min(robots, len(CORES)))]
        runs[robots] = _run(crews, CORES[: len(crews)], seconds)
        if runs[robots]["missed"] > _OVERLOADED * runs[robots]["ticks"]:
            break
    most = max(run["cpu"] for run in runs.values())
    rows = [
        [str(robots), *_cells(run, robots), f"{run['lost']:.0f}", "█" * round(_BAR * run["cpu"] / most)]
        for robots, run in runs.items()
    ]
    note = (
        f"As above, with one process on each available core ({len(CORES)}); the clients run on the same cores. Cost: "
        "that of the robots' processes alone."
    )
    columns = ["robots", "missed", "worst", "cost", "core per robot", "memory per robot", "lost", "cost, as a bar"]
    return Table("Growth of a fleet", note, columns, rows)


def measure_virtual(ticks: int = VIRTUAL_TICKS, numbers: Sequence[int] = ROBOTS) -> Table:
    """Robot time in a second of one core's time, for each number of controllers that take turns."""
    rows = []
    for robots in numbers:
        rates = [_virtual(robots, script, max(1, ticks // robots)) for script in ("", SWING)]
        rows.append([str(robots), *(f"{rate:.0f} s" for rate in rates)])
    note = (
        f"Robot seconds of all {MODEL} together per second of CPU time of one process, which advances them one control "
        "period at a time. No clients."
    )
    return Table("Fleet in virtual time", note, ["robots", "at rest", "movej back and forth"], rows)


def _virtual(robots: int, script: str, ticks: int) -> float:
    config = ControllerConfig(model=load_model(MODEL), running=True)
    controllers = [Controller(config) for _ in range(robots)]
    for controller in controllers:
        if script:
            controller.post(ScriptUnit(script, "block"))
        for _ in range(round(_SETTLE_S / _period_s())):
            controller.tick()
    began_s = _used_s()
    for _ in range(ticks):
        for controller in controllers:
            controller.tick()
    return robots * ticks * _period_s() / (_used_s() - began_s)


def _run(crews: Sequence[Sequence[int]], cores: Sequence[int], seconds: float) -> dict[str, Any]:
    """Start each crew of robots as a fork of this process, be their clients, and ask how it went."""
    gc.collect()
    gc.freeze()
    context = multiprocessing.get_context("fork")
    links: list[Connection] = []
    processes = []
    for crew, core in zip(crews, cores, strict=True):
        ours, theirs = context.Pipe()
        processes.append(context.Process(target=_serve, args=(crew, core, theirs), daemon=True))
        processes[-1].start()
        links.append(ours)
    for link in links:
        link.recv()
    lost, bare = _receive([_host(index) for crew in crews for index in crew], links, seconds)
    results = [json.loads(link.recv()) for link in links]
    for process in processes:
        process.join()
    sums = {name: sum(result[name] for result in results) for name in ("missed", "ticks", "cpu", "pss_mib")}
    return {**sums, "worst_ms": max(result["worst_ms"] for result in results), "lost": lost, "bare": bare}


def _cells(run: dict[str, Any], robots: int) -> list[str]:
    return [
        f"{run['missed']:.0f} of {run['ticks']:.0f}",
        f"{run['worst_ms']:.1f} ms",
        f"{run['cpu']:.0%}",
        f"{run['cpu'] / robots:.1%}",
        f"{run['pss_mib'] / robots:.1f} MiB",
    ]


def _receive(hosts: Sequence[str], links: Sequence[Connection], seconds: float) -> tuple[int, str]:
    """Packages that did not come, over all clients, and what a bare loop missed meanwhile.

    The robots begin and end to count when told over the links.
    """
    received = {_connect(host): bytearray() for host in hosts}
    _take(received, _SETTLE_S)
    for link in links:
        link.send("begin")
    bare = jitter.child("sleep", str(_period_s()), str(seconds))
    _take(received, seconds)
    for link in links:
        link.send("end")
    for connection in received:
        connection.close()
    lost = sum(jitter.gaps(bytes(data), _period_s()) for data in received.values())
    return lost, jitter.result(bare)[-1]


def _take(received: dict[socket.socket, bytearray], seconds: float) -> None:
    until = time.monotonic() + seconds
    while (left := until - time.monotonic()) > 0:
        for connection in select.select(list(received), [], [], left)[0]:
            received[connection] += connection.recv(65536)


def _connect(host: str) -> socket.socket:
    return jitter.connect(30004, 1 / _period_s(), host)


def _serve(robots: Sequence[int], core: int, link: Connection) -> None:
    _stay_on({core})
    asyncio.run(_serve_all(robots, link))


async def _serve_all(robots: Sequence[int], link: Connection) -> None:
    emulators = [Emulator(_config(index)) for index in robots]
    claim_real_time()
    orders: asyncio.Queue[str] = asyncio.Queue()
    async with AsyncExitStack() as running:
        for emulator in emulators:
            await running.enter_async_context(emulator)
        asyncio.get_running_loop().add_reader(link.fileno(), lambda: orders.put_nowait(link.recv()))
        link.send("ready")
        await orders.get()
        clocks = [emulator.clock for emulator in emulators if isinstance(emulator.clock, RealClock)]
        for clock in clocks:
            clock.statistics = ClockStatistics()
        began_s, used_s = time.monotonic(), _used_s()
        await orders.get()
        cpu = (_used_s() - used_s) / (time.monotonic() - began_s)
        all_statistics = [clock.statistics for clock in clocks]
        link.send(json.dumps(_result(all_statistics, cpu)))


def _result(all_statistics: Sequence[ClockStatistics], cpu: float) -> dict[str, float]:
    return {
        "missed": sum(statistics.missed for statistics in all_statistics),
        "ticks": sum(statistics.ticks for statistics in all_statistics),
        "worst_ms": max(statistics.latest_ns for statistics in all_statistics) / 1e6,
        "cpu": cpu,
        "pss_mib": shared_mib(os.getpid()),
    }


def _config(index: int) -> EmulatorConfig:
    return EmulatorConfig(controller=ControllerConfig(model=load_model(MODEL), running=True), host=_host(index))


def _host(index: int) -> str:
    return f"127.77.0.{index + 1}"


def _period_s() -> float:
    return load_model(MODEL).series.period_s


def _used_s() -> float:
    """CPU time of this process [s]."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def _stay_on(cores: set[int]) -> None:
    os.sched_setaffinity(0, cores)


def main() -> None:
    """All three tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seconds", nargs="?", type=float, default=SECONDS, help="how long each row is measured")
    parser.add_argument("--quick", action="store_true", help="a few robots for a short time")
    options = parser.parse_args()
    if options.quick:
        virtual = measure_virtual(400, QUICK_ROBOTS)
        tables = [measure(QUICK_SECONDS, QUICK_ROBOTS), measure_growth(QUICK_SECONDS, QUICK_ROBOTS), virtual]
    else:
        tables = [measure(options.seconds), measure_growth(options.seconds), measure_virtual()]
    sys.stdout.write("\n".join(table.markdown() for table in tables))


if __name__ == "__main__":
    main()
