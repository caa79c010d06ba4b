"""HTTP for the servers of this package: a request in, JSON or bytes in parts out, one after the other per connection.

A server decides how a request is answered. Requests that h11 rejects and bodies that are too large are answered here.
``check_host`` and ``check_type`` keep web pages out. A web site whose name was made to resolve to this machine (DNS
rebinding) sends that name as the Host, which is not an address. For a page that sends JSON to another site, a browser
first asks that site for permission (a preflight request); without permission a page can only send other types.
"""

import logging
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from ipaddress import ip_address
from typing import Any, Final

import h11
import msgspec

from emulator.servers.connection import Connection
from emulator.servers.port import PortServer
from urproto.text import from_bytes, readable_in

JSON: Final = "application/json"
CONTINUE, OK, TEMPORARY_REDIRECT = 100, 200, 307
BAD, UNAUTHORIZED, FORBIDDEN, NOT_FOUND, NOT_ALLOWED, CONFLICT = 400, 401, 403, 404, 405, 409
TOO_LARGE, WRONG_TYPE, INVALID, FAILED, UNAVAILABLE, TIMED_OUT = 413, 415, 422, 500, 503, 504

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
    max_body = 4 * 1024 * 1024

    def __init__(self, server: PortServer) -> None:
        super().__init__(server)
        self._http = h11.Connection(h11.SERVER)
        self._request: h11.Request | None = None
        self._body = bytearray()
        self._waiting = False  # for the answer to a request

    @abstractmethod
    def answer(self, request: Request) -> Response | None:
        """Return the answer, or None if ``reply`` is called later. Raises HttpError."""

    @abstractmethod
    def refusal(self, status: int, text: str) -> Any:
        """Return the content of an error answer."""

    def reply(self, response: Response) -> None:
        """Answer the pending request and continue with the next one."""
        self._waiting = False
        self._send(response)
        self._proceed()

    def begin_response(self, status: int, headers: Mapping[str, str]) -> None:
        """Start the answer to the pending request; ``send_part`` continues and ``end_response`` completes it."""
        self.send(self._http.send(h11.Response(status_code=status, headers=list(headers.items()))) or b"")

    def send_part(self, content: bytes) -> None:
        """Send the next part of the answer."""
        self.send(self._http.send(h11.Data(data=content)) or b"")

    def end_response(self) -> None:
        """Complete the answer and continue with the next request."""
        self.send(self._http.send(h11.EndOfMessage()) or b"")
        self._waiting = False
        self._next_cycle()
        self._proceed()

    def refuse(self, error: HttpError) -> Response:
        """Return the answer to a request that is refused."""
        return Response(error.status, self.refusal(error.status, str(error)), error.headers)

    @property
    def waiting(self) -> bool:
        """Whether a request has not been answered yet."""
        return self._waiting

    def received(self, data: bytes) -> None:
        self._feed(data)
        self._proceed()

    def at_end(self) -> bool:
        """A client that closes its sending side no longer waits for an answer."""
        self._feed(b"")
        return False

    def _feed(self, data: bytes) -> None:
        if self._http.their_state is not h11.ERROR:
            self._http.receive_data(data)

    def _proceed(self) -> None:
        """Handle the complete requests one after the other."""
        while not self._waiting:
            try:
                event = self._http.next_event()
            except h11.RemoteProtocolError as error:
                self._send(self.refuse(HttpError(error.error_status_hint, str(error))))
                self.hang_up()
                return
            if event is h11.NEED_DATA or event is h11.PAUSED or isinstance(event, h11.ConnectionClosed):
                return
            self._handle(event)

    def _handle(self, event: Any) -> None:
        if isinstance(event, h11.Request):
            self._request, self._body = event, bytearray()
            if self._http.they_are_waiting_for_100_continue:
                self.send(self._http.send(h11.InformationalResponse(status_code=CONTINUE, headers=[])) or b"")
        elif isinstance(event, h11.Data) and len(self._body) <= self.max_body:
            self._body += event.data
        elif isinstance(event, h11.EndOfMessage):
            response = self._outcome(self._answer)
            self._waiting = response is None
            if response is not None:
                self._send(response)

    def _answer(self) -> Response | None:
        assert self._request is not None
        headers = {name.decode(): from_bytes(value) for name, value in self._request.headers}
        path, _, query = from_bytes(self._request.target).partition("?")
        if len(self._body) > self.max_body:
            raise HttpError(TOO_LARGE, f"the body has more than {self.max_body} bytes")
        return self.answer(Request(self._request.method.decode(), path, query, headers, bytes(self._body)))

    def _outcome(self, work: Callable[[], Response | None]) -> Response | None:
        try:
            return work()
        except HttpError as error:
            return self.refuse(error)
        except Exception as error:
            _logger.exception("%s: a request failed", self.server.name)
            return self.refuse(HttpError(FAILED, f"the request failed because of a bug in the emulator: {error}"))

    def _send(self, response: Response) -> None:
        if self._http.our_state not in (h11.IDLE, h11.SEND_RESPONSE):
            return
        raw = isinstance(response.content, bytes)
        body = response.content if raw else as_json(response.content)
        headers = {"Content-Type": JSON, "Content-Length": str(len(body)), **response.headers}
        events = (
            h11.Response(status_code=response.status, headers=list(headers.items())),
            h11.Data(data=body),
            h11.EndOfMessage(),
        )
        self.send(b"".join(self._http.send(event) or b"" for event in events))
        self._next_cycle()

    def _next_cycle(self) -> None:
        try:
            self._http.start_next_cycle()
        except h11.LocalProtocolError:  # the request was invalid, or the client asked to close the connection
            self.hang_up()


def as_json(content: Any) -> bytes:
    """Encode content as JSON."""
    try:
        return msgspec.json.encode(content)
    except UnicodeEncodeError:  # lone surrogates are rare, so the content is only searched for them after a failure
        return msgspec.json.encode(readable_in(content))


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
    """Whether a text is an IP address."""
    try:
        ip_address(text)
    except ValueError:
        return False
    return True
