"""TCP sockets of a program.

A read returns immediately if its data is available. Otherwise it checks once per control
period until its timeout has passed, or for ever if the timeout is 0 or negative. It also ends
when the peer closes the connection. Failures are values, never errors: False, an empty string,
or a list that begins with 0. A call that fails takes at least one control period, so that a
program that retries in a loop leaves time for others.
"""

import math
import re
import struct
from collections.abc import Callable
from typing import Any, Final

from emulator.builtins.host import Frames, ProgramHost
from emulator.services.sockets import MAX_SOCKETS, ScriptSocket
from urproto.facts import rows
from urproto.text import from_bytes, to_bytes
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.meter import charge
from urscript.values import INT_MAX, INT_MIN, MAX_STRING, Any_, Bool, Int, Num, Str, to_text, type_name

LIBRARY = Library("sockets", host=True)

_CONNECT_S: Final = 2.0  # Script Manual, socket_open
_SECONDARY_CONNECT_S: Final = rows("secondary.connect")[0].number
_VARIABLE_S: Final = 2.0  # Script Manual, socket_get_var
_MAX_VALUES: Final = 30  # Script Manual, socket_read_ascii_float and the other list readers
_SEARCHED_BYTES: Final = 8  # per meter unit of work, in the worst case: all data resembles the marker
_NAME: Final = "socket_0"
_ESCAPES: Final = {"\\n": "\n", "\\r": "\r", "\\t": "\t", "\\\\": "\\"}


@LIBRARY.builtin()
def socket_open(host: ProgramHost, address: Str, port: Int, socket_name: Str = _NAME) -> Frames[bool]:
    """Connect; False if that fails or takes longer than 2 s. An open socket of that name is closed first.

    In a secondary program, a connection that is answered within a period takes no time; others fail.
    """
    if not 0 < port < 65536:
        raise RuntimeFault(f"socket_open: there is no port {port}: use 1 to 65535")
    if len(host.sockets) >= MAX_SOCKETS and host.sockets.get(socket_name) is None:
        return False
    socket = host.programs.socket_backend.open(address, port)
    host.sockets.put(socket_name, socket)
    host.connecting = host.secondary
    for _ in range(host.frames(_SECONDARY_CONNECT_S if host.secondary else _CONNECT_S)):
        if socket.state == "connecting" or not host.secondary:
            yield
        if socket.state != "connecting":
            break
    host.connecting = False
    if socket.state == "open":
        return True
    host.sockets.close(socket_name)
    return False


@LIBRARY.builtin()
def socket_close(host: ProgramHost, socket_name: Str = _NAME) -> None:
    """Close a socket."""
    host.sockets.close(socket_name)


@LIBRARY.builtin()
def socket_send_string(host: ProgramHost, str_: Any_, socket_name: Str = _NAME) -> bool:
    """Send the text of a value; False when the socket is not open."""
    return _send(host, socket_name, _text_bytes(str_))


@LIBRARY.builtin()
def socket_send_line(host: ProgramHost, str_: Any_, socket_name: Str = _NAME) -> bool:
    """Send the text of a value and a line feed; False when the socket is not open."""
    return _send(host, socket_name, _text_bytes(str_) + b"\n")


@LIBRARY.builtin()
def socket_send_byte(host: ProgramHost, value: Any_, socket_name: Str = _NAME) -> bool:
    """Send one byte: 0 to 255, or the first character of a string. False when the socket is not open."""
    if isinstance(value, str) and value:
        return _send(host, socket_name, to_bytes(value)[:1])
    if type(value) not in (int, float) or not 0 <= value <= 255:
        raise RuntimeFault(f"socket_send_byte: the value must be 0 to 255, not {to_text(value) or 'an empty string'}")
    return _send(host, socket_name, bytes([int(value)]))


