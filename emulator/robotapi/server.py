"""The port of the Robot API (HTTP 80): checks requests, which are executed in the next control period.

In addition, the port answers the requests with which start scripts wait for a robot. Web pages cannot use it: see
`emulator.servers.http`. As a host, names without a dot and names of the local network, as containers and robots have
them, are accepted like addresses.
"""

import re
from collections.abc import Collection, Generator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final
from urllib.parse import unquote, urlsplit

import msgspec

from emulator.controller import Controller
from emulator.mailbox import Command
from emulator.robotapi.endpoints import OPERATIONS, Operation, Upload
from emulator.robotapi.messages import ApiError, InvalidPart, ValidationError
from emulator.servers import http
from emulator.servers.command_queue import CommandQueue
from emulator.servers.connection import Connection
from emulator.servers.port import PortServer, ServedController
from urproto.robotapi import BASE, MAX_UPLOAD, OPENAPI, URCAPS, api_version
from urproto.versions import PolyscopeVersion

_FORM: Final = "multipart/form-data"
_FILE: Final = "file"
_NOT_IMPLEMENTED: Final = 501
_METHODS_OF_URCAPS: Final = ("DELETE", "GET", "PATCH", "POST", "PUT")
_CALL_WORK: Final = 20  # [units of `urscript.work`], next to what HTTP costs
_AT: Final = re.compile(r" - at `\$\.?([^`]*)`")
_LOCAL_CONTROL: Final = "the robot is in local control: switch it to Remote Control on its pendant"
_BOUNDARY: Final = re.compile(r'boundary=(?:"([^"]{1,70})"|([^\s;"]{1,70}))', re.IGNORECASE)
_PART_NAME: Final = re.compile(r'(?:^|;)\s*name="([^"]*)"|(?:^|;)\s*name=([^\s;"]+)', re.IGNORECASE)
_LINE_END: Final = b"\r\n"
_SCHEMAS: Final = "#/components/schemas/{name}"
_REFUSALS: Final = {
    "400": "The program exists already.",
    "403": "The robot is in local control, or the request comes from another site's web page.",
    "404": "There is no such program.",
    "409": "The robot cannot do that in the state it is in.",
    "413": "The request is too large.",
    "415": "The content type is not supported.",
    "500": "The emulator failed.",
    "504": "The robot takes too long.",
}
_UPLOADED: Final = {
    "type": "object",
    "properties": {"file": {"type": "string", "contentMediaType": "application/octet-stream"}},
    "required": ["file"],
}


class RobotApiServer(PortServer):
    """Serves the requests that the controller's version supports."""

    def __init__(self, controller: ServedController) -> None:
        super().__init__("robot api", controller)
        self.operations = [each for each in OPERATIONS if each.endpoint.available.covers(controller.version)]

    def connect(self) -> Connection:
        return _RobotApiConnection(self)

    @cached_property
    def document(self) -> bytes:
        return http.as_json(openapi(self.operations, self.controller.version))


@dataclass(frozen=True, slots=True)
class RobotApiCall(Command):
    """A request. Answer: status and content of the response."""

    price = _CALL_WORK

    operation: Operation
    arguments: tuple[Any, ...]

    def apply(self, controller: Controller) -> Generator[None, None, tuple[int, Any]]:
        if self.operation.endpoint.remote_only and controller.local_control:
            return http.FORBIDDEN, ApiError(_LOCAL_CONTROL)
        try:
            answer = self.operation.function(controller, *self.arguments)
            if isinstance(answer, Generator):
                answer = yield from answer
        except http.HttpError as error:
            return error.status, ApiError(str(error))
        return http.OK, answer

    @property
    def failure(self) -> tuple[int, Any]:
        return http.FAILED, ApiError("the request failed because of an error in the emulator: see its log")


