"""The files of a LeRobotDataset v3.0: episodes in Parquet files, with metadata next to them.

    meta/info.json                               features, frames per second, number of episodes and frames
    meta/stats.json                              statistics of all episodes
    meta/tasks.parquet                           tasks and their numbers
    meta/episodes/chunk-000/file-000.parquet     a row per episode: its task, its place in the data, its statistics
    data/chunk-000/file-000.parquet              a row per frame

Source: ``lerobot`` 0.4.4, its documentation of the format and the files that it writes.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from client.errors import RecordingError, extra
from client.lerobot import stats
from client.lerobot.episodes import DEFAULT_ACTION, DEFAULT_STATE, Episode, Numbers, episode, usual_rate_hz
from client.recording import read
from client.recording.files import remarks
from client.recording.pictures import RecordedPictures, read_pictures
from urproto.durable import new_folder, write_file

if TYPE_CHECKING:
    import pyarrow as pa

VERSION: Final = "v3.0"
DEFAULT_FPS: Final = 10
"""Default frames per second for recordings without images."""

_WHAT: Final = "a dataset for LeRobot"
_STATE, _ACTION, _PICTURES = "observation.state", "action", "observation.images."
_ENVIRONMENT: Final = "observation.environment_state"
_IN_CHUNK: Final = 1000  # files; this and the next two as LeRobot has them
_DATA_MB, _VIDEO_MB = 100, 200
_FILE_NAME: Final = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_DATA: Final = f"data/{_FILE_NAME}.parquet"
_EPISODES: Final = f"meta/episodes/{_FILE_NAME}.parquet"
_INDEX_COLUMNS: Final = ("frame_index", "episode_index", "index", "task_index")


@dataclass(frozen=True, slots=True)
class Dataset:
    """A dataset that was written.

    late_s: largest time between an image and its frame [s]. notes: remarks about the recordings.
    """

    path: Path
    fps: int
    episodes: int
    frames: int
    cameras: tuple[str, ...]
    late_s: float
    notes: tuple[str, ...]


def write_dataset(
    path: Path | str,
    recordings: Sequence[Path | str],
    tasks: Sequence[str],
    *,
    fps: int | None = None,
    state: Iterable[str] = DEFAULT_STATE,
    action: Iterable[str] = DEFAULT_ACTION,
    robot_type: str = "ur",
) -> Dataset:
    """Write a dataset folder from recordings; each recording becomes one episode.

    tasks: descriptions of the task, one for all recordings or one for each. fps: frames per second (default: the rate
    of the images in the first recording, else `DEFAULT_FPS`). state, action: RTDE variables, elements of vectors
    (``actual_q[0]``), or bits of words. The dataset includes all recorded cameras; every recording must have the same.

    The folder appears only when it is complete. Raises RecordingError, MissingExtraError.
    """
    path, files = Path(path), [Path(file) for file in recordings]
    if not files:
        raise RecordingError("no recordings: a dataset needs at least one")
    if len(tasks) not in (1, len(files)) or not all(task.strip() for task in tasks):
        raise RecordingError(
            f"{len(tasks)} tasks for {len(files)} recordings: give one for all, or one for each, in order"
        )
    each = list(tasks) * len(files) if len(tasks) == 1 else list(tasks)
    _check(path, fps)
    notes: list[str] = []
    with _folder(path) as folder, ExitStack() as opened:
        writer: _Writer | None = None
        numbers = Numbers(state), Numbers(action)
        for file, task in zip(files, each, strict=True):
            recording = read(file)
            notes += [f"{file}: {remark}" for remark in remarks(recording.info)]
            try:
                pictures = read_pictures(file) if file.suffix.lower() == ".mcap" else {}
                if writer is None:
                    labels = {_STATE: numbers[0].labels, _ACTION: numbers[1].labels}
                    writer = _Writer(folder, fps or _usual_fps(pictures), labels, robot_type)
                    opened.callback(writer.end_file)
                writer.add(episode(recording, pictures, task, writer.fps, numbers))
            except RecordingError as error:
                raise RecordingError(f"{file}: {error}") from error
        assert writer is not None
        writer.finish()
    return Dataset(path, writer.fps, len(files), writer.frames, writer.cameras, writer.late_s, tuple(notes))


def write_episodes(
    path: Path | str,
    episodes: Iterable[Episode],
    *,
    fps: int,
    state: Sequence[str],
    action: Sequence[str],
    environment: Sequence[str] = (),
    robot_type: str = "ur",
) -> Dataset:
    """Write a dataset folder from episodes that a program has in memory, such as those of a Gymnasium environment.

    state, action, environment: names of the numbers in each episode. Frames are ``1 / fps`` apart, whatever the time
    that computing them took.

    The folder appears only when it is complete. Raises RecordingError, MissingExtraError.
    """
    path = Path(path)
    _check(path, fps)
    labels = {_STATE: tuple(state), _ACTION: tuple(action)}
    if environment:
        labels[_ENVIRONMENT] = tuple(environment)
    with _folder(path) as folder, ExitStack() as opened:
        writer = _Writer(folder, fps, labels, robot_type)
        opened.callback(writer.end_file)
        for number, made in enumerate(episodes):
            try:
                writer.add(made)
            except RecordingError as error:
                raise RecordingError(f"episode {number}: {error}") from error
        if not writer.frames:
            raise RecordingError("no episodes: a dataset needs at least one")
        writer.finish()
    return Dataset(path, fps, writer.episodes, writer.frames, writer.cameras, writer.late_s, ())


def _check(path: Path, fps: int | None) -> None:
    """Check what can be checked before anything is read."""
    if path.exists():
        raise RecordingError(f"{path} exists: choose another name")
    if fps is not None and fps < 1:
        raise RecordingError(f"a dataset needs at least 1 frame per second, not {fps}")
    with extra("lerobot", _WHAT):
        import_module("pyarrow.parquet")
        import_module("PIL.Image")


def _usual_fps(pictures: Mapping[str, RecordedPictures]) -> int:
    """The rate of the slowest camera."""
    rate_hz = usual_rate_hz(pictures)
    return max(1, round(rate_hz)) if rate_hz else DEFAULT_FPS


@contextmanager
def _folder(path: Path) -> Iterator[Path]:
    """The folder, which appears at the end of the block."""
    try:
        with new_folder(path) as folder:
            yield folder
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror or error}") from error


class _Writer:
    """Writes episodes one after the other. frames: number of frames so far."""

    def __init__(self, folder: Path, fps: int, labels: Mapping[str, tuple[str, ...]], robot_type: str) -> None:
        self.fps = fps
        self.frames = 0
        self.cameras: tuple[str, ...] = ()
        self.late_s = 0.0
        self._folder = folder
        self._robot_type = robot_type
        self._labels = labels
        self._sizes: dict[str, tuple[int, int]] = {}  # of each camera's pictures: height, width
        self._tasks: dict[str, int] = {}
        self._rows: list[dict[str, Any]] = []  # of episodes
        self._stats: list[dict[str, stats.Statistics]] = []
        self._data: Any = None  # the ParquetWriter of the newest file
        self._place = (0, 0)  # its chunk and its number there

    def add(self, made: Episode) -> None:
        """Write an episode. Raises RecordingError for images that are unreadable or differ from the earlier ones, and
        for numbers that do not match their names.
        """
        self._check_numbers(made)
        self._check_pictures(made)
        number, task = len(self._rows), self._tasks.setdefault(made.task, len(self._tasks))
        frames = np.arange(len(made))
        counted = {
            "frame_index": frames,
            "episode_index": np.full_like(frames, number),
            "index": self.frames + frames,
            "task_index": np.full_like(frames, task),
        }
        times = (frames / self.fps).astype(np.float32)
        self._write(self._table(made, times, counted))
        numbers: dict[str, NDArray[Any]] = {**self._numbers(made), "timestamp": times, **counted}
        found = {
            name: stats.number_statistics(np.asarray(values, np.float64).reshape(len(made), -1))
            for name, values in numbers.items()
        }
        for camera, pictures in made.pictures.items():
            found[_PICTURES + camera] = stats.picture_statistics(pictures)
        chunk, place = self._place
        self._rows.append(
            {
                "episode_index": number,
                "tasks": [made.task],
                "length": len(made),
                "data/chunk_index": chunk,
                "data/file_index": place,
                "dataset_from_index": self.frames,
                "dataset_to_index": self.frames + len(made),
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                **{
                    f"stats/{feature}/{name}": values.tolist()
                    for feature, part in found.items()
                    for name, values in part.items()
                },
            }
        )
        self._stats.append(found)
        self.frames += len(made)
        self.late_s = max(self.late_s, made.late_s)

    def finish(self) -> None:
        """Write the metadata."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        self.end_file()
        episodes = self._folder / _EPISODES.format(chunk_index=0, file_index=0)
        episodes.parent.mkdir(parents=True)
        pq.write_table(pa.Table.from_pylist(self._rows), episodes)
        pq.write_table(_tasks_table(self._tasks), self._folder / "meta/tasks.parquet")
        features = self._stats[0]
        every = {name: stats.combined([found[name] for found in self._stats]) for name in features}
        self._write_json("stats.json", {name: {k: v.tolist() for k, v in part.items()} for name, part in every.items()})
        self._write_json("info.json", self._info())

    def end_file(self) -> None:
        """Close the newest file of frames; calling it twice is allowed."""
        if self._data is not None:
            self._data.close()
            self._data = None

    @property
    def episodes(self) -> int:
        """Number of episodes so far."""
        return len(self._rows)

    def _numbers(self, made: Episode) -> dict[str, NDArray[np.float32]]:
        every = {_STATE: made.state, _ACTION: made.action, _ENVIRONMENT: made.environment}
        return {name: every[name] for name in self._labels}

    def _check_numbers(self, made: Episode) -> None:
        for name, values in self._numbers(made).items():
            if values.shape != (len(made), len(self._labels[name])) or not len(made):
                raise RecordingError(
                    f"{name} has the shape {values.shape}: it needs a row for each of its frames, and "
                    f"{len(self._labels[name])} numbers in each"
                )
            if not np.isfinite(values).all():
                raise RecordingError(f"{name} has numbers that are not finite")

    def _check_pictures(self, made: Episode) -> None:
        """Check that every episode has the same cameras, with images of the same size."""
        shapes = {camera: stats.decoded(pictures[0]).shape for camera, pictures in made.pictures.items()}
        sizes = {camera: (shape[0], shape[1]) for camera, shape in shapes.items()}
        if not self._rows:
            self._sizes, self.cameras = sizes, tuple(sizes)
        elif sizes != self._sizes:
            raise RecordingError(
                f"it has images of {_sizes_text(sizes)}, but earlier recordings of {_sizes_text(self._sizes)}"
            )

    def _table(self, made: Episode, times: NDArray[np.float32], counted: Mapping[str, NDArray[np.int64]]) -> "pa.Table":
        import pyarrow as pa

        columns: dict[str, Any] = {name: _vectors(values) for name, values in self._numbers(made).items()}
        picture = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
        for camera, pictures in made.pictures.items():
            columns[_PICTURES + camera] = pa.array([{"bytes": data, "path": None} for data in pictures], picture)
        columns["timestamp"] = pa.array(times)
        columns |= {name: pa.array(values, pa.int64()) for name, values in counted.items()}
        return pa.table(columns)

    def _write(self, table: "pa.Table") -> None:
        """Write an episode as one row group, to a new file if the current one would get too large."""
        import pyarrow.parquet as pq

        if self._data is not None and self._size_mb() + table.nbytes / 2**20 > _DATA_MB:
            self.end_file()
            chunk, place = self._place
            self._place = (chunk, place + 1) if place + 1 < _IN_CHUNK else (chunk + 1, 0)
        if self._data is None:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            self._data = pq.ParquetWriter(self._file, table.schema, compression="snappy")
        self._data.write_table(table)

    @property
    def _file(self) -> Path:
        return self._folder / _DATA.format(chunk_index=self._place[0], file_index=self._place[1])

    def _size_mb(self) -> float:
        return self._file.stat().st_size / 2**20

    def _info(self) -> dict[str, Any]:
        features: dict[str, dict[str, Any]] = {
            name: {"dtype": "float32", "shape": [len(labels)], "names": list(labels)}
            for name, labels in self._labels.items()
        }
        for camera, size in self._sizes.items():
            features[_PICTURES + camera] = {
                "dtype": "image",
                "shape": [*size, 3],
                "names": ["height", "width", "channels"],
            }
        features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
        features |= {name: {"dtype": "int64", "shape": [1], "names": None} for name in _INDEX_COLUMNS}
        return {
            "codebase_version": VERSION,
            "robot_type": self._robot_type,
            "total_episodes": len(self._rows),
            "total_frames": self.frames,
            "total_tasks": len(self._tasks),
            "chunks_size": _IN_CHUNK,
            "data_files_size_in_mb": _DATA_MB,
            "video_files_size_in_mb": _VIDEO_MB,
            "fps": self.fps,
            "splits": {"train": f"0:{len(self._rows)}"},
            "data_path": _DATA,
            "video_path": None,
            "features": features,
        }

    def _write_json(self, name: str, content: Mapping[str, Any]) -> None:
        write_file(self._folder / "meta" / name, json.dumps(content, indent=4, allow_nan=False) + "\n")


