"""Serves the cameras of a scene over HTTP like an IP camera: streams and single pictures (`urproto.cameras`).

Pictures are drawn only on request. Clients can only read. Pages of other web sites have no access and cannot embed a
picture.
"""

import asyncio
from collections import deque
from collections.abc import Callable, Collection, Sequence
from html import escape
from typing import TYPE_CHECKING, Any, Final, TypeGuard
from urllib.parse import parse_qs, unquote

from emulator.servers import http
from emulator.servers.camera_drawing import MAX_HZ, Drawing, DrawingError, Picture
from emulator.servers.connection import Connection
from emulator.servers.port import PortServer, ServedController
from urproto.cameras import CAMERAS, FORMS, POSE_HEADER, STREAM, TIME_HEADER, picture_path, pose_text
from urproto.errors import RemoteProtocolError

if TYPE_CHECKING:
    from emulator.physics.world import PhysicsWorld
    from emulator.world.world import World

_DEFAULT_HZ: Final = 10.0
_MIN_HZ: Final = 0.01
_MAX_VIEWERS: Final = 32  # clients that wait for a picture or receive a stream (guess)
_BUFFER: Final = 128 * 1024  # bytes that may be buffered for a client; above that, sending pauses
_JPEG: Final = "rgb.jpg"
_BOUNDARY: Final = "picture"
_STREAM_TYPE: Final = f"multipart/x-mixed-replace; boundary={_BOUNDARY}"
_PAGE_HEADERS: Final = {"Content-Type": "text/html; charset=utf-8", "Content-Security-Policy": http.PAGE_POLICY}
# every request draws another picture, of which the rest of an earlier one is no part
_PICTURE_HEADERS: Final = {"Accept-Ranges": "none"}
_PAGE: Final = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>Cameras</title></head>
<body><h1>Cameras</h1>
{cameras}
</body></html>
"""
_PAGE_ENTRY: Final = """<h2>{name}</h2>
<p><img src="{picture}" width="{width}" height="{height}" alt="Live picture of camera {name}"></p>
<p>{links}</p>"""
_NO_CAMERAS: Final = "<p>The scene has no cameras. Add them to the world file, section <code>cameras</code>.</p>"


def has_cameras(world: "World | None") -> TypeGuard["PhysicsWorld"]:
    """Whether a world is one with physics, which may have cameras. Does not import the physics engine."""
    return hasattr(world, "cameras")


class CameraServer(PortServer):
    """Serves the cameras of one world."""

    def __init__(self, controller: ServedController, world: "PhysicsWorld") -> None:
        super().__init__("cameras", controller)
        self.world = world
        self._drawing: Drawing | None = None

    def connect(self) -> Connection:
        return _CameraConnection(self)

    @property
    def drawing(self) -> Drawing:
        """The process that draws the pictures, and its queue of requests."""
        assert self._drawing is not None, "the port is open"
        return self._drawing

    async def start(self, host: str, port: int) -> None:
        self._drawing = Drawing(self.world, lambda: self.robot_time_s)
        await super().start(host, port)

    async def stop(self) -> None:
        await super().stop()
        if self._drawing is not None:
            await self._drawing.close()

    def index(self) -> dict[str, Any]:
        """Return the index: the cameras, and the names of the bodies that segmentation pictures number."""
        from emulator.physics.cameras import describe

        model = self.world.model
        return {
            "cameras": [describe(self.world, name).as_json() for name in self.world.cameras],
            "bodies": [model.body(i).name for i in range(model.nbody)],
            "most_hz": MAX_HZ,
        }

    def page(self) -> bytes:
        """Return the index as a web page."""
        shown = [
            _PAGE_ENTRY.format(
                name=escape(name),
                picture=picture_path(name, STREAM),
                width=camera.size[0],
                height=camera.size[1],
                links=" ".join(f'<a href="{picture_path(name, form)}">{form}</a>' for form in (STREAM, *FORMS)),
            )
            for name, camera in self.world.cameras.items()
        ]
        return _PAGE.format(cameras="\n".join(shown) or _NO_CAMERAS).encode()

    def check_room(self) -> None:
        """Raises HttpError if the maximum number of viewers is reached."""
        if sum(isinstance(one, http.HttpConnection) and one.waiting for one in self.connections) >= _MAX_VIEWERS:
            raise http.HttpError(
                http.UNAVAILABLE, f"the limit of {_MAX_VIEWERS} viewers of cameras is reached: close one"
            )


class _CameraConnection(http.HttpConnection):
    server: CameraServer
    max_body = 0

    def __init__(self, server: CameraServer) -> None:
        super().__init__(server)
        self._viewing: _Viewing | None = None
        self._parts: deque[bytes] = deque()
        self._full = False  # the write buffer of the connection is full
        self._pumping: asyncio.Handle | None = None

    def admit(self, request: http.Request) -> None:
        http.check_host(request, also=http.is_local)
        http.check_site(request)

    def methods(self, path: str) -> Collection[str]:
        if path not in ("/", CAMERAS):
            self._camera_and_form(path)
        return ("GET",)

    def answer(self, request: http.Request) -> http.Response | None:
        if request.path == "/":
            return http.Response(http.OK, self.server.page(), _PAGE_HEADERS)
        if request.path == CAMERAS:
            return http.Response(http.OK, self.server.index())
        name, form = self._camera_and_form(request.path)
        every_s = 1.0 / _fps(request.query) if form == STREAM else None
        if self.head_only and form == STREAM:
            return http.Response(http.OK, b"", {"Content-Type": _STREAM_TYPE})
        self.server.check_room()
        self._viewing = _Viewing(self, name, _JPEG if form == STREAM else form, every_s)
        return None

    def _camera_and_form(self, path: str) -> tuple[str, str]:
        """Return the camera and the form of the picture that a path names. Raises HttpError."""
        top, _, rest = path.removeprefix("/").partition("/")
        name, _, form = rest.partition("/")
        if f"/{top}" != CAMERAS or not form:
            raise http.HttpError(http.NOT_FOUND, f"nothing is served at {path}: see {CAMERAS}")
        name, known = unquote(name), self.server.world.cameras
        if name not in known:
            raise http.HttpError(
                http.NOT_FOUND, f"there is no camera {name!r}; there are: {', '.join(known) or 'none'}"
            )
        if form != STREAM and form not in FORMS:
            raise http.HttpError(
                http.NOT_FOUND, f"a camera does not serve {form}; it serves: {', '.join((STREAM, *FORMS))}"
            )
        return name, form

    def too_far_ahead(self) -> None:
        """A viewer of a stream may send its next request, but no more than that: its end would not be noticed."""
        raise RemoteProtocolError("it sent many requests while it was being sent pictures")

    def opened(self) -> None:
        assert self._transport is not None
        self._transport.set_write_buffer_limits(high=_BUFFER)

    def lost(self) -> None:
        super().lost()
        if self._viewing is not None:
            self._viewing.cancel()
        if self._pumping is not None:
            self._pumping.cancel()

    # a picture is sent in pieces, so that the control period can run between them

    def send_parts(self, parts: Sequence[bytes]) -> None:
        """Send parts of the answer as fast as the client reads, then let the viewing continue."""
        self._parts.extend(parts)
        self._pump()

    def pause_writing(self) -> None:
        self._full = True

    def resume_writing(self) -> None:
        self._full = False
        self._pump()

    def _pump(self) -> None:
        if self._full or self._pumping is not None or not self.is_open:
            return
        if self._parts:
            self.send_part(self._parts.popleft())
            self._pumping = asyncio.get_running_loop().call_soon(self._continue_pumping)
        elif self._viewing is not None and self._viewing.sent():
            self._viewing = None
            self.end_response()

    def _continue_pumping(self) -> None:
        self._pumping = None
        self._pump()


class _Viewing:
    """One request for a picture or a stream. every_s: period of a stream, None for a single picture."""

    def __init__(self, connection: _CameraConnection, name: str, form: str, every_s: float | None) -> None:
        self._connection = connection
        self._name, self._form, self._every_s = name, form, every_s
        self._stream_started = False
        self._sending = False
        self._requested_s = 0.0
        self._next: asyncio.TimerHandle | None = None

        self._callback: Callable[[Picture | DrawingError], None] = self._send_picture
        # later: the drawing may answer immediately, but the request has to be handled completely before
        asyncio.get_running_loop().call_soon(self._request_picture)

    def cancel(self) -> None:
        """The client has disconnected."""
        self._connection.server.drawing.remove(self._callback)
        if self._next is not None:
            self._next.cancel()

    def sent(self) -> bool:
        """Call when all parts have been sent; returns True if that completes the answer, False for a stream."""
        if not self._sending:
            return False
        self._sending = False
        if self._every_s is None:
            return True
        loop = asyncio.get_running_loop()
        self._next = loop.call_at(max(loop.time(), self._requested_s + self._every_s), self._request_picture)
        return False

    def _request_picture(self) -> None:
        self._next = None
        if self._connection.is_open:
            self._requested_s = asyncio.get_running_loop().time()
            self._connection.server.drawing.request(self._name, self._form, self._callback)

    def _send_picture(self, picture: Picture | DrawingError) -> None:
        connection = self._connection
        if isinstance(picture, DrawingError):
            if self._stream_started:
                connection.close()  # the status of a stream has been sent already: closing is the only signal left
            else:
                connection.reply(connection.refuse(http.HttpError(http.UNAVAILABLE, str(picture))))
            return
        head = {
            "Content-Type": FORMS[self._form],
            "Content-Length": str(picture.size),
            TIME_HEADER: f"{picture.time_s:.6f}",
            POSE_HEADER: pose_text(picture.pose),
        }
        self._sending = True
        if self._every_s is None:
            connection.begin_response(http.OK, {**_PICTURE_HEADERS, **head})
            connection.send_parts(picture.parts)
            return
        lines = "".join(f"{name}: {value}\r\n" for name, value in head.items())
        begin = [] if self._stream_started else [f"--{_BOUNDARY}\r\n".encode()]
        if not self._stream_started:
            connection.begin_response(http.OK, {"Content-Type": _STREAM_TYPE})
            self._stream_started = True
        # the next boundary follows immediately: browsers show a picture once they see the boundary after it
        connection.send_parts([*begin, f"{lines}\r\n".encode(), *picture.parts, f"\r\n--{_BOUNDARY}\r\n".encode()])


def _fps(query: str) -> float:
    """Return the rate that a query asks for, in pictures per second. Raises HttpError."""
    given = parse_qs(query).get("fps", [str(_DEFAULT_HZ)])[-1]
    try:
        rate_hz = float(given)
    except ValueError:
        rate_hz = 0.0
    if not _MIN_HZ <= rate_hz <= MAX_HZ:
        raise http.HttpError(http.BAD, f"fps must be a number from {_MIN_HZ:g} to {MAX_HZ:g}, not {given[:20]!r}")
    return rate_hz
