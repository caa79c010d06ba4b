"""Programs of PolyScope X, and an independent HTTP client."""

import json
from typing import Any

import httpx

from emulator.app import Emulator
from urproto.robotapi import BASE

HOST = "127.0.0.1"
_NIL = "00000000-0000-0000-0000-000000000000"
_FRAME = ("ur-modules", "ur-functions", "ur-before-start", "ur-configuration", "ur-status", "ur-code")


def client(emulator: Emulator, **options: Any) -> httpx.AsyncClient:
    """A client of the API; paths are relative to its base."""
    url = f"http://{HOST}:{emulator.ports['robot api']}{BASE}"
    return httpx.AsyncClient(base_url=url, timeout=30.0, **options)


def node(kind: str, guid: str, **parameters: Any) -> dict[str, Any]:
    """A node without children."""
    return {
        "children": [],
        "contributedNode": {"type": kind, "version": "0.0.3", "parameters": parameters},
        "guid": guid,
    }


def wait(seconds: float, guid: str = "w") -> dict[str, Any]:
    """A Wait node, as in the vendor's files."""
    time = {"entity": {"value": seconds, "unit": "s"}, "selectedType": "VALUE", "value": str(seconds)}
    return node("ur-wait", guid, type="time", time=time)


def urpx(name: str, *nodes: dict[str, Any], script: str = "", known: tuple[str, ...] = ()) -> bytes:
    """A program with these nodes. script: the URScript saved with it; known: the nodes with a label in it."""
    program = json.loads(empty_urpx(name))
    content = program["program"]["programContent"]
    content["children"][-1]["children"] += nodes
    frame = [content["guid"], *(part["guid"] for part in content["children"] if _writes(part))]
    ids = [_NIL, *frame, *known]
    program["program"]["urscript"] = {"script": script, "nodeIDList": ids if script else []}
    return json.dumps(program).encode()


def _writes(part: dict[str, Any]) -> bool:
    return part["contributedNode"]["type"] not in ("ur-configuration", "ur-status")


def empty_urpx(name: str) -> bytes:
    """A program without nodes, as PolyScope X saves one."""
    parts = [{"children": [], "contributedNode": _part(kind), "guid": _guid(i + 2)} for i, kind in enumerate(_FRAME)]
    document = {
        "application": {
            "id": "1",
            "applicationInfo": {"name": "application"},
            "applicationContent": {"applicationContributions": {}},
            "urscript": {"script": "", "nodeIDList": []},
        },
        "program": {
            "id": "1",
            "programContent": {
                "children": parts,
                "contributedNode": {**_part("ur-program"), "lockChildren": True, "parameters": {"name": name}},
                "guid": _guid(1),
            },
            "programInformation": {
                "name": name,
                "description": "",
                "createdDate": 0,
                "lastSavedDate": None,
                "lastModifiedDate": None,
                "programState": "FINAL",
            },
            "urscript": {"script": "", "nodeIDList": []},
        },
    }
    return json.dumps(document, indent=2).encode()


def _part(kind: str) -> dict[str, Any]:
    parameters: dict[str, Any] = {"loopForever": False} if kind == "ur-code" else {}
    return {"type": kind, "version": "0.0.1", "allowsChildren": True, "parameters": parameters}


def _guid(number: int) -> str:
    return f"{_NIL[:-4]}{number:04d}"
