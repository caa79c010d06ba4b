"""Serves the pendant: its pages, their web sockets, and access control."""

import asyncio
import os
import secrets
import socket
from collections.abc import Callable
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Final, Literal

from fastapi import Response, WebSocket
from fastapi.responses import HTMLResponse, PlainTextResponse, StreamingResponse
from nicegui import Client, app, ui

from client.errors import CameraError, PortTakenError
from client.pendant import frame
from client.pendant.cameras import ROUTE
from client.pendant.live import Live
from client.pendant.page import Page
from client.pendant.screens import SCREENS
from client.pendant.station import Station
from client.pendant.traces import POLICY, opened_files
from client.pendant.traces import ROUTE as TRACES
from client.pendant.web_security import BROWSERS, Gate, InvalidMessages, guard_events, shorten_library_logs
from urproto.addresses import BackdoorMark
from urproto.trace import STATIC

_STATIC: Final = Path(__file__).with_name("static")
_STYLESHEETS: Final = ("pendant.css", *sorted(path.name for path in _STATIC.glob("screen_*.css")))
_SHARED: Final = ("curves.js", "shapes.js")  # with the pages of traces
_SCRIPTS: Final = ("pendant.js", *_SHARED, *sorted(path.name for path in _STATIC.glob("screen_*.js")))
_PROCESS_TOKEN: Final = secrets.token_hex(8)  # differs in each process, so that pages detect a restart
_NO_SUCH_PAGE: Final = 1008
_MAX_MESSAGE_BYTES: Final = 1_000_000  # the most that NiceGUI's pages send over a web socket
_POLL_PERIOD_S: Final = 0.05
_CONNECTION_TIMEOUT_S: Final = 30.0  # guess: browsers open the web socket within a second, slow ones within several
_NO_STORE: Final = {"cache-control": "no-store"}


def serve(station: Station, host: str, port: int, ready: Callable[[], None], key: str = "") -> None:
    """Serve one robot's pendant until the process is asked to end. ready: called when browsers can connect.

    key: what browsers have to show, "" for nothing. Raises PortTakenError.
    """
    os.environ.pop(
        "PYTEST_CURRENT_TEST", None
    )  # set by a test that started this process; NiceGUI would switch to test mode
    exit_stack = AsyncExitStack()
    tasks = set[asyncio.Task[None]]()  # the event loop keeps only weak references
    _check_free(host, port)
    exit_stack.callback(_mark_port(host, port).close)

    async def start() -> None:
        await exit_stack.enter_async_context(station)
        tasks.add(asyncio.create_task(_call_when_open(host, port, ready)))

    app.on_startup(start)
    app.on_shutdown(exit_stack.aclose)
    for name in _SHARED:
        app.add_static_file(local_file=STATIC / name, url_path=f"/pendant/{name}")
    app.add_static_files("/pendant", _STATIC)
    app.config.quasar_config["loadingBar"]["skipHijack"] = True  # no unlabelled progress bar for each fetched file
    invalid_messages = InvalidMessages()
    screens = [screen.name for screen in SCREENS]
    app.add_middleware(
        Gate,
        screens=screens,
        full=lambda limit: len(Client.instances) >= limit,
        invalid_messages=invalid_messages,
        key=key,
    )
    guard_events(invalid_messages)
    shorten_library_logs(invalid_messages)

    @app.get(BROWSERS)
    async def browsers() -> list[str | None]:
        return [client.ip for client in Client.instances.values() if client.has_socket_connection]

    @ui.page("/")
    @ui.page("/{screen}")
    async def pendant(screen: str = SCREENS[0].name) -> None:
        await _build_page(station, screen)

    @app.get(f"{ROUTE}/{{name}}/{{kind}}")
    async def camera(name: str, kind: Literal["stream", "still"]) -> Response:
        try:
            if kind == "still":
                return Response(await station.cameras.still(name), media_type="image/jpeg", headers=_NO_STORE)
            content_type, content = await station.cameras.stream(name)
        except CameraError as error:
            return PlainTextResponse(f"{error}\n", 502)
        return StreamingResponse(content, media_type=content_type, headers=_NO_STORE)

    @app.get(f"{TRACES}/{{token}}")
    async def trace(token: str) -> Response:
        if (content := opened_files.page(token)) is None:
            return PlainTextResponse("This page is no longer kept: open the file again.\n", 404)
        return HTMLResponse(content, headers={**_NO_STORE, "content-security-policy": POLICY})

    @app.websocket("/live/{page_id}")
    async def live(web_socket: WebSocket, page_id: str) -> None:
        if page_id in Live.pages:
            await Live.pages[page_id].serve(web_socket, invalid_messages)
        else:
            await web_socket.close(_NO_SUCH_PAGE)

    ui.run(
        host=host,
        port=port,
        title="Pendant",
        favicon=_STATIC / "favicon.svg",
        dark=None,
        language="en-US",
        reload=False,
        show=False,
        show_welcome_message=False,
        reconnect_timeout=10.0,
        binding_refresh_interval=None,
        ws_per_message_deflate=False,
        access_log=False,
        ws_max_size=_MAX_MESSAGE_BYTES,
    )


def _check_free(host: str, port: int) -> None:
    """Raise PortTakenError if the port is taken; the server itself would log a traceback."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise PortTakenError(host, port, error.strerror or str(error)) from error


def _mark_port(host: str, port: int) -> BackdoorMark:
    """Mark the port as off limits for programs of emulated robots on this machine. Raises PortTakenError."""
    address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0][4][0]
    try:
        return BackdoorMark(str(address), port)
    except OSError as error:
        raise PortTakenError(host, port, error.strerror or str(error)) from error


async def _call_when_open(host: str, port: int, ready: Callable[[], None]) -> None:
    """Call ``ready`` when the server has opened its port, which happens after its start-up handlers."""
    while True:
        try:
            _, writer = await asyncio.open_connection(host, port)
        except OSError:
            await asyncio.sleep(_POLL_PERIOD_S)
        else:
            writer.close()
            return ready()


async def _build_page(station: Station, screen: str) -> None:
    client = ui.context.client
    ui.colors(primary="#27699a", secondary="#56a0d3", positive="#23803f", negative="#c62828", warning="#e0a100")
    for name in _STYLESHEETS:
        ui.add_head_html(f'<link rel="stylesheet" href="/pendant/{name}">')
    for name in _SCRIPTS:
        ui.add_body_html(f'<script src="/pendant/{name}"></script>')
    await client.connected(timeout=_CONNECTION_TIMEOUT_S)  # a request alone costs little, and is soon forgotten
    if client.is_deleted:
        return
    page = Page(station, Live(station, client.id))
    client.on_delete(page.close)
    frame.build(page, screen)
    ui.run_javascript(f"pendant.start('{client.id}', '{_PROCESS_TOKEN}')")
