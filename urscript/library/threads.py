"""What the language itself does with time."""

from collections.abc import Generator

from urscript.builtins import Library

LIBRARY = Library("threads")


@LIBRARY.builtin()
def sync() -> Generator[None, None, None]:
    """Give up the rest of this frame: the thread goes on in the next control period."""
    yield
