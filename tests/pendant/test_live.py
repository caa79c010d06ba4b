"""Messages of a browser over the web socket of its page."""

from typing import Any

import pytest
from fastapi import WebSocketDisconnect

from client.pendant.live import Live
from client.pendant.station import Station
from client.pendant.web_security import InvalidMessages


class FakeSocket:
    """A browser that sends these texts and disconnects."""

    def __init__(self, *texts: str) -> None:
        self.texts = list(texts)
        self.closed: list[int] = []
        self.sent: list[str] = []

    async def accept(self) -> None:
        pass

    async def receive_text(self) -> str:
        if not self.texts:
            raise WebSocketDisconnect(1001)
        return self.texts.pop(0)

    async def send_text(self, text: str) -> None:
        self.sent.append(text)

    async def close(self, code: int) -> None:
        self.closed.append(code)


@pytest.fixture
def live() -> Live:
    return Live(Station("127.0.0.1"), "a page")


async def test_held_button_is_reported_and_released_on_disconnection(live: Live) -> None:
    received: list[Any] = []
    live.on_held.append(received.append)
    socket = FakeSocket('{"held": {"kind": "joint"}}', '{"held": 3}', '{"other": 1}', "[]")
    await live.serve(socket, InvalidMessages())  # type: ignore[arg-type]
    assert received == [{"kind": "joint"}, None, None]


async def test_reconnected_browser_gets_everything_again(live: Live) -> None:
    """Its page may have been reloaded, or have missed updates."""

    class Element:
        id = 7

    live.bind(Element(), "text", lambda station: "as ever")  # type: ignore[arg-type]
    for _ in range(2):
        await live.serve(FakeSocket(), InvalidMessages())  # type: ignore[arg-type]
        assert live.changes() == [(7, "text", "as ever")]
        assert live.changes() == []


@pytest.mark.parametrize("text", ["", "{", "nonsense", '{"held": ', "\x00"])
async def test_invalid_message_closes_connection_and_releases_button(live: Live, text: str) -> None:
    received: list[Any] = []
    live.on_held.append(received.append)
    socket = FakeSocket('{"held": {}}', text, '{"held": {}}')
    await live.serve(socket, InvalidMessages())  # type: ignore[arg-type]
    assert socket.closed == [1007]
    assert received == [{}, None]


async def test_handler_error_closes_connection(live: Live) -> None:
    live.on_message("camera", lambda value: value["azimuth"] if value is not None else None)
    socket = FakeSocket('{"camera": 3}')
    await live.serve(socket, InvalidMessages())  # type: ignore[arg-type]
    assert socket.closed == [1007]
