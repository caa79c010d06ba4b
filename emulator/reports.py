"""Report files: the log, flight reports, support files, and crash reports of the emulator.

They are written to the programs directory, or without one to a temporary folder, which the log names. Their contents
are the emulator's own. The name of a support file, and the fact that it contains all flight reports, come from the
e-Series dashboard manual.
"""

import tempfile
import zipfile
from calendar import isleap, monthrange
from collections.abc import Generator
from io import BytesIO
from pathlib import Path
from typing import Final, TypeVar

from emulator.machine import Machine
from urproto.durable import replacing, writing
from urproto.text import readable, strip, to_bytes

_T = TypeVar("_T")
Waiting = Generator[None, None, _T]  # yields once per control period, and returns when the disk has the file

_FLIGHT_REPORTS: Final = ("controller", "software", "system")
_FLIGHT_REPORT: Final = "flightreport_"  # followed by its id: beginning of a file name
_CRASH: Final = "crash_"  # likewise


def write_log(machine: Machine) -> Waiting[None]:
    """Write the log. Raises OSError when it cannot be written."""
    yield from writing(_directory(machine) / "log_history.txt", readable(_log(machine)))


def write_flight_report(machine: Machine, kind: str) -> Waiting[str]:
    """Write a report and return its id. Raises ValueError for an unknown kind, OSError."""
    if kind.lower() not in _FLIGHT_REPORTS:
        raise ValueError(f"unknown report {kind!r}: choose one of {', '.join(_FLIGHT_REPORTS)}")
    report_id = f"{machine.serial_number}_{machine.step_count}_{kind.lower()}"
    yield from writing(_directory(machine) / f"{_FLIGHT_REPORT}{report_id}.txt", readable(_summary(machine)))
    return report_id


def write_support_file(machine: Machine, directory: str) -> Waiting[Path]:
    """Write log, state, all flight and crash reports to a zip file, after creating a new flight report of the system.

    Raises ValueError for a directory outside the programs directory, OSError.
    """
    root = _directory(machine)
    target = (root / strip(directory).lstrip("/")).resolve()
    if not target.is_relative_to(root.resolve()) or not target.is_dir():
        raise ValueError(f"{directory!r} is not a directory below the programs directory")
    yield from write_flight_report(machine, "system")
    path = target / f"ur_{machine.serial_number}_{_date_and_time(machine.wall_clock_ns // 1_000_000_000)}.zip"
    content = BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("log_history.txt", readable(_log(machine)))
        archive.writestr("state.txt", readable(_summary(machine)))
        for report in sorted((*root.glob(f"{_FLIGHT_REPORT}*.txt"), *root.glob(f"{_CRASH}*.zip"))):
            archive.write(report, readable(report.name))
    yield from writing(path, content.getvalue())
    return path


def write_crash(machine: Machine, source: str | None, stage: str, trace: str) -> Path:
    """Write what a bug report needs: traceback, robot, its last state, program and log. Raises OSError.

    source: text of the main program that ran last.
    """
    config = machine.config
    arm = f"dynamic arm, seed {config.seed}" if config.dynamic else "ideal arm"
    about = f"{_head(machine)}{arm}\nuptime {machine.time_s:.3f} s, control period {machine.step_count}\n"
    path = _directory(machine) / f"{_CRASH}{machine.serial_number}_{machine.step_count}.zip"
    with replacing(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("traceback.txt", readable(f"while {stage}\n{trace}"))
        archive.writestr("about.txt", readable(f"{about}{config}\n"))
        archive.writestr("state.txt", readable(_summary(machine)))
        archive.writestr("log_history.txt", readable(_log(machine)))
        if source is not None:
            archive.writestr("program.script", to_bytes(source))
    return path


def _directory(machine: Machine) -> Path:
    directory = machine.config.programs_dir or machine.reports_dir
    if directory is None:
        directory = machine.reports_dir = Path(tempfile.mkdtemp(prefix="ur-emulator-"))
        machine.messages.note(f"no programs directory: reports are written to {directory}")
    return directory


def _log(machine: Machine) -> str:
    return "".join(f"{line}\n" for line in machine.messages.history)


def _head(machine: Machine) -> str:
    return f"{machine.model.title}, serial number {machine.serial_number}, PolyScope {machine.version}\n"


def _summary(machine: Machine) -> str:
    return _head(machine) + "".join(f"{name}: {value}\n" for name, value in vars(machine.snapshot).items())


def _date_and_time(seconds: int) -> str:
    """YYYY-MM-DD_HH-MM-SS of a time since 1970, without a module that could read the wall clock."""
    days, seconds = divmod(seconds, 86_400)
    year, month = 1970, 1
    while days >= 365 + isleap(year):
        days -= 365 + isleap(year)
        year += 1
    while days >= monthrange(year, month)[1]:
        days -= monthrange(year, month)[1]
        month += 1
    hours, minutes = seconds // 3600, seconds // 60 % 60
    return f"{year:04}-{month:02}-{days + 1:02}_{hours:02}-{minutes:02}-{seconds % 60:02}"
