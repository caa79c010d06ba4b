"""HTTP as every client may speak it, on the control API, which is served like all other ports with HTTP."""

import asyncio
import logging
import re
from collections.abc import AsyncIterator

import pytest

from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from emulator.servers import http
from tests.rows import each_row
from urproto.robots import load_model

HOST = b"Host: 127.0.0.1\r\n"
CALL = b"POST /verbs/time HTTP/1.1\r\n" + HOST + b"Content-Type: application/json\r\n"
POLICY = "default-src 'none'; frame-ancestors 'none'"
GET, POST = "GET, HEAD, OPTIONS", "OPTIONS, POST"

# request, status, headers of the answer, whether it has a body
CASES: dict[str, tuple[bytes, int, dict[str, str], bool]] = {
    "GET": (b"GET / HTTP/1.1\r\n" + HOST + b"\r\n", 200, {"content-type": "application/json"}, True),
    "HEAD": (b"HEAD / HTTP/1.1\r\n" + HOST + b"\r\n", 200, {"content-type": "application/json"}, False),
    "HEAD of nothing": (b"HEAD /x HTTP/1.1\r\n" + HOST + b"\r\n", 404, {"content-security-policy": POLICY}, False),
    "OPTIONS of a page": (b"OPTIONS /verbs HTTP/1.1\r\n" + HOST + b"\r\n", 204, {"allow": GET}, False),
    "OPTIONS of a verb": (b"OPTIONS /verbs/time HTTP/1.1\r\n" + HOST + b"\r\n", 204, {"allow": POST}, False),
    "OPTIONS of everything": (b"OPTIONS * HTTP/1.1\r\n" + HOST + b"\r\n", 204, {}, False),
    "another method": (b"DELETE / HTTP/1.1\r\n" + HOST + b"\r\n", 405, {"allow": GET}, True),
    "GET of a verb": (b"GET /verbs/time HTTP/1.1\r\n" + HOST + b"\r\n", 405, {"allow": POST}, True),
    "an unknown method": (b"BREW /verbs HTTP/1.1\r\n" + HOST + b"\r\n", 405, {"allow": GET}, True),
    "nothing there": (b"GET /x HTTP/1.1\r\n" + HOST + b"\r\n", 404, {"content-security-policy": POLICY}, True),
    "an absolute target": (b"GET http://127.0.0.1/health HTTP/1.1\r\nHost: x.example\r\n\r\n", 200, {}, True),
    "a query": (b"GET /health?a=b HTTP/1.1\r\n" + HOST + b"\r\n", 200, {}, True),
    "a range, which may be ignored": (b"GET / HTTP/1.1\r\n" + HOST + b"Range: bytes=0-1\r\n\r\n", 200, {}, True),
    "no host": (b"GET / HTTP/1.1\r\n\r\n", 400, {}, True),
    "two hosts": (b"GET / HTTP/1.1\r\n" + HOST + HOST + b"\r\n", 400, {}, True),
    "HTTP/1.0": (b"GET / HTTP/1.0\r\n" + HOST + b"\r\n", 200, {"connection": "close"}, True),
    "close": (b"GET / HTTP/1.1\r\n" + HOST + b"Connection: close\r\n\r\n", 200, {"connection": "close"}, True),
    "a body": (CALL + b"Content-Length: 2\r\n\r\n{}", 200, {}, True),
    "a body in chunks": (CALL + b"Transfer-Encoding: chunked\r\n\r\n1\r\n{\r\n1\r\n}\r\n0\r\n\r\n", 200, {}, True),
    "two lengths": (CALL + b"Content-Length: 2\r\nContent-Length: 3\r\n\r\n{}", 400, {}, True),
    "a length that is no number": (CALL + b"Content-Length: x\r\n\r\n", 400, {}, True),
    "an unknown coding": (CALL + b"Transfer-Encoding: gzip\r\n\r\n", 501, {}, True),
    "a chunk without a size": (CALL + b"Transfer-Encoding: chunked\r\n\r\nx\r\n", 400, {}, True),
    "chunks of one byte": (CALL + b"Transfer-Encoding: chunked\r\n\r\n" + b"1\r\n \r\n" * 5000, 413, {}, True),
    "endless headers": (b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 10_000, 431, {}, True),
    "an endless header": (b"GET / HTTP/1.1\r\nA: " + b"b" * 60_000, 431, {}, True),
    "an endless target": (b"GET /" + b"b" * 60_000, 431, {}, True),
    "a body that is too large": (CALL + b"Content-Length: 5000000\r\n\r\n" + b" " * 5_000_000, 413, {}, True),
}


