"""A process whose threads, clocks and event loops run in virtual time, one thread at a time, and repeatably.

    with World(seed=7) as world:
        threading.Thread(target=work).start()       # waits, sleeps and event loops take no time of ours
        time.sleep(3600.0)

Inside the context the standard library's threads, locks, sleeps and clocks are those of the world. A thread runs until
it waits for something; then the next one runs, chosen by the seed among those that can. If none can, time jumps to the
next event. A thread may also be interrupted where it takes a lock or sends (`World.interrupt`), as threads are.

Nothing of the system under test is replaced: asyncio's loops, `threading.Condition` and the executors of
`concurrent.futures` are the standard library's, on these locks and on the selector of `network.py`.
"""

import _thread
import heapq
import itertools
import queue
import secrets
import sys
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import ExitStack
from hashlib import blake2b
from random import Random
from typing import Any, Final
from unittest.mock import patch

from urproto.compat import Self

_LOOK_S: Final = 1e-6  # that a look at the clock takes, so that a loop that polls it comes to an end
_BEGIN_S: Final = 1000.0  # of the monotonic clock; an uptime, unlike 0, is not mistaken for "never"
_EPOCH_S: Final = 1.7e9  # of the wall clock, at the beginning
_MAX_AT_ONCE: Final = 200_000  # events without a pause: more is a loop without an end


class HangError(Exception):
    """The limit of virtual time has passed: a call has not returned. The message shows where every thread waits."""


class Killed(SystemExit):
    """Ends a thread that is still there when its world ends."""


