"""Client for the Robot API of PolyScope X: power, brakes, programs and modes, over HTTP.

    async with RobotAPIClient("192.168.56.101") as robot:
        await robot.request(POWER_ON)
        mode = await robot.request(ROBOT_MODE)

    with BlockingRobotAPIClient("192.168.56.101") as robot:
        robot.request(upload(Path("pick.urpx").read_bytes()))
        robot.request(load("pick"))

An ApiRequest is a request and how to read its answer. `request` raises RobotRefused if the answer does not report
success. It also does so for a request that the robot's API version does not have, without sending it. Each request uses
a new connection, because robots close idle ones.
"""

import asyncio
import json
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Generic, TypeVar
from urllib.parse import urlsplit

import h11

from client.connection import DEFAULT_TIMEOUT_S, AsyncConnection, BlockingConnection, Flow, Reconnect, TimeLimit
from client.dashboard_commands import POWER_ADVICE, PROGRAM_ADVICE
from client.errors import ConnectionLostError
from client.quantities import checked, checked_call
from urproto import robotapi as wire
from urproto.dashboard import OperationalMode, ProgramState
from urproto.errors import RemoteProtocolError, RobotRefused
from urproto.modes import RobotMode, SafetyMode
from urproto.ports import CONTROLLER_PORTS
from urproto.robotapi import Endpoint, ProgramAction, StateAction

PORT: Final = CONTROLLER_PORTS["robot api"]

Answer = TypeVar("Answer")

_SWITCHING_S: Final = 90.0  # guess: the emulator gives up after 60 s
_MAX_REDIRECTS: Final = 3
_OK, _FORBIDDEN, _REDIRECTS = 200, 403, (301, 302, 307, 308)
_READING_SINCE: Final = (3, 1, 4)  # of the API's own versions: came with PolyScope 10.12
REMOTE_CONTROL: Final = "switch the robot to Remote Control on its teach pendant"
"""Advice for a refusal by a robot in local control."""


@dataclass(frozen=True, slots=True)
class ApiRequest(Generic[Answer]):
    """A request and how to read its answer; ``read`` may raise RemoteProtocolError.

    body: a JSON object, or the bytes of a file. name: the program in the path. advice: what to do if the robot refuses.
    timeout_s: how long the answer may take [s]; None for the connection's timeout.
    """

    endpoint: Endpoint
    read: Callable[[Any], Answer]
    body: Mapping[str, str] | bytes | None = None
    name: str = ""
    advice: str = ""
    timeout_s: float | None = None

    @property
    def path(self) -> str:
        """Path of the request on the robot."""
        path = wire.program_path(self.name) if self.name else self.endpoint.path
        return f"{wire.BASE}{path}"

    def __str__(self) -> str:
        suffix = f" {self.body}" if isinstance(self.body, Mapping) else ""
        return f"{self.endpoint.method} {self.endpoint.path}{suffix}"


@dataclass(frozen=True, slots=True)
class StoredProgram:
    """A program as the robot lists it. Dates are milliseconds since 1970, or None if the event never happened."""

    name: str
    description: str
    created_ms: int | None
    modified_ms: int | None
    saved_ms: int | None
    state: str


def _done(_: Any) -> None:
    return None


def _field(content: Any, name: str) -> str:
    value = content.get(name) if isinstance(content, dict) else None
    if not isinstance(value, str):
        raise RemoteProtocolError(f"the answer has no {name}: {str(content)[:60]!r}")
    return value


def _word(name: str, parse: Callable[[str], Answer]) -> Callable[[Any], Answer]:
    """Return a reader for a field with a fixed set of words."""

    def read(content: Any) -> Answer:
        word = _field(content, name)
        try:
            return parse(word)
        except (ValueError, KeyError) as error:
            raise RemoteProtocolError(f"{word!r} is not a known {name}") from error

    return read


def _programs(content: Any) -> list[StoredProgram]:
    listed = content.get("programs") if isinstance(content, dict) else None
    if not isinstance(listed, list):
        raise RemoteProtocolError("the answer is not a list of programs")
    return [
        StoredProgram(
            _field(each, "name"),
            str(each.get("description") or ""),
            _date(each, "createdDate"),
            _date(each, "lastModifiedDate"),
            _date(each, "lastSavedDate"),
            str(each.get("programState") or ""),
        )
        for each in listed
    ]


def _date(listed: Any, key: str) -> int | None:
    value = listed.get(key)
    return int(value) if isinstance(value, int | float) else None


def _change(action: StateAction, advice: str = POWER_ADVICE) -> ApiRequest[None]:
    return ApiRequest(wire.PUT_STATE, _done, {"action": action.value}, advice=advice, timeout_s=_SWITCHING_S)


