"""Security of the web server: which requests are accepted, what a page may do in its browser, and invalid messages.

Because a pendant moves an arm, requests of pages from other sites are rejected, no other site may embed a page of the
pendant, and an invalid message is rejected or dropped with one line in the log instead of a traceback.
"""

import logging
import secrets
import socket
import time
import traceback
from collections.abc import Callable, Collection
from ipaddress import ip_address
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

import socketio  # type: ignore[import-untyped]
from fastapi.responses import PlainTextResponse, RedirectResponse
from nicegui import core

from client.pendant.cameras import ROUTE
from client.pendant.traces import ROUTE as TRACES
from urproto.log_throttle import LogThrottle

BROWSERS: Final = "/browsers"
"""Path of the list of the browsers that show the pendant: their addresses, as JSON."""

_UNAUTHORIZED, _FORBIDDEN, _SEE_OTHER = 401, 403, 303
_POLICY_VIOLATION: Final = 1008  # web socket status for what is not permitted
_MAX_PAGES: Final = 200  # guess: one per browser; those that have not connected yet count, too
_MAX_KINDS: Final = 32
_FILES: Final = ("/pendant/", "/_nicegui/", f"{ROUTE}/", f"{TRACES}/")
_MAX_LINE: Final = 300  # characters of a line about an invalid message
_LOGGERS: Final = ("uvicorn.error", "engineio.server", "socketio.server", "nicegui", "asyncio")
_SOURCE: Final = Path(__file__).parents[2]

_FIXED_HEADERS: Final = (
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
)
# Scripts run by their nonce or from files of this server. NiceGUI hands code to pages as text, which takes
# 'unsafe-eval', and Quasar and Tailwind write styles as they go, which takes 'unsafe-inline' for styles.
_POLICIES: Final = (
    "default-src 'none'",
    "script-src 'self' 'nonce-{nonce}' 'unsafe-eval'",
    "style-src 'self' 'unsafe-inline'",
    "img-src 'self' data: blob:",
    "font-src 'self' data:",
    "connect-src 'self'",
    "base-uri 'none'",
    "form-action 'none'",
    "frame-ancestors 'none'",
)

_logger = logging.getLogger(__name__)


