"""Runs every benchmark and writes docs/benchmarks.md. Takes some minutes; ``run.py 5`` takes less.

The argument is how many seconds each control period measurement lasts.
"""

import os
import platform
import sys
from pathlib import Path

import campaign
import crowd
import fleet
import idle
import jitter
import latency
import pendant
import physics
import planning
import ros2_driver
import rtde_codec
import startup
import streaming
import tick_rate
import urscript_speed

TARGET = Path(__file__).resolve().parents[1] / "docs" / "benchmarks.md"
HEAD = """# Benchmarks

Written by `make benchmarks`. Bars: every port answers within 2 s of a cold start, less than 150 MiB of resident
memory, no missed control period in a minute with five RTDE clients at 125 and 500 Hz.

Machine: {machine}
"""


def main() -> None:
    """Measure and write."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else jitter.SECONDS
    tables = (
        startup.measure(),
        startup.measure_imports(),
        idle.measure(),
        idle.measure_stages(),
        jitter.measure(seconds),
        crowd.measure(),
        fleet.measure(),
        fleet.measure_growth(),
        fleet.measure_virtual(),
        latency.measure(),
        streaming.measure(),
        pendant.measure(),
        planning.measure(),
        ros2_driver.measure(),
        ros2_driver.latency(),
        tick_rate.measure(),
        tick_rate.measure_dynamics(),
        physics.measure(),
        physics.measure_learning(),
        physics.measure_real_time(),
        rtde_codec.measure(),
        urscript_speed.measure_compiling(),
        urscript_speed.measure(),
        campaign.measure(),
    )
    sections = [HEAD.format(machine=_machine()), *(table.markdown() for table in tables)]
    TARGET.write_text("\n".join(sections))
    sys.stdout.write(f"wrote {TARGET}\n")


def _machine() -> str:
    cpu = next(
        (line.split(":", 1)[1].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")),
        platform.processor() or platform.machine(),
    )
    return (
        f"{cpu}, {os.cpu_count()} cores, {platform.system()} {platform.release()}, Python {platform.python_version()}."
    )


def _lines(path: str) -> list[str]:
    try:
        return Path(path).read_text().splitlines()
    except OSError:
        return []


if __name__ == "__main__":
    main()
