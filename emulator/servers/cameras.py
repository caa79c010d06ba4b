"""The cameras of a scene over HTTP, as an IP camera has them: streams and single pictures (`urproto.cameras`).

Nothing is drawn while nobody looks. Clients read only; pages of other sites are kept out, and may not show a picture.
"""

import asyncio
from collections import deque
from collections.abc import Callable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import parse_qs, unquote

from emulator.servers.camera_drawing import MOST_HZ, CannotDraw, Drawing, Picture
from emulator.servers.connection import Connection
from emulator.servers.http import (
    BAD,
    NOT_ALLOWED,
    NOT_FOUND,
    OK,
    UNAVAILABLE,
    HttpConnection,
    Refused,
    Request,
    Response,
    check_host,
    check_site,
    is_local,
)
from emulator.servers.port import PortServer, ServedController
from urproto.cameras import CAMERAS, FORMS, POSE_HEADER, STREAM, TIME_HEADER, picture_path, pose_text
from urproto.errors import RemoteProtocolError

if TYPE_CHECKING:
    from emulator.physics.world import PhysicsWorld

_USUAL_HZ: Final = 10.0
_LEAST_HZ: Final = 0.01
_MOST_VIEWERS: Final = 32  # who wait for a picture or look at a stream (guess)
_BUFFER: Final = 128 * 1024  # bytes that may wait for a client before it is sent more
_MOST_AHEAD: Final = 64 * 1024  # bytes of requests that come before a picture is through (guess)
_JPEG: Final = "rgb.jpg"
_BOUNDARY: Final = "picture"
_COMMON: Final = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}
_PAGE_HEADERS: Final = {
    **_COMMON,
    "Content-Type": "text/html; charset=utf-8",
    "Content-Security-Policy": "default-src 'none'; img-src 'self'; frame-ancestors 'none'",
}
_PAGE: Final = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>Cameras</title></head>
<body><h1>Cameras</h1>
{cameras}
</body></html>
"""
_ON_PAGE: Final = """<h2>{name}</h2>
<p><img src="{picture}" width="{width}" height="{height}" alt="What the camera {name} sees now"></p>
<p>{links}</p>"""
_NONE: Final = "<p>The scene has no cameras: name some in the section <code>cameras</code> of the world file.</p>"


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
        """What draws them."""
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
        """What cameras there are, and the names of what segmentation shows."""
        from emulator.physics.cameras import describe

        model = self.world.model
        return {
            "cameras": [describe(self.world, name).as_json() for name in self.world.cameras],
            "bodies": [model.body(i).name for i in range(model.nbody)],
            "most_hz": MOST_HZ,
        }

    def page(self) -> bytes:
        """The index for people."""
        shown = [
            _ON_PAGE.format(
                name=escape(name),
                picture=picture_path(name, STREAM),
                width=camera.size[0],
                height=camera.size[1],
                links=" ".join(f'<a href="{picture_path(name, form)}">{form}</a>' for form in (STREAM, *FORMS)),
            )
            for name, camera in self.world.cameras.items()
        ]
        return _PAGE.format(cameras="\n".join(shown) or _NONE).encode()

    def check_room(self) -> None:
        """Raises Refused when there are too many viewers."""
        if sum(isinstance(one, HttpConnection) and one.waiting for one in self.connections) >= _MOST_VIEWERS:
            raise Refused(UNAVAILABLE, f"{_MOST_VIEWERS} viewers look at the cameras already: close one")


class _CameraConnection(HttpConnection):
    server: CameraServer
    most_body = 0

    def __init__(self, server: CameraServer) -> None:
        super().__init__(server)
        self._look: _Look | None = None
        self._ahead = 0  # bytes that came during this look
        self._parts: deque[bytes] = deque()
        self._full = False  # as much waits for the client as may
        self._pumping: asyncio.Handle | None = None

    def refusal(self, status: int, text: str) -> Any:
        return {"error": text}

    def answer(self, request: Request) -> Response | None:
        check_host(request, also=is_local)
        check_site(request)
        if request.method != "GET":
            raise Refused(NOT_ALLOWED, f"pictures are for reading: GET, not {request.method}", {"Allow": "GET"})
        if request.path == "/":
            return Response(OK, self.server.page(), _PAGE_HEADERS)
        if request.path == CAMERAS:
            return Response(OK, self.server.index(), _COMMON)
        name, form = self._wanted(request.path)
        every_s = 1.0 / _fps(request.query) if form == STREAM else None
        self.server.check_room()
        self._ahead = 0
        self._look = _Look(self, name, _JPEG if form == STREAM else form, every_s)
        return None

    def _wanted(self, path: str) -> tuple[str, str]:
        """Camera and form. Raises Refused."""
        top, _, rest = path.removeprefix("/").partition("/")
        name, _, form = rest.partition("/")
        if f"/{top}" != CAMERAS or not form:
            raise Refused(NOT_FOUND, f"there is nothing at {path}: see {CAMERAS}")
        name, known = unquote(name), self.server.world.cameras
        if name not in known:
            raise Refused(NOT_FOUND, f"there is no camera {name!r}; there are: {', '.join(known) or 'none'}")
        if form != STREAM and form not in FORMS:
            raise Refused(NOT_FOUND, f"a camera has no {form}; it has: {', '.join((STREAM, *FORMS))}")
        return name, form

    def received(self, data: bytes) -> None:
        if (
            self._look is not None
        ):  # whoever looks at a stream may have asked for what comes next, but not go on talking
            self._ahead += len(data)
            if self._ahead > _MOST_AHEAD:
                raise RemoteProtocolError(f"it sent more than {_MOST_AHEAD} bytes while it is sent pictures")
        super().received(data)

    def opened(self) -> None:
        assert self._transport is not None
        self._transport.set_write_buffer_limits(high=_BUFFER)

    def lost(self) -> None:
        if self._look is not None:
            self._look.leave()
        if self._pumping is not None:
            self._pumping.cancel()

    # a picture is sent in pieces, between which the robot has its turn

    def send_parts(self, parts: Sequence[bytes]) -> None:
        """Send all of them, as fast as the client reads; then the look goes on."""
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
            self.part(self._parts.popleft())
            self._pumping = asyncio.get_running_loop().call_soon(self._pump_on)
        elif self._look is not None and self._look.sent():
            self._look = None
            self.end()

    def _pump_on(self) -> None:
        self._pumping = None
        self._pump()


class _Look:
    """One request for a picture, or for a stream of them. every_s: of a stream."""

    def __init__(self, connection: _CameraConnection, name: str, form: str, every_s: float | None) -> None:
        self._connection = connection
        self._name, self._form, self._every_s = name, form, every_s
        self._begun = False
        self._sending = False
        self._wanted_s = 0.0
        self._next: asyncio.TimerHandle | None = None
        self._took: Callable[[Picture | CannotDraw], None] = self._take
        asyncio.get_running_loop().call_soon(self._want)  # the answer may come at once: not before the request is over

    def leave(self) -> None:
        """The client has gone."""
        self._connection.server.drawing.forget(self._took)
        if self._next is not None:
            self._next.cancel()

    def sent(self) -> bool:
        """All that was to be sent has been; True when that was the answer."""
        if not self._sending:
            return False
        self._sending = False
        if self._every_s is None:
            return True
        loop = asyncio.get_running_loop()
        self._next = loop.call_at(max(loop.time(), self._wanted_s + self._every_s), self._want)
        return False

    def _want(self) -> None:
        self._next = None
        if self._connection.is_open:
            self._wanted_s = asyncio.get_running_loop().time()
            self._connection.server.drawing.want(self._name, self._form, self._took)

    def _take(self, picture: Picture | CannotDraw) -> None:
        connection = self._connection
        if isinstance(picture, CannotDraw):
            if self._begun:
                connection.close()  # in the middle of a stream there is no other way to say it
            else:
                connection.reply(connection.refuse(Refused(UNAVAILABLE, str(picture))))
            return
        head = {
            "Content-Type": FORMS[self._form],
            "Content-Length": str(picture.size),
            TIME_HEADER: f"{picture.time_s:.6f}",
            POSE_HEADER: pose_text(picture.pose),
        }
        self._sending = True
        if self._every_s is None:
            connection.begin(OK, {**_COMMON, **head})
            connection.send_parts(picture.parts)
            return
        lines = "".join(f"{name}: {value}\r\n" for name, value in head.items())
        begin = [] if self._begun else [f"--{_BOUNDARY}\r\n".encode()]
        if not self._begun:
            kind = f"multipart/x-mixed-replace; boundary={_BOUNDARY}"
            connection.begin(OK, {**_COMMON, "Content-Type": kind})
            self._begun = True
        # the next boundary follows at once: browsers show a picture when they see that it has ended
        connection.send_parts([*begin, f"{lines}\r\n".encode(), *picture.parts, f"\r\n--{_BOUNDARY}\r\n".encode()])


def _fps(query: str) -> float:
    """Pictures a second. Raises Refused."""
    given = parse_qs(query).get("fps", [str(_USUAL_HZ)])[-1]
    try:
        wanted = float(given)
    except ValueError:
        wanted = 0.0
    if not _LEAST_HZ <= wanted <= MOST_HZ:
        raise Refused(BAD, f"fps must be a number from {_LEAST_HZ:g} to {MOST_HZ:g}, not {given[:20]!r}")
    return wanted
