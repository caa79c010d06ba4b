"""Recordings as MCAP files, which ROS 2, PlotJuggler and Foxglove can open."""

import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from os import SEEK_END
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final

from client.errors import RecordingError, extra
from client.recording.cdr import Message, MessageType
from client.recording.definitions import ros_name
from client.recording.output import FLUSH_S, OutputFile
from client.recording.recording import ROBOT, Columns, Info, Recording
from client.recording.topics import RTDE_TOPIC, Topics
from client.recording.tracking import Tracking, TrackingBuilder
from urproto.joints import JOINT_NAMES
from urproto.rtde.fields import OUTPUT_FIELDS

if TYPE_CHECKING:
    from mcap.records import Channel, Schema


_WHAT: Final = "an MCAP file"
_CHUNK: Final = 1 << 18  # bytes; a chunk also ends after FLUSH_S, which limits the loss in a crash
_MAX_CHUNK_BYTES: Final = 1 << 30  # bytes, uncompressed; guess: a larger size means damage
_METADATA: Final = "ur-client"
_JOINT_STATES: Final = "/joint_states"
_CONTROLLER_STATE: Final = "control_msgs/msg/JointTrajectoryControllerState"
_RTDE_NAMES: Final = {ros_name(name): name for name in OUTPUT_FIELDS}


class McapWriter:
    """Writes each state as messages on the topics of the ROS 2 driver, and complete on ``/rtde``.

    saved: number of states in the file.
    """

    def __init__(self, path: Path, names: Collection[str], info: Info) -> None:
        with extra("record", _WHAT):
            from mcap.writer import Writer
        self.saved = 0
        self._count = 0
        self.file = OutputFile(path)
        self._written = 0  # size of the file after the last state, in bytes
        self._flushed_s = time.monotonic()  # time at which the last chunk was ended
        stream: Any = self.file  # has those methods of a stream that the writer uses
        self._writer = Writer(stream, chunk_size=_CHUNK)
        # the package has no public method to end a chunk before it is full
        self._end_chunk: Callable[[], None] = getattr(self._writer, "_Writer__finalize_chunk", lambda: None)
        self._writer.start(profile="ros2", library="ur-client")
        if info:
            self._writer.add_metadata(_METADATA, dict(info))
        self._topics = Topics(names)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def write(self, values: Mapping[str, Any], time_ns: int) -> None:
        """Add a state. Raises RecordingError."""
        for message in self._topics.encoded(values, time_ns):
            self.add(message, time_ns)
        if (now_s := time.monotonic()) - self._flushed_s > FLUSH_S:
            self._end_chunk()
            self._flushed_s = now_s
        self._count += 1
        if (written := self.file.tell()) != self._written:
            self._written = written
            self.saved = self._count
            self.file.keep = True

    def add(self, message: Message, time_ns: int) -> None:
        """Add a message that is not part of a state. Raises RecordingError."""
        topic, kind, data = message
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schema(kind))
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns)

    def close(self, *, complete: bool = True) -> None:
        """Finish the file: write its index and footer; see `FileWriter`. Raises RecordingError."""
        if self.file.failed:
            return
        finish: Callable[[], None] = self._writer.finish
        self._end_chunk()
        self.saved = self._count
        finish()
        self.file.close(complete=complete)

    def _schema(self, kind: MessageType) -> int:
        if kind.name not in self._schemas:
            self._schemas[kind.name] = self._writer.register_schema(kind.name, "ros2msg", kind.definition.encode())
        return self._schemas[kind.name]


def read_mcap(path: Path) -> Recording:
    """Read a file of `McapWriter`, or any ROS 2 bag in MCAP with ``/joint_states`` of a UR arm.

    A truncated file, as a crash leaves it, is read up to its end, and damaged chunks are skipped; info reports both.
    Raises RecordingError.
    """
    content = _Content()
    with path.open("rb") as file:
        damage = Damage()
        content.read(records_of(file, damage))
        if damage.chunks:  # they may have contained channels that other chunks need, which the end of the file repeats
            file.seek(0)
            channels, content, damage = content.channels, _Content(), Damage()
            content.read([*channels, *records_of(file, damage)])
    content.info |= damage.remarks(content.unreadable)
    return content.recording(path)


