"""A recorder in a separate process, for programs that must not be delayed, such as a control loop.

Writing a state takes some tenths of a millisecond, and several milliseconds when a chunk is compressed. A call here
takes microseconds: a thread passes the states to the process, which writes the file with `Recorder`. The process
finishes the file properly even if this program dies; only an earlier recording is not replaced then.
"""

import json
import logging
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from queue import SimpleQueue
from types import SimpleNamespace
from typing import IO, Any, BinaryIO, Final, NamedTuple

from client.errors import RecordingError
from client.recording.files import Recorder, field_names
from client.recording.recording import DEFAULT_FIELDS, Info
from client.recording.topics import POINT_FIELDS, POINTS
from urproto.compat import Self

_READY: Final = b"ready\n"
_ENDS_S: Final = 30.0  # guess: compressing an hour of npz takes less
# isolated, because a folder of the user may have the name of a module; the search path is this program's
_PROGRAM: Final = "import sys, json; sys.path[:] = json.loads(sys.argv[1]); from client.recording import background"
_COMMAND: Final = ("-I", "-c", f"{_PROGRAM}; sys.exit(background.work(sys.stdin.buffer))")

_logger = logging.getLogger(__name__)


class _Markers(NamedTuple):
    """Arguments of `Recorder.write_markers`."""

    topic: str
    markers: Sequence[Mapping[str, Any]]
    time_s: float


class BackgroundRecorder:
    """Like `Recorder`, callable from any thread; use it with ``with``, which also finishes the file.

    If the file can no longer be written, that is logged once and raised by `close`; the calls in between do not fail.
    Raises RecordingError.
    """

    def __init__(self, path: Path | str, names: Iterable[str] = DEFAULT_FIELDS, info: Info | None = None) -> None:
        self.path = Path(path)
        self.names = field_names(names)
        self.count = 0
        self._queue: SimpleQueue[Any] = SimpleQueue()
        self._open = True
        self._process = subprocess.Popen(
            (sys.executable, *_COMMAND, json.dumps(sys.path)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for this program, which then finishes the file
        )
        pipe = self._process.stdin
        assert pipe
        self._send(pipe, (str(self.path), self.names, dict(info or {})))
        self._check_ready()
        self._thread = threading.Thread(target=self._feed, args=(pipe,), name="recorder", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, values: Mapping[str, Any]) -> None:
        """Add a state; more variables than the recording's do no harm."""
        self._queue.put([values[name] for name in self.names])  # the first is the timestamp
        self.count += 1

    def write_controller(self, controller: str, state: Any) -> None:
        """Add the state of a trajectory controller; see `Recorder.write_controller`."""
        self._queue.put((controller, state))

    def write_markers(self, topic: str, markers: Sequence[Mapping[str, Any]], time_s: float) -> None:
        """Add markers for 3D views; see `Recorder.write_markers`. Errors in them are raised by `close`."""
        self._queue.put(_Markers(topic, markers, time_s))

    def close(self) -> None:
        """Finish the file. Raises RecordingError if part of it could not be written."""
        if not self._open:
            return
        self._open = False
        self._queue.put(None)
        self._thread.join()
        if self._wait():
            raise self._failure()
        self._close_pipes()

    def _check_ready(self) -> None:
        assert self._process.stdout
        if self._process.stdout.readline() != _READY:
            raise self._failure()

    def _feed(self, pipe: IO[bytes]) -> None:
        try:
            while (item := self._queue.get()) is not None:
                self._send(pipe, _plain(item))
            self._send(pipe, None)
            pipe.close()
        except OSError:  # the process has ended
            _logger.error("%s can no longer be written", self.path)

    def _send(self, pipe: IO[bytes], item: Any) -> None:
        pickle.dump(item, pipe, protocol=pickle.HIGHEST_PROTOCOL)
        if self._queue.empty():
            pipe.flush()

    def _wait(self) -> int:
        try:
            return self._process.wait(_ENDS_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def _failure(self) -> RecordingError:
        """The error that the process printed before it ended."""
        assert self._process.stderr
        errors = self._process.stderr.read().decode(errors="replace").strip().splitlines()
        self._wait()
        self._close_pipes()
        return RecordingError(errors[-1] if errors else f"{self.path}: the process that writes it was killed")

    def _close_pipes(self) -> None:
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            assert pipe
            try:
                pipe.close()
            except OSError:  # unwritten data for a process that has ended
                continue


def _plain(item: Any) -> Any:
    """A controller's state in the form that the other process knows; anything else unchanged."""
    if isinstance(item, _Markers) or not isinstance(item[0], str):
        return item
    name, state = item
    points = {point: _copied(getattr(state, point), *POINT_FIELDS) for point in POINTS}
    return name, SimpleNamespace(**vars(_copied(state, "time_s", "joint_names")), **points)


def _copied(source: Any, *names: str) -> SimpleNamespace:
    return SimpleNamespace(**{name: getattr(source, name) for name in names})


# the process


def work(pipe: BinaryIO) -> int:
    """Record everything that arrives through a pipe until its end; return the exit status."""
    path, names, info = pickle.load(pipe)
    problem = ""
    try:
        with Recorder(path, names, info) as recorder:
            sys.stdout.buffer.write(_READY)
            sys.stdout.buffer.flush()
            for item in iter(_reader_of(pipe, path), None):
                if isinstance(item, _Markers):
                    problem = _write_markers(recorder, item) or problem
                elif isinstance(item[0], str):
                    recorder.write_controller(*item)
                else:
                    recorder.write(dict(zip(recorder.names, item, strict=True)))
    except RecordingError as error:
        problem = str(error)
    except OSError as error:
        problem = f"cannot write {path}: {error.strerror}"
    if problem:
        sys.stderr.write(f"{problem}\n")
    return 1 if problem else 0


def _write_markers(recorder: Recorder, item: _Markers) -> str:
    """Write markers; return what is wrong with them. The recording continues without them."""
    try:
        recorder.write_markers(*item)
    except RecordingError as error:
        return str(error)
    return ""


def _reader_of(pipe: BinaryIO, path: str) -> Callable[[], Any]:
    """A function that returns the next item, or None at the end. Raises RecordingError if the sender has died."""

    def read() -> Any:
        try:
            return pickle.load(pipe)
        except (EOFError, pickle.UnpicklingError):
            raise RecordingError(f"{path}: the program has ended before its recording") from None

    return read
