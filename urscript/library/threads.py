"""Built-ins of the language that take time."""

from collections.abc import Generator

from urscript.builtins import Library

LIBRARY = Library("threads")


@LIBRARY.builtin()
def sync() -> Generator[None, None, None]:
    """Give up the rest of this frame: the thread continues in the next control period."""
    yield
