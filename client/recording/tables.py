"""Recordings as CSV and as numpy's npz."""

import csv
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from client.errors import RecordingError
from client.recording.recording import Columns, Info, Recording
from urproto.rtde.fields import OUTPUT_FIELDS
from urproto.rtde.types import FieldType

__all__ = ["CsvWriter", "NpzWriter", "read_csv", "read_npz"]

_INFO: Final = "info"  # beside the variables of an npz; no RTDE variable is called so


class CsvWriter:
    """A line each state, a column each number: ``actual_q_0``. Lines are in the file at once."""

    def __init__(self, path: Path, names: Iterable[str]) -> None:
        self._names = tuple(names)
        self._file = path.open("w", newline="", encoding="utf-8", buffering=1)
        self._writer = csv.writer(self._file)
        self._writer.writerow(column for name in self._names for column in _columns(name))

    def write(self, values: Mapping[str, Any], time_ns: int = 0) -> None:
        """Add a state."""
        parts = (values[name] for name in self._names)
        self._writer.writerow([part for value in parts for part in (value if isinstance(value, tuple) else (value,))])

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


class NpzWriter:
    """One array each variable, for ``numpy.load``. It is written when it is closed."""

    def __init__(self, path: Path, names: Iterable[str], info: Info) -> None:
        self._file = path.open("wb")  # at once, so that a wrong path is not noticed an hour later
        self._columns = Columns(tuple(names))
        self._info = dict(info)

    def write(self, values: Mapping[str, Any], time_ns: int) -> None:
        """Add a state."""
        self._info.setdefault("began_ns", str(time_ns))
        self._columns.append(values)

    def close(self) -> None:
        """Write the file."""
        with self._file:
            np.savez_compressed(
                self._file, allow_pickle=False, **{_INFO: np.array(json.dumps(self._info))}, **self._columns.arrays()
            )


def read_csv(path: Path) -> Recording:
    """A file of `CsvWriter`; columns that are no RTDE variable are left out. Raises RecordingError."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = csv.reader(file)
        try:
            return _read_rows(path, rows)
        except csv.Error as error:
            raise RecordingError(f"{path}, line {rows.line_num}: {error}") from error


def _read_rows(path: Path, rows: Iterator[list[str]]) -> Recording:
    header = next(rows, [])
    names = _variables(path, header)
    columns = Columns(tuple(names))
    for number, row in enumerate(rows, 2):
        if len(row) != len(header):
            note = {"cut_off": f"line {number} has {len(row)} columns instead of {len(header)}"}
            return Recording(columns.arrays(), note)
        try:
            columns.append({name: _parsed(row, places, name) for name, places in names.items()})
        except (ValueError, OverflowError) as error:
            raise RecordingError(f"{path}, line {number}: {error}") from error
    return Recording(columns.arrays())


def read_npz(path: Path) -> Recording:
    """A file of `NpzWriter`. Raises RecordingError."""
    with path.open("rb") as opened:
        try:
            with np.load(opened, allow_pickle=False) as file:
                values = {name: file[name] for name in file.files if name in OUTPUT_FIELDS}
                info = dict(json.loads(str(file[_INFO]))) if _INFO in file.files else {}
        except Exception as error:  # of zipfile, zlib, struct, tokenize, json: numpy lets through any
            raise RecordingError(f"{path} is no npz file of a recording: {error}") from error
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
    return Recording(values, info)


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
    values = [_number(row[place], kind) for place in places]
    return values if kind.count > 1 else values[0]


def _number(text: str, kind: FieldType) -> Any:
    if kind is FieldType.BOOL:
        return text.strip() in ("True", "true", "1")
    return float(text) if kind.letter == "d" else int(text)
