"""Talking to people: the log, popups, and questions to the operator."""

from typing import Any, Final

from emulator.popups import Popup
from emulator.programs.host import Frames, ProgramHost
from urproto.modes import RequestedType
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.meter import charge
from urscript.values import Any_, Bool, Str, to_text

__all__ = ["LIBRARY"]

LIBRARY = Library("messages", host=True)

_LOG_LIMIT: Final = 3500  # characters: clients read primary packages into 4096 bytes
_LOG_WORK: Final = 200  # of a line on its way to the log and the clients [meter units]


@LIBRARY.builtin()
def textmsg(host: ProgramHost, s1: Any_, s2: Any_ = "") -> None:
    """Write a line of two values of any type to the log, and to the primary clients."""
    host.controller.messages.text(_log_text(s1) + _log_text(s2))


@LIBRARY.builtin(status="partial", note="undocumented; the value goes to the log only")
def varmsg(host: ProgramHost, name: Str, value: Any_) -> None:
    """Show a variable's value."""
    host.controller.messages.note(f"{name} = {_log_text(value)}")


@LIBRARY.builtin()
def popup(
    host: ProgramHost,
    s: Any_,
    title: Str = "Popup",
    warning: Bool = False,
    error: Bool = False,
    blocking: Bool = False,
) -> Frames[None]:
    """Show a dialogue on the pendant; with `blocking`, suspend the program until it is closed.

    `close popup` on the dashboard server closes it.
    """
    shown = host.controller.popups.show(
        _log_text(s), title=title, warning=warning, error=error, blocking=blocking and not host.secondary
    )
    if shown.blocking:
        host.suspend(shown)
        yield


@LIBRARY.builtin(note="undocumented; URCaps use it")
def close_popup(host: ProgramHost) -> None:
    """Close the dialogues that are open."""
    host.controller.popups.close_all()


@LIBRARY.builtin()
def request_boolean_from_primary_client(host: ProgramHost, Text: Str) -> Frames[bool]:
    """Ask the operator for a boolean and wait for the answer."""
    return bool((yield from _ask(host, Text, RequestedType.BOOLEAN)))


@LIBRARY.builtin()
def request_integer_from_primary_client(host: ProgramHost, Text: Str) -> Frames[int]:
    """Ask the operator for an integer and wait for the answer."""
    return int((yield from _ask(host, Text, RequestedType.INTEGER)))


@LIBRARY.builtin()
def request_float_from_primary_client(host: ProgramHost, Text: Str) -> Frames[float]:
    """Ask the operator for a number and wait for the answer."""
    return float((yield from _ask(host, Text, RequestedType.FLOAT)))


@LIBRARY.builtin()
def request_string_from_primary_client(host: ProgramHost, Text: Str) -> Frames[str]:
    """Ask the operator for a text and wait for the answer."""
    return str((yield from _ask(host, Text, RequestedType.STRING)))


def _ask(host: ProgramHost, text: str, kind: RequestedType) -> Frames[Any]:
    question: Popup = host.remember(host.controller.popups.request(text, kind))
    while question.open:
        yield
    if question.answer is None:
        raise RuntimeFault(f"the question {text!r} was closed without an answer")
    return question.answer


def _log_text(value: Any) -> str:
    charge(_LOG_WORK)
    return to_text(value, message=True, limit=_LOG_LIMIT, cut=True)