def _act(action: ProgramAction) -> ApiRequest[None]:
    return ApiRequest(wire.PUT_PROGRAM_STATE, _done, {"action": action.value}, advice=PROGRAM_ADVICE)


POWER_ON = _change(StateAction.POWER_ON)
POWER_OFF = _change(StateAction.POWER_OFF)
BRAKE_RELEASE = _change(StateAction.BRAKE_RELEASE)
UNLOCK_PROTECTIVE_STOP = _change(StateAction.UNLOCK_PROTECTIVE_STOP, "find the cause of the stop, then try again")
RESTART_SAFETY = _change(StateAction.RESTART_SAFETY)
PLAY = _act(ProgramAction.PLAY)
PAUSE = _act(ProgramAction.PAUSE)
RESUME = _act(ProgramAction.RESUME)
STOP = _act(ProgramAction.STOP)
ROBOT_MODE: ApiRequest[RobotMode] = ApiRequest(wire.GET_ROBOT_MODE, _word("mode", wire.parse_robot_word))
SAFETY_MODE: ApiRequest[SafetyMode] = ApiRequest(wire.GET_SAFETY_MODE, _word("mode", wire.parse_safety_word))
IS_IN_REMOTE_CONTROL: ApiRequest[bool] = ApiRequest(
    wire.GET_CONTROL_MODE, _word("mode", {"REMOTE": True, "LOCAL": False}.__getitem__)
)
OPERATIONAL_MODE: ApiRequest[OperationalMode] = ApiRequest(
    wire.GET_OPERATIONAL_MODE, _word("mode", OperationalMode.__getitem__)
)
PROGRAM_STATE: ApiRequest[ProgramState] = ApiRequest(wire.GET_PROGRAM_STATE, _word("state", ProgramState.__getitem__))
LOADED_PROGRAM: ApiRequest[str] = ApiRequest(wire.GET_LOADED, lambda content: _field(content, "name"))
PROGRAMS: ApiRequest[list[StoredProgram]] = ApiRequest(wire.GET_PROGRAMS, _programs)


@checked_call
def load(program: str) -> ApiRequest[None]:
    """Load a stored program by its name, without .urpx. The client chooses the request by the API's version."""
    return ApiRequest(wire.PUT_LOADED, _done, {"name": program}, advice="PROGRAMS lists the stored programs")


@checked_call
def upload(file: bytes, *, replace: bool = False) -> ApiRequest[str]:
    """Store a .urpx file, as a new program or as a replacement for the program of that name; returns the name."""
    place = wire.PUT_PROGRAM if replace else wire.POST_PROGRAM
    return ApiRequest(place, lambda content: _field(content, "programName"), file)


@checked_call
def download(program: str) -> ApiRequest[bytes]:
    """Download a stored program as a .urpx file."""
    return ApiRequest(wire.GET_PROGRAM, _as_file, name=program)


def _as_file(content: Any) -> bytes:
    return content if isinstance(content, bytes) else json.dumps(content).encode()


@dataclass(frozen=True, slots=True)
class _Response:
    status: int
    location: str
    body: bytes


