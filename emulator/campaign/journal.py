"""The results of the runs of a campaign, stored as they arrive, so that an interrupted campaign can be resumed.

The journal is a file of JSON lines: the fingerprint of the plan, then one result per line. An incomplete last line is
ignored, and its run is repeated. When all results are there, they are written to a Parquet file.
"""

import os
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from shlex import join
from typing import Any, Final

import msgspec
from msgspec.structs import replace

from emulator.campaign.plan import Axis, Numbers, Plan
from emulator.campaign.work import Result
from emulator.config import ConfigError
from urproto.compat import Self
from urproto.durable import replacing, write_file

FAILED_RUNS: Final = "failed_runs"
"""Folder for the journals and crash reports of failed runs, next to the results."""
_MAX_FILES: Final = 200  # in it (guess)
_ROWS: Final = 20_000  # of a Parquet file's row group
_ENCODER: Final = msgspec.json.Encoder()
_DECODER: Final = msgspec.json.Decoder(Result)


class _Head(msgspec.Struct):
    campaign: str
    fingerprint: str
    version: str


class Journal:
    """Results in a folder, while the context is entered. Raises ConfigError if it has those of another plan."""

    def __init__(self, folder: Path, plan: Plan, version: str) -> None:
        self.path = folder / "journal.jsonl"
        self._plan = plan
        self._head = _Head(plan.name, plan.fingerprint, version)
        self._done = bytearray(len(plan))
        self._kept = len(list(folder.glob(f"{FAILED_RUNS}/*")))
        folder.mkdir(parents=True, exist_ok=True)

    def __enter__(self) -> Self:
        if self.path.exists() and self.path.stat().st_size:
            self._resume()
        self._file = self.path.open("ab")
        if not self.path.stat().st_size:
            self._write([self._head])
        return self

    def __exit__(self, *reason: object) -> None:
        self._file.close()

    @property
    def missing(self) -> Iterator[int]:
        """The numbers of runs without a result, in ascending order."""
        place = self._done.find(0)
        while place >= 0:
            yield place
            place = self._done.find(0, place + 1)

    @property
    def left(self) -> int:
        """Number of runs without a result."""
        return self._done.count(0)

    def add(self, results: Sequence[Result]) -> list[Result]:
        """Store results, except of runs that have one already; return the new ones."""
        new = []
        for result in results:
            if not self._done[result.run]:
                self._done[result.run] = 1
                new.append(self._with_files(result))
        self._write(new)
        return new

    def _with_files(self, result: Result) -> Result:
        """Write the files of a failed run, as long as there are not too many; returns the result with their names."""
        folder, names = self.path.with_name(FAILED_RUNS), {}
        for name, content in result.files.items():
            if self._kept < _MAX_FILES:
                self._kept += 1
                folder.mkdir(exist_ok=True)
                write_file(folder / f"{result.run}_{name}", content)
                names[f"{folder.name}/{result.run}_{name}"] = b""
        return replace(result, files=names)

    def results(self) -> Iterator[Result]:
        """All results, in the order in which they arrived."""
        with self.path.open("rb") as lines:
            next(lines, None)
            for line in lines:
                yield _DECODER.decode(line)

    def _write(self, lines: Sequence[Any]) -> None:
        self._file.write(b"".join(_ENCODER.encode(line) + b"\n" for line in lines))
        self._file.flush()
        os.fsync(self._file.fileno())

    def _resume(self) -> None:
        self._truncate_partial_line()
        with self.path.open("rb") as lines:
            try:
                head = msgspec.json.decode(next(lines, b""), type=_Head)
            except msgspec.DecodeError:
                raise ConfigError(f"{self.path} is not a campaign journal: choose another --out") from None
            for name, kept, now in (
                ("the campaign, or a file that it names,", head.fingerprint, self._head.fingerprint),
                ("the version of ur-emulator", head.version, self._head.version),
            ):
                if kept != now:
                    raise ConfigError(f"{self.path}: {name} has changed: add --fresh, or choose another --out")
            for line in lines:
                self._done[_DECODER.decode(line).run] = 1

    def _truncate_partial_line(self) -> None:
        with self.path.open("rb+") as file:
            content_ends = file.seek(0, os.SEEK_END)
            file.seek(max(0, content_ends - 1))
            if file.read(1) == b"\n":
                return
            file.seek(0)
            whole = sum(len(line) for line in file if line.endswith(b"\n"))
            file.truncate(whole)


def write_parquet(journal: Journal, plan: Plan, target: Path) -> None:
    """Write all results as a table, with a column per axis and the replay command of each run. Raises ConfigError."""
    import pyarrow
    import pyarrow.parquet

    axes = [(axis.name, _arrow_type(pyarrow, axis)) for axis in plan.axes]
    words = pyarrow.dictionary(pyarrow.int32(), pyarrow.string())
    schema = pyarrow.schema(
        [
            ("run", pyarrow.int64()),
            ("status", words),
            ("failure", words),
            *axes,
            ("robot_s", pyarrow.float64()),
            ("cpu_s", pyarrow.float64()),
            ("wall_s", pyarrow.float64()),
            ("node", words),
            ("command", pyarrow.string()),
        ]
    )
    results = journal.results()
    with replacing(target) as file, pyarrow.parquet.ParquetWriter(file, schema, compression="zstd") as writer:
        while rows := [_row(plan, result) for result in islice(results, _ROWS)]:
            writer.write_table(pyarrow.Table.from_pylist(rows, schema=schema))


def _row(plan: Plan, result: Result) -> dict[str, Any]:
    place = plan.place(result.run)
    values = {axis.name: shown(axis, index) for axis, index in zip(plan.axes, place, strict=True)}
    return msgspec.structs.asdict(result) | values | {"command": join(plan.command(plan.run(result.run)))}


def shown(axis: Axis, index: int) -> Any:
    """A value of an axis as a cell of a table: the value itself, or the text of a list or a mapping."""
    value = axis.value(index)
    if _has_numbers(axis):
        return value
    if isinstance(value, dict):
        return ", ".join(f"{name}={one}" for name, one in value.items())
    return "; ".join(str(one) for one in value) if isinstance(value, list) else "" if value is None else str(value)


def _has_numbers(axis: Axis) -> bool:
    values = axis.values
    return isinstance(values, Numbers) or all(
        isinstance(value, int | float) and not isinstance(value, bool) for value in values
    )


def _arrow_type(pyarrow: Any, axis: Axis) -> Any:
    if not _has_numbers(axis):
        return pyarrow.dictionary(pyarrow.int32(), pyarrow.string())
    whole = isinstance(axis.values, Numbers) or all(isinstance(value, int) for value in axis.values)
    return pyarrow.int64() if whole else pyarrow.float64()
