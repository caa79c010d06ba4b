"""Invalid data sent to a pendant is refused or dropped, with a few lines in its log.

UR_GARBAGE: number of requests of each kind, for longer runs.
"""

import json
import os
import random
import re
import socket
import sys
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from client.pendant.web_security import _MAX_PAGES, Gate, InvalidMessages
from tests.pendant.pendants import pendant
from urproto.testing.process import claim_address

websockets = pytest.importorskip("websockets.sync.client")
from websockets.exceptions import WebSocketException  # noqa: E402

COUNT = int(os.environ.get("UR_GARBAGE", "60"))
PORT = 6080
BYTES = bytes(range(256))
METHODS = (
    "GET",
    "POST",
    "PUT",
    "DELETE",
    "PATCH",
    "OPTIONS",
    "HEAD",
    "TRACE",
    "CONNECT",
    "get",
    "G\x00T",
    "é",
    "",
    "PRI",
)
PATHS = (
    *("/", "/move", "/nosuch", "//", "/../../etc/passwd", "/pendant/../server.py", "/pendant/%2e%2e/server.py", "*"),
    *("/%00", "/%ff%fe", "/a" * 4000, "/\x7f", "http://[::1", "/move?x[]=%zz&x=1", "/_nicegui/0/static/a", "/pendant/"),
    *(
        "/_nicegui/client/1/upload/2",
        "/_nicegui_ws/socket.io/?EIO=4&transport=polling",
        "/_nicegui_ws/socket.io/?sid=1",
    ),
    *("/_nicegui_ws/socket.io/?EIO=x&transport=%00", "/live/1", "/favicon.ico/x", "/openapi.json", "/docs", "?"),
)
HEADER_NAMES = (
    *("Host", "Origin", "Content-Length", "Transfer-Encoding", "Upgrade", "Connection", "X-Forwarded-Prefix", "Range"),
    *("Sec-WebSocket-Key", "Sec-WebSocket-Version", "Accept", "If-Modified-Since", "Cookie", "\x00", "é", ""),
    *("Accept-Encoding", "NiceGUI-Check"),
)
HEADER_VALUES = (
    *("", "-1", "1e9", "99999999999999999999", "chunked", "websocket", "[", "http://[", "bytes=9-1,-", "\xff\xfe"),
    *("a" * 9000, "localhost", "127.0.0.1:x", '"><script>', "13", "0"),
)
GET = b"GET /move HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n"
JSON_VALUES: tuple[Any, ...] = (None, True, -1, 1e308, "", "x", "held", [], {}, [[]], {"held": {}}, "\ud800", 10**400)

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="requires a separate address")


class Target(NamedTuple):
    """A pendant without a robot, and its log."""

    host: str
    log: Path

    @property
    def address(self) -> tuple[str, int]:
        return self.host, PORT

    def page(self) -> tuple[str, dict[str, str]]:
        """Text and headers of the page."""
        text = self.request(GET).decode()
        head, _, body = text.partition("\r\n\r\n")
        assert head.startswith("HTTP/1.1 200"), head
        return body, dict(line.split(": ", 1) for line in head.split("\r\n")[1:])

    def request(self, data: bytes) -> bytes:
        """The answer, until the pendant disconnects or is silent for a moment."""
        answer = b""
        with socket.create_connection(self.address, 20) as web, suppress(OSError):
            web.sendall(data)
            web.settimeout(20 if b"close" in data else 0.02)
            while part := web.recv(1 << 16):
                answer += part
        return answer

    def web_socket(self, path: str) -> Any:
        return websockets.connect(f"ws://{self.host}:{PORT}{path}", open_timeout=20, close_timeout=5)


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Target]:
    address = claim_address()
    log = tmp_path_factory.mktemp("garbage") / "log"
    try:
        with log.open("w") as errors, pendant(address.host, errors=errors):
            yield Target(address.host, log)
    finally:
        address.release()


@pytest.fixture(autouse=True)
def check_pendant(request: pytest.FixtureRequest) -> Iterator[None]:
    """Check after each test that the pendant still serves a page, and that its log is short and without tracebacks."""
    yield
    if "target" not in request.fixturenames:
        return
    target: Target = request.getfixturevalue("target")
    target.page()
    log = target.log.read_text()
    assert "Traceback" not in log
    assert len(log.splitlines()) < 60, log


@pytest.fixture
def dice(request: pytest.FixtureRequest) -> random.Random:
    return random.Random(request.node.name)


def random_bytes(dice: random.Random, max_length: int = 200) -> bytes:
    return bytes(dice.choices(BYTES, k=dice.randrange(max_length)))


