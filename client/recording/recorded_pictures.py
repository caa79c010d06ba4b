"""Read the camera images of a recording: JPEG, as recorded from this project's cameras or in ROS 2."""

import re
from collections.abc import Iterable, Iterator
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
from client.recording.mcapfile import Damage, decodable, records_of, stamp_ns

if TYPE_CHECKING:
    from mcap.records import Message

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


def _messages(records: Iterable[object]) -> Iterator[tuple[str, MessageType, "Message"]]:
    """The messages with images, each with the name of its camera."""
    with extra("record", "an MCAP file"):
        from mcap.records import Channel, Message, Schema
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
        elif isinstance(record, Message) and record.channel_id in cameras:
            yield *cameras[record.channel_id], record