def _vectors(values: NDArray[np.float32]) -> "pa.Array":
    """A fixed-length list per row; a plain number if the length is one, as in LeRobot."""
    import pyarrow as pa

    flat = pa.array(values.ravel(), pa.float32())
    return flat if values.shape[1] == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _tasks_table(tasks: Mapping[str, int]) -> "pa.Table":
    """Tasks and their numbers. The metadata tells pandas to use the tasks as index, by which LeRobot looks them up."""
    import pyarrow as pa

    text = {"pandas_type": "unicode", "numpy_type": "object"}
    number = {"pandas_type": "int64", "numpy_type": "int64"}
    described = {
        "index_columns": ["task"],
        "column_indexes": [{"name": None, "field_name": None, **text, "metadata": {"encoding": "UTF-8"}}],
        "columns": [
            {"name": "task_index", "field_name": "task_index", **number, "metadata": None},
            {"name": "task", "field_name": "task", **text, "metadata": None},
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.2.0",
    }
    table = pa.table({"task_index": pa.array(tasks.values(), pa.int64()), "task": pa.array(tasks.keys(), pa.string())})
    return table.replace_schema_metadata({"pandas": json.dumps(described)})


def _sizes_text(sizes: Mapping[str, tuple[int, int]]) -> str:
    return ", ".join(f"{camera} ({size[1]}x{size[0]})" for camera, size in sizes.items()) or "no camera"
