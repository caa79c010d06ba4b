"""Copies of a robot that go on by themselves, each in a copy of this process.

A running program is a stack of Python frames, which nothing but the system can copy: `os.fork` does, in milliseconds.
"""

import os
import signal
import sys
import warnings
import weakref
from multiprocessing.connection import Connection, Pipe
from multiprocessing.reduction import recv_handle, send_handle
from pickle import PicklingError
from typing import Any, Final, NoReturn

from emulator.control.control import VerbMethods
from urproto.compat import Self
from urproto.controlapi import NotPossible

Call = tuple[tuple[Any, ...], dict[str, Any]]
_NO_COPIES: Final = "this system cannot copy processes"
_COPY: Final = None  # the request for another copy

_open: "weakref.WeakSet[Copied]" = weakref.WeakSet()  # of this process: its copies must not keep their connections


def can_branch() -> bool:
    """Whether the system can copy processes."""
    return sys.platform != "win32"


class Copied:
    """An object in a copy of this process, whose methods are called by name. Use it with ``with``, or close it.

    Exceptions that a method raises are raised here. The process ends when it is closed, or with this one.
    """

    def __init__(self, connection: Connection, process: int | None) -> None:
        self.connection = connection
        self._ended = weakref.finalize(self, _end, connection, process)
        _open.add(self)

    @classmethod
    def of(cls, subject: object) -> "Copied":
        """Copy this process, and with it the object as it is. Raises OSError if there is no room for a process."""
        if sys.platform == "win32":
            raise OSError(_NO_COPIES)
        mine, its = Pipe()
        if (process := _fork()) == 0:
            mine.close()
            _serve(subject, its)
        its.close()
        return cls(mine, process)

    def copy(self) -> "Copied":
        """Another copy of the object as it is there."""
        if sys.platform == "win32":
            raise OSError(_NO_COPIES)
        mine, its = Pipe()
        with its:
            self._send(_COPY)
            send_handle(self.connection, its.fileno(), None)
            self.result()
        return Copied(mine, None)

    def ask(self, name: str, *values: Any, **named: Any) -> Any:
        """Call a method and return its result; or return an attribute."""
        self.start(name, *values, **named)
        return self.result()

    def start(self, name: str, *values: Any, **named: Any) -> None:
        """Call a method, whose `result` is taken later; the connection can be read then."""
        self._send((name, values, named))

    def result(self) -> Any:
        """The result of the call that was started. Raises what it raised, or NotPossible if the process has ended."""
        try:
            failed, result = self.connection.recv()
        except (EOFError, OSError) as error:
            raise NotPossible("the process of the copy has ended") from error
        if failed:
            raise result
        return result

    def close(self) -> None:
        self._ended()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def forget(self) -> None:
        """In a copy of the process that made this one: leave it to the original."""
        self._ended.detach()
        self.connection.close()

    def _send(self, request: Any) -> None:
        if not self._ended.alive:
            raise NotPossible("the branch is closed")
        try:
            self.connection.send(request)
        except OSError as error:
            raise NotPossible("the process of the copy has ended") from error


class Branch(VerbMethods):
    """A robot in another process: it has the verbs of a robot as methods, and is at its own moment.

    Time passes only in the verbs that wait, so a branch that only branches is a checkpoint. Use it with ``with``, or
    close it.
    """

    def __init__(self, robot: Copied) -> None:
        self._copied = robot

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "controller":
            raise AttributeError(f"{name}: a branch is in another process, and has verbs only")
        return lambda *values, **named: self._copied.ask(name, *values, **named)

    @property
    def journal(self) -> bytes:
        journal: bytes = self._copied.ask("journal")
        return journal

    def branch(self) -> "Branch":
        """Another robot that goes on from this moment."""
        return Branch(self._copied.copy())

    def close(self) -> None:
        self._copied.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _fork() -> int:
    if sys.platform == "win32":
        raise OSError(_NO_COPIES)
    with warnings.catch_warnings():
        # of threads, which the copy does not have: it needs none, and takes no lock that one of them may hold
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _end(connection: Connection, process: int | None) -> None:
    connection.close()
    if process is not None:  # else it is the child of a copy, in which the system removes it
        os.waitpid(process, 0)


def _serve(subject: object, connection: Connection) -> NoReturn:
    """What the copy of a process does: answer, until nobody is left to ask."""
    if sys.platform == "win32":
        raise OSError(_NO_COPIES)
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is for whoever has made the copy
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the system itself removes copies that are over
        for other in tuple(_open):
            other.forget()
        Server(subject, connection).serve()
    except (EOFError, OSError):
        pass
    finally:
        os._exit(0)  # without what the original does at its end


class Server:
    """Calls methods of an object for the process that has made this copy.

    A method that needs to say something before it is over calls `pause` of the object's attribute ``server``.
    """

    def __init__(self, subject: object, connection: Connection) -> None:
        self._subject = subject
        self._connection = connection
        if hasattr(subject, "server"):
            subject.server = self

    def serve(self, until: str = "") -> Call:
        """Answer until a method of a certain name is called; returns its arguments. Raises EOFError in the end."""
        while True:
            request = self._connection.recv()
            if request is _COPY:
                self._connection = _copied(self._connection)
                continue
            name, values, named = request
            if name == until:
                return values, named
            try:
                member = getattr(self._subject, name)
                answer = False, member(*values, **named) if callable(member) else member
            except Exception as error:
                answer = True, error
            _answer(self._connection, answer)

    def pause(self, name: str, result: Any) -> Call:
        """Answer the call of a method, in which this is, and wait for the next one; returns its arguments.

        Other methods are answered in the meantime, and copies are made, which go on from here.
        """
        _answer(self._connection, (False, result))
        return self.serve(name)


def _answer(connection: Connection, answer: tuple[bool, Any]) -> None:
    try:
        connection.send(answer)
    except (TypeError, AttributeError, PicklingError) as error:
        connection.send(
            (True, NotPossible(f"{type(answer[1]).__name__} cannot leave the process of the copy: {error}"))
        )


def _copied(connection: Connection) -> Connection:
    """Copy the process once more; returns the connection that this process answers on now."""
    if sys.platform == "win32":
        raise OSError(_NO_COPIES)
    its = Connection(recv_handle(connection))
    if _fork() == 0:
        connection.close()
        return its
    its.close()
    connection.send((False, None))
    return connection
