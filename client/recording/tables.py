"""Recordings as CSV and as numpy's npz."""

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
from urproto.rtde.fields import OUTPUT_FIELDS
from urproto.rtde.types import FieldType
from urproto.text import json_document

_UNFINISHED: Final = b"ur-client recording, not finished\n"  # how a file begins while an NpzWriter is open
_INFO: Final = "info"  # beside the variables of an npz; no RTDE variable is called so


class CsvWriter:
    """A line each state, a column each number: ``actual_q_0``. Lines are in the file at once.

    saved: states that are in the file.
    """

    def __init__(self, path: Path, names: Iterable[str]) -> None:
        self.saved = 0
        self._names = tuple(names)
        self._file = OutputFile(path)
        self._writer = csv.writer(_Lines(self._file))
        self._writer.writerow(column for name in self._names for column in _columns(name))

    def write(self, values: Mapping[str, Any], time_ns: int = 0) -> None:
        """Add a state. Raises RecordingError."""
        parts = (values[name] for name in self._names)
        self._writer.writerow([part for value in parts for part in (value if isinstance(value, tuple) else (value,))])
        self.saved += 1

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


class _Lines:
    """Text into a file of bytes."""

    def __init__(self, file: OutputFile) -> None:
        self._file = file

    def write(self, text: str) -> int:
        return self._file.write(text.encode())


class NpzWriter:
    """One array each variable, for ``numpy.load``, when it is closed.

    Until then the file has the states one after the other as they come, which `read_npz` reads too: that is what a
    recorder that is killed leaves. saved: states that are in the file.
    """

    def __init__(self, path: Path, names: Iterable[str], info: Info) -> None:
        self.saved = 0
        self._file = OutputFile(path)
        self._columns = Columns(tuple(names))
        self._info = dict(info)

    def write(self, values: Mapping[str, Any], time_ns: int) -> None:
        """Add a state. Raises RecordingError."""
        if not self.saved:
            self._info.setdefault("began_ns", str(time_ns))
            head = {"names": self._columns.names, "info": self._info}
            self._file.write(_UNFINISHED + json.dumps(head).encode() + b"\n")
        self._file.write(self._columns.row(values))
        self.saved += 1

    def close(self) -> None:
        """Put the arrays in the place of the states. Raises RecordingError, and leaves the states, when it cannot."""
        self._file.close()
        if self._file.failed:
            return
        path = self._file.path.resolve()
        whole = path.with_name(f"{path.name}.new")
        try:
            if self.saved:
                with path.open("rb") as states:
                    _journal(states, self._columns)
            arrays = {_INFO: np.array(json.dumps(self._info)), **self._columns.arrays()}
            with whole.open("wb") as file:
                np.savez_compressed(file, allow_pickle=False, **arrays)
            whole.replace(path)
        except OSError as error:
            self._file.failed = True
            whole.unlink(missing_ok=True)
            raise RecordingError(
                f"cannot finish {path}: {error.strerror or error}; ur-client convert makes another file of it"
            ) from error


def read_csv(path: Path, names: Sequence[str] | None = None) -> Recording:
    """A file of `CsvWriter`, or of the vendor's recorder, whose columns blanks separate.

    Columns that are no RTDE variable are left out, and so are lines that are damaged. names: the RTDE variables of the
    columns, for a file without a first line that says them. Raises RecordingError.
    """
    # damaged bytes spoil their own line only: they are no error of the whole text, and quotes span no lines
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
    if not cut_off and len(columns) and not _ends_with_line(path):  # its last number may lack digits
        columns.drop_last()
        broken.append(f"line {rows.line_num}: it has no end")
        cut_off = True
    if broken and len(broken) == count:
        raise RecordingError(f"{path} has no line that can be read; {broken[0]}")
    info = {"cut_off": f"{broken.pop()}; that line is left out"} if cut_off else {}
    if broken:
        info["left_out"] = f"{len(broken)} of {count} lines are damaged and left out (the first, {broken[0]})"
    return Recording(columns.arrays(), info)


