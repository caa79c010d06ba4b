"""Blocking counterparts of asynchronous classes, without duplicating their code.

The driver is a server that must answer while its owner does something else. So a blocking counterpart runs an event
loop in a separate thread and forwards every call to it:

    class BlockingGripper(Blocking[Gripper]):
        close = blocking(Gripper.close)
        holding = blocking_context(Gripper.holding)
"""

import asyncio
import functools
import inspect
import threading
from collections.abc import Callable, Coroutine, Iterator
from contextlib import AbstractAsyncContextManager, AbstractContextManager, contextmanager
from types import TracebackType
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar, cast, overload

from urproto.compat import Self

Inner = TypeVar("Inner", bound=AbstractAsyncContextManager[Any])
Component = TypeVar("Component")
Entered = TypeVar("Entered")
Owner = TypeVar("Owner")
Params = ParamSpec("Params")
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
Function = TypeVar("Function", bound=Callable[..., Any])


class Blocking(Generic[Inner]):
    """Owns an asynchronous object and the thread that runs its event loop; use it with ``with``.

    make: creates the object; called in that thread.
    """

    def __init__(self, make: Callable[[], Inner]) -> None:
        self._make = make
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._inner: Inner | None = None

    @property
    def inner(self) -> Inner:
        """The asynchronous object. Raises RuntimeError outside the context."""
        if self._inner is None:
            raise RuntimeError(f"{type(self).__name__} is not open: use it in a with statement")
        return self._inner

    def __enter__(self) -> Self:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name=type(self).__name__, daemon=True)
        self._thread.start()
        try:
            self._inner = self.call(self._enter())
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        inner, self._inner = self._inner, None
        try:
            if inner is not None:
                self.call(_leave(inner, kind, error, trace))
        finally:
            self._end()

    def call(self, work: Coroutine[Any, Any, Result]) -> Result:
        """Run a coroutine in the event loop and wait for it; a KeyboardInterrupt in the caller cancels it."""
        if self._loop is None:
            work.close()
            raise RuntimeError(f"{type(self).__name__} is not open: use it in a with statement")
        if threading.current_thread() is self._thread:
            work.close()
            raise RuntimeError(
                f"{type(self).__name__} cannot be called from its own callbacks: it would wait for itself"
            )
        future = asyncio.run_coroutine_threadsafe(work, self._loop)
        try:
            return future.result()
        except BaseException:
            future.cancel()
            raise

    async def _enter(self) -> Inner:
        inner = self._make()
        await inner.__aenter__()
        return inner

    def _end(self) -> None:
        loop, thread = self._loop, self._thread
        self._loop = self._thread = None
        if loop is None or thread is None:
            return
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.run_until_complete(loop.shutdown_asyncgens())
        loop.close()


class BlockingPart(Generic[Component]):
    """Blocking counterpart of a component of the object that a `Blocking` owns; ``pick`` returns the component."""

    def __init__(self, whole: Blocking[Any], pick: Callable[[Any], Component]) -> None:
        self._whole = whole
        self._pick = pick

    @property
    def inner(self) -> Component:
        """The asynchronous component. Raises RuntimeError outside the context."""
        return self._pick(self._whole.inner)

    def call(self, work: Coroutine[Any, Any, Result]) -> Result:
        """See `Blocking.call`."""
        return self._whole.call(work)


async def _enter(context: AbstractAsyncContextManager[Entered]) -> Entered:
    return await context.__aenter__()


async def _leave(context: AbstractAsyncContextManager[Any], *reason: Any) -> bool | None:
    return await context.__aexit__(*reason)


@overload
def blocking(
    method: Callable[Concatenate[Owner, Params], Coroutine[Any, Any, Result]],
) -> Callable[Concatenate[Any, Params], Result]: ...
@overload
def blocking(method: Callable[Concatenate[Owner, Params], Result]) -> Callable[Concatenate[Any, Params], Result]: ...
def blocking(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return the blocking form of a method, plain or async, of the object that a `Blocking` owns."""

    async def invoke(inner: Any, args: Any, kwargs: Any) -> Any:
        result = method(inner, *args, **kwargs)
        return await result if inspect.isawaitable(result) else result

    def call(self: Blocking[Any], *args: Any, **kwargs: Any) -> Any:
        return self.call(invoke(self.inner, args, kwargs))

    return named_after(method, call)


def named_after(method: Callable[..., Any], function: Function) -> Function:
    """Give the blocking form of a method the method's name and docstring."""
    functools.update_wrapper(function, method)
    function.__dict__.pop("__wrapped__")  # otherwise `inspect` takes the blocking form for a coroutine function too
    return function


def direct(
    method: Callable[Concatenate[Owner, Params], Result],
) -> Callable[Concatenate[Any, Params], Result]:
    """Return the blocking form of a thread-safe method: it is called directly, bypassing the event loop."""

    @functools.wraps(method)
    def call(self: Any, *args: Params.args, **kwargs: Params.kwargs) -> Result:
        return method(self.inner, *args, **kwargs)

    return cast(Callable[Concatenate[Any, Params], Result], call)


@overload
def blocking_context(
    method: Callable[Concatenate[Owner, Params], AbstractAsyncContextManager[None]],
) -> Callable[Concatenate[Any, Params], AbstractContextManager[None]]: ...
@overload
def blocking_context(
    method: Callable[
        Concatenate[Owner, Params], AbstractAsyncContextManager[Callable[Arguments, Coroutine[Any, Any, Result]]]
    ],
) -> Callable[Concatenate[Any, Params], AbstractContextManager[Callable[Arguments, Result]]]: ...
def blocking_context(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return the blocking form of a method that returns an asynchronous context of None or of a coroutine function."""

    @contextmanager
    def enter(self: Blocking[Any], *args: Any, **kwargs: Any) -> Iterator[Any]:
        with entered_context(self, method(self.inner, *args, **kwargs)) as invoke:
            yield None if invoke is None else lambda *given, **named: self.call(invoke(*given, **named))

    return named_after(method, enter)


@contextmanager
def entered_context(owner: Blocking[Any], context: AbstractAsyncContextManager[Entered]) -> Iterator[Entered]:
    """Enter and leave an asynchronous context in the owner's event loop, from the caller's thread."""
    entered = owner.call(_enter(context))
    try:
        yield entered
    except BaseException as error:
        if not owner.call(_leave(context, type(error), error, error.__traceback__)):
            raise
    else:
        owner.call(_leave(context, None, None, None))
