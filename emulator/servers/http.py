"""HTTP for servers of this package: requests in, JSON out, or bytes in parts, one after the other on each connection.

A server says what a request is answered with; what h11 finds wrong with a request, and bodies that are too large, are
answered here. ``check_host`` and ``check_type`` keep pages of web browsers out: a page's own name, which somebody made
point to this machine, is no address; and a browser asks first before it sends a page's JSON, or sends it not as JSON.
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


class Refused(Exception):  # noqa: N818 - an answer
    """A request is answered with an error: a status, what is wrong, and headers that say more."""

    def __init__(self, status: int, text: str, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(text)
        self.status = status
        self.headers = headers or {}


@dataclass(frozen=True, slots=True)
class Request:
    """A whole request. path: without the query; headers by their names in lower case."""

    method: str
    path: str
    query: str
    headers: Mapping[str, str]
    body: bytes


@dataclass(frozen=True, slots=True)
class Response:
    """An answer. content: what JSON can say, or bytes."""

    status: int
    content: Any
    headers: Mapping[str, str] = field(default_factory=dict)


class HttpConnection(Connection):
    """One client. A request is answered by `reply`, at once or later; the next one waits until then.

    most_body: bytes; more is answered with 413, and not kept.
    """

    for_browsers = True  # or those that speak as they do: the requests say whether they are pages
    most_body = 4 * 1024 * 1024

    def __init__(self, server: PortServer) -> None:
        super().__init__(server)
        self._http = h11.Connection(h11.SERVER)
        self._request: h11.Request | None = None
        self._body = bytearray()
        self._waiting = False  # for the answer to a request

    @abstractmethod
    def answer(self, request: Request) -> Response | None:
        """The answer; None when ``reply`` comes later. Raises Refused."""

    @abstractmethod
    def refusal(self, status: int, text: str) -> Any:
        """The content of an answer that is an error."""

    def reply(self, response: Response) -> None:
        """Answer the request that waits, and go on with the next."""
        self._waiting = False
        self._send(response)
        self._proceed()

    def begin(self, status: int, headers: Mapping[str, str]) -> None:
        """Begin to answer the request that waits; ``part`` goes on with it, and ``end`` ends it."""
        self.send(self._http.send(h11.Response(status_code=status, headers=list(headers.items()))) or b"")

    def part(self, content: bytes) -> None:
        """More of the answer."""
        self.send(self._http.send(h11.Data(data=content)) or b"")

    def end(self) -> None:
        """That was the answer; go on with the next request."""
        self.send(self._http.send(h11.EndOfMessage()) or b"")
        self._waiting = False
        self._next_cycle()
        self._proceed()

    def refuse(self, error: Refused) -> Response:
        """The answer to a request that is refused."""
        return Response(error.status, self.refusal(error.status, str(error)), error.headers)

    @property
    def waiting(self) -> bool:
        """Whether a request is not answered yet."""
        return self._waiting

    def received(self, data: bytes) -> None:
        self._feed(data)
        self._proceed()

    def at_end(self) -> bool:
        """Who ends its side waits no longer for an answer."""
        self._feed(b"")
        return False

    def _feed(self, data: bytes) -> None:
        if self._http.their_state is not h11.ERROR:
            self._http.receive_data(data)

    def _proceed(self) -> None:
        """Carry out the requests that are complete, one after the other."""
        while not self._waiting:
            try:
                event = self._http.next_event()
            except h11.RemoteProtocolError as error:
                self._send(self.refuse(Refused(error.error_status_hint, str(error))))
                self.hang_up()
                return
            if event is h11.NEED_DATA or event is h11.PAUSED or isinstance(event, h11.ConnectionClosed):
                return
            self._take(event)

    def _take(self, event: Any) -> None:
        if isinstance(event, h11.Request):
            self._request, self._body = event, bytearray()
            if self._http.they_are_waiting_for_100_continue:
                self.send(self._http.send(h11.InformationalResponse(status_code=CONTINUE, headers=[])) or b"")
        elif isinstance(event, h11.Data) and len(self._body) <= self.most_body:
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
        if len(self._body) > self.most_body:
            raise Refused(TOO_LARGE, f"more than {self.most_body} bytes")
        return self.answer(Request(self._request.method.decode(), path, query, headers, bytes(self._body)))

    def _outcome(self, work: Callable[[], Response | None]) -> Response | None:
        try:
            return work()
        except Refused as error:
            return self.refuse(error)
        except Exception as error:
            _logger.exception("%s: a request failed", self.server.name)
            return self.refuse(Refused(FAILED, f"the request failed, which is a fault of the emulator: {error}"))

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
        except h11.LocalProtocolError:  # the request was broken, or the client wants the connection closed
            self.hang_up()


def as_json(content: Any) -> bytes:
    """Content as JSON."""
    try:
        return msgspec.json.encode(content)
    except UnicodeEncodeError:  # seldom enough that the whole is only looked through then
        return msgspec.json.encode(readable_in(content))


def check_host(request: Request, *, also: Callable[[str], bool] = lambda _: False) -> None:
    """A page whose name was made to point here must not get in. also: names that are right beside addresses.

    Raises Refused.
    """
    host = request.headers.get("host", "")
    name = host.rpartition(":")[0] if ":" in host.rpartition("]")[2] else host
    name = name.strip("[]")
    if name != "localhost" and not is_address(name) and not also(name):
        raise Refused(FORBIDDEN, f"ask for an address, not for {host!r}")


def check_site(request: Request) -> None:
    """No page of another site. Browsers say it of every request to this machine. Raises Refused."""
    if request.headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
        raise Refused(FORBIDDEN, "not for pages of other sites")


def check_type(request: Request, wanted: str) -> None:
    """A page may send other types of content without being asked. Raises Refused."""
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != wanted:
        raise Refused(WRONG_TYPE, f"send the header Content-Type: {wanted}")


def is_local(name: str) -> bool:
    """Names that nobody else can own: a page cannot come from them."""
    return bool(name) and ("." not in name or name.endswith(".local"))


def is_address(text: str) -> bool:
    """Whether it is an IP address."""
    try:
        ip_address(text)
    except ValueError:
        return False
    return True
