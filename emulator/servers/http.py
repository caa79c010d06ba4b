"""HTTP for all servers of this package: a request in, JSON or bytes in parts out, one after the other per connection.

A server says which methods it serves at a path, and how a request is answered. Everything that is the same for all of
them is done here: HEAD and OPTIONS, other methods, limits, requests that h11 rejects, and the headers that tell a
browser to treat an answer as nothing but data. A request begins only when the read budget permits it, also if it
arrived together with others; those that are waiting when the client disconnects are dropped.

``check_host`` and ``check_type`` keep web pages out. A web site whose name was made to resolve to this machine (DNS
rebinding) sends that name as the Host, which is not an address. For a page that sends JSON to another site, a browser
first asks that site for permission (a preflight request); without permission a page can only send other types.
"""

import asyncio
import logging
import time
from abc import abstractmethod
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from ipaddress import ip_address
from typing import Any, Final

import h11
import msgspec

from emulator.servers.connection import Connection
from emulator.servers.port import Port
from urproto.text import from_bytes, readable_in

JSON: Final = "application/json"
CONTINUE, OK, NO_CONTENT, TEMPORARY_REDIRECT = 100, 200, 204, 307
BAD, UNAUTHORIZED, FORBIDDEN, NOT_FOUND, NOT_ALLOWED, CONFLICT = 400, 401, 403, 404, 405, 409
TOO_LARGE, WRONG_TYPE, INVALID, FAILED, UNAVAILABLE, TIMED_OUT = 413, 415, 422, 500, 503, 504

PAGE_POLICY: Final = "default-src 'none'; img-src 'self'; frame-ancestors 'none'"
"""Content-Security-Policy of a page that shows pictures of the same server."""

_HEADERS: Final = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}
"""Headers of every answer, unless the server sets them."""

_LAST: Final = {"Connection": "close"}
_DATE: Final = "%a, %d %b %Y %H:%M:%S GMT"
_ABSOLUTE: Final = ("http://", "https://")
_MAX_CHUNKS: Final = 4096  # of a body (guess): clients send some kB in each
_MAX_AHEAD: Final = 64 * 1024  # bytes of further requests that are read while one is being answered (guess)
_GUESS_S: Final = 1.0  # between the answers to two wrong secrets (guess)
_EVENTS_AT_ONCE: Final = 32  # parts of a request that are read between two looks at the read budget (guess)

_logger = logging.getLogger(__name__)


