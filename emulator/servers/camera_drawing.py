"""Requests for camera pictures, and the process that draws them.

The first request starts the process; it is stopped after a while without requests. Requests for the same picture share
the result, and the same picture is drawn at most `MAX_HZ` times a second. Pictures are drawn one at a time, in turn,
each from the state at the moment when drawing starts.
"""

import asyncio
import json
import logging
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from urproto.compat_asyncio import timeout
from urproto.robots.pose import Pose

if TYPE_CHECKING:
    from emulator.physics.world import PhysicsWorld

MAX_HZ: Final = 30.0
"""Maximum rate of one camera in one form, for any number of viewers (guess: the rate of cameras in robot cells)."""

_PIECE: Final = 64 * 1024  # bytes of a picture that are read and sent in one go
_IDLE_S: Final = 5.0  # time without requests after which the process is stopped (guess)
_DRAW_TIMEOUT_S: Final = 60.0  # for one picture (guess: without a graphics card one takes a fraction of a second)
_RETRY_S: Final = 5.0  # after a failure; until then its reason is the answer to every request (guess)
_EXIT_TIMEOUT_S: Final = 10.0  # guess: a killed process ends immediately, except on a very busy machine

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture. parts: its bytes, each sent in one go. time_s: robot time. pose: optical frame in the base frame."""

    parts: Sequence[bytes]
    time_s: float
    pose: Pose

    @property
    def size(self) -> int:
        return sum(map(len, self.parts))


class DrawingError(Exception):
    """A picture cannot be drawn; the text is the reason, in one line."""


PictureCallback = Callable[[Picture | DrawingError], None]


class Drawing:
    """Draws pictures of a world. now_s: returns the robot time. Use it in an event loop, and close it."""

    def __init__(self, world: "PhysicsWorld", now_s: Callable[[], float]) -> None:
        from emulator.physics.drawing import first_message

        self._world = world
        self._now_s = now_s
        # encoded when the port opens, before the robot runs: a large model takes as long as many control periods
        self._scene = first_message(world)
        self._requests: dict[tuple[str, str], list[PictureCallback]] = {}  # by camera and form
        self._drawn_s: dict[tuple[str, str], float] = {}
        self._new_request = asyncio.Event()
        self._worker: asyncio.Task[None] | None = None
        self._tasks: set[asyncio.Task[None]] = set()  # the worker, and former ones whose process is still ending
        self._failed: tuple[float, DrawingError] | None = None

    @property
    def at_work(self) -> bool:
        """Whether the process is running or being started."""
        return self._worker is not None

    def request(self, name: str, form: str, callback: PictureCallback) -> None:
        """Request a picture that is not older than the request; ``callback`` gets it, or the reason for a failure."""
        if self._failed is not None and self._failed[0] > asyncio.get_running_loop().time():
            callback(self._failed[1])
            return
        self._requests.setdefault((name, form), []).append(callback)
        self._new_request.set()
        if self._worker is None:
            self._worker = asyncio.get_running_loop().create_task(self._work())
            self._tasks.add(self._worker)
            self._worker.add_done_callback(self._tasks.discard)

    def remove(self, callback: PictureCallback) -> None:
        """Drop the requests of a client that has disconnected."""
        for key, callbacks in tuple(self._requests.items()):
            if callback in callbacks:
                callbacks.remove(callback)
            if not callbacks:
                del self._requests[key]

    async def close(self) -> None:
        if self._worker is not None:
            self._worker.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks)

    async def _work(self) -> None:
        """Draw the requested pictures until there has been no request for a while."""
        key: tuple[str, str] | None = None
        callbacks: list[PictureCallback] = []
        process: Process | None = None
        try:
            process = await self._start()
            while (key := await self._next_due()) is not None:
                callbacks = self._requests.pop(key)
                picture = await self._draw(process, *key)
                for callback in callbacks:
                    callback(picture)
                callbacks = []
        except (DrawingError, OSError, TimeoutError, ValueError) as error:
            reason = error if isinstance(error, DrawingError) else DrawingError(_lost(error))
            _logger.warning("cameras: %s", reason)
            self._failed = asyncio.get_running_loop().time() + _RETRY_S, reason
            callbacks += [callback for pending in self._requests.values() for callback in pending]
            self._requests.clear()
            for callback in callbacks:
                callback(reason)
        finally:
            self._worker = None
            if process is not None:
                await _end(process)

    async def _start(self) -> Process:
        from emulator.physics.drawing import command

        process = await asyncio.create_subprocess_exec(*command(), stdin=PIPE, stdout=PIPE, limit=_PIECE)
        assert process.stdin is not None
        try:
            for start in range(0, len(self._scene), _PIECE):
                process.stdin.write(self._scene[start : start + _PIECE])
                await process.stdin.drain()
        except BaseException:
            await _end(process)
            raise
        return process

    async def _next_due(self) -> tuple[str, str] | None:
        """Wait until a request is due and return its key; None if there has been no request for a while."""
        loop = asyncio.get_running_loop()
        idle_at_s = loop.time() + _IDLE_S
        while True:
            self._new_request.clear()
            due_s = {key: self._drawn_s.get(key, -1e9) + 1.0 / MAX_HZ for key in self._requests}
            if due_s:
                key = min(due_s, key=due_s.__getitem__)  # the one that was drawn least recently
                if due_s[key] <= loop.time():
                    self._drawn_s[key] = loop.time()
                    return key
                wait_s = due_s[key] - loop.time()
            else:
                wait_s = idle_at_s - loop.time()
                if wait_s <= 0.0:
                    return None
            with suppress(TimeoutError):
                async with timeout(wait_s):
                    await self._new_request.wait()

    async def _draw(self, process: Process, name: str, form: str) -> Picture:
        """Raises DrawingError, OSError, TimeoutError, ValueError."""
        from emulator.physics.cameras import CameraError
        from emulator.physics.drawing import HEADER, pose_of_picture, request

        assert process.stdin is not None
        assert process.stdout is not None
        time_s = self._now_s()
        process.stdin.write(request(self._world, name, form))
        async with timeout(_DRAW_TIMEOUT_S):
            try:
                length, size = HEADER.unpack(await process.stdout.readexactly(HEADER.size))
                message = json.loads(await process.stdout.readexactly(length))
                parts = []
                while size:
                    parts.append(await process.stdout.readexactly(min(size, _PIECE)))
                    size -= len(parts[-1])
                return Picture(parts, time_s, pose_of_picture(message))
            except asyncio.IncompleteReadError as error:
                raise DrawingError(_lost(error)) from error
            except CameraError as error:
                raise DrawingError(str(error)) from error


def _lost(error: Exception) -> str:
    what = "takes too long" if isinstance(error, TimeoutError) else "has ended"
    if isinstance(error, OSError) and error.strerror:
        what = f"is not available ({error.strerror})"
    return f"the process that draws pictures {what}: its error output is among that of the emulator"


async def _end(process: Process) -> None:
    """Kill the process without waiting for its picture; unread output is read, since otherwise the pipe stays open."""
    with suppress(ProcessLookupError):
        process.kill()
    with suppress(TimeoutError):
        async with timeout(_EXIT_TIMEOUT_S):
            await process.communicate()
