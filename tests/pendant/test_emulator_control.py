"""An emulator's control API as seen by a pendant."""

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from client.pendant.dialogues import Dialogues
from client.pendant.emulator_control import EmulatorControl
from urproto.compat_asyncio import timeout


@asynccontextmanager
async def server(status: int, answers: dict[str, object]) -> AsyncIterator[int]:
    """Answers every request on a port: /verbs with the names, a verb with its result."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        header = await reader.readuntil(b"\r\n\r\n")
        path = header.split()[1].decode()
        lengths = [line.split(b":")[1] for line in header.split(b"\r\n") if line.lower().startswith(b"content-length")]
        await reader.readexactly(int(lengths[0]) if lengths else 0)
        content = [{"name": verb} for verb in answers]
        response = content if path == "/verbs" else {"result": answers.get(path.rpartition("/")[2])}
        body = json.dumps(response if status == 200 else {"error": "no"}).encode()
        lines = (f"HTTP/1.1 {status} X", "Connection: close", f"Content-Length: {len(body)}", "", "")
        writer.write("\r\n".join(lines).encode() + body)
        await writer.drain()
        writer.close()

    listening = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with listening:
        yield listening.sockets[0].getsockname()[1]


async def query_emulator(status: int, answers: dict[str, object], **also: object) -> EmulatorControl:
    """The state after the first queries."""
    changed = asyncio.Event()
    async with server(status, answers) as port, timeout(20.0):
        emulator = EmulatorControl("127.0.0.1", port, "", changed.set, lambda: asyncio.sleep(0))
        following = asyncio.create_task(emulator.follow(Dialogues()))
        while not (emulator.locked or emulator.time):
            await asyncio.sleep(0)
        following.cancel()
        await asyncio.gather(following, return_exceptions=True)
        emulator.still = await emulator.is_time_paused()  # type: ignore[attr-defined]
        await emulator.close()
    return emulator


TIME = {"time_s": 1.0, "period_s": 0.008, "speed": 1.0, "paused": False}


async def test_emulator_with_unknown_token_is_locked() -> None:
    emulator = await query_emulator(401, {})
    assert (emulator.available, emulator.locked) == (False, True)


async def test_constant_results_are_queried_once() -> None:
    emulator = await query_emulator(200, {"popups": [], "time": TIME, "ports": {"rtde": 30004}, "fault_kinds": []})
    assert (emulator.available, emulator.locked) == (True, False)
    assert emulator.catalogue == {"ports": {"rtde": 30004}, "fault_kinds": []}
    assert (emulator.pace, emulator.still) == ("", False)


async def test_paused_time_is_detected() -> None:
    emulator = await query_emulator(200, {"popups": [], "time": {**TIME, "paused": True}})
    assert (emulator.pace, emulator.still) == ("time paused", True)