class HttpError(Exception):
    """A request is refused: the status of the answer, the error message, and additional headers."""

    def __init__(self, status: int, text: str, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(text)
        self.status = status
        self.headers = headers or {}


@dataclass(frozen=True, slots=True)
class Request:
    """A complete request. path: without the query. headers: by name, in lower case."""

    method: str
    path: str
    query: str
    headers: Mapping[str, str]
    body: bytes


@dataclass(frozen=True, slots=True)
class Response:
    """An answer. content: an object that is encoded as JSON, or bytes."""

    status: int
    content: Any
    headers: Mapping[str, str] = field(default_factory=dict)


class HttpConnection(Connection):
    """One client. A request is answered immediately or later, by `reply`; until then the next request waits.

    max_body: limit for the body of a request [bytes]. A larger body is discarded and answered with 413.
    """

    for_browsers = True  # HTTP is all that a browser sends; the headers of a request show whether it is from a page
    outlives_client = False
    max_body = 4 * 1024 * 1024

    def __init__(self, server: Port) -> None:
        super().__init__(server)
        self._http = h11.Connection(h11.SERVER)
        self._request: h11.Request | None = None
        self._body = bytearray()
        self._chunks = 0
        self.waiting = False  # for the answer to a request
        self._next: asyncio.Handle | None = None  # looks at what else was received

    @abstractmethod
    def admit(self, request: Request) -> None:
        """Check who sends a request, before anything else. Raises HttpError."""

    @abstractmethod
    def methods(self, path: str) -> Collection[str]:
        """The methods at a path, without HEAD and OPTIONS. Raises HttpError if nothing is served there."""

    @abstractmethod
    def answer(self, request: Request) -> Response | None:
        """Return the answer, or None if ``reply`` is called later. Its method is one of ``methods``; HEAD is GET.

        Raises HttpError.
        """

    def refusal(self, text: str) -> Any:
        """Return the content of an error answer."""
        return {"error": text}

    def reply(self, response: Response) -> None:
        """Answer the pending request and continue with the next one."""
        self.waiting = False
        self._send(response)
        self._continue()

    def begin_response(self, status: int, headers: Mapping[str, str]) -> None:
        """Start the answer to the pending request; ``send_part`` continues and ``end_response`` completes it."""
        response = h11.Response(status_code=status, headers=_with_defaults(headers))
        self.send(self._http.send(response) or b"")

    def send_part(self, content: bytes) -> None:
        """Send the next part of the answer; its size must have been stated, or the answer have no end."""
        if not self.head_only:
            self.send(self._http.send(h11.Data(data=content)) or b"")

    def end_response(self) -> None:
        """Complete the answer and continue with the next request."""
        self.send(self._http.send(h11.EndOfMessage()) or b"")
        self.waiting = False
        self._next_cycle()
        self._continue()

    def refuse(self, error: HttpError) -> Response:
        """Return the answer to a request that is refused."""
        return Response(error.status, self.refusal(str(error)), error.headers)

    @property
    def head_only(self) -> bool:
        """Whether the present request is for the headers of an answer."""
        return self._request is not None and self._request.method == b"HEAD"

    def lost(self) -> None:
        if self._next is not None:
            self._next.cancel()

    def received(self, data: bytes) -> None:
        if self._http.their_state is not h11.ERROR:
            self._http.receive_data(data)
        if len(self._http.trailing_data[0]) > _MAX_AHEAD:
            self.too_far_ahead()

    def too_far_ahead(self) -> None:
        """Called when a client has sent many further requests: the rest waits in the system's buffers."""
        self.read_on(False)

    def at_end(self) -> bool:
        """A client that closes its sending side no longer waits for an answer."""
        return False

    @property
    def has_work(self) -> bool:
        return super().has_work or (not self.waiting and bool(self._http.trailing_data[0]))

    def work(self) -> None:
        """Read what was received, up to the end of one request."""
        super().work()
        for _ in range(_EVENTS_AT_ONCE):
            if self.waiting or not self.is_open:
                return
            try:
                event = self._http.next_event()
                if event is h11.NEED_DATA or event is h11.PAUSED or isinstance(event, h11.ConnectionClosed):
                    self.read_on(True)
                    return
                self._handle(event)
            except (h11.RemoteProtocolError, HttpError) as error:
                status = error.error_status_hint if isinstance(error, h11.RemoteProtocolError) else error.status
                self._send(self.refuse(HttpError(status, str(error), _LAST)))
                self.hang_up()
                return
            if isinstance(event, h11.EndOfMessage):
                break
        self._continue()

    def _continue(self) -> None:
        """Serve what else was received, after others had their turn."""
        if self._next is None and self.has_work and self.is_open:
            self._next = asyncio.get_running_loop().call_soon(self._serve_next)

    def _serve_next(self) -> None:
        self._next = None
        self.serve()

    def _handle(self, event: Any) -> None:
        if isinstance(event, h11.Request):
            self._request, self._body, self._chunks = event, bytearray(), 0
            if self._http.they_are_waiting_for_100_continue:
                self.send(self._http.send(h11.InformationalResponse(status_code=CONTINUE, headers=[])) or b"")
        elif isinstance(event, h11.Data):
            self._chunks += event.chunk_start
            if self._chunks > _MAX_CHUNKS:
                raise HttpError(TOO_LARGE, f"the body has more than {_MAX_CHUNKS} chunks: send larger ones")
            if len(self._body) <= self.max_body:
                self._body += event.data
        elif isinstance(event, h11.EndOfMessage):
            response = self._outcome(self._answer)
            self.waiting = response is None
            if response is not None:
                self._send(response)

    def _answer(self) -> Response | None:
        assert self._request is not None
        method, target = self._request.method.decode(), from_bytes(self._request.target)
        headers = {name.decode(): from_bytes(value) for name, value in self._request.headers}
        if target.startswith(_ABSOLUTE):  # overrides the header
            _, _, target = target.partition("://")
            headers["host"], _, target = target.partition("/")
            target = f"/{target}"
        path, _, query = target.partition("?")
        request = Request("GET" if method == "HEAD" else method, path, query, headers, bytes(self._body))
        self.admit(request)
        if len(self._body) > self.max_body:
            raise HttpError(TOO_LARGE, f"the body has more than {self.max_body} bytes")
        if (method, path) == ("OPTIONS", "*"):
            return Response(NO_CONTENT, b"")
        there = self.methods(path)
        allowed = ", ".join(sorted({*there, "OPTIONS", *(["HEAD"] if "GET" in there else [])}))
        if method == "OPTIONS":
            return Response(NO_CONTENT, b"", {"Allow": allowed})
        if request.method not in there:
            raise HttpError(NOT_ALLOWED, f"{method[:20]} is not allowed here: use {allowed}", {"Allow": allowed})
        return self.answer(request)

    def _outcome(self, work: Callable[[], Response | None]) -> Response | None:
        try:
            return work()
        except HttpError as error:
            return self.refuse(error)
        except Exception as error:
            if self.server.reported.is_new(error):
                _logger.exception("%s: a request failed", self.server.name)
            return self.refuse(HttpError(FAILED, f"the request failed because of a bug in the emulator: {error}"))

    def _send(self, response: Response) -> None:
        if self._http.our_state not in (h11.IDLE, h11.SEND_RESPONSE):
            return
        raw = isinstance(response.content, bytes)
        body = response.content if raw else as_json(response.content)
        headers = {"Content-Type": JSON, "Content-Length": str(len(body)), **response.headers}
        if response.status == NO_CONTENT:
            del headers["Content-Type"], headers["Content-Length"]
        events = (
            h11.Response(status_code=response.status, headers=_with_defaults(headers)),
            h11.Data(data=b"" if self.head_only else body),
            h11.EndOfMessage(),
        )
        self.send(b"".join(self._http.send(event) or b"" for event in events))
        self._next_cycle()

    def _next_cycle(self) -> None:
        try:
            self._http.start_next_cycle()
        except h11.LocalProtocolError:  # the request was invalid, or the client asked to close the connection
            self.hang_up()


def _with_defaults(headers: Mapping[str, str]) -> list[tuple[str, str]]:
    return list({"Date": time.strftime(_DATE, time.gmtime()), **_HEADERS, **headers}.items())


def as_json(content: Any) -> bytes:
    try:
        return msgspec.json.encode(content)
    except UnicodeEncodeError:  # lone surrogates are rare, so the content is only searched for them after a failure
        return msgspec.json.encode(readable_in(content))


class Guesses:
    """Delays the answers to wrong passwords and tokens, so that nobody can try many."""

    def __init__(self) -> None:
        self._next_s = 0.0

    def delay_s(self) -> float:
        """Time until a wrong secret is answered [s]: one after the other, whoever sends them."""
        now_s = time.monotonic()
        self._next_s = max(now_s, self._next_s) + _GUESS_S
        return self._next_s - now_s


def check_host(request: Request, *, also: Callable[[str], bool] = lambda _: False) -> None:
    """Require the Host of a request to be an address, localhost, or a name that ``also`` accepts. Raises HttpError.

    This keeps out pages of web sites whose name was made to resolve to this machine (DNS rebinding).
    """
    host = request.headers.get("host", "")
    name = host.rpartition(":")[0] if ":" in host.rpartition("]")[2] else host
    name = name.strip("[]")
    if name != "localhost" and not is_address(name) and not also(name):
        raise HttpError(FORBIDDEN, f"the Host {host!r} is not allowed: use an IP address in the URL")


def check_site(request: Request) -> None:
    """Keep out pages of other sites: browsers mark all their requests to this machine. Raises HttpError."""
    if request.headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
        raise HttpError(FORBIDDEN, "pages of other web sites have no access")


def check_type(request: Request, expected: str) -> None:
    """Require a content type that web pages cannot send to another site without its permission. Raises HttpError."""
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != expected:
        raise HttpError(WRONG_TYPE, f"send the header Content-Type: {expected}")


def is_local(name: str) -> bool:
    """Whether a name only has a meaning in the local network, so that no site on the internet can have it."""
    return bool(name) and ("." not in name or name.endswith(".local"))


def is_address(text: str) -> bool:
    try:
        ip_address(text)
    except ValueError:
        return False
    return True
