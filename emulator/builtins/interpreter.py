"""Interpreter mode: the program executes statements that clients send to port 30020."""

from collections.abc import Generator

from emulator.builtins.host import ProgramHost
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.interpreter import Locals
from urscript.values import Bool

LIBRARY = Library("interpreter mode", host=True)


@LIBRARY.builtin(cb3="3.15", e="5.10", takes_scope=True)
def interpreter_mode(
    host: ProgramHost, scope: Locals, clearQueueOnEnter: Bool = True, clearOnEnd: Bool = True
) -> Generator[bool | None, None, None]:
    """Execute statements sent to port 30020, in the scope of the caller, until end_interpreter().

    `clearQueueOnEnter` discards statements that arrived before. `clearOnEnd` removes the functions and
    variables they defined from the program at the end. Only the program's body, and functions it
    calls, may call this.
    """
    interpreter = host.programs.interpreter
    current = None if host.secondary else host.runtime.current
    if current is None or current.id != 0:
        raise RuntimeFault("interpreter_mode can only be called in the main thread of a program")
    if interpreter.active:
        raise RuntimeFault("interpreter_mode cannot be called by an interpreted statement: it cannot be nested")
    interpreter.enter(scope, clear_queue=clearQueueOnEnter, clear_on_end=clearOnEnd)
    try:
        yield from interpreter.execute()
    finally:
        interpreter.leave()


@LIBRARY.builtin(cb3="3.15", e="5.10")
def end_interpreter(host: ProgramHost) -> None:
    """Let interpreter_mode() return after the statement in progress; any thread and any `sec` program may call this."""
    host.programs.interpreter.end()


@LIBRARY.builtin(cb3="3.15", e="5.10")
def clear_interpreter(host: ProgramHost) -> None:
    """Remove all statements interpreted so far, with their functions, threads and variables, from the program.

    Only an interpreted statement may call this.
    """
    if host.secondary or not host.runtime.interpreting:
        raise RuntimeFault("clear_interpreter can only be called by a statement sent to interpreter mode")
    host.programs.interpreter.clear()