class Damage:
    """The parts of a file that could not be read."""

    def __init__(self) -> None:
        self.chunks = 0
        self.why = ""  # of the first chunk
        self.cut_off = ""

    def remarks(self, messages: int) -> dict[str, str]:
        """The entries for `Recording.info`. messages: number of messages that could not be read either."""
        parts = [f"{self.chunks} damaged parts of the file ({self.why})"] if self.chunks else []
        parts += [f"{messages} damaged messages"] if messages else []
        left_out = {"left_out": f"left out: {', '.join(parts)}"} if parts else {}
        return left_out | ({"cut_off": self.cut_off} if self.cut_off else {})


def records_of(file: BinaryIO, damage: Damage) -> Iterator[object]:
    """The records of a file up to the first unreadable one; damaged chunks are skipped."""
    with extra("record", _WHAT):
        from mcap.records import Chunk
        from mcap.stream_reader import StreamReader, breakup_chunk
    size = file.seek(0, SEEK_END)
    file.seek(0)
    records = StreamReader(file, emit_chunks=True, record_size_limit=size).records
    end = 0  # of the last readable record
    while True:
        try:
            record = next(records, None)
        except Exception as error:  # the reader also lets through errors of struct and of the decompressors
            damage.cut_off = f"{_reason(error)}; the last {size - end} of {size} bytes cannot be read"
            return
        end = file.tell()
        if record is None:
            return
        if not isinstance(record, Chunk):
            yield record
            continue
        try:
            if record.uncompressed_size > _MAX_CHUNK_BYTES:
                raise ValueError(f"a chunk of {record.uncompressed_size} bytes")
            inside = breakup_chunk(record, validate_crc=True)
        except Exception as error:  # as above
            damage.chunks += 1
            damage.why = damage.why or _reason(error)
            continue
        yield from inside


def _reason(error: Exception) -> str:
    return str(error) or type(error).__name__


