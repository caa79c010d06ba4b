"""Recordings as CSV files and as numpy's npz files."""

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from os import SEEK_END
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from client.errors import RecordingError
from client.recording.output import OutputFile
from client.recording.recording import Columns, Info, Recording
from client.rtde import unknown_fields
from urproto.durable import replacing
from urproto.rtde.fields import OUTPUT_FIELDS, FieldType
from urproto.text import json_document

_UNFINISHED: Final = b"ur-client recording, not finished\n"  # start of the file while an NpzWriter is open
_INFO: Final = "info"  # array next to the variables in an npz file; no RTDE variable has this name


class CsvWriter:
    """Writes a line per state and a column per number, such as ``actual_q_0``. Lines are written immediately.

    saved: number of states in the file.
    """

    def __init__(self, path: Path, names: Iterable[str]) -> None:
        self.saved = 0
        self._names = tuple(names)
        self.file = OutputFile(path)
        self._writer = csv.writer(_TextFile(self.file))
        self._writer.writerow(column for name in self._names for column in _columns(name))

    def write(self, values: Mapping[str, Any], time_ns: int = 0) -> None:
        """Add a state. Raises RecordingError."""
        parts = (values[name] for name in self._names)
        self._writer.writerow([part for value in parts for part in (value if isinstance(value, tuple) else (value,))])
        self.saved += 1
        self.file.keep = True

    def close(self, *, complete: bool = True) -> None:
        """Finish the file; see `FileWriter`."""
        self.file.close(complete=complete)


class _TextFile:
    """Writes text to a binary file."""

    def __init__(self, file: OutputFile) -> None:
        self._file = file

    def write(self, text: str) -> int:
        return self._file.write(text.encode())


class NpzWriter:
    """Writes one array per variable, for ``numpy.load``, when it is closed.

    Until then the file contains the states one after the other. `read_npz` can read that too, so a recorder that is
    killed leaves a readable file. saved: number of states in the file.
    """

    def __init__(self, path: Path, names: Iterable[str], info: Info) -> None:
        self.saved = 0
        self.file = OutputFile(path)
        self._path = path
        self._columns = Columns(tuple(names))
        self._info = dict(info)

    def write(self, values: Mapping[str, Any], time_ns: int) -> None:
        """Add a state. Raises RecordingError."""
        if not self.saved:
            self._info.setdefault("began_ns", str(time_ns))
            head = {"names": self._columns.names, "info": self._info}
            self.file.write(_UNFINISHED + json.dumps(head).encode() + b"\n")
        self.file.write(self._columns.row(values))
        self.saved += 1
        self.file.keep = True

    def close(self, *, complete: bool = True) -> None:
        """Replace the states by arrays; see `FileWriter`. If that fails, raises RecordingError and keeps the states."""
        self.file.close(complete=False)
        if self.file.failed or not complete:
            return
        try:
            if self.saved:
                with self.file.path.open("rb") as states:
                    _read_unfinished(states, self._columns)
            arrays = {_INFO: np.array(json.dumps(self._info)), **self._columns.arrays()}
            with replacing(self._path) as file:
                np.savez_compressed(file, allow_pickle=False, **arrays)
        except OSError as error:
            self.file.fail()
            raise RecordingError(
                f"cannot finish {self.file.path}: {error.strerror or error}: ur-client convert can still read it"
            ) from error
        self.file.discard()


def read_csv(path: Path, names: Sequence[str] | None = None) -> Recording:
    """Read a file of `CsvWriter`, or of the vendor's recorder, which separates columns by blanks.

    Columns that are not RTDE variables and damaged lines are left out. names: the RTDE variables of the columns, for a
    file without a header line. Raises RecordingError.
    """
    # damaged bytes must spoil only their own line: so decoding does not fail, and quotes cannot span lines
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        begin = file.readline()
        file.seek(0)
        rows = csv.reader(file, delimiter="," if "," in begin else " ", quoting=csv.QUOTE_NONE)
        if names is None:
            header = [cell.strip('" ') for cell in _row(rows) or []]
        elif problem := unknown_fields(names):
            raise RecordingError(problem)
        else:
            header = [column for name in names for column in _columns(name)]
        places_of = _variables(path, header)
        columns = Columns(tuple(places_of))
        count, broken = 0, list[str]()
        while (row := _row(rows)) is not None:
            count += 1
            try:
                if len(row) != len(header):
                    raise ValueError(f"{len(row)} columns instead of {len(header)}")
                columns.append({name: _parsed(row, places, name) for name, places in places_of.items()})
            except (ValueError, OverflowError) as error:
                broken.append(f"line {rows.line_num}: {error}")
                last = rows.line_num
        cut_off = bool(broken) and last == rows.line_num
    if not cut_off and len(columns) and not _ends_with_line(path):  # its last number may be truncated
        columns.drop_last()
        broken.append(f"line {rows.line_num} is incomplete")
        cut_off = True
    if broken and len(broken) == count:
        raise RecordingError(f"{path} has no readable line; {broken[0]}")
    info = {"cut_off": f"{broken.pop()}; that line is left out"} if cut_off else {}
    if broken:
        info["left_out"] = f"{len(broken)} of {count} lines are damaged and left out (first: {broken[0]})"
    return Recording(columns.arrays(), info)


