"""A separate implementation of RTDE protocol version 2: records every published period, and writes inputs.

Written from the RTDE guide, without the project's own codec, so that the two can disagree.
"""

import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from pose_matrices import rotation_matrix

from urproto.compat import Self

RTDE_PORT = 30004
_FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}

Sample = Mapping[str, Any]


class RawRtde:
    """One connection to port 30004 that has negotiated protocol version 2."""

    def __init__(self, host: str) -> None:
        self._socket = socket.create_connection((host, RTDE_PORT), timeout=5)
        self._received = bytearray()
        try:
            assert self.request("V", struct.pack(">H", 2)) == b"\x01"
            self._set_up()
        except BaseException:
            self.close()
            raise

    def _set_up(self) -> None:
        """Requests of a subclass before it can be used."""

    def close(self) -> None:
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def request(self, kind: str, payload: bytes = b"") -> bytes:
        """Send one package and return the payload of its reply, passing over anything else."""
        self.send(kind, payload)
        while True:
            answer, body = self.package(timeout_s=5)
            if answer == kind:
                return body

    def send(self, kind: str, payload: bytes) -> None:
        self._socket.sendall(struct.pack(">HB", len(payload) + 3, ord(kind)) + payload)

    def package(self, timeout_s: float) -> tuple[str, bytes]:
        """The next package: its type letter and payload. Raises TimeoutError."""
        deadline = time.monotonic() + timeout_s
        while (package := self._complete()) is None:
            self._receive(max(deadline - time.monotonic(), 0))
        return package

    def _complete(self) -> tuple[str, bytes] | None:
        if len(self._received) < 3:
            return None
        size, kind = struct.unpack_from(">HB", self._received)
        if len(self._received) < size:
            return None
        body = bytes(self._received[3:size])
        del self._received[:size]
        return chr(kind), body

    def _receive(self, timeout_s: float) -> None:
        if not select.select([self._socket], [], [], timeout_s)[0]:
            raise TimeoutError(f"no RTDE package within {timeout_s:.1f} s")
        data = self._socket.recv(65536)
        if not data:
            raise ConnectionError("the emulator closed the RTDE connection")
        self._received += data


class StateStream(RawRtde):
    """Every published period of some output fields, oldest first; the kernel buffers what is not yet read."""

    def __init__(self, host: str, fields: list[str], frequency_hz: float = 125.0) -> None:
        self.samples: list[Sample] = []  # all data read so far
        self._names, self._frequency_hz = fields, frequency_hz
        super().__init__(host)

    def _set_up(self) -> None:
        reply = self.request("O", struct.pack(">d", self._frequency_hz) + ",".join(self._names).encode())
        self._fields = list(zip(self._names, reply[1:].decode().split(","), strict=True))
        self._format = ">B" + "".join(_FORMATS[kind] for _, kind in self._fields)
        assert self.request("S") == b"\x01"

    def next(self, timeout_s: float = 2.0) -> Sample:
        kind = ""
        while kind != "U":
            kind, body = self.package(timeout_s)
        self.samples.append(self._sample(body))
        return self.samples[-1]

    def _sample(self, body: bytes) -> Sample:
        values = iter(struct.unpack(self._format, body))
        next(values)  # the recipe's number
        return {name: _value(kind, values) for name, kind in self._fields}

    def newest(self) -> Sample:
        """Read all periods that have arrived, and wait for one more: the current state."""
        while select.select([self._socket], [], [], 0)[0]:
            self._receive(0)
        while (package := self._complete()) is not None:
            if package[0] == "U":
                self.samples.append(self._sample(package[1]))
        return self.next()

    def wait_until(self, condition: Callable[[Sample], bool], timeout_s: float = 10.0) -> Sample:
        """The first period from now on that fulfils the condition. Raises AssertionError after the time-out."""
        sample = self.newest()
        deadline = time.monotonic() + timeout_s
        while not condition(sample):
            assert time.monotonic() < deadline, f"not seen within {timeout_s} s; last: {sample}"
            sample = self.next()
        return sample

    def wait_for(self, seconds: float) -> Sample:
        """Let the controller's clock advance."""
        end = self.newest()["timestamp"] + seconds
        return self.wait_until(lambda sample: sample["timestamp"] >= end, timeout_s=seconds + 5.0)


def _value(kind: str, values: Iterator[Any]) -> Any:
    count = int(_FORMATS[kind][0]) if kind.startswith("VECTOR") else 1
    return next(values) if count == 1 else tuple(next(values) for _ in range(count))


class InputWriter(RawRtde):
    """Writes input fields, named once with their values' order fixed."""

    def __init__(self, host: str, *fields: str) -> None:
        self._names = fields
        super().__init__(host)

    def _set_up(self) -> None:
        reply = self.request("I", ",".join(self._names).encode())
        kinds = reply[1:].decode().split(",")
        assert reply[0] != 0, f"the recipe {self._names} was refused: {kinds}"
        self._header, self._format = reply[:1], ">" + "".join(_FORMATS[kind] for kind in kinds)
        assert self.request("S") in (b"\x00", b"\x01")  # inputs need no start

    def write(self, *values: float) -> None:
        self.send("U", self._header + struct.pack(self._format, *values))


class ForceSensor:
    """A force sensor in the flange: once a period, ``force_on(sample)`` (N, base frame; 3) goes to the controller.

    The controller requires at least 10 Hz, and takes the wrench in the axes of the flange.
    """

    def __init__(self, host: str, force_on: Callable[[Sample], Sequence[float]]) -> None:
        self.force_on = force_on
        self._writer = InputWriter(host, "external_force_torque")
        self._state = StateStream(host, ["timestamp", "actual_TCP_pose"])
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._feed, name="force sensor")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._state.close()
        self._writer.close()

    def _feed(self) -> None:
        while not self._ended.is_set():
            sample = self._state.newest()
            axes = rotation_matrix(sample["actual_TCP_pose"][3:])
            force = axes.T @ np.array(self.force_on(sample), dtype=float)
            self._writer.write(*force, 0.0, 0.0, 0.0)
