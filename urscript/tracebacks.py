"""What stopped a program: Python's exceptions as errors of the script, at their place in it."""

import re
from types import CodeType, TracebackType
from typing import Final

from urscript.compiler import FILE_NAME
from urscript.errors import RuntimeFault
from urscript.interpreter import STATEMENT_FILE
from urscript.values import TYPE_NAMES

__all__ = ["error_position", "message_of", "position"]


def position(code: CodeType, instruction: int) -> tuple[int, int]:
    """Line and column (from 1) of an instruction; column 1 when Python runs without column tables."""
    positions = list(code.co_positions())
    line, _, column, _ = positions[instruction // 2]
    return line or 0, (column or 0) + 1


def error_position(trace: TracebackType | None) -> tuple[int, int, bool]:
    """Line, column, and whether the error arose in compiled code itself and not in something it called.

    An error in an interpreted statement is where the program called interpreter_mode(); only in
    a thread of interpreted code, which the program has no line for, the line is the statement's.
    """
    places = {FILE_NAME: (0, 0), STATEMENT_FILE: (0, 0)}
    inside = False
    while trace is not None:
        code = trace.tb_frame.f_code
        inside = code.co_filename in places
        if inside:
            places[code.co_filename] = position(code, trace.tb_lasti)
        trace = trace.tb_next
    line, column = places[FILE_NAME] if places[FILE_NAME][0] else places[STATEMENT_FILE]
    return line, column, inside


# How Python words what compiled code runs into itself.
_VARIABLE: Final = re.compile(r".*'v_(\w+)'")
_COMPARISON: Final = re.compile(r"'([<>]=?)' not supported between instances of '(\w+)' and '(\w+)'")
_TYPE_NAMES: Final = {python.__name__: name for python, name in TYPE_NAMES.items()}


def message_of(error: Exception, inside: bool) -> str:
    if isinstance(error, RuntimeFault):
        return str(error)
    if isinstance(error, RecursionError):
        return "Functions call each other too deeply"
    if inside and isinstance(error, NameError):
        variable = _VARIABLE.search(str(error))
        return f"Variable '{variable[1]}' is used before it has a value" if variable else str(error)
    if inside and isinstance(error, TypeError):
        comparison = _COMPARISON.match(str(error))
        names = [_TYPE_NAMES.get(name, name) for name in comparison.group(2, 3)] if comparison else ["?", "?"]
        sign = comparison[1] if comparison else "<"
        return f"Type error: operator {sign} cannot be used with '{names[0]}' and '{names[1]}'"
    return f"internal error: {error!r}"
