"""Start-up: from starting the process to a handshake on every port, and the memory it then takes."""

import asyncio
import os
import subprocess
import sys
import time
from pathlib import Path

from table import Table

from emulator.ports import PORTS
from emulator.readiness import NotReady, check_ready

REPEATS = 5
UNUSED = ("gripper", "tool line")  # open only where something is mounted
OPENED = {name: port for name, port in PORTS.items() if name not in UNUSED}


def measure() -> Table:
    """Best and worst of several cold processes (the files are in the system's cache)."""
    rows = []
    for model in ("ur3", "ur5e"):
        results = [asyncio.run(_start(model)) for _ in range(REPEATS)]
        times = sorted(seconds for seconds, _ in results)
        memory = max(mib for _, mib in results)
        rows.append([model, f"{times[0]:.2f} s", f"{times[-1]:.2f} s", f"{memory:.0f} MiB"])
    note = f"From starting the process to a handshake on every port, as another process sees it; {REPEATS} starts."
    return Table("Start-up", note, ["arm", "best", "worst", "resident memory"], rows)


async def _start(model: str) -> tuple[float, float]:
    """Seconds until ready, and resident memory [MiB]."""
    host = f"127.79.{os.getpid() >> 8 & 255}.{os.getpid() & 255}"
    began = time.monotonic()
    command = [sys.executable, "-m", "emulator", "--no-pendant", "--model", model, "--host", host]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        while True:
            try:
                await check_ready(host, OPENED)
                break
            except NotReady:
                if process.poll() is not None:
                    raise
                await asyncio.sleep(0.005)
        return time.monotonic() - began, _resident_mib(process.pid)
    finally:
        process.terminate()
        process.wait()


def _resident_mib(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    (line,) = (line for line in status.splitlines() if line.startswith("VmRSS:"))
    return int(line.split()[1]) / 1024


if __name__ == "__main__":
    sys.stdout.write(measure().markdown())