@LIBRARY.builtin()
def socket_send_int(host: ProgramHost, value: Any_, socket_name: Str = _NAME) -> bool:
    """Send four bytes: a signed integer, highest byte first. False when the socket is not open."""
    if type(value) not in (bool, int, float):  # bools: a guess, a public program sends one
        raise RuntimeFault(
            f"Type error: argument 'value' of socket_send_int expected type 'Num' but found '{type_name(value)}'"
        )
    if not INT_MIN <= value <= INT_MAX:
        raise RuntimeFault(f"socket_send_int: {value} does not fit 32 bits")
    return _send(host, socket_name, struct.pack(">i", int(value)))


@LIBRARY.builtin()
def socket_set_var(host: ProgramHost, name: Any_, value: Any_, socket_name: Str = _NAME) -> None:
    """Send the line ``SET <name> <value>``; both may be of any type, as a gripper maker's programs rely on."""
    _send(host, socket_name, to_bytes(f"SET {to_text(name)} {to_text(value)}\n"))


@LIBRARY.builtin()
def socket_get_var(host: ProgramHost, name: Str, socket_name: Str = _NAME) -> Frames[int]:
    """Send the line ``GET <name>`` and read ``<name> <value>``; 0 when no answer comes within 2 s."""
    _send(host, socket_name, to_bytes(f"GET {name}\n"))
    line = yield from _take_line(host, socket_name, _VARIABLE_S)
    match = re.fullmatch(r"(\S+)\s+(-?\d{1,10})\s*", line or "", re.ASCII)
    value = int(match[2]) if match and match[1] == name else 0
    return value if INT_MIN <= value <= INT_MAX else 0


@LIBRARY.builtin()
def socket_read_binary_integer(
    host: ProgramHost, number: Int, socket_name: Str = _NAME, timeout: Num = 2
) -> Frames[list[int]]:
    """Read `number` 32-bit integers, highest byte first: [number, ...], or [0, -1, ...] on failure."""
    data = yield from _take(host, socket_name, 4 * _count(number), timeout)
    return _failed_integers(number) if data is None else [number, *struct.unpack(f">{number}i", data)]


@LIBRARY.builtin()
def socket_read_byte_list(
    host: ProgramHost, number: Int, socket_name: Str = _NAME, timeout: Num = 2
) -> Frames[list[int]]:
    """Read `number` bytes: [number, ...], or [0, -1, ...] on failure."""
    data = yield from _take(host, socket_name, _count(number), timeout)
    return _failed_integers(number) if data is None else [number, *data]


@LIBRARY.builtin()
def socket_read_ascii_float(
    host: ProgramHost, number: Int, socket_name: Str = _NAME, timeout: Num = 2
) -> Frames[list[float]]:
    """Read `number` floats as ``(1.0, 2.0)``: [number, ...], or [0, nan, ...] on failure."""
    _count(number)
    socket = host.sockets.get(socket_name)
    found = yield from _wait(host, socket, timeout, lambda inbox: b")" in inbox)
    failed = [0, *[math.nan] * number]
    if socket is None or not found:
        return failed
    text = _pop(socket, socket.inbox.index(b")") + 1)
    values = _floats(text[text.rfind(b"(") + 1 : -1]) if b"(" in text else None
    return [number, *values] if values is not None and len(values) == number else failed


@LIBRARY.builtin(note="deprecated")
def socket_read_line(host: ProgramHost, socket_name: Str = _NAME, timeout: Num = 2) -> Frames[str]:
    """Read up to a line feed, which is dropped; "" on failure."""
    return (yield from _take_line(host, socket_name, timeout)) or ""


