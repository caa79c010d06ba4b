"""A participant of CycloneDDS in a process of its own, as a node of ROS 2 would be.

Types are made of rosbags' definitions, and CycloneDDS itself reads and writes them: nothing of ours is used. Lines of
JSON come in and go out:
    {"hear": TOPIC, "type": NAME, "latched": BOOL}             then, once: {"hears": TOPIC} when it has met a publisher
    {"next": TOPIC}                                            {"topic": TOPIC, "message": {...}}: newer than all before
    {"say": TOPIC, "type": NAME, "message": {...}, "effort": "best" or "reliable"}   {"said": TOPIC} when it has arrived
    {"look": TOPIC}                                            {"found": {"type": ..., "user": ..., ...}} of a publisher
An answer with "!" says what did not happen in time.
"""

import dataclasses
import json
import sys
import time
from functools import cache
from typing import Any

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

PATIENCE = duration(seconds=15)
EVERYTHING = SampleState.Any | ViewState.Any | InstanceState.Any
STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg("int8 mode", "ur_dashboard_msgs/msg/RobotMode"))
STORE.register(get_types_from_msg("uint8 pin\nbool state", "ur_msgs/msg/Digital"))
STORE.register(get_types_from_msg("uint8 pin\nuint8 domain\nfloat32 state", "ur_msgs/msg/Analog"))
STORE.register(
    get_types_from_msg(
        "Digital[] digital_in_states\nDigital[] digital_out_states\nDigital[] flag_states\n"
        "Analog[] analog_in_states\nAnalog[] analog_out_states",
        "ur_msgs/msg/IOStates",
    )
)


@cache
def idl_class(name: str) -> Any:
    package, _, own = name.split("/")
    fields = {field: idl_field(desc) for field, desc in STORE.fielddefs[name][1]}
    return make_idl_struct(own, f"{package}.msg.dds_.{own}_", fields)


def idl_field(desc: Any) -> Any:
    kind, what = desc
    if kind is Nodetype.NAME:
        return idl_class(what)
    if kind is Nodetype.BASE:
        return {"string": str, "bool": bool}.get(what[0]) or getattr(types, what[0])
    inner, count = what
    return types.array[idl_field(inner), count] if kind is Nodetype.ARRAY else types.sequence[idl_field(inner)]


def built(name: str, values: dict[str, Any]) -> Any:
    """A message with these fields, the others zero or empty."""
    return idl_class(name)(**{field: built_field(desc, values.get(field)) for field, desc in STORE.fielddefs[name][1]})


def built_field(desc: Any, value: Any) -> Any:
    kind, what = desc
    if kind is Nodetype.NAME:
        return built(what, value or {})
    if kind is Nodetype.BASE:
        return value if value is not None else {"string": "", "bool": False}.get(what[0], 0)
    return [built_field(what[0], one) for one in value or ()]


def quality(latched: bool = False, effort: str = "reliable") -> Qos:
    return Qos(
        Policy.Reliability.Reliable(PATIENCE) if effort == "reliable" else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(10),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )


class Peer:
    def __init__(self, domain: int, config: str) -> None:
        self._domain = Domain(domain, config)
        self._participant = DomainParticipant(domain)
        self._readers: dict[str, DataReader] = {}
        self._writers: dict[str, DataWriter] = {}

    def hear(self, hear: str, type: str, latched: bool = False) -> dict[str, Any]:  # noqa: A002
        topic = Topic(self._participant, f"rt{hear}", idl_class(type))
        reader = self._readers[hear] = DataReader(self._participant, topic, quality(latched))
        met = until(lambda: reader.get_subscription_matched_status().current_count)
        return {"hears": hear} if met else {"!": f"nobody publishes {hear}"}

    def next(self, next: str) -> dict[str, Any]:  # noqa: A002
        reader = self._readers[next]
        waitset = WaitSet(self._participant)
        condition = ReadCondition(reader, EVERYTHING)
        waitset.attach(condition)
        waitset.wait(PATIENCE)
        messages = reader.take(10)
        return {"topic": next, "message": dataclasses.asdict(messages[-1])} if messages else {"!": f"nothing on {next}"}

    def say(self, say: str, type: str, message: dict[str, Any], effort: str = "reliable") -> dict[str, Any]:  # noqa: A002
        if say not in self._writers:
            topic = Topic(self._participant, f"rt{say}", idl_class(type))
            self._writers[say] = DataWriter(self._participant, topic, quality(effort=effort))
        writer = self._writers[say]
        if not until(lambda: writer.get_publication_matched_status().current_count, 15 if effort == "reliable" else 1):
            return {"!": f"nobody hears {say}"}
        writer.write(built(type, message))
        return {"said": say} if writer.wait_for_acks(PATIENCE) else {"!": f"{say} has not arrived"}

    def look(self, look: str) -> dict[str, Any]:
        endpoints = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)

        def found() -> Any:
            return [one for one in endpoints.read(100) if getattr(one, "topic_name", "") == f"rt{look}"]

        if not until(found):
            return {"!": f"nobody publishes {look}"}
        endpoint = found()[0]
        qos = endpoint.qos
        return {
            "found": {
                "type": endpoint.type_name,
                "user": qos[Policy.Userdata].data.decode(),
                "reliable": isinstance(qos[Policy.Reliability], Policy.Reliability.Reliable),
                "latched": qos[Policy.Durability] == Policy.Durability.TransientLocal,
            }
        }


def until(condition: Any, patience_s: float = 15.0) -> bool:
    """What discovery tells has no event in this library: look often."""
    end_s = time.monotonic() + patience_s
    while not condition():
        if time.monotonic() > end_s:
            return False
        time.sleep(0.01)
    return True


def main() -> None:
    peer = Peer(int(sys.argv[1]), sys.argv[2])
    for line in sys.stdin:
        request = json.loads(line)
        print(json.dumps(getattr(peer, next(iter(request)))(**request)), flush=True)


main()
