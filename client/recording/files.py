"""Recordings by file name: ``.mcap``, ``.csv`` or ``.npz``."""

import logging
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from client.cameras import Shot
from client.errors import RecordingError
from client.recording.cdr import Message
from client.recording.mcapfile import McapWriter, read_mcap
from client.recording.output import OutputFile
from client.recording.pictures import Pictures
from client.recording.recording import DEFAULT_FIELDS, Info, Recording
from client.recording.tables import CsvWriter, NpzWriter, read_csv, read_npz
from client.recording.timestamps import Stamps
from client.recording.topics import controller_message, markers_message
from client.rtde import unknown_fields
from urproto.compat import Self
from urproto.rtde.fields import MAX_TIMESTAMP_S

FORMATS: Final = (".mcap", ".csv", ".npz")
_DEFAULT: Final = "default"

_logger = logging.getLogger(__name__)


class Writer(Protocol):
    """Accepts states."""

    def write(self, values: Mapping[str, Any], time_ns: int) -> None:
        """Add a state. time_ns: its time since 1970."""

    def close(self) -> None:
        """Finish."""


class FileWriter(Protocol):
    """Writes states to a file. saved: number of states that are certainly in it."""

    @property
    def saved(self) -> int: ...

    @property
    def file(self) -> OutputFile: ...

    def write(self, values: Mapping[str, Any], time_ns: int) -> None:
        """Add a state. time_ns: its time since 1970. Raises RecordingError."""

    def close(self, *, complete: bool = True) -> None:
        """Finish. complete: give the file its name; otherwise it keeps that of an unfinished one."""


