"""Requests to the control API of a running robot."""

import asyncio
import json
from collections.abc import Iterator
from functools import cache

from server_rig import MemoryClient

from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.control.control import LiveControl
from emulator.control.verbs import verbs_of
from emulator.machine import ControllerConfig
from targets.registry import Finding, target
from tests.ticking import StepClock
from urproto.robots import load_model


def _http(method: str, path: str, body: bytes = b"") -> bytes:
    head = f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
    return head.encode() + f"Content-Length: {len(body)}\r\n\r\n".encode() + body


def _requests() -> Iterator[bytes]:
    yield _http("GET", "/openapi.json") + _http("GET", "/verbs")
    for name, verb in verbs_of(LiveControl.SUBJECTS).items():
        yield _http("POST", f"/verbs/{name}", json.dumps(dict.fromkeys(verb.arguments, 1)).encode())


@cache
def _robot() -> Emulator:
    """Reused until a verb has changed its state."""
    config = ControllerConfig(model=load_model("ur5e"), running=True)
    return Emulator(EmulatorConfig(controller=config, ephemeral_ports=True), StepClock())


@target(_requests)
def control_api(data: bytes) -> None:
    asyncio.run(_control_api(data))


async def _control_api(data: bytes) -> None:
    emulator = _robot()
    client = MemoryClient(emulator.servers["control"])
    client.feed(data)
    for _ in range(3):
        emulator.controller.tick()
        await asyncio.sleep(0)  # pipelined requests take turns
    client.end()
    client.vanish()
    answer = client.take()
    if b"HTTP/1.1 500" in answer:
        raise Finding(answer.decode(errors="replace"))
    if b"POST" in data and b"HTTP/1.1 200" in answer:
        _robot.cache_clear()