class RobotApiCore:
    """The client's side of a Robot API connection, without I/O. version: version of the API, known after `opening`."""

    def __init__(self, host: str, port: int) -> None:
        self.host = host if port == PORT else f"{host}:{port}"
        self.version: tuple[int, ...] | None = None
        self._used = False

    def opening(self) -> Flow[None]:
        """Request the API's version. Raises RemoteProtocolError if this is not a Robot API."""
        self.version = None
        response = yield from self._exchange("GET", wire.OPENAPI, b"", "")
        try:
            version = json.loads(response.body)["info"]["version"]
            self.version = tuple(int(part) for part in version.split("."))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise RemoteProtocolError(f"this is not a Robot API: {wire.OPENAPI} has no version") from error

    def request(self, request: ApiRequest[Answer]) -> Flow[Answer]:
        """Send a request and read its answer."""
        request = self._for_this_version(request)
        body, content_type = _encoded(request.body)
        yield TimeLimit(request.timeout_s)
        path = request.path
        for _ in range(_MAX_REDIRECTS):
            response = yield from self._exchange(request.endpoint.method, path, body, content_type)
            if response.status not in _REDIRECTS or not response.location:
                break
            path = urlsplit(response.location).path
        yield TimeLimit(None)
        if response.status != _OK:
            advice = REMOTE_CONTROL if response.status == _FORBIDDEN else request.advice
            raise RobotRefused(str(request), _reason(response), advice)
        try:
            return request.read(response.body if request.name else _json(response.body))
        except RemoteProtocolError as error:
            raise RobotRefused(str(request), str(error)) from error

    def _for_this_version(self, request: ApiRequest[Answer]) -> ApiRequest[Answer]:
        """Adapt a request to the robot's API version. Raises RobotRefused if that version does not have it."""
        if self.version is None or self.version >= _READING_SINCE or request.endpoint.available == wire.AVAILABLE:
            return request
        if request.endpoint is wire.PUT_LOADED and isinstance(request.body, Mapping):
            return ApiRequest(wire.PUT_LOAD, request.read, {"programName": request.body["name"]}, advice=request.advice)
        have, need = (".".join(map(str, version)) for version in (self.version, _READING_SINCE))
        raise RobotRefused(str(request), f"Robot API {have} does not have it", f"it needs {need}, PolyScope 10.12")

    def _exchange(self, method: str, path: str, body: bytes, content_type: str) -> Flow[_Response]:
        if self._used:
            yield Reconnect(0.0)
        self._used = True
        http = h11.Connection(h11.CLIENT)
        headers = [("Host", self.host), ("Accept", "application/json"), ("Connection", "close")]
        if body or method != "GET":
            headers += [("Content-Type", content_type), ("Content-Length", str(len(body)))]
        request = h11.Request(method=method, target=path, headers=headers)
        events = (request, *([h11.Data(data=body)] if body else []), h11.EndOfMessage())
        try:
            yield b"".join(http.send(event) or b"" for event in events)
            return (yield from self._response(http))
        except h11.ProtocolError as error:
            raise RemoteProtocolError(f"the robot does not answer like a web server: {error}") from error

    def _response(self, http: h11.Connection) -> Flow[_Response]:
        head: h11.Response | None = None
        content = bytearray()
        while True:
            event = http.next_event()
            if event is h11.NEED_DATA:
                http.receive_data((yield from self._received(http)))
            elif isinstance(event, h11.Response):
                head = event
            elif isinstance(event, h11.Data):
                content += event.data
            elif isinstance(event, h11.EndOfMessage) and head is not None:
                found = dict(head.headers)
                return _Response(head.status_code, found.get(b"location", b"").decode("latin-1"), bytes(content))

    def _received(self, http: h11.Connection) -> Flow[bytes]:
        """The next bytes; b"" if the connection has ended, which may also mark the end of the answer."""
        try:
            return (yield None)
        except ConnectionLostError:
            if http.their_state is not h11.SEND_BODY:
                raise
            return b""


def _encoded(body: Mapping[str, str] | bytes | None) -> tuple[bytes, str]:
    """The encoded body and its content type; a file is sent as a form."""
    if body is None:
        return b"", "application/json"
    if not isinstance(body, bytes):
        return json.dumps(dict(body)).encode(), "application/json"
    boundary = secrets.token_hex(16)
    head = 'Content-Disposition: form-data; name="file"; filename="program.urpx"\r\nContent-Type: text/plain'
    form = f"--{boundary}\r\n{head}\r\n\r\n".encode() + body + f"\r\n--{boundary}--\r\n".encode()
    return form, f"multipart/form-data; boundary={boundary}"


def _json(body: bytes) -> Any:
    try:
        return json.loads(body)
    except (ValueError, RecursionError) as error:
        raise RemoteProtocolError(f"the answer is not JSON: {body[:60]!r}") from error


def _reason(response: _Response) -> str:
    """The robot's reason for a refusal: its error message, or what is wrong with the request."""
    try:
        content = json.loads(response.body)
    except (ValueError, RecursionError):
        content = None
    if isinstance(content, dict):
        details: Sequence[Any] = content["detail"] if isinstance(content.get("detail"), list) else ()
        messages = [str(each.get("msg")) for each in details if isinstance(each, dict)]
        text = content.get("message") or "; ".join(messages)
        if text:
            return str(text)
    return f"HTTP status {response.status}"


@checked
class RobotAPIClient(AsyncConnection):
    """Robot API client for asyncio programs; use it with ``async with``, which connects and requests the version."""

    def __init__(self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self.core = RobotApiCore(host, port)
        self._lock = asyncio.Lock()

    async def request(self, request: ApiRequest[Answer]) -> Answer:
        """Send one request and return its answer. Raises RobotRefused if the robot refuses."""
        async with self._lock:
            return await self.run(self.core.request(request))

    def _opening(self) -> Flow[None]:
        return self.core.opening()


@checked
class BlockingRobotAPIClient(BlockingConnection):
    """Robot API client for scripts and notebooks; use it with ``with``."""

    def __init__(self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self.core = RobotApiCore(host, port)

    def request(self, request: ApiRequest[Answer]) -> Answer:
        """Send one request and return its answer. Raises RobotRefused if the robot refuses."""
        return self.run(self.core.request(request))

    def _opening(self) -> Flow[None]:
        return self.core.opening()
