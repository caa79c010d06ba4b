"""Rendering in a separate process, so that a robot in real time is not delayed.

Reading a picture from OpenGL keeps Python's interpreter locked for 30 ms and more if it is large, while a control
period is 2 or 8 ms long. The process therefore receives the model once, and for each picture only the changes of model
and state, some kilobytes. It runs at low priority (nice), and ends when its standard input does.

`first_message`, `request` and `pose_of_picture` are for the robot's side; `work` is the process.
"""

import io
import json
import os
import pickle
import struct
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, BinaryIO, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from emulator.physics.cameras import CameraError, Cameras, Scenery, extrinsics
from emulator.physics.description import Camera
from urproto.cameras import FORMS
from urproto.compat import module_command
from urproto.robots.pose import Pose

HEADER: Final = struct.Struct("<II")
"""Before each message of the process: lengths of its JSON and of the picture."""

_STATE: Final = mujoco.mjtState.mjSTATE_INTEGRATION
_LOOKS: Final = ("body_pos", "body_quat", "geom_rgba")  # parts of the model that a running robot changes
_JPEG_QUALITY: Final = 85  # guess: edges of parts stay sharp, 320 x 240 pixels take some 10 kB
_NICE: Final = 5  # a third of the CPU share of other processes, such as the robot (guess)
_MAX_MM: Final = 65535.0


@dataclass
class Sketch:
    """A scene in another process: `Scenery` with its own state."""

    model: Any
    cameras: Mapping[str, Camera]
    covered: frozenset[str] = frozenset()
    data: Any = field(init=False)

    def __post_init__(self) -> None:
        self.data = mujoco.MjData(self.model)

    def take(self, appearance: tuple[NDArray[np.float64], tuple[NDArray[Any], ...], frozenset[str]]) -> None:
        """Take over the appearance of the scene at the time of a `request`."""
        state, looks, self.covered = appearance
        for name, value in zip(_LOOKS, looks, strict=True):
            getattr(self.model, name)[:] = value
        mujoco.mj_setState(self.model, self.data, state, _STATE)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        mujoco.mj_flex(self.model, self.data)
        mujoco.mj_tendon(self.model, self.data)


def command() -> list[str]:
    """Command that starts the process. It expects `first_message`, then `request`s."""
    return module_command("emulator.physics.drawing")


def first_message(scenery: Scenery) -> bytes:
    """Message with the scene. Its model is copied, which takes time in proportion to its size."""
    return pickle.dumps((scenery.model, dict(scenery.cameras)), pickle.HIGHEST_PROTOCOL)


def request(scenery: Scenery, name: str, form: str) -> bytes:
    """Request for a picture of the scene in its present state. form: one of `urproto.cameras.FORMS`."""
    state = np.zeros(mujoco.mj_stateSize(scenery.model, _STATE))
    mujoco.mj_getState(scenery.model, scenery.data, state, _STATE)
    appearance = state, tuple(getattr(scenery.model, look) for look in _LOOKS), frozenset(scenery.covered)
    return pickle.dumps((name, form, appearance), pickle.HIGHEST_PROTOCOL)


def pose_of_picture(message: Mapping[str, Any]) -> Pose:
    """Pose of the camera. Raises CameraError if the process reports an error instead of a picture."""
    if "error" in message:
        raise CameraError(message["error"])
    x, y, z, rx, ry, rz = message["pose"]
    return (x, y, z, rx, ry, rz)


# the process


def work(orders: BinaryIO, pictures: BinaryIO) -> None:
    """Render on request until the input ends."""
    sketch = Sketch(*pickle.load(orders))
    try:
        cameras = Cameras(sketch)
    except CameraError as error:
        _send(pictures, {"error": str(error)})
        return
    with cameras:
        while True:
            try:
                name, form, appearance = pickle.load(orders)
            except (EOFError, pickle.UnpicklingError):  # the robot has ended, possibly in the middle of a message
                return
            sketch.take(appearance)
            picture = _FORMS[form](cameras, name)
            _send(pictures, {"pose": extrinsics(sketch, name)}, picture)


def _send(pictures: BinaryIO, message: Mapping[str, Any], picture: bytes = b"") -> None:
    text = json.dumps(message).encode()
    pictures.write(HEADER.pack(len(text), len(picture)) + text)
    pictures.write(picture)
    pictures.flush()


def _image(picture: NDArray[Any], kind: str, **options: Any) -> bytes:
    from PIL import Image

    written = io.BytesIO()
    Image.fromarray(picture).save(written, kind, **options)
    return written.getvalue()


def _numpy(picture: NDArray[Any]) -> bytes:
    written = io.BytesIO()
    np.save(written, picture, allow_pickle=False)
    return written.getvalue()


def _rgbd(cameras: Cameras, name: str) -> bytes:
    rgb, depth = cameras.rgbd(name)
    written = io.BytesIO()
    np.savez(written, rgb=rgb, depth=depth)
    return written.getvalue()


def _millimetres(metres: NDArray[np.float32]) -> NDArray[np.uint16]:
    mm = np.rint(1e3 * metres.astype(np.float64))
    return np.where(mm > _MAX_MM, 0.0, mm).astype(np.uint16)


_FORMS: Final[Mapping[str, Callable[[Cameras, str], bytes]]] = {
    "rgb.jpg": lambda cameras, name: _image(cameras.rgb(name), "JPEG", quality=_JPEG_QUALITY),
    "rgb.npy": lambda cameras, name: _numpy(cameras.rgb(name)),
    "depth.npy": lambda cameras, name: _numpy(cameras.depth(name)),
    "depth.png": lambda cameras, name: _image(_millimetres(cameras.depth(name)), "PNG", compress_level=1),
    "rgbd.npz": _rgbd,
    "segmentation.npy": lambda cameras, name: _numpy(cameras.segmentation(name)),
}
assert _FORMS.keys() == FORMS.keys()


def _main() -> None:
    """Run the process. Output that a library prints must not get between the pictures."""
    pictures = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    if hasattr(os, "nice"):
        os.nice(_NICE)
    try:
        work(sys.stdin.buffer, pictures)
    except (BrokenPipeError, KeyboardInterrupt):  # the robot has ended, or is ending by the same Ctrl-C
        return


if __name__ == "__main__":
    _main()
