"""What clients want of cameras, and the process that draws it: started by the first wish, ended when there are no more.

Wishes for the same picture share it, and the same picture is not drawn more often than `MOST_HZ`. One is drawn at a
time, in turns; the state it shows is that of the moment when its turn came.
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

MOST_HZ: Final = 30.0
"""Pictures of one camera in one form a second, however many look (guess: what cameras of cells do)."""

_PIECE: Final = 64 * 1024  # bytes of a picture that are read, and sent, at once
_IDLE_S: Final = 5.0  # without a wish, and the process ends (guess)
_DRAWS_S: Final = 60.0  # for one picture: a machine without a graphics card takes part of a second (guess)
_AGAIN_S: Final = 5.0  # after a failure, whose reason is the answer until then (guess)
_GOODBYE_S: Final = 10.0  # guess: what is killed ends at once, but on a very busy machine

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Picture:
    """parts: its bytes, in pieces to be sent at once. time_s: the robot's. pose: of the optical frame, in base."""

    parts: Sequence[bytes]
    time_s: float
    pose: Pose

    @property
    def size(self) -> int:
        """Bytes of it."""
        return sum(map(len, self.parts))


class CannotDraw(Exception):  # noqa: N818 - an answer
    """There is no picture: why, in a line."""


Take = Callable[[Picture | CannotDraw], None]


class Drawing:
    """Draws a world. now_s: the robot's time. Use it in an event loop, and close it."""

    def __init__(self, world: "PhysicsWorld", now_s: Callable[[], float]) -> None:
        from emulator.physics.drawing import first_message

        self._world = world
        self._now_s = now_s
        self._scene = first_message(world)  # here, at the start: a large model takes many control periods
        self._wishes: dict[tuple[str, str], list[Take]] = {}  # by camera and form
        self._drawn_s: dict[tuple[str, str], float] = {}
        self._news = asyncio.Event()
        self._working: asyncio.Task[None] | None = None
        self._tasks: set[asyncio.Task[None]] = set()  # that one, and those that still see a process end
        self._failed: tuple[float, CannotDraw] | None = None

    @property
    def at_work(self) -> bool:
        """Whether there is a process now, or one begins."""
        return self._working is not None

    def want(self, name: str, form: str, take: Take) -> None:
        """Have a picture taken from now on; ``take`` is given it, or why there is none."""
        if self._failed is not None and self._failed[0] > asyncio.get_running_loop().time():
            take(self._failed[1])
            return
        self._wishes.setdefault((name, form), []).append(take)
        self._news.set()
        if self._working is None:
            self._working = asyncio.get_running_loop().create_task(self._work())
            self._tasks.add(self._working)
            self._working.add_done_callback(self._tasks.discard)

    def forget(self, take: Take) -> None:
        """Who wanted it has gone."""
        for key, takes in tuple(self._wishes.items()):
            if take in takes:
                takes.remove(take)
            if not takes:
                del self._wishes[key]

    async def close(self) -> None:
        """End the process."""
        if self._working is not None:
            self._working.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks)

    async def _work(self) -> None:
        """Draw what is wanted until nothing has been for a while."""
        key: tuple[str, str] | None = None
        takes: list[Take] = []
        process: Process | None = None
        try:
            process = await self._start()
            while (key := await self._next()) is not None:
                takes = self._wishes.pop(key)
                picture = await self._draw(process, *key)
                for take in takes:
                    take(picture)
                takes = []
        except (CannotDraw, OSError, TimeoutError, ValueError) as error:
            why = error if isinstance(error, CannotDraw) else CannotDraw(_lost(error))
            _logger.warning("cameras: %s", why)
            self._failed = asyncio.get_running_loop().time() + _AGAIN_S, why
            takes += [take for wished in self._wishes.values() for take in wished]
            self._wishes.clear()
            for take in takes:
                take(why)
        finally:
            self._working = None
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

    async def _next(self) -> tuple[str, str] | None:
        """The wish whose turn it is, when it is time for it; None when there is none for a while."""
        loop = asyncio.get_running_loop()
        idle_at_s = loop.time() + _IDLE_S
        while True:
            self._news.clear()
            due_s = {key: self._drawn_s.get(key, -1e9) + 1.0 / MOST_HZ for key in self._wishes}
            if due_s:
                key = min(due_s, key=due_s.__getitem__)  # who was not drawn longest is the first
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
                    await self._news.wait()

    async def _draw(self, process: Process, name: str, form: str) -> Picture:
        """Raises CannotDraw, OSError, TimeoutError, ValueError."""
        from emulator.physics.cameras import CameraError
        from emulator.physics.drawing import HEADER, pose_of_picture, request

        assert process.stdin is not None
        assert process.stdout is not None
        time_s = self._now_s()
        process.stdin.write(request(self._world, name, form))
        async with timeout(_DRAWS_S):
            try:
                said, size = HEADER.unpack(await process.stdout.readexactly(HEADER.size))
                message = json.loads(await process.stdout.readexactly(said))
                parts = []
                while size:
                    parts.append(await process.stdout.readexactly(min(size, _PIECE)))
                    size -= len(parts[-1])
                return Picture(parts, time_s, pose_of_picture(message))
            except asyncio.IncompleteReadError as error:
                raise CannotDraw(_lost(error)) from error
            except CameraError as error:
                raise CannotDraw(str(error)) from error


def _lost(error: Exception) -> str:
    what = "takes too long" if isinstance(error, TimeoutError) else "has ended"
    if isinstance(error, OSError) and error.strerror:
        what = f"is not there ({error.strerror})"
    return f"the process that draws pictures {what}: its last words are among the emulator's"


async def _end(process: Process) -> None:
    """Without waiting for the picture that it draws; what it has written of one is read, or its pipe stays open."""
    with suppress(ProcessLookupError):
        process.kill()
    with suppress(TimeoutError):
        async with timeout(_GOODBYE_S):
            await process.communicate()
