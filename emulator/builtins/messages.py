"""Messages to people: the log, popups, and questions to the operator."""

from typing import Any, Final

from emulator.builtins.host import Frames, ProgramHost
from emulator.reporting.popups import Popup
from urproto.modes import RequestedType
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.meter import charge
from urscript.values import Any_, Bool, Str, cut_text

LIBRARY = Library("messages", host=True)

_POPUP_BYTES: Final = 3500  # without the title
_TEXT_BYTES: Final = 4000  # clients read primary packages into 4096 bytes
_LOG_WORK: Final = 200  # of sending a line to the log and the clients [meter units]
_BYTE_WORK: Final = 0.5  # of each byte, so that a loop cannot flood the network
_POPUP_WORK: Final = 1500  # of a dialogue


@LIBRARY.builtin()
def textmsg(host: ProgramHost, s1: Any_, s2: Any_ = "") -> None:
    """Write two values of any type as one line to the log and the primary clients, cut at 4000 bytes."""
    host.machine.messages.text(cut_text(_log_text(s1) + _log_text(s2), _TEXT_BYTES))


@LIBRARY.builtin(note="undocumented; sends the message that the vendor's interface document calls deprecated")
def varmsg(host: ProgramHost, name: Str, value: Any_) -> None:
    """Send a variable's value to the primary clients."""
    host.machine.messages.variable(name, _log_text(value))


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
    shown = host.machine.popups.show(
        _popup_text(s), title=title, warning=warning, error=error, blocking=blocking and not host.secondary
    )
    if shown.blocking:
        yield from host.suspend(shown)


@LIBRARY.builtin(note="undocumented; URCaps use it")
def close_popup(host: ProgramHost) -> None:
    """Close the dialogues that are open."""
    host.machine.popups.close_all()


@LIBRARY.builtin()
def request_boolean_from_primary_client(host: ProgramHost, Text: Str) -> Frames[bool]:
    """Ask the operator for a boolean and wait for the answer."""
    return bool((yield from _request_value(host, Text, RequestedType.BOOLEAN)))


@LIBRARY.builtin()
def request_integer_from_primary_client(host: ProgramHost, Text: Str) -> Frames[int]:
    """Ask the operator for an integer and wait for the answer."""
    return int((yield from _request_value(host, Text, RequestedType.INTEGER)))


@LIBRARY.builtin()
def request_float_from_primary_client(host: ProgramHost, Text: Str) -> Frames[float]:
    """Ask the operator for a number and wait for the answer."""
    return float((yield from _request_value(host, Text, RequestedType.FLOAT)))


@LIBRARY.builtin()
def request_string_from_primary_client(host: ProgramHost, Text: Str) -> Frames[str]:
    """Ask the operator for a string and wait for the answer."""
    return str((yield from _request_value(host, Text, RequestedType.STRING)))


def _request_value(host: ProgramHost, text: str, kind: RequestedType) -> Frames[Any]:
    question: Popup = host.remember(host.machine.popups.request(_popup_text(text), kind))
    while question.open:
        yield
    if question.answer is None:
        raise RuntimeFault("the operator cancelled the question")
    return question.answer


def _log_text(value: Any) -> str:
    text = cut_text(value, _TEXT_BYTES)
    charge(_LOG_WORK + int(_BYTE_WORK * len(text)))
    return text


def _popup_text(value: Any) -> str:
    text = cut_text(value, _POPUP_BYTES)
    charge(_POPUP_WORK + int(_BYTE_WORK * len(text)))
    return text
