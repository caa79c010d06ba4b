"""Programs of PolyScope X, and the HTTP client that is not ours."""

import json
from typing import Any

import httpx

from emulator.app import Emulator
from urproto.robotapi import BASE
from urscript.polyscope.urpx import empty_urpx

HOST = "127.0.0.1"


def client(emulator: Emulator, **options: Any) -> httpx.AsyncClient:
    """Of the API; paths are below its base."""
    url = f"http://{HOST}:{emulator.ports['robot api']}{BASE}"
    return httpx.AsyncClient(base_url=url, timeout=30.0, **options)


def node(kind: str, guid: str, **parameters: Any) -> dict[str, Any]:
    """A node without others in it."""
    return {
        "children": [],
        "contributedNode": {"type": kind, "version": "0.0.3", "parameters": parameters},
        "guid": guid,
    }


def wait(seconds: float, guid: str = "w") -> dict[str, Any]:
    """A wait, as the vendor's files have it."""
    time = {"entity": {"value": seconds, "unit": "s"}, "selectedType": "VALUE", "value": str(seconds)}
    return node("ur-wait", guid, type="time", time=time)


def urpx(name: str, *nodes: dict[str, Any], script: str = "", known: tuple[str, ...] = ()) -> bytes:
    """A program with these nodes. script: the URScript saved with it; known: the nodes that this has labels for."""
    program = json.loads(empty_urpx(name))
    content = program["program"]["programContent"]
    content["children"][-1]["children"] += nodes
    frame = [content["guid"], *(part["guid"] for part in content["children"] if _writes(part))]
    ids = ["00000000-0000-0000-0000-000000000000", *frame, *known]
    program["program"]["urscript"] = {"script": script, "nodeIDList": ids if script else []}
    return json.dumps(program).encode()


def _writes(part: dict[str, Any]) -> bool:
    return part["contributedNode"]["type"] not in ("ur-configuration", "ur-status")