def _ends_with_line(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, SEEK_END)
        return file.read() in (b"\n", b"\r")


def _row(rows: Any) -> list[str] | None:
    """The next line of a CSV file; one that csv refuses has no columns. None at the end."""
    try:
        row: list[str] | None = next(rows, None)
    except csv.Error:
        return []
    return row


def _journal(file: BinaryIO, columns: Columns | None = None) -> Recording:
    """What an `NpzWriter` has written before it was closed. Raises RecordingError."""
    try:
        file.seek(len(_UNFINISHED))
        head = json_document(file.readline())
        names = tuple(name for name in head["names"] if name in OUTPUT_FIELDS)
        if len(names) != len(head["names"]):
            raise ValueError("a variable of another version")
        if not names or len(set(names)) != len(names):
            raise ValueError("it names no variable, or one twice")
        info = {str(name): str(text) for name, text in head["info"].items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise RecordingError(f"{file.name} is a recording whose beginning is damaged: {error}") from error
    columns = Columns(names) if columns is None else columns
    rest = columns.extend(file.read())
    info["cut_off"] = "its recorder was ended before it could finish it" + (f"; {rest} bytes are lost" if rest else "")
    return Recording(columns.arrays(), info)


def read_npz(path: Path) -> Recording:
    """A file of `NpzWriter`, finished or not; without the variables whose arrays are damaged. Raises RecordingError."""
    broken = []
    with path.open("rb") as opened:
        if opened.read(len(_UNFINISHED)) == _UNFINISHED:
            return _journal(opened)
        opened.seek(0)
        try:
            with np.load(opened, allow_pickle=False) as file:
                values = {}
                for name in file.files:
                    if name in OUTPUT_FIELDS:
                        try:
                            values[name] = np.asarray(file[name])  # bytes, when it does not begin as an array
                        except Exception as error:  # as below
                            broken.append(f"{name} is damaged and left out: {error}")
                info = _info(file[_INFO]) if _INFO in file.files else {}
        except Exception as error:  # of zipfile, zlib, struct, tokenize, json: numpy lets through any
            raise RecordingError(f"{path} is not an npz file of a recording: {error}") from error
    for name, array in values.items():
        count = OUTPUT_FIELDS[name].type.count
        if array.dtype.kind not in "biuf" or array.shape != (
            (*array.shape[:1], count) if count > 1 else array.shape[:1]
        ):
            raise RecordingError(
                f"{name} of {path} has the shape {array.shape}, which is none of {count} values a state"
            )
    if len({len(array) for array in values.values()}) > 1:
        raise RecordingError(f"the variables of {path} are not of the same length")
    return Recording(values, info | ({"left_out": "; ".join(broken)} if broken else {}))


def _info(array: Any) -> dict[str, str]:
    return {str(name): str(text) for name, text in json_document(str(array)).items()}


def _columns(name: str) -> list[str]:
    count = OUTPUT_FIELDS[name].type.count
    return [f"{name}_{index}" for index in range(count)] if count > 1 else [name]


def _variables(path: Path, header: list[str]) -> dict[str, list[int]]:
    """RTDE variable -> its columns."""
    places = {column: index for index, column in enumerate(header)}
    found = {
        name: [places[column] for column in _columns(name)]
        for name in OUTPUT_FIELDS
        if all(column in places for column in _columns(name))
    }
    if not found:
        raise RecordingError(
            f"{path} has no columns of RTDE variables, such as timestamp or actual_q_0, in its first line"
        )
    return dict(sorted(found.items(), key=lambda item: item[1]))


def _parsed(row: list[str], places: list[int], name: str) -> Any:
    """A variable's value. Raises ValueError."""
    kind = OUTPUT_FIELDS[name].type
    values = [_number(row[place].strip('" '), kind) for place in places]
    return values if kind.count > 1 else values[0]


def _number(text: str, kind: FieldType) -> Any:
    if kind is FieldType.BOOL:
        return text in ("True", "true", "1")
    return float(text) if kind.letter == "d" else int(text)
