"""Runs every benchmark and writes docs/reference/benchmarks.md, table by table. Takes half an hour.

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
from importlib import import_module
from pathlib import Path
from typing import Final

from table import Table

TARGET = Path(__file__).resolve().parents[1] / "docs" / "reference" / "benchmarks.md"
HEAD = """# Benchmarks

Speed, memory use and punctuality of the emulator and the client library, each next to a bound or an alternative
measured in the same run. `make benchmarks` writes this page.

Requirements: every port answers within 2 s of a cold start; less than 150 MiB of resident memory; no missed control
period in a minute with five RTDE clients at 125 and 500 Hz.

A control period is *missed* if it begins a whole period late. A package is *lost* if a client does not receive it.
Costs are CPU time, as a share of one core. Load averages are those of the machine when a measurement begins.

Machine: {machine}
"""


MEASUREMENTS: Final = (
    "startup.measure",
    "startup.measure_imports",
    "idle.measure",
    "idle.measure_stages",
    "jitter.measure",
    "crowd.measure",
    "fleet.measure",
    "fleet.measure_growth",
    "fleet.measure_virtual",
    "latency.measure",
    "streaming.measure",
    "lockstep.measure",
    "pendant.measure",
    "class_page.measure",
    "planning.measure",
    "ros2_driver.measure",
    "ros2_driver.latency",
    "ros2_driver.under_load",
    "tick_rate.measure",
    "tick_rate.measure_dynamics",
    "physics.measure",
    "physics.measure_learning",
    "physics.measure_real_time",
    "journal.measure",
    "rtde_codec.measure",
    "urscript_speed.measure_compiling",
    "urscript_speed.measure",
    "editor.measure",
    "campaign.measure",
    "explore.measure",
    "explore.measure_planted",
)
"""Modules of this folder and the functions in them that measure a table, in the order of the page."""
_SECTION: Final = re.compile(r"^<!-- ([\w.]+) -->\n(.*?)(?=^<!-- [\w.]+ -->\n|\Z)", re.MULTILINE | re.DOTALL)


def main() -> int:
    """Measure and write; 1 when something could not be measured."""
    modules = sorted({name.partition(".")[0] for name in MEASUREMENTS})
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("only", nargs="*", metavar="module", help=f"measure these alone: {', '.join(modules)}")
    parser.add_argument("--seconds", type=float, help="of each measurement of the control period (default: 60)")
    arguments = parser.parse_args()
    if unknown := sorted(set(arguments.only) - set(modules)):
        parser.error(f"no benchmark is called {', '.join(unknown)}: there are {', '.join(modules)}")
    page = TARGET.read_text() if TARGET.exists() else ""
    sections = dict(_SECTION.findall(page)) if arguments.only else {}
    failures = 0
    for name in MEASUREMENTS:
        if arguments.only and name.partition(".")[0] not in arguments.only:
            continue
        began, load = time.monotonic(), _load()
        options = [arguments.seconds] if name == "jitter.measure" and arguments.seconds else []
        try:
            sections[name] = f"{_measurement(name)(*options).markdown()}\n{load}"
        except Exception as error:  # one that fails must not cost the page the results of the others
            traceback.print_exc()
            failures += 1
            sections[name] = f"## {name}\n\nNot measured: {type(error).__name__}: {error}\n"
        sys.stdout.write(f"{name}: {time.monotonic() - began:.0f} s\n")
        sys.stdout.flush()
        _write(sections)
    sys.stdout.write(f"wrote {TARGET}\n")
    return 1 if failures else 0


def _measurement(name: str) -> Callable[..., Table]:
    """The function of that name; its module is imported here, since some need packages that not everybody has."""
    module, _, function = name.partition(".")
    found: Callable[..., Table] = getattr(import_module(module), function)
    return found


def _load() -> str:
    """The load before a measurement; results of a busy machine can only be compared within a table."""
    if not hasattr(os, "getloadavg"):
        return ""
    return f"Load average: {os.getloadavg()[0]:.1f}.\n"


def _write(sections: dict[str, str]) -> None:
    parts = (f"<!-- {name} -->\n{sections[name].strip()}\n" for name in MEASUREMENTS if name in sections)
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
