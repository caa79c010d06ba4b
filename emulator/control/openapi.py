"""The verbs as an OpenAPI document, for clients in other languages."""

from collections.abc import Mapping
from typing import Any, Final

import msgspec

from emulator.control.verbs import Verb

_SCHEMAS: Final = "#/components/schemas/{name}"
_REFUSALS: Final = {
    "400": "The arguments do not fit the verb.",
    "401": "The token is missing or wrong.",
    "409": "The robot cannot do that in the state it is in.",
}


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
