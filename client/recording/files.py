"""Recordings by file name: ``.mcap``, ``.csv`` or ``.npz``."""

import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Protocol

import numpy as np

from client.cameras import Shot
from client.errors import RecordingError
from client.recording.mcapfile import McapWriter, read_mcap
from client.recording.recording import DEFAULT_FIELDS, Info, Recording
from client.recording.tables import CsvWriter, NpzWriter, read_csv, read_npz
from client.recording.timestamps import Stamps
from client.recording.topics import markers_message
from client.rtde import unknown_fields
from urproto.compat import Self
from urproto.rtde.fields import LONGEST_S

FORMATS: Final = (".mcap", ".csv", ".npz")
_DEFAULT: Final = "default"


class Writer(Protocol):
    """Where states go."""

    def write(self, values: Mapping[str, Any], time_ns: int) -> None:
        """Add a state; time_ns: since 1970."""

    def close(self) -> None:
        """Finish."""


class FileWriter(Writer, Protocol):
    """A file that they go to; saved: states that are in it for sure."""

    @property
    def saved(self) -> int: ...


class Recorder:
    """Writes RTDE states into a file; use it with ``with``, which also finishes the file.

    path: its suffix says the format. names: the variables, ``timestamp`` is always among them.
    info: whatever is worth knowing later. Raises RecordingError; where a file cannot be written any more, it says how
    many states are in it. count: states it was given; left_out: those without a time, which are not in the file.

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
        self.left_out = 0
        self._failure = ""
        self._closed = False
        self._writer = open_writer(self.path, self.names, info or {})
        self._stamps = Stamps(now_ns)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except RecordingError:
            if error is None:  # else it has been told, or matters less
                raise

    def write(self, values: Mapping[str, Any]) -> None:
        """Add a state; more variables than the recording's do no harm.

        A file that cannot be written any more is an error once, and again when it is closed.
        """
        time_ns = self._stamps.of(values["timestamp"])
        if time_ns is None:
            self.left_out += 1
            return
        if self._closed:
            raise RecordingError(f"{self.path} is finished: record into another file")
        self.count += 1
        if self._failure:
            return
        with self._telling():
            self._writer.write({name: values[name] for name in self.names}, time_ns)

    def write_controller(self, controller: str, state: Any) -> None:
        """Add the state of a trajectory controller, see `McapWriter.write_controller`; its time_s is the robot's.

        Only MCAP files have a place for it; others raise RecordingError.
        """
        writer, time_ns = self._mcap("states of controllers"), self._stamps.of(state.time_s)
        if time_ns is not None and not self._failure:
            with self._telling():
                writer.write_controller(controller, state, time_ns)

    def write_markers(self, topic: str, markers: Sequence[Mapping[str, Any]], time_s: float) -> None:
        """Add what 3D views draw, fields of visualization_msgs/Marker, at a time [s] of the robot.

        Only MCAP files have a place for it; others raise RecordingError, and so do markers that are none: the file
        stays as it is.
        """
        writer, message, time_ns = self._mcap("markers"), markers_message(markers), self._stamps.of(time_s)
        if time_ns is not None and not self._failure:
            with self._telling():
                writer.write_markers(topic, message, time_ns)

    def _mcap(self, what: str) -> McapWriter:
        if not isinstance(self._writer, McapWriter):
            raise RecordingError(f"{self.path}: only .mcap files hold {what}")
        return self._writer

    def write_shot(self, shot: Shot) -> None:
        """Add a picture; before the first state it is left out.

        Only MCAP files have a place for it; others raise RecordingError.
        """
        if not isinstance(self._writer, McapWriter):
            raise RecordingError(f"{self.path}: only .mcap files hold pictures of cameras")
        time_ns = self._stamps.at(shot.time_s)
        if time_ns is not None and not self._failure:
            with self._telling():
                self._writer.write_shot(shot, time_ns)

    def close(self) -> None:
        """Finish the file; closing twice does no harm."""
        if self._closed:
            return
        self._closed = True
        with self._telling():
            self._writer.close()

        if self._failure:
            raise self._failure_reported()

    @contextmanager
    def _telling(self) -> Iterator[None]:
        try:
            yield
        except RecordingError as error:
            self._failure = str(error)
            raise self._failure_reported() from error

    def _failure_reported(self) -> RecordingError:
        lost = self.count - self._writer.saved
        saved = f"{self._writer.saved} states are in the file for sure"
        return RecordingError(
            f"{self._failure}; {saved}, the last {lost} may be lost: free some space and record again"
        )


def open_writer(path: Path, names: Collection[str], info: Info) -> FileWriter:
    """A file to write, by its suffix. Raises RecordingError."""
    try:
        if _suffix(path) == ".csv":
            return CsvWriter(path, names)
        return McapWriter(path, names, info) if _suffix(path) == ".mcap" else NpzWriter(path, names, info)
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror}") from error


def read(path: Path | str, columns: Sequence[str] | None = None) -> Recording:
    """A recording. columns: of a CSV file without a first line, the RTDE variables in it.

    Raises RecordingError for what is none.
    """
    path = Path(path)
    if columns is not None and _suffix(path) != ".csv":
        raise RecordingError(f"{path} says itself what it has: columns are for .csv files that do not")
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
        raise RecordingError(f"{path} is a recording without a single state" + (f": {why}" if why else ""))
    return _with_times(path, recording)


def remarks(info: Info) -> list[str]:
    """What there is to say about a recording that is not as it was made."""
    return [info[key] for key in ("cut_off", "left_out") if key in info]


def _with_times(path: Path, recording: Recording) -> Recording:
    """Without the states whose time is none. Raises RecordingError when there are no others."""
    stamps = recording["timestamp"]
    sound = np.isfinite(stamps) & (np.abs(stamps) < LONGEST_S)
    if bad := int(len(sound) - sound.sum()):
        if bad == len(sound):
            raise RecordingError(f"{path}: none of its {bad} states has a time (timestamp)")
        parts = [recording.info["left_out"]] if "left_out" in recording.info else []
        left_out = "; ".join([*parts, f"{bad} of {len(sound)} states have no time and are left out"])
        values = {name: array[sound] for name, array in recording.values.items()}
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
        try:
            for values, time_ns in zip(recording.states(), recording.times_ns, strict=True):
                writer.write(values, time_ns)
        finally:
            writer.close()
    except RecordingError as error:
        raise RecordingError(f"{error}; {writer.saved} of {len(recording)} states are in it for sure") from error
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