class _RobotApiConnection(http.HttpConnection):
    server: RobotApiServer
    max_body = MAX_UPLOAD

    def __init__(self, server: RobotApiServer) -> None:
        super().__init__(server)
        self._queue = CommandQueue(server.controller, self.read_on, client=self)

    def refusal(self, text: str) -> Any:
        return ApiError(text)

    def admit(self, request: http.Request) -> None:
        http.check_host(request, also=http.is_local)
        _check_origin(request)

    def methods(self, path: str) -> Collection[str]:
        if path == URCAPS:
            return _METHODS_OF_URCAPS
        if path == OPENAPI and self.server.operations:
            return ("GET",)
        here = {each.endpoint.method for each, _ in self._operations(path)}
        if not here:
            raise self._nothing_at(path)
        return here

    def answer(self, request: http.Request) -> http.Response | None:
        if request.path == URCAPS:
            return _urcaps(request)
        if request.path == OPENAPI:
            return http.Response(http.OK, self.server.document)
        method = request.method
        operation, name = next(each for each in self._operations(request.path) if each[0].endpoint.method == method)
        try:
            arguments = _arguments(operation, name, request)
        except _InvalidRequestError as error:
            return http.Response(http.INVALID, ValidationError([InvalidPart(error.where, str(error), "value_error")]))
        self._queue.put(RobotApiCall(operation, arguments), self._answered)
        return None

    def lost(self) -> None:
        super().lost()
        self._queue.clear()

    def _answered(self, answer: tuple[int, Any]) -> None:
        if self.is_open:
            self.reply(http.Response(*answer))

    def _operations(self, path: str) -> list[tuple[Operation, str]]:
        """The operations at a path, each with the name in the path."""
        if not path.startswith(f"{BASE}/"):
            return []
        path = path.removeprefix(BASE)
        return [(each, name) for each in self.server.operations if (name := _matched(each, path)) is not None]

    def _nothing_at(self, path: str) -> http.HttpError:
        """Why there is nothing: a path that differs in its last slash is redirected."""
        other = path.rstrip("/") if path.endswith("/") else f"{path}/"
        if any(f"{BASE}{each.endpoint.path}" == other for each in self.server.operations):
            return http.HttpError(http.TEMPORARY_REDIRECT, f"it is at {other}", {"Location": other})
        return http.HttpError(http.NOT_FOUND, f"there is nothing at {path[:100]}: see {OPENAPI}")


def _matched(operation: Operation, path: str) -> str | None:
    """The name in a path of this operation, "" if it has none; None for another path."""
    if not operation.named:
        return "" if path == operation.endpoint.path else None
    before, _, behind = operation.endpoint.path.partition("{name}")
    name = path.removeprefix(before).removesuffix(behind)
    return unquote(name) if path.startswith(before) and name and "/" not in name else None


class _InvalidRequestError(ValueError):
    """A part of a request is invalid."""

    def __init__(self, where: list[str | int], text: str) -> None:
        super().__init__(text)
        self.where = where


def _arguments(operation: Operation, name: str, request: http.Request) -> tuple[Any, ...]:
    """The arguments of the operation's function. Raises _InvalidRequestError or HttpError."""
    if operation.named:
        return (name,)
    if operation.upload:
        http.check_type(request, _FORM)
        try:
            found = _parts_of(request.headers["content-type"], request.body)
        except ValueError as error:
            raise _InvalidRequestError(["body"], str(error)) from error
        if _FILE not in found:
            raise _InvalidRequestError(["body", _FILE], "the form has no part with this name")
        return (Upload(found[_FILE]),)
    if operation.body is None:
        return ()
    http.check_type(request, http.JSON)
    try:
        return (msgspec.json.decode(request.body, type=operation.body),)
    except msgspec.ValidationError as error:
        text = str(error)
        at = _AT.search(text)
        where: list[str | int] = ["body", *at[1].split(".")] if at and at[1] else ["body"]
        raise _InvalidRequestError(where, _AT.sub("", text)) from error
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        raise _InvalidRequestError(["body"], f"the body is not JSON: {error}") from error


