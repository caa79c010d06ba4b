"""A participant of a DDS domain by CycloneDDS, as ROS 2 expects one to be.

Messages travel as bytes: `client.recording.cdr` reads and writes them three times as fast as CycloneDDS's own Python,
which only gets to know the types. Writing is a matter of microseconds and never waits; reading is done in a thread of
its own, which sleeps until something happens.

Quality of service: reliable, and the last message is kept. Latched topics (transient local) are told to those who come
late. Source: rmw_cyclonedds, as for what stands in the user data.
"""

import logging
import re
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from types import TracebackType
from typing import Any, Final, Self

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
from cyclonedds.core import (
    DDSException,
    DDSStatus,
    Entity,
    GuardCondition,
    InstanceState,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import Domain as DDSDomain
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from client.errors import RecordingError, Ros2Error
from client.recording.cdr import Field, MessageType
from client.ros2.domain import Domain
from client.ros2.type_hash import type_hash

_TOPIC: Final = "rt"  # in front of topics; services have others
_NAMESPACE: Final = re.compile(r"(/[A-Za-z_]\w*)*", re.ASCII)
_PREFIX: Final = re.compile(r"([A-Za-z_][\w/]*)?", re.ASCII)


def dds_topic(name: str) -> str:
    """``/joint_states`` is the DDS topic ``rt/joint_states``."""
    return _TOPIC + name


def dds_type(name: str) -> str:
    """``sensor_msgs/msg/JointState``, or without ``/msg``, is the DDS type ``sensor_msgs::msg::dds_::JointState_``."""
    package, _, own = name.replace("/msg/", "/").partition("/")
    return f"{package}::msg::dds_::{own}_"


def resolved(name: str, namespace: str, node: str) -> str:
    """``/x`` stays as it is, ``x`` is in the namespace, ``~/x`` below the node's name."""
    if name.startswith("/"):
        return name
    return f"{namespace}/{name.replace('~', node, 1)}"


def check_namespace(text: str) -> str:
    """A namespace with its slash in front, "" for none. Raises Ros2Error."""
    namespace = "" if not text.strip("/") else "/" + text.removeprefix("/")
    if not _NAMESPACE.fullmatch(namespace) or "__" in namespace:
        raise Ros2Error(
            f"{text!r} is not a namespace: letters, digits and single underscores, parts with a slash between them, "
            "none beginning with a digit, such as left or cell1/left"
        )
    return namespace


def check_prefix(text: str) -> str:
    """What comes before the names of joints and frames. Raises Ros2Error."""
    if not _PREFIX.fullmatch(text):
        raise Ros2Error(f"{text!r} is not a prefix of joint names: letters, digits and underscores, such as left_")
    return text


_NUMBERS: Final[dict[str, Any]] = {
    "bool": bool,
    "byte": types.uint8,
    "char": types.uint8,
    "int8": types.int8,
    "uint8": types.uint8,
    "int16": types.int16,
    "uint16": types.uint16,
    "int32": types.int32,
    "uint32": types.uint32,
    "int64": types.int64,
    "uint64": types.uint64,
    "float32": types.float32,
    "float64": types.float64,
    "string": str,
}


@cache
def idl_type(kind: MessageType) -> Any:
    """What CycloneDDS has to know of a type, as one of its classes: its name on DDS and its fields."""
    return _struct(kind, next(iter(kind.structs)))


def _struct(kind: MessageType, name: str) -> Any:
    fields = {field.name: _field(kind, field) for field in kind.structs[name]}
    # CycloneDDS writes the colons itself
    return make_idl_struct(name.rpartition("/")[2], dds_type(name).replace("::", "."), fields)


def _field(kind: MessageType, field: Field) -> Any:
    one = _NUMBERS[field.type] if field.type in _NUMBERS else _struct(kind, field.type)
    if field.count is None:
        return one
    return types.array[one, field.count] if field.count else types.sequence[one]


_ENCLAVE: Final = b"enclave=/;"  # ROS 2 counts participants only that have one
_UNLIMITED: Final = -1
_AT_ONCE: Final = 16  # messages; a reader keeps fewer
_NEW: Final = ViewState.Any | InstanceState.Any | SampleState.NotRead

_logger = logging.getLogger(__name__)


class _Bytes:
    """A message as CycloneDDS is to see it: already written, or not yet read."""

    sample_info: Any = None

    def __init__(self, data: bytes) -> None:
        self.data = data

    def serialize(self, use_version_2: bool | None = None) -> bytes:
        return self.data

    @classmethod
    def deserialize(cls, data: bytes) -> Self:
        return cls(data)

    deserialize_key = deserialize


class Participant:
    """A participant of ``domain``; use it with ``with``, make what it has, then `start` it.

    Raises Ros2Error where DDS does not want to.
    """

    def __init__(self, domain: Domain) -> None:
        self._domain = domain
        self._dds: list[Entity] = []  # what lives as long as this does
        self._types: dict[str, str] = {}  # of our topics, as DDS calls both
        self._looks: list[Callable[[], object]] = []
        self._thread = threading.Thread(target=self._listen, name="ros2-reader", daemon=True)

    def __enter__(self) -> Self:
        with _explained(f"domain {self._domain.id}"):
            self._dds.append(_created(self._domain))
            self._participant = DomainParticipant(self._domain.id, Qos(Policy.Userdata(data=_ENCLAVE)))
            self._stop = GuardCondition(self._participant)
            self._waitset = WaitSet(self._participant)
            self._waitset.attach(self._stop)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set(True)
        if self._thread.is_alive():
            self._thread.join()
        self._looks.clear()
        del self._waitset, self._stop, self._participant
        while self._dds:  # what was made last goes first; they are deleted as soon as nobody has them
            self._dds.pop()

    def publisher(self, name: str, kind: MessageType, *, latched: bool = False, depth: int = 1) -> "Publisher":
        """A topic to be written."""
        with _explained(name):
            topic = self._topic(name, kind)
            writer = DataWriter(self._participant, topic, _qos(kind, latched, depth))
            writer.set_status_mask(DDSStatus.PublicationMatched | DDSStatus.OfferedIncompatibleQos)
            self._dds += [topic, writer]
            self._waitset.attach(writer)
        publisher = Publisher(name, kind, writer, latched)
        self._looks.append(publisher.look)
        return publisher

    def subscribe(self, name: str, kind: MessageType, take: Callable[[dict[str, Any]], object]) -> None:
        """A topic to be read: ``take`` is called in this participant's thread, with the fields of each message."""
        with _explained(name):
            topic = self._topic(name, kind)
            reader = DataReader(self._participant, topic, _qos(kind, False, 1))
            reader.set_status_mask(DDSStatus.RequestedIncompatibleQos)
            condition = ReadCondition(reader, _NEW)
            self._dds += [topic, reader, condition]
            for entity in (condition, reader):
                self._waitset.attach(entity)
        self._looks.append(_Subscription(name, kind, reader, take).look)

    def start(self) -> None:
        """Begin to read, and to look who is there."""
        with _explained("discovery"):
            for builtin, does in ((BuiltinTopicDcpsPublication, "publishes"), (BuiltinTopicDcpsSubscription, "wants")):
                endpoints = BuiltinDataReader(self._participant, builtin)
                condition = ReadCondition(endpoints, _NEW)
                self._dds += [endpoints, condition]
                self._waitset.attach(condition)
                self._looks.append(_Strangers(endpoints, does, self._types).look)
        self._thread.start()

    def _topic(self, name: str, kind: MessageType) -> Topic[Any]:
        topic: Topic[Any] = Topic(self._participant, dds_topic(name), idl_type(kind))
        topic.data_type = _Bytes
        self._types[dds_topic(name)] = dds_type(kind.name)
        return topic

    def _listen(self) -> None:
        while True:
            self._waitset.wait(duration(infinite=True))
            if self._stop.read():
                return
            for look in self._looks:
                try:
                    look()
                except Exception:  # one topic must not end the others
                    _logger.exception("ROS 2: a topic could not be looked at")


class Publisher:
    """A topic that is written. wanted: whether somebody listens, or may later want what is latched."""

    def __init__(self, name: str, kind: MessageType, writer: DataWriter[Any], latched: bool) -> None:
        self.name = name
        self.kind = kind
        self._writer = writer
        self._latched = latched
        self._listeners = 0
        self._failed = False
        self._incompatible = 0

    @property
    def wanted(self) -> bool:
        """False saves the work."""
        return self._latched or self._listeners > 0

    def write(self, values: Mapping[str, Any]) -> None:
        """Send a message; fields that are not named are zero or empty. What cannot be sent now is lost, and told."""
        try:
            self._writer.write(_Bytes(self.kind.encode(values)))
        except DDSException as error:
            if not self._failed:
                _logger.warning("%s: a message was not sent (%s); more of these are not told", self.name, error)
            self._failed = True

    def look(self) -> None:
        """Who listens; called by the participant's thread."""
        self._listeners = self._writer.get_publication_matched_status().current_count
        status = self._writer.get_offered_incompatible_qos_status()
        if status.total_count > self._incompatible:
            self._incompatible = status.total_count
            _logger.warning(
                "%s: somebody wants it with a quality of service it does not have (%s): subscribe reliable or best "
                "effort, %s",
                self.name,
                _policy(status.last_policy_id),
                "volatile or transient local" if self._latched else "volatile",
            )


class _Subscription:
    def __init__(
        self, name: str, kind: MessageType, reader: DataReader[Any], take: Callable[[dict[str, Any]], object]
    ) -> None:
        self._name = name
        self._kind = kind
        self._reader = reader
        self._take = take
        self._incompatible = 0

    def look(self) -> None:
        """Take what has come."""
        for message in self._reader.take(_AT_ONCE):
            if not isinstance(message, _Bytes):  # a publisher has left
                continue
            try:
                values = self._kind.decode(message.data)
            except RecordingError as error:
                _logger.warning("%s: %s; it is ignored", self._name, error)
                continue
            self._take(values)
        status = self._reader.get_requested_incompatible_qos_status()
        if status.total_count > self._incompatible:
            self._incompatible = status.total_count
            _logger.warning(
                "%s: somebody publishes it with a quality of service that is not good enough (%s): publish reliable",
                self._name,
                _policy(status.last_policy_id),
            )


class _Strangers:
    """Looks for others that have a topic of ours as another type: DDS does not tell anybody, they just never meet."""

    def __init__(self, endpoints: BuiltinDataReader, does: str, types: Mapping[str, str]) -> None:
        self._endpoints = endpoints
        self._does = does
        self._types = types

    def look(self) -> None:
        for endpoint in self._endpoints.take(_AT_ONCE):
            name, kind = getattr(endpoint, "topic_name", ""), getattr(endpoint, "type_name", "")
            if name in self._types and kind != self._types[name]:
                _logger.warning(
                    "%s: somebody %s it as %s, but it is %s: they do not hear each other",
                    name.removeprefix("rt"),
                    self._does,
                    kind,
                    self._types[name],
                )


def _qos(kind: MessageType, latched: bool, depth: int) -> Qos:
    policies = [
        Policy.Reliability.Reliable(max_blocking_time=0),
        Policy.History.KeepLast(depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.TypeConsistency.AllowTypeCoercion(),
        Policy.Userdata(data=f"typehash={type_hash(kind)};".encode()),
    ]
    if latched:
        policies += [
            Policy.Durability.TransientLocal,
            Policy.DurabilityService(0, Policy.History.KeepLast(depth), _UNLIMITED, _UNLIMITED, _UNLIMITED),
        ]
    else:
        policies.append(Policy.Durability.Volatile)
    return Qos(*policies)


def _created(domain: Domain) -> DDSDomain:
    *others, last = domain.configs
    for config in others:
        try:
            return DDSDomain(domain.id, config)
        except DDSException:  # CycloneDDS has written why
            continue
    return DDSDomain(domain.id, last)


_POLICIES: Final = {2: "durability", 4: "deadline", 8: "liveliness", 11: "reliability", 23: "data representation"}


def _policy(number: int) -> str:
    return _POLICIES.get(number, f"policy {number}")


@contextmanager
def _explained(what: str) -> Iterator[None]:
    try:
        yield
    except DDSException as error:
        raise Ros2Error(
            f"{what}: CycloneDDS says {error} (see CYCLONEDDS_URI and the other variables of ROS 2's discovery, and "
            "that the network is up)"
        ) from error