class InvalidMessages:
    """Log of invalid messages: the first of each kind immediately, then a count, at most once per minute."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._kinds = dict[str, LogThrottle]()

    def report(self, kind: str, content: object) -> None:
        """Report an invalid message. kind: messages of one kind are counted together. content: its text."""
        if kind not in self._kinds and len(self._kinds) >= _MAX_KINDS:
            kind = ""
        suffix = self._kinds.setdefault(kind, LogThrottle(self._clock)).due()
        if suffix is None:
            return
        text = " ".join(str(content).split())[:_MAX_LINE]
        _logger.warning("web: %s%s", text or "an error without a message", suffix)

    def report_error(self, error: BaseException) -> None:
        """Report an error, by the place in our own code where it was raised; the traceback is logged at debug level."""
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in frames if Path(frame.filename).is_relative_to(_SOURCE / "client")]
        location = "?"
        if frames:
            frame = (own or frames)[-1]
            location = f"{Path(frame.filename).name}:{frame.lineno} in {frame.name}"
        error_type = type(error).__name__
        self.report(f"{error_type} {location}", f"dropped a message that caused {error_type}: {error} ({location})")
        _logger.debug("the message that was dropped", exc_info=error)


class Gate:
    """Middleware for all requests to a pendant.

    The Host of a request must be an address or a name of this machine, and its Origin, if it has one, the same. Only
    existing resources are served: pages by name, files, uploads of a page, web sockets. full: returns whether the limit
    of open pages is reached. key: a cookie must contain it, which browsers get from the address /?key=...; "" for none.
    """

    def __init__(
        self,
        inner: Any,
        screens: Collection[str],
        full: Callable[[int], bool],
        invalid_messages: InvalidMessages,
        key: str = "",
    ) -> None:
        self._inner = inner
        self._pages = {"/", *(f"/{screen}" for screen in screens)}
        self._full = full
        self._key = key
        self._invalid_messages = invalid_messages
        self._names = {"localhost", socket.gethostname().lower(), socket.getfqdn().lower()}

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._inner(scope, receive, send)
            return
        status, reason = self._refusal(scope)
        if status and scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": _POLICY_VIOLATION})
        elif status:
            await PlainTextResponse(f"{reason}\n", status)(scope, receive, _with_headers(send, ""))
        elif scope["type"] == "websocket":
            await self._socket(scope, receive, send)
        elif self._key and scope["query_string"] == self._query_with_key:
            await self._admission(scope)(scope, receive, _with_headers(send, ""))
        else:
            await self._request(scope, receive, send)

    def _refusal(self, scope: Any) -> tuple[int, str]:
        """Status and reason of a refusal; status 0 if the request is accepted."""
        path, method, headers = scope["path"], scope.get("method", ""), dict(scope["headers"])
        if not self._allowed(headers):
            return _FORBIDDEN, "This pendant only answers requests to its machine's addresses and name."
        if not self._has_key(scope, headers):
            return _UNAUTHORIZED, "This pendant is for the browsers of a class: open it with the link of its robot."
        if scope["type"] == "websocket":
            return (0, "") if path.startswith(("/live/", "/_nicegui_ws/")) else (404, "There is no such web socket.")
        if method == "POST" and path.startswith("/_nicegui/client/"):
            return 0, ""
        if path not in self._pages and not path.startswith(_FILES) and path not in ("/favicon.ico", BROWSERS):
            return 404, "There is no such page. The pendant is at /"
        if method not in ("GET", "HEAD"):
            return 405, "This address is read-only."
        if path in self._pages and self._full(_MAX_PAGES):
            return 503, f"{_MAX_PAGES} browsers show this pendant already. Close one, and try again in a minute."
        return 0, ""

    @property
    def _query_with_key(self) -> bytes:
        return f"key={self._key}".encode()

    def _cookie(self, scope: Any) -> str:
        """The cookie with the key; browsers send cookies to all ports of an address, so its name has the port."""
        return f"pendant_{scope['server'][1]}={self._key}"

    def _has_key(self, scope: Any, headers: dict[bytes, bytes]) -> bool:
        cookies = headers.get(b"cookie", b"").decode("latin-1").split("; ")
        shown = any(secrets.compare_digest(cookie.encode(), self._cookie(scope).encode()) for cookie in cookies)
        return not self._key or shown or secrets.compare_digest(scope["query_string"], self._query_with_key)

    def _admission(self, scope: Any) -> RedirectResponse:
        """The answer to the address with the key: a cookie, and the same page without the key in its address."""
        cookie = f"{self._cookie(scope)}; HttpOnly; SameSite=Lax; Path=/"
        return RedirectResponse(scope["path"], _SEE_OTHER, {"set-cookie": cookie})

    async def _request(self, scope: Any, receive: Any, send: Any) -> None:
        started = gone = False
        nonce = secrets.token_urlsafe(16)

        async def listen() -> Any:
            nonlocal gone
            message = await receive()
            gone = gone or message["type"] == "http.disconnect"
            return message

        async def forward(message: Any) -> None:
            nonlocal started
            started = True
            await send(message)

        try:
            await self._inner(scope, listen, _with_headers(_with_nonce(forward, nonce), nonce))
        except Exception as error:
            if gone:  # before there was an answer, which the layers below take for an error
                return
            self._invalid_messages.report_error(error)
            if not started:
                text = "Bad request; the pendant's log says why.\n"
                await PlainTextResponse(text, 400)(scope, receive, _with_headers(send, nonce))

    async def _socket(self, scope: Any, receive: Any, send: Any) -> None:
        try:
            await self._inner(scope, receive, send)
        except Exception as error:
            self._invalid_messages.report_error(error)

    def _allowed(self, headers: dict[bytes, bytes]) -> bool:
        host = headers.get(b"host", b"").decode("latin-1").lower()
        origin = headers.get(b"origin", b"").decode("latin-1").lower()
        try:
            return self._is_this_machine(host) and (not origin or urlsplit(origin).netloc == host)
        except ValueError:  # unbalanced brackets
            return False

    def _is_this_machine(self, host: str) -> bool:
        name = urlsplit(f"//{host}").hostname or ""
        try:
            ip_address(name)
        except ValueError:
            return name in self._names
        return True


def _with_headers(send: Any, nonce: str) -> Any:
    policy = "; ".join(_POLICIES).format(nonce=nonce).encode()

    async def add(message: Any) -> None:
        if message["type"] == "http.response.start":
            headers = [*message["headers"], *_FIXED_HEADERS]
            if not any(name == b"content-security-policy" for name, _ in headers):
                headers.append((b"content-security-policy", policy))
            message = {**message, "headers": headers}
        await send(message)

    return add


def _with_nonce(send: Any, nonce: str) -> Any:
    """Add the nonce to the scripts of a page. Texts of a robot have their < escaped, so they cannot get one."""
    start: Any = None
    parts = list[bytes]()

    async def mark(message: Any) -> None:
        nonlocal start
        if message["type"] == "http.response.start":
            if dict(message["headers"]).get(b"content-type", b"").startswith(b"text/html"):
                start = message
                return
        elif start is not None and message["type"] == "http.response.body":
            parts.append(message.get("body", b""))
            if message.get("more_body"):
                return
            body = b"".join(parts).replace(b"<script", b'<script nonce="%s"' % nonce.encode())
            headers = [(name, value) for name, value in start["headers"] if name != b"content-length"]
            headers.append((b"content-length", str(len(body)).encode()))
            await send({**start, "headers": headers})
            message = {"type": "http.response.body", "body": body}
        await send(message)

    return mark


def guard_events(invalid_messages: InvalidMessages) -> None:
    """Pass events to NiceGUI only for pages that the sender has open, and handle errors in them."""
    sio: Any = core.sio
    sio.eio.transports = ["websocket"]  # polling adds attack surface and is useless for a page that moves an arm
    core.app.config.socket_io_js_transports = ["websocket"]
    handlers = sio.handlers["/"]
    connect = handlers["connect"]

    async def guarded_connect(sid: str, environ: Any, login: Any = None) -> None:
        try:
            await connect(sid, environ, login)
        except socketio.exceptions.ConnectionRefusedError:
            raise
        except Exception as error:
            invalid_messages.report_error(error)
            raise socketio.exceptions.ConnectionRefusedError("Bad request.") from None

    def guarded(name: str, handler: Callable[[str, Any], None]) -> Callable[..., None]:
        def handle(sid: str, *message: Any) -> None:
            try:
                (payload,) = message
                if payload["client_id"] in sio.rooms(sid):
                    handler(sid, payload)
            except Exception as error:
                invalid_messages.report_error(error)

        return handle

    handshake = handlers["handshake"]

    async def guarded_handshake(sid: str, *message: Any) -> bool:
        try:
            (payload,) = message
            return bool(await handshake(sid, payload))
        except Exception as error:
            invalid_messages.report_error(error)
            return False

    sio.on("connect", guarded_connect)
    sio.on("handshake", guarded_handshake)
    for name in ("event", "javascript_response", "ack", "log"):
        sio.on(name, guarded(name, handlers[name]))


def shorten_library_logs(invalid_messages: InvalidMessages) -> None:
    """Shorten errors logged by the web libraries to one throttled line each."""

    def shorten(record: logging.LogRecord) -> bool:
        if record.levelno < logging.WARNING:
            return True
        error = record.exc_info[1] if record.exc_info else None
        if error is None and isinstance(record.msg, BaseException):
            error = record.msg
        if error is not None:
            invalid_messages.report_error(error)
        else:
            invalid_messages.report(f"{record.name} {record.msg}"[:_MAX_LINE], record.getMessage())
        return False

    for name in _LOGGERS:
        logging.getLogger(name).addFilter(shorten)
