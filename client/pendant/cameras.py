"""The cameras of an emulator's scene, for the pages: a list of them, and their pictures.

Browsers get pictures through the pendant: they may have no access to the ports of the robot, and the security policy of
the pages allows nothing from another origin.
"""

import io
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import suppress
from typing import Any, Final
from urllib.parse import quote

import httpx
import numpy as np

from client.errors import CameraError
from client.pendant.polling import Poller
from urproto.cameras import CAMERAS, STREAM, CameraDescription, picture_path

ROUTE: Final = "/camera"
"""Path of the pictures on a pendant: /camera/NAME/stream and /camera/NAME/still."""

_LIST_PERIOD_S: Final = 5.0
_DESCRIPTION_PERIOD_S: Final = 3.0
_TIMEOUT_S: Final = 30.0  # the first picture waits for a process to start
_OK: Final = 200
_STILL: Final = "rgb.jpg"
_ARM_PREFIX: Final = "ur/"  # before the names of bodies of the arm and of what it carries
_MIN_SHARE: Final = 0.002  # of a picture: smaller objects are not mentioned (guess)
_MAX_NAMED: Final = 8


class CameraLink:
    """The cameras at one address. on_change: called when something to show has changed. port: 0 for no cameras."""

    def __init__(self, host: str, port: int, on_change: Callable[[], object]) -> None:
        self._http = httpx.AsyncClient(base_url=f"http://{host}:{port}", timeout=_TIMEOUT_S, trust_env=False)
        self._port = port
        self._on_change = on_change
        self._cameras = Poller(self._list_cameras, _LIST_PERIOD_S, on_change)
        self._descriptions: dict[str, Poller[str]] = {}
        self._bodies: tuple[str, ...] = ()

    @property
    def available(self) -> tuple[CameraDescription, ...]:
        """The existing cameras. Reading this property keeps the list up to date."""
        return (self._cameras.value or ()) if self._port else ()

    def view_description(self, name: str) -> str:
        """The objects in a camera's view as text, "" while unknown. Calling this keeps the text up to date."""
        if name not in self._descriptions:
            self._descriptions[name] = Poller(lambda: self._describe_view(name), _DESCRIPTION_PERIOD_S, self._on_change)
        poller = self._descriptions[name]
        return poller.value or poller.problem

    async def still(self, name: str) -> bytes:
        """Return a JPEG picture. Raises CameraError."""
        return (await self._response(picture_path(name, _STILL))).content

    async def stream(self, name: str) -> tuple[str, AsyncIterator[bytes]]:
        """Content type and bytes of a stream, until the robot or the reader ends it. Raises CameraError."""
        response = await self._response(picture_path(name, STREAM), stream=True)
        return response.headers.get("content-type", ""), _stream_content(response)

    async def close(self) -> None:
        await self._cameras.close()
        for poller in self._descriptions.values():
            await poller.close()
        await self._http.aclose()

    async def _list_cameras(self) -> tuple[CameraDescription, ...]:
        response = await self._response(CAMERAS)
        try:
            index: Mapping[str, Any] = response.json()
            self._bodies = tuple(map(str, index["bodies"]))
            return tuple(CameraDescription.from_json(entry) for entry in index["cameras"])
        except (ValueError, TypeError, KeyError) as error:
            raise CameraError(f"{self._http.base_url} is not a camera server: {error}") from error

    async def _describe_view(self, name: str) -> str:
        response = await self._response(picture_path(name, "segmentation.npy"))
        try:
            segmentation = np.load(io.BytesIO(response.content), allow_pickle=False)
            body_numbers, counts = np.unique(segmentation, return_counts=True)
        except Exception as error:  # numpy raises many kinds
            raise CameraError(f"{name}: the objects in view cannot be read: {error}") from error
        return describe_shares(
            dict(zip(body_numbers.tolist(), (counts / segmentation.size).tolist(), strict=True)), self._bodies
        )

    async def _response(self, path: str, *, stream: bool = False) -> httpx.Response:
        try:
            response = await self._http.send(self._http.build_request("GET", path), stream=stream)
            if response.status_code != _OK:
                await response.aread()
                await response.aclose()
        except httpx.HTTPError as error:
            raise CameraError(f"no cameras at {self._http.base_url}: {error or type(error).__name__}") from error
        if response.status_code != _OK:
            raise CameraError(_error_text(response))
        return response


def camera_path(name: str, kind: str) -> str:
    """Path of a camera's pictures on this pendant. kind: stream or still."""
    return f"{ROUTE}/{quote(name, safe='')}/{kind}"


def describe_shares(shares: Mapping[int, float], bodies: tuple[str, ...]) -> str:
    """A text that lists the objects in a picture, largest first. shares: of the picture, by body number."""
    named: dict[str, float] = {}
    for number, share in shares.items():
        if 0 < number < len(bodies):
            name = "the arm" if bodies[number].startswith(_ARM_PREFIX) else bodies[number]
            named[name] = named.get(name, 0.0) + share
    seen = sorted((name for name in named if named[name] >= _MIN_SHARE), key=lambda name: -named[name])
    if not seen:
        return "No known object is in view."
    rest = f" and {len(seen) - _MAX_NAMED} more" if len(seen) > _MAX_NAMED else ""
    return f"It sees: {', '.join(f'{name} ({100 * named[name]:.1f} %)' for name in seen[:_MAX_NAMED])}{rest}."


def _error_text(response: httpx.Response) -> str:
    with suppress(ValueError, TypeError, KeyError):
        return str(response.json()["error"])
    return f"{response.url} answers with status {response.status_code}"


async def _stream_content(response: httpx.Response) -> AsyncIterator[bytes]:
    """Yield the parts of a stream. It ends when the robot closes it, so that the browser sees its end."""
    try:
        with suppress(httpx.HTTPError):
            async for part in response.aiter_raw():
                yield part
    finally:
        await response.aclose()