@pytest.fixture
async def emulator() -> AsyncIterator[Emulator]:
    controller = ControllerConfig(model=load_model("ur3"))
    async with Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True, control_token="t")) as running:
        yield running


async def exchange(emulator: Emulator, data: bytes) -> bytes:
    """Everything that is answered before the connection is closed, which the last request asks for."""
    reader, writer = await asyncio.open_connection("127.0.0.1", emulator.ports["control"])
    writer.write(data)
    answer = await asyncio.wait_for(reader.read(), 30)
    writer.close()
    return answer


LAST = b"GET /health HTTP/1.1\r\n" + HOST + b"Connection: close\r\n\r\n"


def parsed(answer: bytes) -> tuple[int, dict[str, str], bytes]:
    head, _, body = answer.partition(b"\r\n\r\n")
    line, *fields = head.decode().split("\r\n")
    headers = {name.lower(): value for name, _, value in (field.partition(": ") for field in fields)}
    return int(line.split()[1]), headers, body


@each_row("name", CASES)
async def test_http(emulator: Emulator, name: str) -> None:
    request, status, wanted, has_body = CASES[name]
    request = request.replace(b"\r\nHost", b"\r\nAuthorization: Bearer t\r\nHost", 1)
    answered, headers, rest = parsed(await exchange(emulator, request + LAST))
    assert answered == status, rest[:200]
    assert {key: headers.get(key) for key in wanted} == wanted
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["content-security-policy"]
    assert re.fullmatch(r"\w{3}, \d\d \w{3} \d{4} \d\d:\d\d:\d\d GMT", headers["date"])
    length = int(headers.get("content-length", 0))
    assert (length > 0) or not has_body
    after = rest[length if has_body else 0 :]
    assert after.startswith(b"HTTP/1.1 200") or (not after and headers.get("connection") == "close")


async def test_pipelined_requests_are_answered_in_order_and_end_with_their_client(emulator: Emulator) -> None:
    one = b"GET /health HTTP/1.1\r\n" + HOST + b"\r\n"
    assert (await exchange(emulator, one * 3000 + LAST)).count(b"HTTP/1.1 200") == 3001
    reader, writer = await asyncio.open_connection("127.0.0.1", emulator.ports["control"])
    writer.write(one * 3000)
    await reader.readexactly(1)
    writer.transport.abort()
    while emulator.servers["control"].connections:
        await asyncio.sleep(0)
    deferred = emulator.read_budget.used_s
    for _ in range(100):
        await asyncio.sleep(0)
    assert emulator.read_budget.used_s == deferred


async def test_wrong_tokens_are_answered_one_after_the_other_counted_and_logged_once(
    emulator: Emulator, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(http, "_GUESS_S", 0.05)
    loop = asyncio.get_running_loop()
    guess = b"GET /verbs HTTP/1.1\r\nConnection: close\r\nAuthorization: Bearer x\r\n" + HOST + b"\r\n"
    began_s = loop.time()
    with caplog.at_level(logging.WARNING):
        answers = await asyncio.gather(*(exchange(emulator, guess) for _ in range(6)))
    assert [parsed(answer)[0] for answer in answers] == [401] * 6
    assert loop.time() - began_s >= 0.3
    assert emulator.control.turned_away()["control"] == {"wrong token": 6}
    assert sum("wrong token" in record.message for record in caplog.records) == 1
    assert b"401" in await exchange(emulator, LAST.replace(b"/health", b"/verbs"))


async def test_metrics_are_in_the_text_format_of_prometheus(emulator: Emulator) -> None:
    request = b"GET /metrics HTTP/1.1\r\nAuthorization: Bearer t\r\nConnection: close\r\n" + HOST + b"\r\n"
    status, headers, body = parsed(await exchange(emulator, request))
    assert (status, headers["content-type"]) == (200, "text/plain; version=0.0.4; charset=utf-8")
    sample = r'[a-z_]+(\{[a-z]+="[^"]*"(,[a-z]+="[^"]*")*\})? -?[0-9.e+-]+'
    typed: set[str] = set()
    for line in body.decode().splitlines():
        if line.startswith("# TYPE "):
            typed.add(line.split()[2])
        elif not line.startswith("# HELP "):
            assert re.fullmatch(sample, line), line
            assert re.match("[a-z_]+", line)[0] in typed, line  # type: ignore[index]
    for name in ("periods_missed_total", "period_lateness_seconds", "work_deferred_total", "queue_length"):
        assert f"ur_emulator_{name}" in typed
    assert b'ur_emulator_clients{port="control"} 1' in body
