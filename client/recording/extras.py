"""Packages that are only there when somebody asked for them."""

from collections.abc import Iterator
from contextlib import contextmanager

from client.errors import MissingExtraError


@contextmanager
def extra(name: str, what: str) -> Iterator[None]:
    """Around the imports of an extra. Raises MissingExtraError when one of its packages is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingExtraError(what, name) from error
