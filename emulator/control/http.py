"""The control API over HTTP: ``POST /verbs/<name>`` with a JSON object of arguments.

``GET /openapi.json`` documents it, ``GET /verbs`` lists the verbs for command-line clients, ``GET /metrics`` is for
Prometheus. Answers to wrong tokens are delayed, so that nobody can try many. Web pages cannot use it: a
request needs the JSON content type, for which browsers first ask for permission, and an address of this robot as Host.
"""

import asyncio
import hmac
import logging
from collections.abc import Callable, Collection, Mapping
from functools import cache
from importlib.metadata import version as distribution_version
from typing import Any, Final

import msgspec

from emulator.control.control import LiveControl, is_waiting
from emulator.control.metrics import CONTENT_TYPE
from emulator.control.verbs import Verb, verbs_of
from emulator.servers import http
from emulator.servers.admission import Reason
from emulator.servers.connection import Connection
from emulator.servers.port import PortServer, ServedController
from emulator.snapshot import Snapshot
from urproto.addresses import BackdoorMark
from urproto.controlapi import BadArguments, NotPossible
from urproto.text import to_bytes

_VERBS: Final[Mapping[str, Verb]] = verbs_of(LiveControl.SUBJECTS)

_CALLS: Final = "/verbs/"
_OPEN: Final = ("/", "/health")  # without a token
_METRICS: Final = "/metrics"
_WELCOME: Final = {"name": "ur-emulator control API", "documentation": "/openapi.json", "verbs": "/verbs"}
_SCHEMAS: Final = "#/components/schemas/{name}"
_REFUSALS: Final = {
    "400": "The arguments do not fit the verb.",
    "401": "The token is missing or wrong.",
    "409": "The robot cannot do that in the state it is in.",
}


@cache
def _openapi() -> bytes:
    return http.as_json(openapi(_VERBS, distribution_version("ur-emulator")))


@cache
def _listing() -> bytes:
    return http.as_json(listing(_VERBS))


_PAGES: Final[Mapping[str, Callable[[], bytes]]] = {"/openapi.json": _openapi, "/verbs": _listing, _METRICS: bytes}

_logger = logging.getLogger(__name__)


class ControlServer(PortServer):
    """Calls the verbs of ``control``.

    token: the token that clients have to send, "" for none. metrics: returns the answer to ``GET /metrics``.
    """

    def __init__(
        self,
        controller: ServedController,
        control: LiveControl,
        token: str = "",
        metrics: Callable[[], bytes] = bytes,
    ) -> None:
        super().__init__("control", controller)
        self.control = control
        self.metrics = metrics
        self.token = token
        self.guesses = http.Guesses()
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


