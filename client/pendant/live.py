"""Updates what changes on a page: texts, states and the arm, thirty times a second.

NiceGUI lays out pages and handles clicks. Live values bypass it on a separate web socket, as lists of changes that
``static/pendant.js`` applies. Values that look the same are not sent, nor are those of hidden screens, and a slow
browser skips frames. A page that receives nothing, not even an empty list, greys its values and says how old they are.
"""

import asyncio
import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Final, Literal

from fastapi import WebSocket, WebSocketDisconnect
from nicegui import ui

from client.pendant.station import Station
from client.pendant.web_security import InvalidMessages

Kind = Literal["text", "state", "title", "value", "width", "bits", "cells", "plot", "samples", "lines", "sliders",
               "ghost", "objects", "goal", "path"]  # fmt: skip
Read = Callable[[Station], Any]
NextUpdate = Callable[[bool], Any]
HeldHandler = Callable[[Mapping[str, Any] | None], None]

_NEVER: Final = object()
_HEARTBEAT_S: Final = 0.4  # static/pendant.js greys the values of a page that has received nothing for 1 s
_INVALID_DATA: Final = 1007  # the status of web sockets for data that cannot be read


@dataclass(slots=True)
class _Binding:
    target: int  # id of a NiceGUI element
    kind: Kind
    read: Read
    screen: str | None
    last: Any = _NEVER


@dataclass(slots=True)
class _Effect:
    read: Read
    apply: Callable[[Any], object]
    screen: str | None
    last: Any = _NEVER


@dataclass(slots=True)
class _Stream:
    target: int
    kind: Kind
    next_update: NextUpdate
    screen: str | None
    fresh: bool = True


class Live:
    """The live values of one browser's page.

    screen: the visible screen. building: the screen whose elements are being built. on_held: called with the jog button
    that is held, several times a second, and with None when it is released. on_show: called with the screen that
    becomes visible, "" when the browser has disconnected. on_lost: called when the browser has disconnected or is
    unreachable.
    """

    pages: ClassVar[dict[str, "Live"]] = {}

    def __init__(self, station: Station, page_id: str) -> None:
        self.station = station
        self.page_id = page_id
        self.screen = ""
        self.building: str | None = None
        self.on_held: list[HeldHandler] = []
        self._listeners: dict[str, Callable[[Any], object]] = {}
        self.on_show: list[Callable[[str], None]] = []
        self.on_lost: list[Callable[[], None]] = []
        self._bindings: list[_Binding] = []
        self._effects: list[_Effect] = []
        self._streams: list[_Stream] = []
        self._wake = asyncio.Event()
        self.pages[page_id] = self
        station.audience.join(page_id)

    def close(self) -> None:
        """The browser has disconnected for good."""
        self.pages.pop(self.page_id, None)
        self.station.audience.leave(self.page_id)
        self._connection_lost()
        self.show("")

    # what is shown

    def text(self, read: Read, classes: str = "") -> ui.element:
        """Add a text that follows the value of ``read``."""
        return self.bind(ui.element("span").classes(f"live {classes}"), "text", read)

    def bind(self, element: ui.element, kind: Kind, read: Read) -> ui.element:
        """Bind a part of an element to the robot's state.

        text: its content. state: its attribute data-state, for style sheets. title: its tooltip. width:
        percent, of a bar. value: passed to the function in ``pendant.followers`` for it, see static/pendant.js.
        The kinds of single screens are in static/screen_*.js.
        """
        self._bindings.append(_Binding(element.id, kind, read, self.building))
        return element

    def effect(self, read: Read, apply: Callable[[Any], object]) -> None:
        """Call ``apply`` with the value of ``read`` whenever it has changed: for updates through NiceGUI."""
        self._effects.append(_Effect(read, apply, self.building))

    def stream(self, element: ui.element, kind: Kind, next_update: NextUpdate) -> None:
        """Send a stream to the browser: ``next_update`` returns what is new since the last call, or None.

        Its argument is True if the browser has nothing yet. While the element does not exist yet, all updates of the
        kind lines are queued, and only the newest of other kinds.
        """
        self._streams.append(_Stream(element.id, kind, next_update, self.building))

    def show(self, screen: str) -> None:
        self.screen = screen
        for handler in self.on_show:
            handler(screen)
        self._wake.set()

    # the web socket

    async def serve(self, socket: WebSocket, invalid_messages: InvalidMessages) -> None:
        """Send changes until the browser disconnects or sends invalid data. After reconnection, all is sent again."""
        await socket.accept()
        for binding in self._bindings:
            binding.last = _NEVER
        for stream in self._streams:
            stream.fresh = True
        sender = asyncio.create_task(self._send_frames(socket))
        sender.add_done_callback(partial(_report_failure, invalid_messages))
        try:
            while True:
                self._dispatch(json.loads(await socket.receive_text()))
        except WebSocketDisconnect:
            pass
        except Exception as error:  # an invalid message, or an error in its handler
            invalid_messages.report_error(error)
            with suppress(RuntimeError, WebSocketDisconnect):  # it has disconnected in the meantime
                await socket.close(_INVALID_DATA)
        finally:
            self._connection_lost()
            sender.cancel()
            await asyncio.gather(sender, return_exceptions=True)

    def on_message(self, key: str, handler: Callable[[Any], object]) -> None:
        """Call ``handler`` with each value sent by ``pendant.send({key: value})``, and with None on disconnection."""
        self._listeners[key] = handler

    def _dispatch(self, message: Any) -> None:
        if not isinstance(message, dict):
            return
        for key in message.keys() & self._listeners.keys():
            self._listeners[key](message[key])
        if "held" in message:
            held = message["held"]
            for handler in self.on_held:
                handler(held if isinstance(held, dict) else None)

    def _connection_lost(self) -> None:
        self._dispatch({"held": None, **dict.fromkeys(self._listeners)})
        for handler in self.on_lost:
            handler()

    async def _send_frames(self, socket: WebSocket) -> None:
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            changes = self.changes()
            if changes or loop.time() >= due_s:  # an empty list says that the values are still the newest
                await socket.send_text(json.dumps(changes))
                due_s = loop.time() + _HEARTBEAT_S
            waiting = [asyncio.ensure_future(self.station.next_frame()), asyncio.ensure_future(self._wake.wait())]
            try:
                await asyncio.wait(waiting, timeout=_HEARTBEAT_S, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for wait in waiting:
                    wait.cancel()
            self._wake.clear()

    def changes(self) -> list[tuple[int, Kind, Any]]:
        """Changes of everything visible since the last call: (element, kind, value)."""
        station, screen = self.station, self.screen
        for effect in self._effects:
            if effect.screen in (None, screen) and (value := effect.read(station)) != effect.last:
                effect.last = value
                effect.apply(value)
        changed = list[tuple[int, Kind, Any]]()
        for binding in self._bindings:
            if binding.screen in (None, screen) and (value := binding.read(station)) != binding.last:
                binding.last = value
                changed.append((binding.target, binding.kind, value))
        for stream in self._streams:
            if stream.screen in (None, screen):
                fresh, stream.fresh = stream.fresh, False
                if (value := stream.next_update(fresh)) is not None:
                    changed.append((stream.target, stream.kind, value))
        return changed


def _report_failure(invalid_messages: InvalidMessages, sender: "asyncio.Task[None]") -> None:
    """Log the error that ended the updates of a page."""
    error = None if sender.cancelled() else sender.exception()
    if error is not None and not isinstance(
        error, RuntimeError | WebSocketDisconnect
    ):  # else the browser has disconnected
        invalid_messages.report_error(error)
