"""The control API over HTTP: ``POST /verbs/<name>`` with a JSON object of arguments.

``GET /openapi.json`` documents it, ``GET /verbs`` lists the verbs for command-line clients. Web pages cannot use it: a
request needs the JSON content type, for which browsers first ask for permission, and an address of this robot as Host.
"""

import hmac
import logging
from collections.abc import Callable, Mapping
from importlib.metadata import version as distribution_version
from typing import Any, Final

import msgspec

from emulator.control.control import LiveControl, is_waiting
from emulator.control.openapi import listing, openapi
from emulator.control.verbs import BadArguments, NotPossible, Verb, verbs_of
from emulator.servers.connection import Connection
from emulator.servers.http import (
    BAD,
    CONFLICT,
    FAILED,
    JSON,
    NOT_ALLOWED,
    NOT_FOUND,
    OK,
    UNAUTHORIZED,
    HttpConnection,
    HttpError,
    Request,
    Response,
    check_host,
    check_type,
)
from emulator.servers.port import PortServer, ServedController
from emulator.snapshot import Snapshot
from urproto.backdoors import BackdoorMark
from urproto.text import to_bytes

_VERBS: Final[Mapping[str, Verb]] = verbs_of(LiveControl.SUBJECTS)

_logger = logging.getLogger(__name__)


class ControlServer(PortServer):
    """Calls the verbs of ``control``. ``token``: the token that clients have to send, "" for none."""

    def __init__(self, controller: ServedController, control: LiveControl, token: str = "") -> None:
        super().__init__("control", controller)
        self.control = control
        self.token = token
        self.unfinished: dict[_ControlConnection, None] = {}  # connections whose verb is not finished, in order
        self._mark: BackdoorMark | None = None

    def connect(self) -> Connection:
        return _ControlConnection(self)

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
        """Resume the verbs that are not finished."""
        for connection in tuple(self.unfinished):
            connection.resume()


class _ControlConnection(HttpConnection):
    server: ControlServer

    def __init__(self, server: ControlServer) -> None:
        super().__init__(server)
        self._steps: Any = None  # of the verb that is not finished

    def refusal(self, status: int, text: str) -> Any:
        return {"error": text}

    def lost(self) -> None:
        self.server.unfinished.pop(self, None)
        if self._steps is not None:
            self._steps.close()

    def resume(self) -> None:
        """Call at the end of a control period: carry out the next step of the verb."""
        if self._steps is not None:
            response = self._outcome_of(self._next_step)
            if response is not None:
                self.reply(response)

    def answer(self, request: Request) -> Response | None:
        return self._outcome_of(lambda: self._carry_out(request))

    def _outcome_of(self, work: Callable[[], Any]) -> Response | None:
        """Return the response to the result or error of the work; None if it takes more time: its steps are kept."""
        status, content = _outcome(work)
        if is_waiting(content):
            self._steps = content
            self.server.unfinished[self] = None
            return None
        self._steps = None
        self.server.unfinished.pop(self, None)
        return Response(status, content)

    def _carry_out(self, request: Request) -> Any:
        """Return the result of a request, or the remaining steps to it."""
        method, path = request.method, request.path
        check_host(request, also=lambda _: bool(self.server.token))
        if method == "GET" and path in ("/", "/health"):
            return {"name": "ur-emulator control API", "documentation": "/openapi.json", "verbs": "/verbs"}
        self._check_token(request.headers.get("authorization", ""))
        if method == "GET" and path == "/openapi.json":
            return openapi(_VERBS, distribution_version("ur-emulator"))
        if method == "GET" and path == "/verbs":
            return listing(_VERBS)
        if not path.startswith("/verbs/"):
            raise HttpError(NOT_FOUND, f"nothing is served at {path}: see /openapi.json")
        if method != "POST":
            raise HttpError(NOT_ALLOWED, f"the method {method} is not allowed: call a verb with POST")
        return self._call(path.removeprefix("/verbs/"), request)

    def _call(self, name: str, request: Request) -> Any:
        if name not in _VERBS:
            raise HttpError(NOT_FOUND, f"there is no verb {name!r}: see /verbs")
        check_type(request, JSON)
        result = _VERBS[name].call(self.server.control, _arguments(request.body))
        if not is_waiting(result):
            return {"result": result}
        self._steps = result
        return self._next_step()

    def _next_step(self) -> Any:
        """Carry out a step; return the remaining steps, or the result of a finished verb."""
        try:
            next(self._steps)
        except StopIteration as done:
            return {"result": done.value}
        return self._steps

    def _check_token(self, authorization: str) -> None:
        token = self.server.token
        if token and not hmac.compare_digest(to_bytes(authorization), to_bytes(f"Bearer {token}")):
            raise HttpError(
                UNAUTHORIZED,
                "the token is missing or wrong: send the header Authorization: Bearer <token>",
                {"WWW-Authenticate": "Bearer"},
            )


def _arguments(body: bytes) -> dict[str, Any]:
    try:
        return msgspec.json.decode(body or b"{}", type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        raise BadArguments(f"the arguments are not a JSON object: {error}") from error


def _outcome(work: Callable[[], Any]) -> tuple[int, Any]:
    """Return the status and the content of the answer. Raises HttpError."""
    try:
        return OK, work()
    except HttpError:
        raise
    except BadArguments as error:
        return BAD, {"error": str(error)}
    except NotPossible as error:
        return CONFLICT, {"error": str(error)}
    except Exception as error:
        _logger.exception("a verb failed")
        return FAILED, {"error": f"the verb failed because of a bug in the emulator: {error}"}
