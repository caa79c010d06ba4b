"""The OpenAPI document of the Robot API, whose version clients read first."""

from collections.abc import Sequence
from typing import Any, Final

import msgspec

from emulator.robotapi.endpoints import Operation
from emulator.robotapi.messages import ApiError, ValidationError
from urproto.robotapi import BASE, api_version
from urproto.versions import PolyscopeVersion

_SCHEMAS: Final = "#/components/schemas/{name}"
_JSON: Final = "application/json"
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
_FILE: Final = {
    "type": "object",
    "properties": {"file": {"type": "string", "contentMediaType": "application/octet-stream"}},
    "required": ["file"],
}


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
            "200": {"description": "Done.", "content": {_JSON: {"schema": schema_of.get(operation.answer, {})}}},
            **{status: _refusal(text, schema_of[ApiError]) for status, text in _REFUSALS.items()},
            "422": _refusal("The request is invalid.", {"anyOf": [schema_of[ValidationError], schema_of[ApiError]]}),
        },
    }
    if operation.body is not None:
        described["requestBody"] = {"required": True, "content": {_JSON: {"schema": schema_of[operation.body]}}}
    if operation.upload:
        described["requestBody"] = {"required": True, "content": {"multipart/form-data": {"schema": _FILE}}}
    if operation.named:
        described["parameters"] = [{"name": "name", "in": "path", "required": True, "schema": {"type": "string"}}]
    assert (operation.named) == ("{name}" in place.path), place.path
    return described


def _refusal(text: str, schema: Any) -> dict[str, Any]:
    return {"description": text, "content": {_JSON: {"schema": schema}}}
