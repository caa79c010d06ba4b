"""Cameras of ``type: ur_emulator``: those of an emulator's scene."""

import time
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from lerobot.cameras import CameraConfig
from lerobot.cameras.camera import Camera
from numpy.typing import NDArray

from client.cameras import CameraClient, CameraFollower, Shot
from urproto.ports import CAMERA_PORT

_PICTURE: Final = "rgb.npy"
_FIRST_S: Final = 30.0  # until the first picture: the renderer starts (guess)
_POLL_S: Final = 0.002


@CameraConfig.register_subclass("ur_emulator")
@dataclass(kw_only=True)
class UREmulatorCameraConfig(CameraConfig):  # type: ignore[misc] # LeRobot has no types
    """``type: ur_emulator``: a camera of an emulator's scene. host, port: the emulator's cameras. name: in the scene.

    width, height and fps are what LeRobot's datasets are made for; the first two must be those of the camera.
    """

    host: str
    name: str
    port: int = CAMERA_PORT


class UREmulatorCamera(Camera):  # type: ignore[misc] # LeRobot has no types
    """Pictures (height, width, 3) of a camera of an emulator, which a thread fetches."""

    def __init__(self, config: UREmulatorCameraConfig) -> None:
        super().__init__(config)
        self.config = config
        self._follower: CameraFollower | None = None
        self._latest: NDArray[Any] | None = None
        self._taken_s = 0.0
        self._count = self._read = 0
        self._problem = ""

    @property
    def is_connected(self) -> bool:
        return self._follower is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """None: an emulator can be anywhere."""
        return []

    def connect(self, warmup: bool = True) -> None:
        """Connect, and wait for the first picture. Raises CameraError, or ValueError for another size."""
        config = self.config
        client = CameraClient(config.host, config.port)
        (camera,) = client.chosen([config.name])
        if (camera.width, camera.height) != (self.width, self.height):
            client.close()
            raise ValueError(
                f"the camera {config.name} has {camera.width} x {camera.height} pixels: set width and height to them"
            )
        rate_hz = float(self.fps or 1)
        self._follower = CameraFollower(client, lambda: [(camera, _PICTURE)], rate_hz, self._receive, self._report)
        self._follower.__enter__()
        self.async_read(timeout_ms=1000.0 * _FIRST_S)

    def read(self) -> NDArray[Any]:
        return self.async_read()

    def async_read(self, timeout_ms: float = 1000.0) -> NDArray[Any]:
        """The next picture that was not read yet. Raises TimeoutError."""
        end_s = time.monotonic() + timeout_ms / 1000.0
        while self._count == self._read:
            if time.monotonic() > end_s:
                raise TimeoutError(f"no picture of {self.config.name} in {timeout_ms:.0f} ms{self._why}")
            time.sleep(_POLL_S)
        self._read = self._count
        return self.read_latest()

    def read_latest(self, max_age_ms: int = 500) -> NDArray[Any]:
        """The newest picture. Raises TimeoutError for one that is older."""
        age_ms = 1000.0 * (time.monotonic() - self._taken_s)
        if self._latest is None or age_ms > max_age_ms:
            raise TimeoutError(f"the newest picture of {self.config.name} is {age_ms:.0f} ms old{self._why}")
        return self._latest

    def disconnect(self) -> None:
        """End the thread."""
        follower, self._follower = self._follower, None
        if follower is not None:
            follower.close()

    @property
    def _why(self) -> str:
        return f": {self._problem}" if self._problem else ""

    def _receive(self, shot: Shot) -> None:
        self._latest, self._taken_s = np.array(shot.arrays["rgb"]), time.monotonic()
        self._count += 1

    def _report(self, problem: str) -> None:
        self._problem = problem
