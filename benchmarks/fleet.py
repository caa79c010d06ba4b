"""How many robots a core carries, each with a streaming RTDE client, and what one more robot costs.

The robots' processes share one core, the clients another where there is one. The two layouts are those of
``ur-emulator fleet``: one process for all robots of a core, or one for each.
"""

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
from pathlib import Path

import jitter
from table import Table

from emulator.app import Emulator
from emulator.clock import ClockStatistics, RealClock
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from emulator.realtime import claim_real_time
from urproto.robots import load_model

SECONDS = 10.0
ROBOTS = (1, 4, 8, 16, 24)
MODEL = "ur3"
LAYOUTS = {"one process for all": False, "one process each": True}
CORES = sorted(os.sched_getaffinity(0))
_SETTLE_S = 1.0  # the first periods pay for first-time costs


def measure(seconds: float = SECONDS) -> Table:
    """One row for each layout and number of robots."""
    _stay_on_core(-1)
    rows = [_run(layout, robots, seconds) for layout in LAYOUTS for robots in ROBOTS]
    note = (
        f"Robots of one core at {1 / _period_s():.0f} Hz over {seconds:g} s, an RTDE client with {len(jitter.NAMES)} "
        "variables at the full rate for each. Missed: began a whole period late. Lost: packages a client did not get. "
        "Memory: proportional set size of their processes, shared pages counted by halves, thirds, ... "
        "Bare loop: periods that a loop missed which only sleeps, at the same time on the clients' core."
    )
    columns = [
        "layout",
        "robots",
        "missed",
        "worst",
        "core used",
        "core a robot",
        "memory a robot",
        "lost",
        "bare loop",
    ]
    return Table("Fleet", note, columns, rows)


def _run(layout: str, robots: int, seconds: float) -> list[str]:
    """Start the robots as forks of this process, be their clients, and ask how it went."""
    gc.collect()
    gc.freeze()
    crews = [[index] for index in range(robots)] if LAYOUTS[layout] else [list(range(robots))]
    context = multiprocessing.get_context("fork")
    links: list[Connection] = []
    processes = []
    for crew in crews:
        ours, theirs = context.Pipe()
        processes.append(context.Process(target=_serve, args=(crew, theirs), daemon=True))
        processes[-1].start()
        links.append(ours)
    for link in links:
        link.recv()
    lost, bare = _receive([_host(index) for index in range(robots)], links, seconds)
    results = [json.loads(link.recv()) for link in links]
    for process in processes:
        process.join()
    return [layout, str(robots), *_sum(results, robots), str(lost), bare]


def _sum(results: Sequence[dict[str, float]], robots: int) -> list[str]:
    missed, ticks = (sum(result[name] for result in results) for name in ("missed", "ticks"))
    used, memory = (sum(result[name] for result in results) for name in ("cpu", "pss_mib"))
    worst = max(result["worst_ms"] for result in results)
    return [
        f"{missed:.0f} of {ticks:.0f}",
        f"{worst:.1f} ms",
        f"{used:.0%}",
        f"{used / robots:.1%}",
        f"{memory / robots:.1f} MiB",
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


def _serve(robots: Sequence[int], link: Connection) -> None:
    _stay_on_core(0)
    asyncio.run(_serve_all(robots, link))


async def _serve_all(robots: Sequence[int], link: Connection) -> None:
    emulators = [Emulator(_config(index)) for index in robots]
    claim_real_time()
    told: asyncio.Queue[str] = asyncio.Queue()
    async with AsyncExitStack() as running:
        for emulator in emulators:
            await running.enter_async_context(emulator)
        asyncio.get_running_loop().add_reader(link.fileno(), lambda: told.put_nowait(link.recv()))
        link.send("ready")
        await told.get()
        clocks = [emulator.clock for emulator in emulators if isinstance(emulator.clock, RealClock)]
        for clock in clocks:
            clock.statistics = ClockStatistics()
        began_s, used_s = time.monotonic(), _used_s()
        await told.get()
        cpu = (_used_s() - used_s) / (time.monotonic() - began_s)
        all_statistics = [clock.statistics for clock in clocks]
        link.send(json.dumps(_result(all_statistics, cpu)))


def _result(all_statistics: Sequence[ClockStatistics], cpu: float) -> dict[str, float]:
    return {
        "missed": sum(statistics.missed for statistics in all_statistics),
        "ticks": sum(statistics.ticks for statistics in all_statistics),
        "worst_ms": max(statistics.latest_ns for statistics in all_statistics) / 1e6,
        "cpu": cpu,
        "pss_mib": _pss_mib(),
    }


def _config(index: int) -> EmulatorConfig:
    return EmulatorConfig(controller=ControllerConfig(model=load_model(MODEL), running=True), host=_host(index))


def _host(index: int) -> str:
    return f"127.77.0.{index + 1}"


def _period_s() -> float:
    return load_model(MODEL).series.period_s


def _used_s() -> float:
    """Processor time of this process [s]."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def _pss_mib() -> float:
    rows = Path("/proc/self/smaps_rollup").read_text().splitlines()
    return int(next(row for row in rows if row.startswith("Pss:")).split()[1]) / 1024


def _stay_on_core(index: int) -> None:
    os.sched_setaffinity(0, {CORES[index]})


if __name__ == "__main__":
    sys.stdout.write(measure(*map(float, sys.argv[1:2])).markdown())