@LIBRARY.builtin()
def socket_read_string(
    host: ProgramHost,
    socket_name: Str = _NAME,
    prefix: Str = "",
    suffix: Str = "",
    interpret_escape: Bool = False,
    timeout: Num = 2,
) -> Frames[str]:
    """Read all text received so far, or the text between `prefix` and `suffix`; "" on failure.

    Text before the prefix is dropped, text after the suffix is kept for the next read.
    Leading blanks of either are ignored (Script Manual). `interpret_escape`: \\n, \\r
    and \\t in prefix and suffix stand for control characters.
    """
    head, tail = _marker(prefix, interpret_escape), _marker(suffix, interpret_escape)
    socket = host.sockets.get(socket_name)
    found = yield from _wait(host, socket, timeout, lambda inbox: _between(inbox, head, tail) is not None)
    if socket is None or not found:
        return ""
    span = _between(socket.inbox, head, tail)
    assert span is not None
    begin, end = span
    text = bytes(socket.inbox[begin:end])
    _pop(socket, end + len(tail))
    return _received(text)


def _between(inbox: bytearray, head: bytes, tail: bytes) -> tuple[int, int] | None:
    """Span of the text between the markers; None while it is incomplete."""
    charge(len(inbox) // _SEARCHED_BYTES)
    at = inbox.find(head)
    begin = at + len(head)
    if at < 0:
        return None
    if not tail:
        return (begin, len(inbox)) if len(inbox) > begin else None
    end = inbox.find(tail, begin)
    too_long = end < 0 and len(inbox) - begin > MAX_STRING + len(tail)
    return (begin, len(inbox)) if too_long else (begin, end) if end >= 0 else None


def _wait(
    host: ProgramHost, socket: ScriptSocket | None, timeout: float, ready: Callable[[bytearray], bool]
) -> Frames[bool]:
    """Wait until enough bytes have arrived; False on timeout, or if no more can arrive."""
    left = host.frames(timeout) if timeout > 0 else -1
    waited = host.secondary  # a secondary program takes no time
    while socket is None or not ready(socket.inbox):
        if socket is None or socket.state != "open" or left == 0:
            if not waited:
                yield
            return False
        left -= 1
        waited = True
        yield
    if host.runtime.current is not None:
        host.runtime.current.parked_frames = 0  # a thread kept busy by its peer is not in an endless loop
    return True


def _take(host: ProgramHost, name: str, size: int, timeout: float) -> Frames[bytes | None]:
    socket = host.sockets.get(name)
    found = yield from _wait(host, socket, timeout, lambda inbox: len(inbox) >= size)
    return _pop(socket, size) if socket is not None and found else None


def _take_line(host: ProgramHost, name: str, timeout: float) -> Frames[str | None]:
    socket = host.sockets.get(name)
    found = yield from _wait(host, socket, timeout, lambda inbox: b"\n" in inbox)
    if socket is None or not found:
        return None
    line = _pop(socket, socket.inbox.index(b"\n") + 1)
    return _received(line[:-1].removesuffix(b"\r"))


def _received(text: bytes) -> str:
    if len(text) > MAX_STRING:
        raise RuntimeFault(f"Received String exceeds maximum length ({MAX_STRING} Bytes).")
    return from_bytes(text)


def _pop(socket: ScriptSocket, size: int) -> bytes:
    data = bytes(socket.inbox[:size])
    del socket.inbox[:size]
    return data


def _send(host: ProgramHost, name: str, data: bytes) -> bool:
    socket = host.sockets.get(name)
    return socket is not None and socket.send(data)


def _text_bytes(value: Any) -> bytes:
    return to_bytes(to_text(value))


def _marker(text: str, interpret_escape: bool) -> bytes:
    if interpret_escape:
        text = re.sub(r"\\[nrt\\]", lambda match: _ESCAPES[match[0]], text)
    return to_bytes(text.lstrip(" "))


def _floats(text: bytes) -> list[float] | None:
    if b"_" in text:  # float() would accept underscores
        return None
    try:
        return [float(part) for part in text.split(b",")] if text.strip() else []
    except ValueError:
        return None


def _count(number: int) -> int:
    if not 0 <= number <= _MAX_VALUES:
        raise RuntimeFault(f"one call can read 0 to {_MAX_VALUES} values, not {number}")
    return number


def _failed_integers(number: int) -> list[int]:
    return [0, *[-1] * number]