def _ends_with_line(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, SEEK_END)
        return file.read() in (b"\n", b"\r")


def _row(rows: Any) -> list[str] | None:
    """The next line of a CSV file; an empty one if the csv module refuses it. None at the end."""
    try:
        row: list[str] | None = next(rows, None)
    except csv.Error:
        return []
    return row


def _read_unfinished(file: BinaryIO, columns: Columns | None = None) -> Recording:
    """Read a file that an `NpzWriter` has not finished. Raises RecordingError."""
    try:
        file.seek(len(_UNFINISHED))
        head = json_document(file.readline())
        names = tuple(name for name in head["names"] if name in OUTPUT_FIELDS)
        if len(names) != len(head["names"]):
            raise ValueError("it has a variable of another version")
        if not names or len(set(names)) != len(names):
            raise ValueError("it has no variable, or one twice")
        info = {str(name): str(text) for name, text in head["info"].items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise RecordingError(f"{file.name}: the start of the recording is damaged: {error}") from error
    columns = Columns(names) if columns is None else columns
    rest = columns.extend(file.read())
    info["cut_off"] = "the recorder was killed before it finished the file" + (
        f"; {rest} bytes are lost" if rest else ""
    )
    return Recording(columns.arrays(), info)


def read_npz(path: Path) -> Recording:
    """Read a file of `NpzWriter`, finished or not; leave out damaged variables. Raises RecordingError."""
    broken = []
    with path.open("rb") as opened:
        if opened.read(len(_UNFINISHED)) == _UNFINISHED:
            return _read_unfinished(opened)
        opened.seek(0)
        try:
            with np.load(opened, allow_pickle=False) as file:
                values = {}
                for name in file.files:
                    if name in OUTPUT_FIELDS:
                        try:
                            values[name] = np.asarray(file[name])  # bytes, if it is not an array
                        except Exception as error:  # as below
                            broken.append(f"{name} is damaged and left out: {error}")
                info = _info(file[_INFO]) if _INFO in file.files else {}
        except Exception as error:  # numpy lets errors of zipfile, zlib, struct, tokenize and json through
            raise RecordingError(f"{path} is not an npz file of a recording: {error}") from error
    for name, array in values.items():
        count = OUTPUT_FIELDS[name].type.count
        if array.dtype.kind not in "biuf" or array.shape != (
            (*array.shape[:1], count) if count > 1 else array.shape[:1]
        ):
            raise RecordingError(
                f"{path}: {name} has the shape {array.shape}, but should have {count} numbers per state"
            )
    if len({len(array) for array in values.values()}) > 1:
        raise RecordingError(f"{path}: the variables differ in length")
    return Recording(values, info | ({"left_out": "; ".join(broken)} if broken else {}))


def _info(array: Any) -> dict[str, str]:
    return {str(name): str(text) for name, text in json_document(str(array)).items()}


def _columns(name: str) -> list[str]:
    count = OUTPUT_FIELDS[name].type.count
    return [f"{name}_{index}" for index in range(count)] if count > 1 else [name]


def _variables(path: Path, header: list[str]) -> dict[str, list[int]]:
    """The column numbers of each RTDE variable."""
    places = {column: index for index, column in enumerate(header)}
    found = {
        name: [places[column] for column in _columns(name)]
        for name in OUTPUT_FIELDS
        if all(column in places for column in _columns(name))
    }
    if not found:
        raise RecordingError(
            f"{path}: the first line names no RTDE variable, such as timestamp or actual_q_0: give --columns"
        )
    return dict(sorted(found.items(), key=lambda item: item[1]))


def _parsed(row: list[str], places: list[int], name: str) -> Any:
    """Parse a variable's value. Raises ValueError."""
    kind = OUTPUT_FIELDS[name].type
    values = [_number(row[place].strip('" '), kind) for place in places]
    return values if kind.count > 1 else values[0]


def _number(text: str, kind: FieldType) -> Any:
    if kind is FieldType.BOOL:
        return text in ("True", "true", "1")
    return float(text) if kind.letter == "d" else int(text)