def test_invalid_requests(target: Target, dice: random.Random) -> None:
    for _ in range(COUNT):
        lines = [f"{dice.choice(METHODS)} {dice.choice(PATHS)} HTTP/{dice.choice(('1.1', '1.0', '9.9', ''))}"]
        if dice.random() < 0.8:
            lines.append("Host: localhost")
        lines += [f"{dice.choice(HEADER_NAMES)}: {dice.choice(HEADER_VALUES)}" for _ in range(dice.randrange(6))]
        data = "\r\n".join(lines).encode("latin-1") + b"\r\n\r\n" + (random_bytes(dice) if dice.random() < 0.5 else b"")
        answer = target.request(data)
        status = re.match(rb"HTTP/1.1 (\d)", answer)
        assert status is None or status[1] in b"12345"
        assert not answer.startswith(b"HTTP/1.1 500"), data


def test_random_bytes_instead_of_request(target: Target, dice: random.Random) -> None:
    for _ in range(COUNT):
        target.request(
            dice.choice((b"", b"GET ", b"\x16\x03\x01", b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n")) + random_bytes(dice, 2000)
        )


@pytest.mark.parametrize(
    ("line", "status"),
    [
        ("GET /nosuch", 404),
        ("POST /move", 405),
        ("GET /_nicegui_ws/socket.io/?EIO=4&transport=polling", 404),
        ("GET /pendant/../server.py", 404),
        ("POST /_nicegui/client/1/upload/2", 404),
    ],
)
def test_unknown_resources_are_refused(target: Target, line: str, status: int) -> None:
    answer = target.request(f"{line} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
    assert answer.startswith(f"HTTP/1.1 {status}".encode()), answer
    assert b"frame-ancestors 'none'" in answer


@pytest.mark.parametrize("header", ["Host: evil.example", "Host: [", "Host: localhost\r\nOrigin: http://evil.example"])
def test_requests_from_other_sites_are_forbidden(target: Target, header: str) -> None:
    answer = target.request(f"GET / HTTP/1.1\r\n{header}\r\nConnection: close\r\n\r\n".encode())
    assert answer.startswith(b"HTTP/1.1 403"), answer


def test_page_has_security_headers(target: Target) -> None:
    body, headers = target.page()
    policy = headers["content-security-policy"]
    nonce = re.search(r"script-src 'self' 'nonce-([\w-]+)' 'unsafe-eval';", policy)
    assert nonce
    assert body.count("<script") == body.count(f'<script nonce="{nonce[1]}"') > 5
    assert target.page()[1]["content-security-policy"] != policy
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["x-frame-options"] == "DENY"
    assert headers["referrer-policy"] == "no-referrer"


def test_invalid_web_socket_messages(target: Target, dice: random.Random) -> None:
    messages = (random_bytes(dice), "[" * 100_000, "", "{", '{"held": {"joint": 1e999}}')
    with open_page(target) as page_id:
        for _ in range(COUNT):
            other = dice.choice(("/live/x", "/live/", "/nosuch", "/move", "/%00"))
            path = f"/live/{page_id}" if dice.random() < 0.8 else other
            with suppress(WebSocketException, OSError), target.web_socket(path) as web:
                for _ in range(dice.randrange(4)):
                    web.send(dice.choice((random_message(dice), *messages)))
                web.socket.sendall(random_bytes(dice))  # not a valid frame


def test_invalid_events(target: Target, dice: random.Random) -> None:
    page_id = page_id_of(target)
    for _ in range(COUNT):
        query = {
            "client_id": page_id,
            "tab_id": "t",
            "document_id": "d",
            "next_message_id": "0",
            "implicit_handshake": "true",
        }
        if dice.random() < 0.4:
            query[dice.choice([*query])] = dice.choice(("", "x", "-1", "true"))
        if dice.random() < 0.2:
            del query[dice.choice([*query])]
        path = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket&" + "&".join(f"{k}={v}" for k, v in query.items())
        with suppress(WebSocketException, OSError), target.web_socket(path) as web:
            web.send("40")
            for _ in range(dice.randrange(12)):
                web.send(random_event(dice, page_id))


def test_oversized_message(target: Target) -> None:
    with open_page(target) as page_id, target.web_socket(f"/live/{page_id}") as web:
        assert web.recv(20).startswith("[[")  # the values of a page that is built
        web.send("x" * 2_000_000)
        with suppress(WebSocketException, OSError):
            while True:
                web.recv(20)


@contextmanager
def open_page(target: Target) -> Iterator[str]:
    """Opens a page as a browser does: the page is built when its web socket is open. The value is its id."""
    page_id = page_id_of(target)
    query = f"client_id={page_id}&tab_id=t&document_id=d&next_message_id=0&implicit_handshake=true"
    with target.web_socket(f"/_nicegui_ws/socket.io/?EIO=4&transport=websocket&{query}") as web:
        web.send("40")
        while not str(web.recv(20)).startswith('42["update"'):
            pass
        yield page_id


def page_id_of(target: Target) -> str:
    """The id of a page that was requested."""
    body, _ = target.page()
    match = re.search(r"""["']client_id["']: ?["']([\w-]+)""", body)
    assert match, body
    return match[1]


def test_pages_that_never_connect_are_small_and_forgotten(tmp_path: Path) -> None:
    """Hundreds of requests by a monitoring program, or by someone with bad intentions, are not hundreds of pages."""
    soon = "import client.pendant.server as server; server._CONNECTION_TIMEOUT_S = 3.0; "
    program = ("-c", f"{soon}from client.cli import app; app()")
    address = claim_address()
    try:
        with (tmp_path / "log").open("w") as log, pendant(address.host, program=program, errors=log) as process:
            target = Target(address.host, tmp_path / "log")
            target.page()
            before = memory_mib(process.pid)
            answers = [target.request(GET)[9:12] for _ in range(_MAX_PAGES + 20)]
            assert memory_mib(process.pid) - before < 0.1 * _MAX_PAGES
            if answers[-1] == b"200":  # on a slow machine, the first are forgotten before the last arrive
                return
            assert set(answers) == {b"200", b"503"}
            deadline = time.monotonic() + 60.0
            while target.request(GET)[9:12] != b"200":
                assert time.monotonic() < deadline, "pages without a web socket are kept"
                time.sleep(0.1)
    finally:
        address.release()


def memory_mib(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def random_message(dice: random.Random) -> str:
    words = ("held", "other", "push", "place", "drag", "scroll", *(str(word) for word in JSON_VALUES[:6]))
    return json.dumps(dice.choice([{dice.choice(words): dice.choice(JSON_VALUES)}, dice.choice(JSON_VALUES)]))


def random_event(dice: random.Random, page_id: str) -> str | bytes:
    name = dice.choice(
        ("event", "log", "ack", "handshake", "javascript_response", "connect", "disconnect", "x", None, 3)
    )
    message = {
        "client_id": dice.choice((page_id, page_id, "x", None, [])),
        "id": dice.choice((*range(40), "x", None)),
        "listener_id": dice.choice(("x", None, 1)),
        "args": dice.choice(JSON_VALUES),
        "level": dice.choice(("error", "x", None)),
        "message": dice.choice(JSON_VALUES),
        "next_message_id": dice.choice(JSON_VALUES),
        "request_id": dice.choice(JSON_VALUES),
    }
    for _ in range(dice.randrange(3)):
        del message[dice.choice([*message])]
    body = json.dumps(dice.choice(([name, message], [name], [], [name, message, 1], dice.choice(JSON_VALUES))))
    kinds = (
        "42",
        "420",
        "43",
        "44",
        "45",
        "451-",
        "46",
        "41",
        "40",
        "4",
        "49",
        "2",
        "3",
        "1",
        "6",
        "5",
        "b",
        "42/x,",
        "99",
    )
    return dice.choice((f"42{body}", f"{dice.choice(kinds)}{body}", random_bytes(dice)))


def test_invalid_messages_are_logged_once_per_minute(caplog: pytest.LogCaptureFixture) -> None:
    now = [0.0]
    invalid_messages = InvalidMessages(lambda: now[0])
    for _ in range(1000):
        invalid_messages.report("a kind", "what it was")
    invalid_messages.report("another kind", "with\na line break")
    now[0] = 61.0
    invalid_messages.report("a kind", "what it was")
    assert [record.getMessage().partition(": ")[2] for record in caplog.records] == [
        "what it was",
        "with a line break",
        "what it was (999 more since the last such line)",
    ]


def test_many_kinds_are_logged_together(caplog: pytest.LogCaptureFixture) -> None:
    invalid_messages = InvalidMessages(time.monotonic)
    for i in range(1000):
        invalid_messages.report(str(i), i)
    assert len(caplog.records) < 40


async def test_a_browser_that_leaves_before_the_answer_is_no_error(caplog: pytest.LogCaptureFixture) -> None:
    async def slow(scope: object, receive: Callable[[], Awaitable[dict[str, str]]], send: object) -> None:
        await receive()
        raise RuntimeError("No response returned.")

    async def leave() -> dict[str, str]:
        return {"type": "http.disconnect"}

    async def stay() -> dict[str, str]:
        return {"type": "http.request"}

    gate = Gate(slow, (), lambda limit: False, InvalidMessages())
    scope = {
        "type": "http",
        "path": "/",
        "method": "GET",
        "query_string": b"",
        "headers": [(b"host", b"127.0.0.1")],
    } | {"server": ("127.0.0.1", 80)}
    sent: list[dict[str, object]] = []

    async def send(message: dict[str, object]) -> None:
        sent.append(message)

    await gate(scope, leave, send)
    assert not sent
    assert not caplog.records
    await gate(scope, stay, send)
    assert sent[0]["status"] == 400
    assert len(caplog.records) == 1