class _ControlConnection(http.HttpConnection):
    server: ControlServer

    def __init__(self, server: ControlServer) -> None:
        super().__init__(server)
        self._steps: Any = None  # of the verb that is not finished
        self._refusing: asyncio.TimerHandle | None = None

    def lost(self) -> None:
        super().lost()
        if self._refusing is not None:
            self._refusing.cancel()
        self.server.unfinished.pop(self, None)
        if self._steps is not None:
            self._steps.close()

    def resume(self) -> None:
        """Call at the end of a control period: carry out the next step of the verb."""
        if self._steps is not None:
            response = self._outcome_of(self._next_step)
            if response is not None:
                self.reply(response)

    def admit(self, request: http.Request) -> None:
        http.check_host(request, also=lambda _: bool(self.server.token))

    def methods(self, path: str) -> Collection[str]:
        if path in _OPEN or path in _PAGES:
            return ("GET",)
        if not path.startswith(_CALLS):
            raise http.HttpError(http.NOT_FOUND, f"nothing is served at {path[:100]}: see /openapi.json")
        return ("POST",)

    def answer(self, request: http.Request) -> http.Response | None:
        path = request.path
        if path in _OPEN:
            return http.Response(http.OK, _WELCOME)
        if self.server.token and not self._authorized(request.headers.get("authorization", "")):
            return None
        if path == _METRICS:
            return http.Response(http.OK, self.server.metrics(), {"Content-Type": CONTENT_TYPE})
        if path in _PAGES:
            return http.Response(http.OK, _PAGES[path]())
        return self._outcome_of(lambda: self._call(path.removeprefix(_CALLS), request))

    def _authorized(self, given: str) -> bool:
        """Whether a request has the token; a wrong one is answered later. Raises HttpError if there is none."""
        if hmac.compare_digest(to_bytes(given), to_bytes(f"Bearer {self.server.token}")):
            return True
        refusal = http.HttpError(
            http.UNAUTHORIZED,
            "the token is missing or wrong: send the header Authorization: Bearer <token>",
            {"WWW-Authenticate": "Bearer"},
        )
        if not given:
            raise refusal
        delay_s = self.server.guesses.delay_s()
        self.server.turned_away.count(Reason.WRONG_TOKEN, self.peer, "sent a wrong token, which is answered later")
        later = asyncio.get_running_loop().call_later
        self._refusing = later(delay_s, lambda: self.reply(self.refuse(refusal)))
        return False

    def _outcome_of(self, work: Callable[[], Any]) -> http.Response | None:
        """Return the response to the result or error of the work; None if it takes more time: its steps are kept."""
        status, content = self._result_of(work)
        if is_waiting(content):
            self._steps = content
            self.server.unfinished[self] = None
            return None
        self._steps = None
        self.server.unfinished.pop(self, None)
        return http.Response(status, content)

    def _result_of(self, work: Callable[[], Any]) -> tuple[int, Any]:
        """Return the status and the content of the answer. Raises HttpError."""
        try:
            return http.OK, work()
        except http.HttpError:
            raise
        except BadArguments as error:
            return http.BAD, {"error": str(error)}
        except NotPossible as error:
            return http.CONFLICT, {"error": str(error)}
        except Exception as error:
            if self.server.reported.is_new(error):
                _logger.exception("a verb failed")
            return http.FAILED, {"error": f"the verb failed because of a bug in the emulator: {error}"}

    def _call(self, name: str, request: http.Request) -> Any:
        if name not in _VERBS:
            raise http.HttpError(http.NOT_FOUND, f"there is no verb {name!r}: see /verbs")
        http.check_type(request, http.JSON)
        control = self.server.control
        control.client = self.peer
        try:
            result = _VERBS[name].call(control, _decoded(request.body))
        finally:
            control.client = ""
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


def _decoded(body: bytes) -> dict[str, Any]:
    try:
        return msgspec.json.decode(body or b"{}", type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        raise BadArguments(f"the arguments are not a JSON object: {error}") from error


def openapi(verbs: Mapping[str, Verb], version: str) -> dict[str, Any]:
    """OpenAPI 3.1: one POST operation for each verb."""
    kinds = [verb.parameters for verb in verbs.values()] + [verb.result for verb in verbs.values()]
    schemas, components = msgspec.json.schema_components(kinds, ref_template=_SCHEMAS)
    results = schemas[len(verbs) :]
    paths = {
        f"/verbs/{name}": {"post": _operation(verb, schema, result)}
        for (name, verb), schema, result in zip(verbs.items(), schemas, results, strict=False)
    }
    return {
        "openapi": "3.1.0",
        "info": {"title": "ur-emulator control API", "version": version},
        "paths": paths,
        "components": {"schemas": components, "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}}},
        "security": [{}, {"token": []}],
    }


def listing(verbs: Mapping[str, Verb]) -> list[dict[str, Any]]:
    """Name, documentation and arguments of each verb, and whether it takes further ones, for a command line."""
    return [
        {"name": verb.name, "text": verb.text, "arguments": _arguments(verb), "open": verb.open}
        for verb in verbs.values()
    ]


def _arguments(verb: Verb) -> list[dict[str, Any]]:
    fields = msgspec.structs.fields(verb.parameters)
    return [{"name": field.name, "required": field.required, "type": _name_of(field.type)} for field in fields]


def _name_of(kind: Any) -> str:
    plain = isinstance(kind, type) and not hasattr(kind, "__args__")
    return str(kind.__name__ if plain else kind).replace("typing.", "").replace("collections.abc.", "")


def _operation(verb: Verb, schema: Mapping[str, Any], result: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "operationId": verb.name,
        "summary": verb.summary,
        "description": verb.text,
        "requestBody": {"required": False, "content": _json(schema)},
        "responses": {
            "200": {"description": "Done.", "content": _json(_object(result=result))},
            **{code: _refusal(text) for code, text in _REFUSALS.items()},
        },
    }


def _refusal(text: str) -> dict[str, Any]:
    return {"description": text, "content": _json(_object(error={"type": "string"}))}


def _object(**properties: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": list(properties)}


def _json(schema: Mapping[str, Any]) -> dict[str, Any]:
    return {"application/json": {"schema": schema}}
