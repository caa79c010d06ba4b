"""Checks that a program makes of itself."""

from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Bool

LIBRARY = Library("checks")


# Script Manuals CB3 3.15.4 and 5.12, chapter on functions; the first versions and the text of the error are guesses.
@LIBRARY.builtin()
def assert_(condition: Bool) -> None:
    """End the program with an error unless `condition` is True."""
    if not condition:
        raise RuntimeFault("assert: the condition is False")
