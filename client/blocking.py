"""Blocking forms of asynchronous classes, derived from them.

The driver is a server that must answer while its owner does something else. So a blocking form runs an event loop in a
separate thread and forwards every call to it. It has every public operation of the class that it is derived from:

    class BlockingGripper(Blocking[Gripper]):
        '''Blocking form of `Gripper`.'''

Type checkers and editors find these operations in the stub beside the module, which docs/stubs.py generates.
"""

import asyncio
import functools
import inspect
import threading
from collections.abc import Callable, Coroutine, Iterator, Sequence
from contextlib import AbstractAsyncContextManager, contextmanager
from types import new_class
from typing import Any, ClassVar, Generic, TypeVar, cast, get_args

from urproto.compat import Self

Inner = TypeVar("Inner")
Entered = TypeVar("Entered")
Result = TypeVar("Result")
Function = TypeVar("Function", bound=Callable[..., Any])


def thread_safe(function: Function) -> Function:
    """Mark a method that any thread may call: its blocking form bypasses the event loop."""
    function.__dict__["thread_safe"] = True
    return function


class EventLoopThread:
    """A thread that runs an event loop, for a blocking form and its parts."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the thread."""
        if self._loop is not None:
            raise RuntimeError(f"{self._title} is already open")
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name=self._title, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """End the thread."""
        loop, thread = self._loop, self._thread
        self._loop = self._thread = None
        if loop is None or thread is None:
            return
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.run_until_complete(loop.shutdown_asyncgens())
        loop.close()

    def call(self, work: Coroutine[Any, Any, Result]) -> Result:
        """Run a coroutine in the event loop and wait for it; a KeyboardInterrupt in the caller cancels it."""
        if self._loop is None:
            work.close()
            raise RuntimeError(f"{self._title} is not open: use it in a with statement")
        if threading.current_thread() is self._thread:
            work.close()
            raise RuntimeError(f"{self._title} cannot be called from its own callbacks: it would wait for itself")
        future = asyncio.run_coroutine_threadsafe(work, self._loop)
        try:
            return future.result()
        except BaseException:
            future.cancel()
            raise


class Blocking(Generic[Inner]):
    """Owns an asynchronous object, or is a part of one; the owner is used with ``with``.

    The arguments are those of the asynchronous class, whose object is created in the thread of the event loop.
    """

    _kind: ClassVar[type]
    _forms: ClassVar[dict[type, type["Blocking[Any]"]]] = {}

    def __init_subclass__(cls, without: Sequence[str] = ()) -> None:
        """Derive the operations of a subclass; those of ``without`` have no blocking form."""
        kind = cls._kind = get_args(cls.__dict__["__orig_bases__"][0])[0]
        cls._forms[kind] = cls
        cls.__signature__ = inspect.signature(kind)  # type: ignore[attr-defined]
        for name, part in parts_of(kind).items():
            setattr(cls, name, _part_property(name, cls._forms.get(part) or _derived(part)))
        for name in dir(kind):
            if not name.startswith("_") and name not in without and name not in vars(cls):
                member = inspect.getattr_static(kind, name)
                setattr(cls, name, member if isinstance(member, staticmethod) else _form_of(name, getattr(kind, name)))

    def __init__(self, *args: Any, **options: Any) -> None:
        self._make = functools.partial(self._kind, *args, **options)
        self._events = EventLoopThread(type(self).__name__)
        self._pick: Callable[[], Any] = lambda: None

    @classmethod
    def _part(cls, whole: "Blocking[Any]", name: str) -> Self:
        part = cls.__new__(cls)
        part._events = whole._events
        part._pick = lambda: getattr(whole.inner, name)
        return part

    @property
    def inner(self) -> Inner:
        """The asynchronous object. Raises RuntimeError outside the context."""
        if (inner := self._pick()) is None:
            raise RuntimeError(f"{type(self).__name__} is not open: use it in a with statement")
        return cast(Inner, inner)

    def call(self, work: Coroutine[Any, Any, Result]) -> Result:
        """Run a coroutine in the event loop and wait for it; a KeyboardInterrupt in the caller cancels it."""
        return self._events.call(work)

    def __enter__(self) -> Self:
        self._events.start()
        try:
            inner = self.call(self._enter())
        except BaseException:
            self._events.end()
            raise
        self._pick = lambda: inner
        return self

    def __exit__(self, *reason: object) -> None:
        inner, self._pick = self._pick(), lambda: None
        try:
            if inner is not None:
                self.call(_leave(inner, *reason))
        finally:
            self._events.end()

    async def _enter(self) -> Inner:
        return cast(Inner, await self._make().__aenter__())


def parts_of(kind: type) -> dict[str, type]:
    """The annotated attributes of a class that have operations themselves: their classes are `checked`."""
    annotated: dict[str, Any] = {}
    for base in reversed(kind.__mro__):
        annotated |= inspect.get_annotations(base)
    return {
        name: part
        for name, part in annotated.items()
        if not name.startswith("_") and "__checked__" in getattr(part, "__dict__", ())
    }


def _derived(kind: type) -> type[Blocking[Any]]:
    form = new_class(f"Blocking{kind.__name__}", (Blocking[kind],))  # type: ignore[valid-type]
    form.__doc__ = kind.__doc__
    return cast(type[Blocking[Any]], form)


def _part_property(name: str, form: type[Blocking[Any]]) -> Any:
    part = functools.cached_property(lambda whole: form._part(whole, name))
    part.__set_name__(Blocking, name)
    return part


def _form_of(name: str, function: Any) -> Any:
    """The blocking form of a member of a class."""
    if isinstance(function, property):
        return property(lambda self: getattr(self.inner, name), doc=function.__doc__)
    if inspect.isasyncgenfunction(inspect.unwrap(function)):
        form = _context_form(name)
    elif getattr(function, "thread_safe", False):
        form = lambda self, *args, **kwargs: getattr(self.inner, name)(*args, **kwargs)  # noqa: E731
    else:
        form = _calling_form(name)
    functools.update_wrapper(form, function)
    form.__dict__.pop("__wrapped__")  # otherwise `inspect` takes the blocking form for a coroutine function too
    form.__signature__ = inspect.signature(function)  # type: ignore[attr-defined]
    return form


def _calling_form(name: str) -> Callable[..., Any]:
    async def invoke(inner: Any, args: Any, kwargs: Any) -> Any:
        result = getattr(inner, name)(*args, **kwargs)
        return await result if inspect.isawaitable(result) else result

    return lambda self, *args, **kwargs: self.call(invoke(self.inner, args, kwargs))


def _context_form(name: str) -> Callable[..., Any]:
    """Enter and leave an asynchronous context in the event loop; its value, if any, has a form for threads."""

    @contextmanager
    def enter(self: Blocking[Any], *args: Any, **kwargs: Any) -> Iterator[Any]:
        with _entered(self, getattr(self.inner, name)(*args, **kwargs)) as value:
            if value is None:
                yield None
            else:
                with value.from_thread(self.call) as form:
                    yield form

    return enter


@contextmanager
def _entered(owner: Blocking[Any], context: AbstractAsyncContextManager[Entered]) -> Iterator[Entered]:
    entered = owner.call(_enter(context))
    try:
        yield entered
    except BaseException as error:
        if not owner.call(_leave(context, type(error), error, error.__traceback__)):
            raise
    else:
        owner.call(_leave(context, None, None, None))


async def _enter(context: AbstractAsyncContextManager[Entered]) -> Entered:
    return await context.__aenter__()


async def _leave(context: AbstractAsyncContextManager[Any], *reason: Any) -> bool | None:
    return await context.__aexit__(*reason)