def _urcaps(request: http.Request) -> http.Response:
    """The answer of the service for URCaps: none are installed, and none can be."""
    if request.method != "GET":
        raise http.HttpError(_NOT_IMPLEMENTED, "URCaps of PolyScope X are not emulated")
    return http.Response(http.OK, [])


def _check_origin(request: http.Request) -> None:
    """Refuse web pages by their Origin header: browsers send forms with files without a preflight request."""
    origin = request.headers.get("origin")
    if origin is not None and urlsplit(origin).netloc != request.headers.get("host", ""):
        raise http.HttpError(http.FORBIDDEN, f"web pages of {origin[:100]} may not use the robot")


def _parts_of(content_type: str, body: bytes) -> dict[str, bytes]:
    """The parts of a form (RFC 7578) by name; the last one if a name occurs several times. Raises ValueError."""
    match = _BOUNDARY.search(content_type)
    if match is None:
        raise ValueError("the content type names no boundary")
    delimiter = b"--" + (match[1] or match[2]).encode("latin-1")
    pieces = (_LINE_END + body).split(_LINE_END + delimiter)
    if len(pieces) < 3 or not pieces[-1].startswith(b"--"):
        raise ValueError("the form does not end with its boundary")
    found = {}
    for piece in pieces[1:-1]:
        head, separator, content = piece.lstrip(b" \t").removeprefix(_LINE_END).partition(_LINE_END * 2)
        if not separator:
            raise ValueError("the headers of a part of the form are not terminated")
        found[_part_name(head)] = content
    return found


def _part_name(head: bytes) -> str:
    for line in head.decode("latin-1").split("\r\n"):
        field, _, value = line.partition(":")
        if field.strip().lower() == "content-disposition" and (match := _PART_NAME.search(value)):
            return match[1] or match[2] or ""
    raise ValueError("a part of the form has no name")


def openapi(operations: Sequence[Operation], version: PolyscopeVersion) -> dict[str, Any]:
    """OpenAPI 3.1, with the requests that a controller of this version supports."""
    kinds = [kind for operation in operations for kind in (operation.body, operation.answer) if _is_struct(kind)]
    schemas, components = msgspec.json.schema_components([*kinds, ApiError, ValidationError], ref_template=_SCHEMAS)
    schema_of = dict(zip([*kinds, ApiError, ValidationError], schemas, strict=True))
    paths: dict[str, dict[str, Any]] = {}
    for operation in operations:
        place = operation.endpoint
        paths.setdefault(place.path, {})[place.method.lower()] = _operation(operation, schema_of)
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "Robot API, emulated",
            "version": api_version(version),
            "description": f"As in PolyScope {version.short}. The descriptions of the requests are the emulator's own.",
        },
        "servers": [{"url": BASE}],
        "paths": paths,
        "components": {"schemas": components},
    }


def _is_struct(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def _operation(operation: Operation, schema_of: dict[Any, Any]) -> dict[str, Any]:
    place = operation.endpoint
    described: dict[str, Any] = {
        "operationId": operation.function.__name__,
        "summary": operation.help.partition("\n")[0],
        "description": operation.help,
        "responses": {
            "200": {"description": "Done.", "content": {http.JSON: {"schema": schema_of.get(operation.answer, {})}}},
            **{status: _refusal(text, schema_of[ApiError]) for status, text in _REFUSALS.items()},
            "422": _refusal("The request is invalid.", {"anyOf": [schema_of[ValidationError], schema_of[ApiError]]}),
        },
    }
    if operation.body is not None:
        described["requestBody"] = {"required": True, "content": {http.JSON: {"schema": schema_of[operation.body]}}}
    if operation.upload:
        described["requestBody"] = {"required": True, "content": {_FORM: {"schema": _UPLOADED}}}
    if operation.named:
        described["parameters"] = [{"name": "name", "in": "path", "required": True, "schema": {"type": "string"}}]
    assert (operation.named) == ("{name}" in place.path), place.path
    return described


def _refusal(text: str, schema: Any) -> dict[str, Any]:
    return {"description": text, "content": {http.JSON: {"schema": schema}}}
