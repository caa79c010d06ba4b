"""Start-up: from starting the process to a handshake on every port, what it took until then, and where that went."""

import asyncio
import os
import subprocess
import sys
import time
from collections import Counter

from processes import cpu_s, memory_mib
from table import Table

from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from emulator.readiness import NotReady, check_ready
from urproto.robots import load_model

REPEATS = 5
MOST_SHOWN = 14  # packages in the table of imports
DEADLINE_S = 60.0  # a start that takes longer has failed


def measure() -> Table:
    """Best and worst of several cold processes (the files are in the system's cache)."""
    rows = []
    for model in ("ur3", "ur5e"):
        results = [asyncio.run(_start(model)) for _ in range(REPEATS)]
        times, cpu, memory = (sorted(column) for column in zip(*results, strict=True))
        rows.append([model, f"{times[0]:.2f} s", f"{times[-1]:.2f} s", f"{cpu[0]:.2f} s", f"{memory[-1]:.0f} MiB"])
    note = (
        "Time from starting the process to a handshake on every port, measured by another process, and its CPU time "
        f"and resident memory at that moment. {REPEATS} starts, with byte code cached."
    )
    return Table("Start-up", note, ["arm", "best", "worst", "least CPU time", "resident memory"], rows)


def measure_imports() -> Table:
    """What of a start is imports, by the package that is imported."""
    runs = [_import_times() for _ in range(REPEATS)]
    packages = sorted(runs[0], key=lambda name: -min(run[name] for run in runs))
    others = packages[MOST_SHOWN:]
    rows = [[name, _ms(min(run[name] for run in runs))] for name in packages[:MOST_SHOWN]]
    rows.append([f"{len(others)} others", _ms(min(sum(run[name] for name in others) for run in runs))])
    rows.append(["all", _ms(min(run.total() for run in runs))])
    note = (
        f"Time spent in each package's own modules, by Python's `-X importtime`, which slows them down; minimum of "
        f"{REPEATS} starts."
    )
    return Table("Imports at start-up", note, ["package", "own time"], rows)


def _import_times() -> Counter[str]:
    """Microseconds for each top-level package that a start of an emulator imports."""
    command = [sys.executable, "-X", "importtime", "-m", "emulator", "--exit-when-ready", "--ephemeral-ports"]
    run = subprocess.run(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=_environment(), check=True
    )
    times: Counter[str] = Counter()
    for line in run.stderr.splitlines():
        if line.startswith("import time:") and line.split()[2].isdigit():
            own, _, name = line.removeprefix("import time:").split("|")
            times[name.strip().partition(".")[0]] += int(own)
    return times


def _ms(microseconds: int) -> str:
    return f"{microseconds / 1000:.0f} ms"


async def _start(model: str) -> tuple[float, float, float]:
    """Seconds until ready, CPU time until then [s], and resident memory [MiB]."""
    host = f"127.79.{os.getpid() >> 8 & 255}.{os.getpid() & 255}"
    command = [sys.executable, "-m", "emulator", "--no-pendant", "--model", model, "--host", host]
    ports = EmulatorConfig(controller=ControllerConfig(model=load_model(model)), host=host).wanted_ports
    began = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=_environment())
    try:
        while True:
            try:
                await check_ready(host, ports)
                break
            except NotReady:
                if process.poll() is not None or time.monotonic() > began + DEADLINE_S:
                    raise
                await asyncio.sleep(0.005)
        return time.monotonic() - began, cpu_s(process.pid), memory_mib(process.pid)
    finally:
        process.terminate()
        process.wait()


def _environment() -> dict[str, str]:
    """Without what keeps Python from caching byte code: users have that cache from the second start on."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


if __name__ == "__main__":
    sys.stdout.write(measure().markdown() + "\n" + measure_imports().markdown())
