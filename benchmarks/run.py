"""Runs every benchmark and writes docs/benchmarks.md, table by table as they are measured. Takes half an hour.

``run.py startup tick_rate`` measures the tables of these modules again and keeps the others of the page;
``--seconds 5`` shortens the measurements of the control period. A table that cannot be measured keeps its place in the
page with the reason, and the exit status is 1.
"""

import argparse
import os
import platform
import re
import sys
import time
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

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
from table import Table

TARGET = Path(__file__).resolve().parents[1] / "docs" / "benchmarks.md"
HEAD = """# Benchmarks

Written by `make benchmarks`. Bars: every port answers within 2 s of a cold start, less than 150 MiB of resident
memory, no missed control period in a minute with five RTDE clients at 125 and 500 Hz.

Machine: {machine}
"""


MEASUREMENTS: Final[tuple[Callable[[], Table], ...]] = (
    startup.measure,
    startup.measure_imports,
    idle.measure,
    idle.measure_stages,
    jitter.measure,
    crowd.measure,
    fleet.measure,
    fleet.measure_growth,
    fleet.measure_virtual,
    latency.measure,
    streaming.measure,
    pendant.measure,
    planning.measure,
    ros2_driver.measure,
    ros2_driver.latency,
    tick_rate.measure,
    tick_rate.measure_dynamics,
    physics.measure,
    physics.measure_learning,
    physics.measure_real_time,
    rtde_codec.measure,
    urscript_speed.measure_compiling,
    urscript_speed.measure,
    campaign.measure,
)
_SECTION: Final = re.compile(r"^<!-- ([\w.]+) -->\n(.*?)(?=^<!-- [\w.]+ -->\n|\Z)", re.MULTILINE | re.DOTALL)


def main() -> int:
    """Measure and write; 1 when something could not be measured."""
    modules = sorted({measurement.__module__ for measurement in MEASUREMENTS})
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("only", nargs="*", metavar="module", help=f"measure these alone: {', '.join(modules)}")
    parser.add_argument("--seconds", type=float, default=jitter.SECONDS, help="of each control period measurement")
    arguments = parser.parse_args()
    if unknown := sorted(set(arguments.only) - set(modules)):
        parser.error(f"no benchmark is called {', '.join(unknown)}: there are {', '.join(modules)}")
    page = TARGET.read_text() if TARGET.exists() else ""
    sections = dict(_SECTION.findall(page)) if arguments.only else {}
    failures = 0
    for measurement in MEASUREMENTS:
        name = f"{measurement.__module__}.{measurement.__name__}"
        if arguments.only and measurement.__module__ not in arguments.only:
            continue
        began = time.monotonic()
        measure = partial(measurement, arguments.seconds) if measurement is jitter.measure else measurement
        try:
            sections[name] = measure().markdown()
        except Exception as error:  # one that fails must not cost the page the results of the others
            traceback.print_exc()
            failures += 1
            sections[name] = f"## {name}\n\nNot measured: {type(error).__name__}: {error}\n"
        sys.stdout.write(f"{name}: {time.monotonic() - began:.0f} s\n")
        sys.stdout.flush()
        _write(sections)
    sys.stdout.write(f"wrote {TARGET}\n")
    return 1 if failures else 0


def _write(sections: dict[str, str]) -> None:
    names = (f"{measurement.__module__}.{measurement.__name__}" for measurement in MEASUREMENTS)
    parts = (f"<!-- {name} -->\n{sections[name].strip()}\n" for name in names if name in sections)
    TARGET.write_text("\n".join([HEAD.format(machine=_machine()), *parts]))


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
    sys.exit(main())
