"""Read the camera images of a recording: JPEG, as recorded from this project's cameras or in ROS 2."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from client.cameras.messages import COMPRESSED
from client.errors import RecordingError
from client.recording.cdr import MessageType
from client.recording.extras import extra
from client.recording.mcapfile import Damage, records_of, stamp_ns

if TYPE_CHECKING:
    from mcap.records import Channel, Schema

_TOPIC: Final = re.compile(r"/([\w/]+)/image_raw/compressed")


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
    with path.open("rb") as file:
        content = _Content()
        content.read(records_of(file, Damage()))
    return content.pictures()


class _Content:
    """The images read from a file so far."""

    def __init__(self) -> None:
        self._schemas: dict[int, Schema] = {}
        self._cameras: dict[int, tuple[str, MessageType]] = {}  # by channel
        self._images: dict[str, list[tuple[int, bytes]]] = {}

    def read(self, records: Iterable[object]) -> None:
        with extra("record", "an MCAP file"):
            from mcap.records import Channel, Message, Schema
        for record in records:
            if isinstance(record, Schema):
                self._schemas[record.id] = record
            elif isinstance(record, Channel):
                self._add_channel(record)
            elif isinstance(record, Message) and record.channel_id in self._cameras:
                camera, kind = self._cameras[record.channel_id]
                message = kind.decode(record.data)
                try:
                    taken_ns = int(np.int64(stamp_ns(message, record.log_time)))
                    picture = bytes([*message["data"]])  # unpacked, because bytes(number) would be that many zeros
                except (KeyError, ValueError, TypeError, OverflowError) as error:
                    raise RecordingError(f"a message of type {kind.name} has unexpected fields: {error}") from error
                self._images.setdefault(camera, []).append((taken_ns, picture))

    def _add_channel(self, channel: "Channel") -> None:
        schema, match = self._schemas.get(channel.schema_id), _TOPIC.fullmatch(channel.topic)
        if match is None or schema is None or schema.name != COMPRESSED:
            return
        if (channel.message_encoding, schema.encoding) == ("cdr", "ros2msg"):
            kind = MessageType(schema.name, schema.data.decode("utf-8", "replace"))
            self._cameras[channel.id] = match[1].replace("/", "_"), kind

    def pictures(self) -> dict[str, RecordedPictures]:
        found = {}
        for camera, images in self._images.items():
            images.sort(key=itemgetter(0))
            times, data = zip(*images, strict=True)
            found[camera] = RecordedPictures(np.array(times, np.int64), data)
        return found
