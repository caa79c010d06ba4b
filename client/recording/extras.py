"""Optional dependencies, installed with an extra such as ``pip install '.[record]'``."""

from collections.abc import Iterator
from contextlib import contextmanager

from client.errors import MissingExtraError


@contextmanager
def extra(name: str, what: str) -> Iterator[None]:
    """Guard the imports of an extra. Raises MissingExtraError if one of its packages is not installed.

    what: the feature that needs them, for the message.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingExtraError(what, name) from error
