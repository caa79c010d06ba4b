"""The control API over HTTP: ``POST /verbs/<name>`` with a JSON object of arguments.

``GET /openapi.json`` documents it, ``GET /verbs`` lists it for command lines. Pages in a browser cannot use it: a
request names the JSON content type, which makes browsers ask first, and its Host is an address of this robot.
"""

import hmac
import logging
from collections.abc import Callable, Mapping
from importlib.metadata import version as distribution_version
from ipaddress import ip_address
from typing import Any, Final

import h11
import msgspec

from emulator.control.control import LiveControl, is_waiting
from emulator.control.openapi import listing, openapi
from emulator.control.verbs import BadArguments, NotPossible, Verb, verbs_of
from emulator.servers.connection import Connection
from emulator.servers.port import PortServer, ServedController
from emulator.snapshot import Snapshot
from urproto.backdoors import BackdoorMark
from urproto.text import from_bytes, readable_in, to_bytes

_MOST_BODY: Final = 4 * 1024 * 1024  # bytes of arguments; a saved state has some 10 kB
_VERBS: Final[Mapping[str, Verb]] = verbs_of(LiveControl.SUBJECTS)
_CONTINUE, _OK, _BAD, _UNAUTHORIZED, _FORBIDDEN, _NOT_FOUND, _NOT_ALLOWED = 100, 200, 400, 401, 403, 404, 405
_CONFLICT, _TOO_LARGE, _WRONG_TYPE, _FAILED = 409, 413, 415, 500

_logger = logging.getLogger(__name__)


class _Refused(Exception):  # noqa: N818 - an answer
    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


class ControlServer(PortServer):
    """Calls the verbs of ``control``. ``token``: what a client has to present, "" for nothing."""

    def __init__(self, controller: ServedController, control: LiveControl, token: str = "") -> None:
        super().__init__("control", controller)
        self.control = control
        self.token = token
        self._mark: BackdoorMark | None = None

    def connect(self) -> Connection:
        return _HttpConnection(self)

    async def _listen(self, host: str, port: int) -> None:
        await super()._listen(host, port)
        if self._listening is not None:
            self._mark = BackdoorMark(*self._listening.address)

    def close_port(self) -> None:
        super().close_port()
        if self._mark is not None:
            self._mark.close()
            self._mark = None

    def publish(self, snapshot: Snapshot) -> None:
        """Go on with verbs that take time."""
        for connection in self.connections:
            assert isinstance(connection, _HttpConnection)
            connection.go_on()