class SimulatedThread(threading.Thread):
    """A thread of a world. host: the machine it runs on, that of the thread that created it by default."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.world = _world()
        self.host = self.world.current.host if self.world.current is not None else ""
        self.gate = _thread.allocate_lock()
        self.gate.acquire()
        self.waiting = False  # may be woken
        self.woken = False  # by something other than the end of its time
        self.killed = False
        self.alive = False
        self.stalled_until_s = 0.0
        self.timer: object = None  # identifies the time until which it waits
        self.joining: list[SimulatedThread] = []
        self.ident_of_system = 0

    def start(self) -> None:
        self.alive = True
        self.world.threads.append(self)
        self.world.ready.append(self)
        _thread.start_new_thread(self._body, ())

    def _body(self) -> None:
        self.ident_of_system = _thread.get_ident()
        self.gate.acquire()
        try:
            if not self.killed:
                self.run()
        except SystemExit:
            pass
        except BaseException as error:
            self.world.failures.append(f"{self.name} ended with {error!r}:\n{traceback.format_exc()}")
        finally:
            self.world.ended(self)

    def is_alive(self) -> bool:
        return self.alive

    def join(self, timeout: float | None = None) -> None:
        until = None if timeout is None else self.world.now + timeout
        while self.alive:
            self.joining.append(self.world.here)
            if not self.world.wait(until):
                break


class SimulatedLock:
    """A lock of a world."""

    def __init__(self) -> None:
        self._world = _world()
        self._locked = False
        self._waiting: list[SimulatedThread] = []

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        self._world.interrupt()
        until = None if timeout < 0 else self._world.now + timeout
        while self._locked:
            if not blocking:
                return False
            me = self._world.here
            self._waiting.append(me)
            woken = self._world.wait(until)
            if me in self._waiting:
                self._waiting.remove(me)
            if not woken and self._locked:
                return False
        self._locked = True
        return True

    def release(self) -> None:
        if not self._locked:
            raise RuntimeError("release unlocked lock")
        self._locked = False
        if self._waiting:
            self._world.wake(self._waiting.pop(0))

    def locked(self) -> bool:
        return self._locked

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class World:
    """Virtual time, and the threads in it; the thread that enters it is the first. Only one exists at a time.

    interruptions: probability that a thread is interrupted where it takes a lock or sends. limit_s: of virtual time,
    after which the world fails with `HangError`.
    """

    def __init__(self, seed: int, host: str = "", interruptions: float = 0.02, limit_s: float = 3600.0) -> None:
        self.random = Random(seed)
        self.now = _BEGIN_S
        self.limit_s = _BEGIN_S + limit_s
        self.interruptions = interruptions
        self.threads: list[SimulatedThread] = []
        self.ready: list[SimulatedThread] = []
        self.failures: list[str] = []
        self.current: SimulatedThread | None = None
        self.events = 0
        self.trace: Callable[[str], object] | None = None
        self._hash = blake2b(digest_size=8)
        self._host = host
        self._due: list[tuple[float, int, Callable[[], object]]] = []
        self._numbers = itertools.count()
        self._at_once = 0
        self._in_event = False
        self._patches = ExitStack()

    # the clock

    @property
    def elapsed_s(self) -> float:
        """Virtual time since the beginning [s]."""
        return self.now - _BEGIN_S

    def monotonic(self) -> float:
        """The clock, for the programs in this world."""
        self.now += _LOOK_S
        return self.now

    def sleep(self, seconds: float) -> None:
        """Let time pass for the calling thread."""
        self.wait(self.now + max(seconds, _LOOK_S))

    def call_at(self, when_s: float, event: Callable[[], object]) -> None:
        """Do something at a time of this clock; it must not wait."""
        heapq.heappush(self._due, (max(when_s, self.now), next(self._numbers), event))

    def call_later(self, delay_s: float, event: Callable[[], object]) -> None:
        """Do something after some time; it must not wait."""
        self.call_at(self.now + delay_s, event)

    # what happened

    def note(self, text: str) -> None:
        """Enter an event into the log, of which `digest` is the hash."""
        line = f"{self.elapsed_s:.6f} {text}"
        self._hash.update(line.encode())
        if self.trace is not None:
            self.trace(line)

    @property
    def digest(self) -> str:
        """Hash of all that was noted: the same in each run with the same seed."""
        return self._hash.hexdigest()

    # threads

    @property
    def here(self) -> SimulatedThread:
        """The running thread."""
        assert self.current is not None
        return self.current

    def wait(self, until_s: float | None) -> bool:
        """Wait until the calling thread is woken; False if the time comes first."""
        me = self.here
        me.waiting, me.woken = True, True
        if until_s is not None:
            marker = object()
            me.timer = marker
            self.call_at(until_s, lambda: self._time_out(me, marker))
        self._run_next(me)
        me.timer = None
        return me.woken

    def wake(self, thread: SimulatedThread) -> None:
        """Let a waiting thread run, when it is its turn."""
        if not thread.waiting:
            return
        if thread.stalled_until_s > self.now:
            self.call_at(thread.stalled_until_s, lambda: self.wake(thread))
            return
        thread.waiting = False
        self.ready.append(thread)

    def stall(self, host: str, seconds: float) -> None:
        """The threads of a machine get no processor for some time."""
        self.note(f"{host} stands still {seconds:.3f}")
        for thread in self.threads:
            if thread.host == host:
                thread.stalled_until_s = max(thread.stalled_until_s, self.now + seconds)

    def interrupt(self) -> None:
        """Perhaps let another thread run first."""
        if not self._in_event and self.current is not None and self.random.random() < self.interruptions:
            self.ready.append(self.current)
            self._run_next(self.current)

    def ended(self, thread: SimulatedThread) -> None:
        """Called by a thread as its last act."""
        thread.alive = False
        self.threads.remove(thread)
        for waiting in thread.joining:
            self.wake(waiting)
        self._next().gate.release()

    def _time_out(self, thread: SimulatedThread, marker: object) -> None:
        if thread.waiting and thread.timer is marker:
            thread.woken = False
            self.wake(thread)

    def _run_next(self, me: SimulatedThread) -> None:
        following = self._next()
        if following is not me:
            following.gate.release()
            me.gate.acquire()
        self.current = me
        if me.killed:
            raise Killed
        if self.now > self.limit_s and me is self._main:
            self.limit_s = float("inf")
            raise HangError(self.describe_threads())

    def _next(self) -> SimulatedThread:
        """Let events happen until a thread can run, and choose it."""
        while not self.ready:
            if not self._due or self.now > self.limit_s:
                self.now = max(self.now, self.limit_s) + 1.0
                self._main.woken = self._main.waiting = False
                return self._main
            when_s, _, event = heapq.heappop(self._due)
            self._at_once = self._at_once + 1 if when_s <= self.now else 0
            if self._at_once > _MAX_AT_ONCE:
                self.limit_s = self.now
            self.now = max(self.now, when_s)
            self.events += 1
            self._in_event = True
            try:
                event()
            finally:
                self._in_event = False
        ready = self.ready
        chosen = ready.pop(self.random.randrange(len(ready)) if len(ready) > 1 else 0)
        self.current = chosen
        return chosen

    def describe_threads(self) -> str:
        """Where each thread is."""
        frames = sys._current_frames()
        texts = [f"virtual time is over, after {self.elapsed_s:.1f} s"]
        for thread in self.threads:
            frame = frames.get(thread.ident_of_system)
            texts.append(f"{thread.name}:\n{''.join(traceback.format_stack(frame)[-6:]) if frame else ''}")
        return "\n".join(texts)

    # beginning and end

    def __enter__(self) -> Self:
        global _current
        assert _current is None, "one world at a time"
        _current = self
        self._main = main = SimulatedThread(name="main")
        main.host, main.alive, main.ident_of_system = self._host, True, _thread.get_ident()
        self.threads.append(main)
        self.current = main
        for module, names in self._replacements().items():
            for name, replacement in names.items():
                self._patches.enter_context(patch.object(module, name, replacement))
        return self

    def __exit__(self, *_: object) -> None:
        global _current
        self.limit_s = float("inf")
        self.interruptions = 0.0
        self._due.clear()  # nothing happens any more
        others = [one for one in self.threads if one is not self._main]
        for thread in others:
            thread.killed = True
        for thread in others:
            while thread.alive:
                thread.waiting = False
                if thread not in self.ready:
                    self.ready.append(thread)
                self.ready.append(self._main)
                self._run_next(self._main)
        self._patches.close()
        _current = None

    def _replacements(self) -> dict[Any, dict[str, Any]]:
        nanoseconds = lambda: round(self.monotonic() * 1e9)  # noqa: E731
        wall_s = lambda: self.monotonic() - _BEGIN_S + _EPOCH_S  # noqa: E731
        return {
            time: {
                "monotonic": self.monotonic,
                "perf_counter": self.monotonic,
                "monotonic_ns": nanoseconds,
                "perf_counter_ns": nanoseconds,
                "time": wall_s,
                "time_ns": lambda: round(wall_s() * 1e9),
                "sleep": self.sleep,
                "clock_gettime": lambda clock: self.monotonic(),
                "thread_time": lambda: 0.0,
                "process_time": lambda: 0.0,
            },
            threading: {
                "Thread": SimulatedThread,
                "Lock": SimulatedLock,
                "RLock": threading._PyRLock,  # type: ignore[attr-defined]
                "_allocate_lock": SimulatedLock,
                "_time": self.monotonic,
                "current_thread": lambda: self.here,
            },
            queue: {"SimpleQueue": queue._PySimpleQueue, "time": self.monotonic},  # type: ignore[attr-defined]
            secrets: {"token_hex": lambda count=32: f"{self.random.getrandbits(8 * count):0{2 * count}x}"},
        }


_current: World | None = None


def _world() -> World:
    assert _current is not None, "not in a world"
    return _current
