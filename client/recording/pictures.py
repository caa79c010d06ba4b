"""Camera images as the messages of a recording: JPEG and depth images, camera info, and the camera's frames.

Colour images are recorded as ``sensor_msgs/CompressedImage``, as they arrive: raw images take thirty times the space.
Depth images are raw.
"""

from collections.abc import Iterable, Iterator
from typing import Any, Final

from client.cameras import Shot
from client.cameras.messages import (
    COMPRESSED,
    IMAGE,
    INFO,
    FrameTransform,
    camera_info,
    compressed,
    fixed_frames,
    image,
    moving_frames,
    optical_frame,
    ros_name,
)
from client.recording.cdr import Message
from client.recording.definitions import message, xyz, xyzw
from client.recording.timestamps import header
from urproto.robots.pose import rotvec_to_quaternion

JPEG, DEPTH = "rgb.jpg", "depth.npy"
"""The forms of images that are recorded."""

_FRAMES: Final = "tf2_msgs/msg/TFMessage"
_REPEAT_NS: Final = 1_000_000_000  # guess: unchanged messages are repeated once a second, for late subscribers


class Pictures:
    """Encodes the images of one recording as messages."""

    def __init__(self) -> None:
        self._sent_ns: dict[str, int] = {}

    def encoded(self, shot: Shot, time_ns: int) -> Iterator[Message]:
        """The messages of one image (`JPEG` or `DEPTH`), taken at time_ns since 1970. Raises CameraError."""
        name = f"/{ros_name(shot.camera)}"
        stamp = {"header": header(time_ns, optical_frame(shot.camera))}
        yield from self._frames(shot, time_ns)
        if shot.form == JPEG:
            yield message(f"{name}/image_raw/compressed", COMPRESSED, stamp | compressed(shot.data))
        else:
            name += "/depth"
            yield message(f"{name}/image_raw", IMAGE, stamp | image(shot.arrays["depth"]))
        yield message(f"{name}/camera_info", INFO, stamp | camera_info(shot.camera))

    def _frames(self, shot: Shot, time_ns: int) -> Iterator[Message]:
        name = shot.camera.name
        if not 0 <= time_ns - self._sent_ns.get(name, -_REPEAT_NS) < _REPEAT_NS:
            self._sent_ns[name] = time_ns
            yield message("/tf_static", _FRAMES, _transforms(fixed_frames(shot.camera), time_ns))
        if moving := moving_frames(shot):
            yield message("/tf", _FRAMES, _transforms(moving, time_ns))


def _transforms(frames: Iterable[FrameTransform], time_ns: int) -> dict[str, Any]:
    return {
        "transforms": [
            {
                "header": header(time_ns, frame.parent),
                "child_frame_id": frame.child,
                "transform": {
                    "translation": xyz(frame.pose[:3]),
                    "rotation": xyzw(rotvec_to_quaternion(*frame.pose[3:])),
                },
            }
            for frame in frames
        ]
    }