class Recorder:
    """Writes RTDE states to a file; use it with ``with``, which also finishes the file.

    path: the suffix selects the format. names: the variables to record; ``timestamp`` is always included.
    info: key-value pairs to store in the file. count: states passed to `write`. left_out: states without a valid time,
    which are not in the file. place: where the states are: in ``run.unfinished.mcap`` until the recording is complete,
    and afterwards if it ended with an error and an earlier ``run.mcap`` would be lost. Raises RecordingError; if the
    file can no longer be written, the error says how many states are in it.

        with Recorder("run.mcap") as recorder, Robot(host, outputs=DEFAULT_FIELDS) as robot:
            robot.inner.driver.link.on_state.append(recorder.write)
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
        self.left_out = 0
        self._failure = ""
        self._closed = self._published = False
        self._writer = open_writer(self.path, self.names, info or {})
        self._stamps = Stamps(now_ns)
        self._pictures = Pictures()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        complete = error is None or not self._writer.file.replaces
        try:
            self._close(complete=complete)
        except RecordingError:
            if error is None:  # otherwise it was raised before, or the other error matters more
                raise
        if not complete:
            _logger.warning("%s is still the earlier recording: what is new is in %s", self.path, self.place)

    @property
    def place(self) -> Path:
        return self.path if self._published else self._writer.file.path

    def write(self, values: Mapping[str, Any]) -> None:
        """Add a state; additional variables are ignored.

        If the file can no longer be written, that raises RecordingError once here, and again in `close`.
        """
        time_ns = self._stamps.of(values["timestamp"])
        if time_ns is None:
            self.left_out += 1
            return
        if self._closed:
            raise RecordingError(f"{self.path} is finished: record to another file")
        self.count += 1
        if self._failure:
            return
        with self._recording_failure():
            self._writer.write({name: values[name] for name in self.names}, time_ns)

    def write_controller(self, controller: str, state: Any) -> None:
        """Add the state of a trajectory controller; see `controller_message`. Its time_s is robot time.

        Raises RecordingError unless the file is an MCAP file.
        """
        self._add(
            "states of controllers",
            self._stamps.of(state.time_s),
            lambda time_ns: [controller_message(controller, state, time_ns)],
        )

    def write_markers(self, topic: str, markers: Sequence[Mapping[str, Any]], time_s: float) -> None:
        """Add markers for 3D views at a robot time [s]. markers: fields of visualization_msgs/Marker.

        Raises RecordingError, and leaves the file as it is, unless the file is an MCAP file and the markers are valid.
        """
        message = markers_message(topic, markers)
        self._add("markers", self._stamps.of(time_s), lambda _: [message])

    def write_shot(self, shot: Shot) -> None:
        """Add a camera image; images before the first state are left out.

        Raises RecordingError unless the file is an MCAP file.
        """
        self._add("camera images", self._stamps.at(shot.time_s), lambda time_ns: self._pictures.encoded(shot, time_ns))

    def _add(self, what: str, time_ns: int | None, messages: Callable[[int], Iterable[Message]]) -> None:
        if not isinstance(self._writer, McapWriter):
            raise RecordingError(f"{self.path}: only .mcap files can contain {what}")
        if time_ns is not None and not self._failure:
            with self._recording_failure():
                for message in messages(time_ns):
                    self._writer.add(message, time_ns)

    def close(self) -> None:
        """Finish the file; closing it twice is allowed."""
        self._close(complete=True)

    def _close(self, *, complete: bool) -> None:
        if self._closed:
            return
        self._closed = True
        with self._recording_failure():
            self._writer.close(complete=complete)
        if self._failure:
            raise self._failure_error()
        self._published = complete

    @contextmanager
    def _recording_failure(self) -> Iterator[None]:
        try:
            yield
        except RecordingError as error:
            self._failure = str(error)
            raise self._failure_error() from error

    def _failure_error(self) -> RecordingError:
        lost = self.count - self._writer.saved
        saved = f"{self._writer.saved} states are certainly in the file"
        return RecordingError(
            f"{self._failure}; {saved}, the last {lost} may be lost: free some space and record again"
        )


def open_writer(path: Path, names: Collection[str], info: Info) -> FileWriter:
    """Open a file for writing, in the format of its suffix. Raises RecordingError."""
    try:
        if _suffix(path) == ".csv":
            return CsvWriter(path, names)
        return McapWriter(path, names, info) if _suffix(path) == ".mcap" else NpzWriter(path, names, info)
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror}") from error


def read(path: Path | str, columns: Sequence[str] | None = None) -> Recording:
    """Read a recording. columns: the RTDE variables of a CSV file without a header line.

    Raises RecordingError if the file is not a recording.
    """
    path = Path(path)
    if columns is not None and _suffix(path) != ".csv":
        raise RecordingError(f"{path} names its variables itself: columns are for .csv files without a header line")
    readers: dict[str, Callable[[Path], Recording]] = {
        ".mcap": read_mcap,
        ".csv": partial(read_csv, names=columns),
        ".npz": read_npz,
    }
    try:
        recording = readers[_suffix(path)](path)
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror or error}") from error
    if not len(recording):
        why = "; ".join(remarks(recording.info))
        raise RecordingError(f"{path} is a recording without any states" + (f": {why}" if why else ""))
    return _with_times(path, recording)


def remarks(info: Info) -> list[str]:
    """Remarks about a recording that is damaged or incomplete."""
    return [info[key] for key in ("cut_off", "left_out") if key in info]


def _with_times(path: Path, recording: Recording) -> Recording:
    """Leave out states without a valid time. Raises RecordingError if no others remain."""
    stamps = recording["timestamp"]
    valid = np.isfinite(stamps) & (np.abs(stamps) < MAX_TIMESTAMP_S)
    if invalid := int(len(valid) - valid.sum()):
        if invalid == len(valid):
            raise RecordingError(f"{path}: none of its {invalid} states has a valid timestamp")
        parts = [recording.info["left_out"]] if "left_out" in recording.info else []
        left_out = "; ".join([*parts, f"{invalid} of {len(valid)} states have no valid timestamp and are left out"])
        values = {name: array[valid] for name, array in recording.values.items()}
        return replace(recording, values=values, info={**recording.info, "left_out": left_out})
    return recording


def convert(source: Path, target: Path) -> Recording:
    """Write a recording in another format, and return it. Raises RecordingError."""
    if source.resolve() == target.resolve():
        raise RecordingError(f"{target} would be overwritten while it is read: choose another name")
    recording = read(source)
    info = {name: text for name, text in recording.info.items() if name not in ("cut_off", "left_out")}
    writer = open_writer(target, tuple(recording.values), info)
    try:
        for values, time_ns in zip(recording.states(), recording.times_ns, strict=True):
            writer.write(values, time_ns)
        writer.close()
    except BaseException as error:
        writer.file.discard()  # the source has everything
        if isinstance(error, RecordingError):
            raise RecordingError(f"{target} is not written: {error}") from error
        raise
    return recording


def field_names(names: Iterable[str]) -> tuple[str, ...]:
    """Check names of RTDE variables; return each once, with ``timestamp``. ``default`` stands for the usual ones.

    Raises RecordingError for an unknown name, with the most similar known one.
    """
    found = {"timestamp": None}
    for name in names:
        if name != _DEFAULT and (problem := unknown_fields([name])):
            raise RecordingError(problem)
        found |= dict.fromkeys(DEFAULT_FIELDS if name == _DEFAULT else (name,))
    return tuple(found)


def _suffix(path: Path) -> str:
    if (suffix := path.suffix.lower()) not in FORMATS:
        raise RecordingError(f"{path} is not a format of recordings: choose one of {', '.join(FORMATS)}")
    return suffix
