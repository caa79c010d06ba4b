"""Values that are computed when they are first read."""

from collections.abc import Callable
from typing import Any, Generic, TypeVar, overload

from urproto.compat import Self

ValueT = TypeVar("ValueT")


class on_demand(Generic[ValueT]):  # noqa: N801  # used as a decorator
    """Decorate a method: its result is an attribute, which is computed when it is first read, and then kept.

    Like functools.cached_property, which takes a lock before Python 3.12: it costs more than most of what is computed
    here. Two threads may both compute a value, so it must be the same each time.
    """

    def __init__(self, compute: Callable[[Any], ValueT]) -> None:
        self._compute = compute
        self._name = compute.__name__
        self.__doc__ = compute.__doc__

    @overload
    def __get__(self, instance: None, owner: type) -> Self: ...

    @overload
    def __get__(self, instance: object, owner: type) -> ValueT: ...

    def __get__(self, instance: object | None, owner: type) -> Self | ValueT:
        if instance is None:
            return self
        value = vars(instance)[self._name] = self._compute(instance)
        return value
