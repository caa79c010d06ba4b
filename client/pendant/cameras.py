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
"""Where a pendant has the pictures: /camera/NAME/stream and /camera/NAME/still."""

_LOOK_EVERY_S: Final = 5.0
_SEE_EVERY_S: Final = 3.0
_TIMEOUT_S: Final = 30.0  # the first picture waits for a process to start
_OK: Final = 200
_STILL: Final = "rgb.jpg"
_ARM: Final = "ur/"  # before the names of bodies that are the arm's, and of what it carries
_LEAST_SHARE: Final = 0.002  # of a picture: less is not worth a word (guess)
_MOST_NAMED: Final = 8


class CameraLink:
    """The cameras at one address. tell: called when something to show has changed. port: 0 for no cameras."""

    def __init__(self, host: str, port: int, tell: Callable[[], object]) -> None:
        self._http = httpx.AsyncClient(base_url=f"http://{host}:{port}", timeout=_TIMEOUT_S, trust_env=False)
        self._port = port
        self._tell = tell
        self._cameras = Poller(self._find, _LOOK_EVERY_S, tell)
        self._seen: dict[str, Poller[str]] = {}
        self._bodies: tuple[str, ...] = ()

    @property
    def found(self) -> tuple[CameraDescription, ...]:
        """Those there are; looking at them is what keeps them new."""
        return (self._cameras.value or ()) if self._port else ()

    def seen(self, name: str) -> str:
        """What a camera sees, in words, "" while that is not known. Looking at it is what keeps it new."""
        if name not in self._seen:
            self._seen[name] = Poller(lambda: self._see(name), _SEE_EVERY_S, self._tell)
        poller = self._seen[name]
        return poller.value or poller.problem

    async def still(self, name: str) -> bytes:
        """A JPEG picture. Raises CameraError."""
        return (await self._get(picture_path(name, _STILL))).content

    async def stream(self, name: str) -> tuple[str, AsyncIterator[bytes]]:
        """Content type and bytes of a stream, until the robot or whoever reads them ends it. Raises CameraError."""
        request = self._http.build_request("GET", picture_path(name, STREAM))
        try:
            response = await self._http.send(request, stream=True)
            if response.status_code != _OK:
                await response.aread()
                await response.aclose()
        except httpx.HTTPError as error:
            raise self._lost(error) from error
        if response.status_code != _OK:
            raise CameraError(_reason(response))
        return response.headers.get("content-type", ""), _content(response)

    async def close(self) -> None:
        """End the connections."""
        await self._cameras.close()
        for poller in self._seen.values():
            await poller.close()
        await self._http.aclose()

    async def _find(self) -> tuple[CameraDescription, ...]:
        response = await self._get(CAMERAS)
        try:
            index: Mapping[str, Any] = response.json()
            self._bodies = tuple(map(str, index["bodies"]))
            return tuple(CameraDescription.from_json(entry) for entry in index["cameras"])
        except (ValueError, TypeError, KeyError) as error:
            raise CameraError(f"{self._http.base_url} is not a camera server: {error}") from error

    async def _see(self, name: str) -> str:
        response = await self._get(picture_path(name, "segmentation.npy"))
        try:
            shown = np.load(io.BytesIO(response.content), allow_pickle=False)
            numbers, counts = np.unique(shown, return_counts=True)
        except Exception as error:  # numpy has many
            raise CameraError(f"{name}: the objects in view cannot be read: {error}") from error
        return in_words(dict(zip(numbers.tolist(), (counts / shown.size).tolist(), strict=True)), self._bodies)

    async def _get(self, path: str) -> httpx.Response:
        try:
            response = await self._http.get(path)
        except httpx.HTTPError as error:
            raise self._lost(error) from error
        if response.status_code != _OK:
            raise CameraError(_reason(response))
        return response

    def _lost(self, error: Exception) -> CameraError:
        return CameraError(f"no cameras at {self._http.base_url}: {error or type(error).__name__}")


def camera_path(name: str, kind: str) -> str:
    """Where this pendant has a camera's pictures. kind: stream or still."""
    return f"{ROUTE}/{quote(name, safe='')}/{kind}"


def in_words(shares: Mapping[int, float], bodies: tuple[str, ...]) -> str:
    """What is in a picture, the largest first. shares: of the picture, by a body's number."""
    named: dict[str, float] = {}
    for number, share in shares.items():
        if 0 < number < len(bodies):
            name = "the arm" if bodies[number].startswith(_ARM) else bodies[number]
            named[name] = named.get(name, 0.0) + share
    seen = sorted((name for name in named if named[name] >= _LEAST_SHARE), key=lambda name: -named[name])
    if not seen:
        return "No known object is in view."
    more = f" and {len(seen) - _MOST_NAMED} more" if len(seen) > _MOST_NAMED else ""
    return f"It sees: {', '.join(f'{name} ({100 * named[name]:.1f} %)' for name in seen[:_MOST_NAMED])}{more}."


def _reason(response: httpx.Response) -> str:
    with suppress(ValueError, TypeError, KeyError):
        return str(response.json()["error"])
    return f"{response.url} answers with status {response.status_code}"


async def _content(response: httpx.Response) -> AsyncIterator[bytes]:
    """Ends when the robot does: a browser sees that the stream is over."""
    try:
        with suppress(httpx.HTTPError):
            async for part in response.aiter_raw():
                yield part
    finally:
        await response.aclose()
