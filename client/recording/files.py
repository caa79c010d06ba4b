"""Recordings by file name: ``.mcap``, ``.csv`` or ``.npz``."""

import time
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Protocol, Self

from client.errors import RecordingError
from client.recipes import unknown_fields
from client.recording.mcapfile import McapWriter, read_mcap
from client.recording.recording import DEFAULT_FIELDS, Info, Recording
from client.recording.stamps import Stamps
from client.recording.tables import CsvWriter, NpzWriter, read_csv, read_npz

__all__ = ["FORMATS", "Recorder", "Writer", "convert", "field_names", "open_writer", "read"]

FORMATS: Final = (".mcap", ".csv", ".npz")
_DEFAULT: Final = "default"


class Writer(Protocol):
    """Where states go."""

    def write(self, values: Mapping[str, Any], time_ns: int) -> None:
        """Add a state; time_ns: since 1970."""

    def close(self) -> None:
        """Finish."""


class Recorder:
    """Writes RTDE states into a file; use it with ``with``, which also finishes the file.

    path: its suffix says the format. names: the variables, ``timestamp`` is always among them.
    info: whatever is worth knowing later. Raises RecordingError.

        with Recorder("run.mcap") as recorder, Robot(host, outputs=DEFAULT_FIELDS) as robot:
            robot.inner.driver.robot.on_state.append(recorder.write)
    """

    def __init__(
        self,
        path: Path | str,
        names: Iterable[str] = DEFAULT_FIELDS,
        info: Info | None = None,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self.path = Path(path)
        self.names = field_names(names)
        self.count = 0
        self._writer = open_writer(self.path, self.names, info or {})
        self._stamps = Stamps(now_ns)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def write(self, values: Mapping[str, Any]) -> None:
        """Add a state; more variables than the recording's do no harm."""
        self._writer.write({name: values[name] for name in self.names}, self._stamps.of(values["timestamp"]))
        self.count += 1

    def write_controller(self, controller: str, state: Any) -> None:
        """Add the state of a trajectory controller, see `McapWriter.write_controller`; its time_s is the robot's.

        Only MCAP files have a place for it; others raise RecordingError.
        """
        if not isinstance(self._writer, McapWriter):
            raise RecordingError(f"{self.path}: only .mcap files hold states of controllers")
        self._writer.write_controller(controller, state, self._stamps.of(state.time_s))

    def close(self) -> None:
        """Finish the file."""
        self._writer.close()


def open_writer(path: Path, names: Collection[str], info: Info) -> Writer:
    """A file to write, by its suffix. Raises RecordingError."""
    try:
        if _suffix(path) == ".csv":
            return CsvWriter(path, names)
        return McapWriter(path, names, info) if _suffix(path) == ".mcap" else NpzWriter(path, names, info)
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror}") from error


def read(path: Path | str) -> Recording:
    """A recording. Raises RecordingError for what is none."""
    path = Path(path)
    readers = {".mcap": read_mcap, ".csv": read_csv, ".npz": read_npz}
    try:
        recording = readers[_suffix(path)](path)
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path} is no text: {error}") from error
    if not len(recording):
        raise RecordingError(f"{path} is a recording without a single state")
    return recording


def convert(source: Path, target: Path) -> Recording:
    """Write a recording in another format, and return it. Raises RecordingError."""
    if source.resolve() == target.resolve():
        raise RecordingError(f"{target} would be overwritten while it is read: choose another name")
    recording = read(source)
    writer = open_writer(target, tuple(recording.values), recording.info)
    try:
        for values, time_ns in zip(recording.states(), recording.times_ns, strict=True):
            writer.write(values, time_ns)
    finally:
        writer.close()
    return recording


def field_names(names: Iterable[str]) -> tuple[str, ...]:
    """RTDE variables, each once and ``timestamp`` among them; ``default`` stands for the usual ones.

    Raises RecordingError for a name that is none, with what may have been meant.
    """
    found = {"timestamp": None}
    for name in names:
        if name != _DEFAULT and (problem := unknown_fields([name])):
            raise RecordingError(problem)
        found |= dict.fromkeys(DEFAULT_FIELDS if name == _DEFAULT else (name,))
    return tuple(found)


def _suffix(path: Path) -> str:
    if (suffix := path.suffix.lower()) not in FORMATS:
        raise RecordingError(f"{path} is none of the formats of recordings: {', '.join(FORMATS)}")
    return suffix
