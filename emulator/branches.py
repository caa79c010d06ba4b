"""Copies of a robot that go on by themselves, each in a copy of this process.

A running program is a stack of Python frames, which nothing but the system can copy: `os.fork` does, in milliseconds.
"""

import os
import signal
import warnings
import weakref
from multiprocessing.connection import Connection, Pipe
from multiprocessing.reduction import recv_handle, send_handle
from types import TracebackType
from typing import Any, NoReturn

from emulator.control.control import Control, VerbMethods
from urproto.compat import Self
from urproto.controlapi import NotPossible

_open: "weakref.WeakSet[Branch]" = weakref.WeakSet()  # of this process: its copies must not keep their connections


def can_branch() -> bool:
    """Whether the system can copy processes."""
    return hasattr(os, "fork")


def branch(robot: Control) -> "Branch":
    """Copy this process, and with it the robot as it is. Raises OSError if the system has no room for a process."""
    mine, its = Pipe()
    if (process := _fork()) == 0:
        mine.close()
        _serve(robot, its)
    its.close()
    return Branch(mine, process)


class Branch(VerbMethods):
    """A robot in another process: it has the verbs of a robot as methods, and is at its own moment.

    Time passes only in the verbs that wait, so a branch that only branches is a checkpoint. Use it with ``with``, or
    close it.
    """

    def __init__(self, connection: Connection, process: int | None) -> None:
        self._connection = connection
        self._ended = weakref.finalize(self, _end, connection, process)
        _open.add(self)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "controller":
            raise AttributeError(f"{name}: a branch is in another process, and has verbs only")
        return lambda *values, **named: self._ask(name, values, named)

    @property
    def journal(self) -> bytes:
        """The run so far, for ``ur-emulator replay``."""
        journal: bytes = self._ask("journal", (), {})
        return journal

    def branch(self) -> "Branch":
        """Another robot that goes on from this moment."""
        mine, its = Pipe()
        with its:
            self._connection.send(None)
            send_handle(self._connection, its.fileno(), None)
            self._answer()
        return Branch(mine, None)

    def close(self) -> None:
        """End the branch and its process."""
        self._ended()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _ask(self, name: str, values: tuple[Any, ...], named: dict[str, Any]) -> Any:
        if not self._ended.alive:
            raise NotPossible("the branch is closed")
        self._connection.send((name, values, named))
        return self._answer()

    def _answer(self) -> Any:
        try:
            failed, result = self._connection.recv()
        except (EOFError, OSError) as error:
            raise NotPossible("the process of the branch has ended") from error
        if failed:
            raise result
        return result


def _fork() -> int:
    with warnings.catch_warnings():
        # of threads, which the copy does not have: it needs none, and takes no lock that one of them may hold
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _end(connection: Connection, process: int | None) -> None:
    connection.close()
    if process is not None:  # else it is the child of a branch, which waits for it
        os.waitpid(process, 0)


def _serve(robot: Control, connection: Connection) -> NoReturn:
    """What the copy of a process does: answer, until nobody is left to ask."""
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is for whoever has branched
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the system itself removes branches that are over
        for other in tuple(_open):
            other._ended.detach()
            other._connection.close()
        while True:
            request = connection.recv()
            if request is None:
                connection = _branched(connection)
                continue
            name, values, named = request
            try:
                answer = False, _member(robot, name, values, named)
            except Exception as error:
                answer = True, error
            _send(connection, answer)
    except EOFError:
        pass
    finally:
        os._exit(0)  # without what the original does at its end


def _member(robot: Control, name: str, values: tuple[Any, ...], named: dict[str, Any]) -> Any:
    member = getattr(robot, name)
    return member(*values, **named) if callable(member) else member


def _send(connection: Connection, answer: tuple[bool, Any]) -> None:
    try:
        connection.send(answer)
    except Exception:  # whatever pickle raises
        connection.send((True, NotPossible(f"{answer[1]!r} cannot leave the process of the branch")))


def _branched(connection: Connection) -> Connection:
    """Copy the process for another branch; returns the connection that this process answers on now."""
    its = Connection(recv_handle(connection))
    if _fork() == 0:
        connection.close()
        return its
    its.close()
    connection.send((False, None))
    return connection