class _Content:
    """The content of a file that has been read so far."""

    def __init__(self) -> None:
        self.channels: list[object] = []  # and their schemas, in the order of the file
        self.info: dict[str, str] = {}
        self.unreadable = 0  # messages
        self._problem: RecordingError | None = None  # of the first
        self._schemas: dict[int, Schema] = {}
        self._types: dict[int, MessageType] = {}  # by channel
        self._rtde: Columns | None = None
        self._rtde_channel: int | None = None
        self._joints = Columns(("timestamp", "actual_q", "actual_qd", "actual_current"))
        self._has_joints = False
        self._joints_began_s = 0.0
        self._began_ns: dict[str, int] = {}
        self._controllers: dict[int, TrackingBuilder] = {}  # by channel

    def read(self, records: Iterable[object]) -> None:
        with extra("record", _WHAT):
            from mcap.records import Channel, Message, Metadata, Schema
        for record in records:
            if isinstance(record, Message):
                try:
                    self._decode_message(record.channel_id, record.log_time, record.data)
                except RecordingError as error:
                    self.unreadable += 1
                    self._problem = self._problem or error
            elif isinstance(record, Metadata) and record.name == _METADATA:
                self.info |= record.metadata
            elif isinstance(record, Schema):
                self.channels.append(record)
                self._schemas[record.id] = record
            elif isinstance(record, Channel):
                self.channels.append(record)
                self._add_channel(record)

    def _add_channel(self, channel: "Channel") -> None:
        schema = self._schemas.get(channel.schema_id)
        if channel.id in self._types or schema is None:
            return
        controller = _controller_of(channel.topic) if schema.name == _CONTROLLER_STATE else ""
        relevant = controller or channel.topic in (RTDE_TOPIC, _JOINT_STATES)
        kind = decodable(channel, schema) if relevant else None
        if kind is None:
            return
        self._types[channel.id] = kind
        if controller:
            self._controllers[channel.id] = TrackingBuilder(controller)
        names = tuple(name for lower, name in _RTDE_NAMES.items() if lower in kind.names)
        if channel.topic == RTDE_TOPIC and names:
            self._rtde_channel = channel.id
            self._rtde = Columns(names)

    def _decode_message(self, channel: int, time_ns: int, data: bytes) -> None:
        if channel not in self._types:
            return
        message = self._types[channel].decode(data)
        try:
            self._add_message(channel, time_ns, message)
        except (
            KeyError,
            ValueError,
            TypeError,
            AttributeError,
            OverflowError,
        ) as error:  # a type of the same name with other fields
            raise RecordingError(
                f"a message of type {self._types[channel].name} has unexpected fields: {error}"
            ) from error

    def _add_message(self, channel: int, time_ns: int, message: Mapping[str, Any]) -> None:
        if channel in self._controllers:
            self._controllers[channel].add(_stamp_s(message, time_ns), message)
        elif self._rtde is not None and channel == self._rtde_channel:
            self._began_ns.setdefault(RTDE_TOPIC, time_ns)
            self._rtde.append({_RTDE_NAMES[name]: value for name, value in message.items() if name in _RTDE_NAMES})
        elif set(message.get("name", ())) >= set(JOINT_NAMES):
            self._began_ns.setdefault(_JOINT_STATES, time_ns)
            values = _joint_values(message, time_ns)
            if not self._has_joints:
                self._joints_began_s = values["timestamp"]
            self._has_joints = True
            self._joints.append(values)

    def recording(self, path: Path) -> Recording:
        if self._problem is not None and not self._began_ns:
            raise self._problem
        if self._rtde is not None:
            columns, topic = self._rtde, RTDE_TOPIC
        elif self._has_joints:
            columns, topic = self._joints, _JOINT_STATES
        else:
            reason = f" ({self.info['cut_off']})" if "cut_off" in self.info else ""
            raise RecordingError(
                f"{path} has neither messages on /rtde nor joint states of a UR arm on /joint_states{reason}"
            )
        began = {"began_ns": str(self._began_ns[topic])} if topic in self._began_ns else {}
        return Recording(columns.arrays(), self.info | began, self._trackings(topic))

    def _trackings(self, topic: str) -> dict[str, Tracking]:
        began_s = self._joints_began_s if topic == _JOINT_STATES else self._began_ns.get(topic, 0) * 1e-9
        found = (controller for controller in self._controllers.values() if controller.joints)
        return {controller.source: controller.build(began_s) for controller in found}


def _joint_values(message: Mapping[str, Any], time_ns: int) -> dict[str, Any]:
    """The RTDE variables of a joint state; its joints may be in any order."""
    time_s = _stamp_s(message, time_ns)
    order = [message["name"].index(joint) for joint in JOINT_NAMES]
    kinds = {"actual_q": "position", "actual_qd": "velocity", "actual_current": "effort"}
    return {"timestamp": time_s} | {
        name: [message[kind][index] if index < len(message[kind]) else 0.0 for index in order]
        for name, kind in kinds.items()
    }


def decodable(channel: "Channel", schema: "Schema") -> MessageType | None:
    """The type of a channel's messages; None for a type that is not described as in ROS 2."""
    if (channel.message_encoding, schema.encoding) != ("cdr", "ros2msg"):
        return None
    return MessageType(schema.name, schema.data.decode("utf-8", "replace"))


def stamp_ns(message: Mapping[str, Any], time_ns: int) -> int:
    """The time in a message's header; if that is zero, the time at which it was written."""
    stamp = message["header"]["stamp"]
    own_ns: int = stamp["sec"] * 1_000_000_000 + stamp["nanosec"]
    return own_ns or time_ns


def _stamp_s(message: Mapping[str, Any], time_ns: int) -> float:
    return stamp_ns(message, time_ns) * 1e-9


def _controller_of(topic: str) -> str:
    """The controller that publishes a topic; empty for the robot's own, whose states are on ``/rtde`` as well."""
    name = topic.strip("/").rpartition("/")[0]
    return "" if name == ROBOT else name
