"""Fetch camera images: one at a time, or periodically in a separate thread."""

import http.client
import io
import json
import socket
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from client.errors import CameraError
from urproto.cameras import CAMERAS, POSE_HEADER, TIME_HEADER, CameraDescription, picture_path, pose_of
from urproto.compat import Self
from urproto.ports import CAMERA_PORT
from urproto.robots.pose import Pose

ALL_CAMERAS: Final = "all"
"""Name that stands for all cameras on a command line."""

_TIMEOUT_S: Final = 30.0  # the first image waits for a process to start (guess)
_MAX_BYTES: Final = 64 * 1024 * 1024  # of a response: colours and depth of 1920 x 1920 pixels take 26 MB
_RETRY_S: Final = 1.0  # delay before the next attempt after a failure (guess)


@dataclass(frozen=True)
class Shot:
    """An image. form: one of `urproto.cameras.FORMS`. data: the image in that form. time_s: robot time, as in RTDE's
    ``timestamp``. pose: of the camera's optical frame at that time, in the base frame.
    """

    camera: CameraDescription
    form: str
    data: bytes
    time_s: float
    pose: Pose

    @cached_property
    def arrays(self) -> Mapping[str, NDArray[Any]]:
        """Arrays of a numpy form: rgb (height, width, 3), depth and segmentation (height, width).

        Raises CameraError for other forms, and for invalid data.
        """
        kind, _, suffix = self.form.partition(".")
        if suffix not in ("npy", "npz"):
            raise CameraError(f"{self.form} is not an array: request {kind}.npy")
        try:
            loaded = np.load(io.BytesIO(self.data), allow_pickle=False)
            arrays = dict(loaded.items()) if suffix == "npz" else {kind: loaded}
        except Exception as error:  # numpy and zipfile raise many types
            raise CameraError(f"{self.camera.name}: its {self.form} cannot be read: {error}") from error
        for name, array in arrays.items():
            if array.shape[:2] != (self.camera.height, self.camera.width):
                raise CameraError(f"{self.camera.name}: its {name} has the shape {array.shape}, unlike its images")
        return arrays


class CameraClient:
    """Client for the cameras of an emulator. Use it from one thread, and close it afterwards.

    port: the emulator's camera port.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = CAMERA_PORT, timeout_s: float = _TIMEOUT_S) -> None:
        self.address = f"http://{host}:{port}"
        self._http = http.client.HTTPConnection(host, port, timeout=timeout_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection; the next request opens another."""
        self._http.close()

    def interrupt(self) -> None:
        """Abort a request that waits in another thread."""
        if (waiting := self._http.sock) is not None:
            waiting.shutdown(socket.SHUT_RDWR)

    def cameras(self) -> list[CameraDescription]:
        """All cameras of the scene. Raises CameraError."""
        _, content = self._get(CAMERAS)
        try:
            return [CameraDescription.from_json(entry) for entry in json.loads(content)["cameras"]]
        except (ValueError, TypeError, KeyError) as error:
            raise CameraError(f"{self.address} is not a camera server: {error}") from error

    def chosen(self, names: Sequence[str]) -> list[CameraDescription]:
        """The cameras with these names; all if `ALL_CAMERAS` is among them. Raises CameraError for unknown names."""
        available = {camera.name: camera for camera in self.cameras()}
        if not available:
            raise CameraError(f"the scene at {self.address} has no cameras: add some to its world file")
        for name in names:
            if name not in available and name != ALL_CAMERAS:
                raise CameraError(f"there is no camera {name!r}; there are: {', '.join(available)}")
        return list(available.values()) if ALL_CAMERAS in names else [available[name] for name in names]

    def shot(self, camera: CameraDescription, form: str) -> Shot:
        """Take an image now. form: one of `urproto.cameras.FORMS`. Raises CameraError."""
        headers, content = self._get(picture_path(camera.name, form))
        try:
            time_s, pose = float(headers[TIME_HEADER]), pose_of(headers[POSE_HEADER])
        except (KeyError, ValueError) as error:
            raise CameraError(f"{self.address} does not report the time and pose of an image: {error}") from error
        return Shot(camera, form, content, time_s, pose)

    def _get(self, path: str) -> tuple[Mapping[str, str], bytes]:
        try:
            self._http.request("GET", path)
            response = self._http.getresponse()
            content = response.read(_MAX_BYTES + 1)
        except (OSError, http.client.HTTPException) as error:
            self._http.close()
            raise CameraError(
                f"no cameras at {self.address} ({error or type(error).__name__}): start the emulator with "
                "--world FILE --physics"
            ) from error
        if len(content) > _MAX_BYTES:
            self._http.close()
            raise CameraError(f"{self.address}{path} has more than {_MAX_BYTES} bytes: too large for an image")
        if response.status != http.client.OK:
            raise CameraError(_reason(content) or f"{self.address}{path} responds with status {response.status}")
        return {name.lower(): value for name, value in response.getheaders()}, content


def _reason(content: bytes) -> str:
    try:
        return str(json.loads(content)["error"])
    except (ValueError, TypeError, KeyError):
        return ""


Subscription = tuple[CameraDescription, str]
"""A camera, and the form of its images."""


class CameraFollower:
    """Fetches images in a thread until it is closed; use it with ``with``.

    subscriptions: called before each round; returns the images to fetch. receive: called with each image, in that
    thread. report: called once with the reason when images stop arriving, and again when they are back.
    """

    def __init__(
        self,
        client: CameraClient,
        subscriptions: Callable[[], Iterable[Subscription]],
        rate_hz: float,
        receive: Callable[[Shot], object],
        report: Callable[[str], object],
    ) -> None:
        self._client = client
        self._subscriptions = subscriptions
        self._period_s = 1.0 / rate_hz
        self._receive = receive
        self._report_change = report
        self._problem = ""
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="cameras", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the thread without waiting for an image that is being rendered."""
        self._closing.set()
        with suppress(OSError):
            self._client.interrupt()
        self._thread.join()
        self._client.close()

    def _follow(self) -> None:
        next_s = time.monotonic()
        while not self._closing.is_set():
            wait_s = self._period_s if self._fetch_all() else _RETRY_S
            next_s = max(next_s + wait_s, time.monotonic())
            self._closing.wait(next_s - time.monotonic())

    def _fetch_all(self) -> bool:
        """Fetch one image of each; return whether all arrived."""
        try:
            for camera, form in self._subscriptions():
                shot = self._client.shot(camera, form)
                if self._closing.is_set():
                    return True
                self._receive(shot)
                self._report("")
        except CameraError as error:
            if not self._closing.is_set():
                self._report(str(error))
            return False
        return True

    def _report(self, problem: str) -> None:
        if problem != self._problem:
            self._problem = problem
            self._report_change(problem or "the cameras deliver images again")