class _HttpConnection(Connection):
    server: ControlServer
    for_browsers = True  # or those that speak as they do: the requests say whether they are pages

    def __init__(self, server: ControlServer) -> None:
        super().__init__(server)
        self._http = h11.Connection(h11.SERVER)
        self._request: h11.Request | None = None
        self._body = bytearray()
        self._steps: Any = None  # of the verb that takes time

    def received(self, data: bytes) -> None:
        self._feed(data)
        self._proceed()

    def at_end(self) -> bool:
        """Who ends its side waits no longer for a verb that takes time."""
        self._feed(b"")
        return False

    def lost(self) -> None:
        if self._steps is not None:
            self._steps.close()

    def go_on(self) -> None:
        """A control period is over."""
        if self._steps is not None:
            self._answer(self._next_step)
            self._proceed()

    def _feed(self, data: bytes) -> None:
        if self._http.their_state is not h11.ERROR:
            self._http.receive_data(data)

    def _proceed(self) -> None:
        """Carry out the requests that are complete, one after the other."""
        while self._steps is None:
            try:
                event = self._http.next_event()
            except h11.RemoteProtocolError as error:
                self._reply(error.error_status_hint, {"error": str(error)})
                self.hang_up()
                return
            if event is h11.NEED_DATA or event is h11.PAUSED or isinstance(event, h11.ConnectionClosed):
                return
            self._take(event)

    def _take(self, event: Any) -> None:
        if isinstance(event, h11.Request):
            self._request, self._body = event, bytearray()
            if self._http.they_are_waiting_for_100_continue:
                self.send(self._http.send(h11.InformationalResponse(status_code=_CONTINUE, headers=[])) or b"")
        elif isinstance(event, h11.Data) and len(self._body) <= _MOST_BODY:
            self._body += event.data
        elif isinstance(event, h11.EndOfMessage):
            self._answer(self._carry_out)

    def _answer(self, work: Callable[[], Any]) -> None:
        """Reply with what the work returns or how it fails, or keep the steps it wants more time for."""
        status, content = _outcome(work)
        self._steps = content if is_waiting(content) else None
        if self._steps is None:
            self._reply(status, content)

    def _carry_out(self) -> Any:
        """What the request asks for, or the steps to it."""
        assert self._request is not None
        headers = {name.decode(): from_bytes(value) for name, value in self._request.headers}
        method, path = self._request.method.decode(), from_bytes(self._request.target).partition("?")[0]
        self._check_host(headers.get("host", ""))
        if method == "GET" and path in ("/", "/health"):
            return {"name": "ur-emulator control API", "documentation": "/openapi.json", "verbs": "/verbs"}
        self._check_token(headers.get("authorization", ""))
        if method == "GET" and path == "/openapi.json":
            return openapi(_VERBS, distribution_version("ur-emulator"))
        if method == "GET" and path == "/verbs":
            return listing(_VERBS)
        if not path.startswith("/verbs/"):
            raise _Refused(_NOT_FOUND, f"there is nothing at {path}: see /openapi.json")
        if method != "POST":
            raise _Refused(_NOT_ALLOWED, f"a verb takes a POST request, not {method}")
        return self._call(path.removeprefix("/verbs/"), headers.get("content-type", ""))

    def _call(self, name: str, content_type: str) -> Any:
        if name not in _VERBS:
            raise _Refused(_NOT_FOUND, f"there is no verb {name!r}: see /verbs")
        if content_type.partition(";")[0].strip().lower() != "application/json":
            raise _Refused(_WRONG_TYPE, "send the header Content-Type: application/json")
        result = _VERBS[name].call(self.server.control, self._arguments())
        if not is_waiting(result):
            return {"result": result}
        self._steps = result
        return self._next_step()

    def _next_step(self) -> Any:
        """The verb's steps while it takes more time, else its answer."""
        try:
            next(self._steps)
        except StopIteration as done:
            return {"result": done.value}
        return self._steps

    def _arguments(self) -> dict[str, Any]:
        if len(self._body) > _MOST_BODY:
            raise _Refused(_TOO_LARGE, f"more than {_MOST_BODY} bytes of arguments")
        try:
            return msgspec.json.decode(bytes(self._body) or b"{}", type=dict[str, Any])
        except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
            raise BadArguments(f"the arguments are not a JSON object: {error}") from error

    def _check_host(self, host: str) -> None:
        """A page whose name was made to point here must not get in."""
        name = host.rpartition(":")[0] if ":" in host.rpartition("]")[2] else host
        name = name.strip("[]")
        if name != "localhost" and not _is_address(name) and not self.server.token:
            raise _Refused(_FORBIDDEN, f"ask for an address, not for {host!r}")

    def _check_token(self, authorization: str) -> None:
        wanted = self.server.token
        if wanted and not hmac.compare_digest(to_bytes(authorization), to_bytes(f"Bearer {wanted}")):
            raise _Refused(_UNAUTHORIZED, "send the header Authorization: Bearer and the token")

    def _reply(self, status: int, content: Any) -> None:
        if self._http.our_state not in (h11.IDLE, h11.SEND_RESPONSE):
            return
        body = _json(content)
        headers = [("Content-Type", "application/json"), ("Content-Length", str(len(body)))]
        if status == _UNAUTHORIZED:
            headers.append(("WWW-Authenticate", "Bearer"))
        events = (h11.Response(status_code=status, headers=headers), h11.Data(data=body), h11.EndOfMessage())
        self.send(b"".join(self._http.send(event) or b"" for event in events))
        try:
            self._http.start_next_cycle()
        except h11.LocalProtocolError:  # the request was broken, or the client wants the connection closed
            self.hang_up()


def _json(content: Any) -> bytes:
    try:
        return msgspec.json.encode(content)
    except UnicodeEncodeError:  # seldom enough that the whole is only looked through then
        return msgspec.json.encode(readable_in(content))


def _outcome(work: Callable[[], Any]) -> tuple[int, Any]:
    """Status and content of the answer."""
    try:
        return _OK, work()
    except _Refused as error:
        return error.status, {"error": str(error)}
    except BadArguments as error:
        return _BAD, {"error": str(error)}
    except NotPossible as error:
        return _CONFLICT, {"error": str(error)}
    except Exception as error:
        _logger.exception("a verb failed")
        return _FAILED, {"error": f"the verb failed, which is a fault of the emulator: {error}"}


def _is_address(text: str) -> bool:
    try:
        ip_address(text)
    except ValueError:
        return False
    return True
