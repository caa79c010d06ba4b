"""Compare the messages of two recordings and their order, without the states."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import SequenceMatcher
from typing import Final

from client.decoding.codecs import CODECS, codec_of_port
from client.traffic.ports import port_name
from client.traffic.recording import Conversation, TrafficRecording

_STATES = re.compile(r"(state:|state of |data \d+: |data: |input \d+: )")  # compared as tracks, or not at all
_TIMES = re.compile(r"\btimestamp_us=\S+ ?")
_ANSWERING: Final = ("dashboard", "rtde", "interpreter", "modbus", "gripper")  # each answer belongs to its request
_MAX_COMPARED: Final = 4000  # messages of a connection: the comparison's time grows with their square
_MAX_CHARACTERS: Final = 400  # characters of a message


@dataclass(frozen=True, slots=True)
class MessageDifference:
    """A place where the messages differ. after: the last common message; index: number of messages before the place."""

    index: int
    after: str
    first: tuple[str, ...]
    second: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class MessageComparison:
    """The messages of one connection in both recordings.

    name: the connection. counts: number of messages in each. partings: places where they differ. cut: whether only the
    first ones were compared.
    """

    name: str
    counts: tuple[int, int]
    partings: tuple[MessageDifference, ...]
    cut: bool = False


def compare_messages(first: TrafficRecording, second: TrafficRecording) -> Iterator[MessageComparison]:
    """Compare the n-th connection to each port with the n-th in the other recording."""
    for port in sorted({*first.ports, *second.ports}):
        own, other = first.on_port(port), second.on_port(port)
        if len(own) != len(other):
            counts = (len(own), len(other))
            counts_text = [f"{count} connection{'s' * (count != 1)}" for count in counts]
            yield MessageComparison(
                port_name(port), counts, (MessageDifference(0, "", (counts_text[0],), (counts_text[1],)),)
            )
        for number, (one, another) in enumerate(zip(own, other, strict=False), 1):
            name = port_name(port) + (f", connection {number}" if max(len(own), len(other)) > 1 else "")
            yield from _compare(name, one, another)


def _compare(name: str, first: Conversation, second: Conversation) -> Iterator[MessageComparison]:
    codec = codec_of_port(first.port) or CODECS["bytes"]
    own, other = messages_of(first), messages_of(second)
    if codec.name in _ANSWERING:
        yield _compare_texts(name, _without_repetitions(own, 2), _without_repetitions(other, 2))
        return
    for mark, direction in (("<", "from the server"), (">", "from the client")):
        parts = [[text for text in texts if text[0] == mark] for texts in (own, other)]
        if any(parts):
            yield _compare_texts(f"{name}, {direction}", *(_without_repetitions(part, 1) for part in parts))


def _compare_texts(name: str, first: list[str], second: list[str]) -> MessageComparison:
    cut = max(len(first), len(second)) > _MAX_COMPARED
    own, other = first[:_MAX_COMPARED], second[:_MAX_COMPARED]
    return MessageComparison(name, (len(first), len(second)), tuple(_find_differences(own, other)), cut)


def _find_differences(first: list[str], second: list[str]) -> Iterator[MessageDifference]:
    for kind, begin, end, other_begin, other_end in SequenceMatcher(None, first, second, autojunk=False).get_opcodes():
        if kind != "equal":
            after = first[begin - 1] if begin else ""
            yield MessageDifference(begin, after, tuple(first[begin:end]), tuple(second[other_begin:other_end]))


def messages_of(conversation: Conversation) -> list[str]:
    """The messages as ``ur-client decode`` prints them, after ``>`` if from the client, ``<`` if from the server."""
    codec = codec_of_port(conversation.port) or CODECS["bytes"]
    channel = codec.open()
    streams = {from_server: channel.stream(codec.side(from_server), codec.usual) for from_server in (True, False)}
    found: list[str] = []
    for piece in conversation.pieces:
        stream = streams[piece.from_server]
        lines = stream.feed(piece.data) if piece.data else stream.end()
        mark = "< " if piece.from_server else "> "
        found += [mark + _TIMES.sub("", line.text)[:_MAX_CHARACTERS] for line in lines if not _STATES.match(line.text)]
    return found


def _without_repetitions(texts: list[str], length: int) -> list[str]:
    """Keep a repeated group of ``length`` messages only once: the number of repetitions depends on chance."""
    kept: list[str] = []
    for text in texts:
        kept.append(text)
        if kept[-length:] == kept[-2 * length : -length]:
            del kept[-length:]
    return kept
