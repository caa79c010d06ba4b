"""Compare two recordings, for example of a robot and an emulator: whether they agree, and where they diverge."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from difflib import SequenceMatcher
from pathlib import Path
from typing import Final

from client.decoding.codecs import CODECS, codec_of_port
from client.errors import FileError
from client.traffic.alignment import Offset, find_offset
from client.traffic.ports import port_name
from client.traffic.recording import Conversation, TrafficRecording
from client.traffic.tracks import Track, tracks_of, tracks_of_csv
from client.traffic.trajectories import ComparisonTolerances, Difference, TrackPair, compare_tracks

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


@dataclass(frozen=True, slots=True)
class Source:
    """One side of a comparison: states, and their recording, or None for a table of states."""

    path: Path
    tracks: tuple[Track, ...]
    recording: TrafficRecording | None = None

    @property
    def remarks(self) -> list[str]:
        """Comments in the file."""
        return self.recording.comments if self.recording else []

    @property
    def problems(self) -> list[str]:
        """Problems found while reading."""
        return self.recording.problems if self.recording else []


@dataclass(frozen=True, slots=True)
class Comparison:
    """Result of a comparison.

    pairs: corresponding tracks of states. unpaired: tracks without a counterpart, as (A or B, label). messages:
    comparisons of messages, by connection.
    """

    first: Source
    second: Source
    pairs: tuple[TrackPair, ...]
    unpaired: tuple[tuple[str, str], ...]
    messages: tuple[MessageComparison, ...]

    @property
    def differences(self) -> list[tuple[TrackPair, Difference]]:
        """Differences of all pairs, in the order of their start in the first recording."""
        found = [(pair, difference) for pair in self.pairs for difference in pair.differences]
        return sorted(found, key=lambda one: one[0].first.times_s[0] + one[1].begins.time_s)

    @property
    def same(self) -> bool:
        """Whether there is no difference at all; also False if there was nothing to compare."""
        compared = any(pair.states for pair in self.pairs) or any(min(item.counts) for item in self.messages)
        missed = any(not pair.states for pair in self.pairs)
        different = self.differences or self.unpaired or any(item.partings for item in self.messages)
        return compared and not missed and not different


def read_source(path: Path, port_offset: int = 0) -> Source:
    """Read a recording, or a table of states if the name ends in .csv. Raises FileError."""
    if path.suffix.lower() == ".csv":
        return Source(path, tuple(tracks_of_csv(path)))
    recording = TrafficRecording.read(path, port_offset)
    return Source(path, tuple(tracks_of(recording)), recording)


def compare(
    first: TrafficRecording, second: TrafficRecording, tolerances: Iterable[str] = (), offset_s: float | None = None
) -> Comparison:
    """Compare two recordings. tolerances: such as ``rad=0.01`` or ``actual_q=0.01``. offset_s: between the clocks."""
    sources = [Source(one.path, tuple(tracks_of(one)), one) for one in (first, second)]
    return compare_sources(sources[0], sources[1], tolerances, offset_s)


def compare_sources(
    first: Source, second: Source, tolerances: Iterable[str] = (), offset_s: float | None = None
) -> Comparison:
    """Like ``compare``, also for tables. Raises FileError if one is a table and the other has no states."""
    allowed = ComparisonTolerances(tolerances)
    partners, unpaired = _pair_tracks(first.tracks, second.tracks)
    common = Offset(offset_s, ()) if offset_s is not None else _common_offset(partners)
    pairs = tuple(compare_tracks(a, b, _offset(a, b, common), allowed) for a, b in partners)
    messages: tuple[MessageComparison, ...] = ()
    if first.recording is not None and second.recording is not None:
        messages = tuple(compare_messages(first.recording, second.recording))
    elif not pairs:
        raise FileError(second.path, f"has nothing in common with {first.path}: both need states")
    return Comparison(first, second, pairs, unpaired, messages)


def _pair_tracks(
    first: tuple[Track, ...], second: tuple[Track, ...]
) -> tuple[list[tuple[Track, Track]], tuple[tuple[str, str], ...]]:
    """Pair the tracks of the same interface with most columns in common; also return the rest, as (A or B, label)."""
    left = list(second)
    partners: list[tuple[Track, Track]] = []
    alone: list[tuple[str, str]] = []
    for track in first:
        fitting = [one for one in left if one.source == track.source and one.columns.keys() & track.columns.keys()]
        if not fitting:
            alone.append(("A", track.label))
            continue
        best = max(fitting, key=lambda one: len(one.columns.keys() & track.columns.keys()))
        left = [one for one in left if one is not best]
        partners.append((track, best))
    return partners, (*alone, *(("B", track.label) for track in left))


def _common_offset(partners: list[tuple[Track, Track]]) -> Offset | None:
    """Offset between the controllers' clocks, from the pair with most states, preferably one with motion."""
    found = [(find_offset(a, b), min(len(a.times_s), len(b.times_s)))
             for a, b in partners if a.robot_time and b.robot_time]  # fmt: skip
    return max(found, key=lambda one: (bool(one[0].by), one[1]))[0] if found else None


def _offset(first: Track, second: Track, common: Offset | None) -> Offset:
    if common is not None and first.robot_time and second.robot_time:
        return common
    return find_offset(first, second)


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
