"""Recognises web browsers on ports that are not for them.

A page of any site can make a browser send requests to this machine and its network: a POST whose body is a script or
dashboard commands, one to the RTDE port whose body begins where a package would, a TLS handshake with text of the
page's choice in its session ticket. So the first bytes of a connection are checked before they are processed. Browsers
are recognised by their first line or first nine bytes, with which no client of a robot begins:

- an HTTP request line, ``METHOD target HTTP/1.1``: the method in upper case, the target a path, a URL or ``*``.
- a TLS record that holds nothing but a ClientHello: its two lengths agree.
"""

import re
from typing import Final

from emulator.servers.admission import Reason

WRONG_PORT: Final = {
    Reason.HTTP: "sent an HTTP request and was disconnected; nothing of it was executed. This is not a web server: "
    "close the web page that sent it, or correct the port in your program. HTTP is for the control API",
    Reason.TLS: "began with TLS and was disconnected. A robot's connections are not encrypted: close the web page "
    "that sent it, or connect without TLS",
}
"""What the log says about browsers."""

_METHOD: Final = re.compile(rb"[A-Z][A-Z0-9_-]{0,31}")
_CONNECT: Final = b"CONNECT"  # the only method whose target is host and port
_TARGETS: Final = (b"/", b"*", b"http://", b"https://")
_VERSION: Final = b"HTTP/"
_LONGEST_TARGET: Final = 2048  # bytes: whatever still looks like a request then is one (guess)
_HANDSHAKE: Final = b"\x16\x03"
_CLIENT_HELLO: Final = 1


def visitor(start: bytes) -> Reason | bool:
    """Why a client whose connection begins like this is rejected; False: it is not; True: undecided, more is needed."""
    if not start:
        return True
    return _tls(start) if start[0] == _HANDSHAKE[0] else _http(start)


def _http(start: bytes) -> Reason | bool:
    line, ended, _ = start.partition(b"\n")
    method, *more = line.split(b" ", 2)
    if _METHOD.fullmatch(method) is None:
        return False
    target, version = (*more, None, None)[:2]
    if target is None:
        return not ended
    if method != _CONNECT and not any(target.startswith(known) or known.startswith(target) for known in _TARGETS):
        return False
    if len(target) > _LONGEST_TARGET or (version is not None and version.startswith(_VERSION)):
        return Reason.HTTP
    return not ended and (version is None or _VERSION.startswith(version))


def _tls(start: bytes) -> Reason | bool:
    """Record type, version 3.x, length; handshake type, length."""
    if not _HANDSHAKE.startswith(start[:2]) or start[2:3] > b"\x04":
        return False
    if len(start) < 6:
        return True
    length = int.from_bytes(start[3:5], "big") - 4
    if start[5] != _CLIENT_HELLO or length < 0:
        return False
    announced, seen = length.to_bytes(3, "big"), start[6:9]
    if seen == announced:
        return Reason.TLS
    return announced.startswith(seen)


class Opening:
    """The first bytes of a connection, until it is known whether a browser sent them.

    patient: hold them back until then. Otherwise they pass immediately, for clients that send single bytes and wait.
    """

    def __init__(self, *, patient: bool) -> None:
        self._patient = patient
        self._start = b""
        self._passed = 0
        self.verdict: Reason | bool = True

    def feed(self, data: bytes) -> bytes:
        """The bytes that may be read now; none if ``verdict``, which must be checked first, is a visitor."""
        self._start += data
        self.verdict = visitor(self._start)
        return b"" if self.verdict is True and self._patient else self.rest()

    def rest(self) -> bytes:
        """The bytes held back, at the end of the connection; none of a visitor."""
        if isinstance(self.verdict, Reason):
            return b""
        rest, self._passed = self._start[self._passed :], len(self._start)
        return rest
