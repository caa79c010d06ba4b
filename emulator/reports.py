"""Report files: the log, flight reports, support files, and crash reports and journals of the emulator.

They are written to the programs directory, or without one to a temporary folder, which the log names; the newest 20 of
each kind are kept, and five journals. Their contents are the emulator's own. The name of a support file, and the fact
that it contains all flight reports, come from the e-Series dashboard manual.
"""

import logging
import tempfile
import zipfile
from calendar import isleap, monthrange
from collections.abc import Generator
from io import BytesIO
from pathlib import Path
from typing import Final, TypeVar

from emulator.machine import Machine
from emulator.workshare import in_periods
from urproto.durable import replacing, write_file, writing
from urproto.text import readable, strip, to_bytes, unknown
from urscript.work import Steps

_T = TypeVar("_T")
Waiting = Generator[None, None, _T]  # yields once per control period, and returns when the disk has the file

_FLIGHT_REPORTS: Final = ("controller", "software", "system")
_FLIGHT_REPORT: Final = "flightreport_"  # followed by its id: beginning of a file name
_CRASH: Final = "crash_"  # likewise
_SUPPORT: Final = "ur_"  # likewise, followed by the serial number
_STOP: Final = "stop_"  # likewise
_KEPT: Final = 20  # of each kind, and in each folder (guess)
_STOPS_KEPT: Final = 5  # journals, which are larger (guess)
_PIECE: Final = 16 * 1024  # bytes that are compressed in one step
_BYTES_PER_WORK: Final = 20  # measured: 40 to 60 ns for a byte of a log
_REPORT_WORK: Final = 1000  # [units of `urscript.work`]; measured: a millisecond
_FILE_WORK: Final = 300  # for creating or deleting a file (guess)

_logger = logging.getLogger(__name__)


def write_log(machine: Machine) -> Waiting[None]:
    """Write the log. Raises OSError when it cannot be written."""
    yield from in_periods(_paid(_REPORT_WORK), machine.work)
    yield from writing(_directory(machine) / "log_history.txt", readable(_log(machine)))


def write_flight_report(machine: Machine, kind: str) -> Waiting[str]:
    """Write a report and return its id. Raises ValueError for an unknown kind, OSError."""
    if kind.lower() not in _FLIGHT_REPORTS:
        raise ValueError(unknown("report", kind, _FLIGHT_REPORTS))
    yield from in_periods(_paid(_REPORT_WORK), machine.work)
    _rotate(_directory(machine), f"{_FLIGHT_REPORT}*.txt")
    report_id = f"{machine.serial_number}_{machine.step_count}_{kind.lower()}"
    yield from writing(_directory(machine) / f"{_FLIGHT_REPORT}{report_id}.txt", readable(_summary(machine)))
    return report_id


def write_support_file(machine: Machine, directory: str) -> Waiting[Path]:
    """Write log, state, all flight and crash reports to a zip file, after creating a new flight report of the system.

    In steps, because it takes many control periods. Raises ValueError for a directory outside the programs directory,
    OSError.
    """
    root = _directory(machine)
    target = (root / strip(directory).lstrip("/")).resolve()
    if not target.is_relative_to(root.resolve()) or not target.is_dir():
        raise ValueError(f"{directory!r} is not a directory below the programs directory")
    yield from write_flight_report(machine, "system")
    _rotate(target, f"{_SUPPORT}{machine.serial_number}_*.zip")
    path = target / f"{_SUPPORT}{machine.serial_number}_{_date_and_time(machine.wall_clock_ns // 1_000_000_000)}.zip"
    content = BytesIO()
    yield from in_periods(_write_archive(machine, content), machine.work)
    yield from writing(path, content.getvalue())
    return path


def _paid(work: int) -> Steps[None]:
    yield work


def _write_archive(machine: Machine, content: BytesIO) -> Steps[None]:
    root = _directory(machine)
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        yield from _add(archive, "log_history.txt", readable(_log(machine)).encode())
        yield from _add(archive, "state.txt", readable(_summary(machine)).encode())
        for report in sorted((*root.glob(f"{_FLIGHT_REPORT}*.txt"), *root.glob(f"{_CRASH}*.zip"))):
            yield _FILE_WORK
            yield from _add(archive, readable(report.name), report.read_bytes())


def _add(archive: zipfile.ZipFile, name: str, content: bytes) -> Steps[None]:
    """Compress a file in pieces that each take about a millisecond."""
    pieces = [content[start : start + _PIECE] for start in range(0, len(content), _PIECE)]
    with archive.open(name, "w") as file:
        for piece in pieces:
            yield len(piece) // _BYTES_PER_WORK
            file.write(piece)


def _rotate(folder: Path, pattern: str, kept: int = _KEPT) -> None:
    """Delete the oldest files of a kind, so that there is room for another one. Raises OSError."""
    files = sorted(folder.glob(pattern), key=lambda file: file.stat().st_mtime_ns)
    for file in files[: max(0, len(files) + 1 - kept)]:
        file.unlink()


def stop_journal(machine: Machine) -> Path:
    """Where the journal of a stop is to be written. Raises OSError."""
    return _directory(machine) / f"{_STOP}{machine.serial_number}_{machine.step_count}.journal"


def write_stop_journal(path: Path, stop: str, journal: bytes) -> None:
    """Write the journal of a stop, from any thread; older ones are deleted. The log says where it is."""
    try:
        _rotate(path.parent, f"{_STOP}*.journal", _STOPS_KEPT)
        write_file(path, journal)
    except OSError as error:
        _logger.warning("%s: the journal of the run could not be written: %s", stop, error)
    else:
        _logger.warning("%s: ur-emulator trace %s shows it, ur-emulator replay %s executes it again", stop, path, path)


def write_crash(machine: Machine, source: str | None, stage: str, trace: str) -> Path:
    """Write what a bug report needs: traceback, robot, its last state, program and log. Raises OSError.

    source: text of the main program that ran last.
    """
    config = machine.config
    arm = f"dynamic arm, seed {config.seed}" if config.dynamic else "ideal arm"
    about = f"{_head(machine)}{arm}\nuptime {machine.time_s:.3f} s, control period {machine.step_count}\n"
    _rotate(_directory(machine), f"{_CRASH}*.zip")
    path = _directory(machine) / f"{_CRASH}{machine.serial_number}_{machine.step_count}.zip"
    with replacing(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("traceback.txt", readable(f"while {stage}\n{trace}"))
        archive.writestr("about.txt", readable(f"{about}{config}\n"))
        archive.writestr("state.txt", readable(_summary(machine)))
        archive.writestr("log_history.txt", readable(_log(machine)))
        if source is not None:
            archive.writestr("program.script", to_bytes(source))
        if machine.recorder is not None and (journal := machine.recorder.journal):
            archive.writestr("run.journal", journal)
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
    return _head(machine) + "".join(f"{name}: {value}\n" for name, value in machine.snapshot.values().items())


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
