"""Recordings of states, and captures of traffic."""

from collections.abc import Callable, Iterator
from contextlib import suppress

import numpy as np

from client.cameras import Shot
from client.decoding.capture import head_of_capture, packet_block
from client.decoding.codecs import ConnectionFrames
from client.decoding.packets import SocketAddress
from client.decoding.session import Choice, DecodingSession
from client.errors import ClientError
from client.recording import Recorder
from client.recording.files import read as read_recording
from client.recording.pictures import read_pictures
from client.traffic.recording import TrafficRecording
from targets.registry import file, folder, target
from urproto.cameras import CameraDescription
from urproto.rtde import codec as rtde_codec


def _recordings(suffix: str) -> Callable[[], Iterator[bytes]]:
    def seeds() -> Iterator[bytes]:
        path = folder() / f"seed{suffix}"
        names = ("timestamp", "actual_q", "robot_mode")
        with Recorder(path, names, now_ns=lambda: 1_700_000_000_000_000_000) as recorder:
            for step in range(3):
                recorder.write({"timestamp": step * 0.002, "actual_q": (0.1,) * 6, "robot_mode": 7})
        yield path.read_bytes()

    return seeds


def _recording(suffix: str, data: bytes) -> None:
    with suppress(ClientError), np.errstate(all="raise"):
        found = read_recording(file(f"any{suffix}", data))
        list(found.states())


@target(_recordings(".mcap"))
def mcap(data: bytes) -> None:
    _recording(".mcap", data)


def _filmed() -> Iterator[bytes]:
    path = folder() / "filmed.mcap"
    camera = CameraDescription("over all", 8, 6, (10.0, 0.0, 4.0, 0.0, 10.0, 3.0, 0.0, 0.0, 1.0), "base", (0.0,) * 6)
    with Recorder(path, ("timestamp",), now_ns=lambda: 1_700_000_000_000_000_000) as recorder:
        recorder.write({"timestamp": 1.0})
        recorder.write_shot(Shot(camera, "rgb.jpg", b"\xff\xd8 as it comes \xff\xd9", 1.0, (0.0,) * 6))
    yield path.read_bytes()


@target(_filmed)
def pictures(data: bytes) -> None:
    with suppress(ClientError):
        read_pictures(file("any.mcap", data))


@target(_recordings(".csv"), b"timestamp,robot_mode\n0,1e400\n", b'"timestamp\n')
def csv(data: bytes) -> None:
    _recording(".csv", data)


@target(_recordings(".npz"))
def npz(data: bytes) -> None:
    _recording(".npz", data)


def _captures() -> Iterator[bytes]:
    ends = SocketAddress("10.0.0.2", 45678), SocketAddress("10.0.0.1", 30004)
    frames = ConnectionFrames(*ends, 1)
    start = rtde_codec.RequestProtocol(2).encode(1)
    parts = [*frames.open(), *frames.data(True, start), *frames.data(False, rtde_codec.ProtocolReply(True).encode(1))]
    yield head_of_capture("fuzz", "lo", ["a comment"]) + b"".join(packet_block(10**18, part) for part in parts)
    for port in (29999, 30001, 30003, 502, 50001, 63352):
        frames = ConnectionFrames(ends[0], SocketAddress("10.0.0.1", port), 1)
        parts = [*frames.open(), *frames.data(True, b"load a\n"), *frames.data(False, b"\0\0\0\5\x14")]
        yield head_of_capture("fuzz", "lo") + b"".join(packet_block(10**18, part) for part in parts)


@target(_captures, b"00 05 56 00 02\n", b"\0\5\x56\0\2")
def captures(data: bytes) -> None:
    session = DecodingSession(Choice())
    for _ in session.feed(data):
        pass
    for _ in session.end():
        pass
    with suppress(ClientError):
        TrafficRecording.read(file("any.pcapng", data))
