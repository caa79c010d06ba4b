"""Camera images in recordings: the messages of JPEG and depth images, and reading the JPEG images again.

Colour images are recorded as ``sensor_msgs/CompressedImage``, as they arrive: raw images take thirty times the space.
Depth images are raw.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

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
from client.errors import RecordingError, extra
from client.recording.cdr import Message, MessageType
from client.recording.definitions import message, xyz, xyzw
from client.recording.mcapfile import Damage, decodable, records_of, stamp_ns
from client.recording.timestamps import header
from urproto.robots.pose import rotvec_to_quaternion

if TYPE_CHECKING:
    from mcap.records import Message as Record


JPEG, DEPTH = "rgb.jpg", "depth.npy"
"""The forms of images that are recorded."""

_FRAMES: Final = "tf2_msgs/msg/TFMessage"
_REPEAT_NS: Final = 1_000_000_000  # guess: unchanged messages are repeated once a second, for late subscribers

_TOPIC: Final = re.compile(r"/([\w/]+)/image_raw/compressed")


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


@dataclass(frozen=True, slots=True)
class RecordedPictures:
    """The images of one camera: JPEG data, ordered by times_ns (n,), the time of each since 1970."""

    times_ns: NDArray[np.int64]
    data: tuple[bytes, ...]


def read_pictures(path: Path) -> dict[str, RecordedPictures]:
    """Read the images of a file of `McapWriter`, or of a ROS 2 bag in MCAP, by camera name.

    They come from the topics ``/NAME/image_raw/compressed``; ``/`` in a name becomes ``_``. Damaged parts are skipped,
    as in `read_mcap`. Raises RecordingError for a message that is not an image.
    """
    images: dict[str, list[tuple[int, bytes]]] = {}
    with path.open("rb") as file:
        for camera, kind, record in _messages(records_of(file, Damage())):
            message = kind.decode(record.data)
            try:
                taken_ns = int(np.int64(stamp_ns(message, record.log_time)))
                picture = bytes([*message["data"]])  # unpacked, because bytes(number) would be that many zeros
            except (KeyError, ValueError, TypeError, OverflowError) as error:
                raise RecordingError(f"a message of type {kind.name} has unexpected fields: {error}") from error
            images.setdefault(camera, []).append((taken_ns, picture))
    found = {}
    for camera, taken in images.items():
        times, data = zip(*sorted(taken, key=itemgetter(0)), strict=True)
        found[camera] = RecordedPictures(np.array(times, np.int64), data)
    return found


def _messages(records: Iterable[object]) -> Iterator[tuple[str, MessageType, "Record"]]:
    """The messages with images, each with the name of its camera."""
    with extra("record", "an MCAP file"):
        from mcap.records import Channel, Schema
        from mcap.records import Message as Record
    schemas: dict[int, Schema] = {}
    cameras: dict[int, tuple[str, MessageType]] = {}  # by channel
    for record in records:
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            schema, match = schemas.get(record.schema_id), _TOPIC.fullmatch(record.topic)
            kind = decodable(record, schema) if match and schema and schema.name == COMPRESSED else None
            if match and kind:
                cameras[record.id] = match[1].replace("/", "_"), kind
        elif isinstance(record, Record) and record.channel_id in cameras:
            yield *cameras[record.channel_id], record
