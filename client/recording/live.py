"""Live states for PlotJuggler and Foxglove."""

import json
import math
import socket
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from client.cameras import Shot
from client.errors import RecordingError, extra
from client.recording.cdr import Message, MessageType
from client.recording.definitions import message
from client.recording.pictures import Pictures
from client.recording.topics import Topics, markers_message

if TYPE_CHECKING:
    from foxglove import Channel


PLOTJUGGLER_PORT: Final = 9870  # default of its UDP server
PLOTJUGGLER_WEBSOCKET_PORT: Final = 9871  # default of its WebSocket server
FOXGLOVE_PORT: Final = 8765  # Foxglove's default
_TIMEOUT_S: Final = 5.0  # guess: a program on the same network answers within this
_MAX_DATAGRAM: Final = 1400  # bytes: below Ethernet's MTU; PlotJuggler truncates at 2048
_DESCRIPTION_NS: Final = 1_000_000_000  # interval at which the URDF is repeated, for late subscribers


def address_of(text: str, scheme: str, default_port: int) -> tuple[str, int]:
    """Host and port of ``udp://127.0.0.1:9870``, ``127.0.0.1:9870`` or ``127.0.0.1``. Raises RecordingError."""
    try:
        parts = urlsplit(text if "://" in text else f"{scheme}://{text}")
        host, port = parts.hostname, default_port if parts.port is None else parts.port
    except ValueError as error:
        raise RecordingError(f"{text!r} is not an address: {error}") from error
    if parts.scheme != scheme or not host:
        raise RecordingError(f"{text!r} is not an address like {scheme}://127.0.0.1:{default_port}")
    return host, port


def plotjuggler(address: str) -> "PlotJugglerSender | PlotJugglerSocket":
    """The sender for ``udp://HOST:PORT`` or ``ws://HOST:PORT``; PlotJuggler listens on both. Raises RecordingError."""
    if address.startswith("ws:"):
        return PlotJugglerSocket(*address_of(address, "ws", PLOTJUGGLER_WEBSOCKET_PORT))
    return PlotJugglerSender(*address_of(address, "udp", PLOTJUGGLER_PORT))


class PlotJugglerSender:
    """Sends each state to PlotJuggler's UDP server. Settings there: protocol JSON, time field ``timestamp``."""

    def __init__(self, host: str, port: int = PLOTJUGGLER_PORT) -> None:
        try:
            family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        except OSError as error:
            raise RecordingError(f"{host} is not a host: {error.strerror}") from error
        self._address = address
        self._socket = socket.socket(family, kind)

    def write(self, values: Mapping[str, Any], time_ns: int) -> None:
        """Send a state. Raises RecordingError if the network refuses it."""
        for data in datagrams(values, time_ns):
            try:
                self._socket.sendto(data, self._address)
            except OSError as error:
                raise RecordingError(f"cannot send to {self._address[0]}: {error.strerror}") from error

    def close(self) -> None:
        """Stop sending."""
        self._socket.close()


class PlotJugglerSocket:
    """Sends each state to PlotJuggler's WebSocket server. Settings there: protocol JSON, time field ``timestamp``.

    A state is one message of any size. Raises RecordingError if no server answers.
    """

    def __init__(self, host: str, port: int = PLOTJUGGLER_WEBSOCKET_PORT) -> None:
        with extra("live", "streaming to a WebSocket"):
            from websockets import exceptions
            from websockets.sync import client
        name = f"[{host}]" if ":" in host else host
        self._address = f"ws://{name}:{port}"
        self._failures = (OSError, exceptions.WebSocketException)
        self._opened = ExitStack()  # closes the connection, which is a context manager
        # no proxy from the environment: PlotJuggler runs nearby
        options: dict[str, Any] = {"proxy": None, "open_timeout": _TIMEOUT_S, "close_timeout": _TIMEOUT_S}
        try:
            self._socket = self._opened.enter_context(client.connect(self._address, **options))
        except self._failures as error:
            raise RecordingError(
                f"no WebSocket server on {self._address} ({error}): first start PlotJuggler's, with protocol json"
            ) from error

    def write(self, values: Mapping[str, Any], time_ns: int) -> None:
        """Send a state. Raises RecordingError if PlotJuggler has closed the connection."""
        try:
            self._socket.send(f"{{{','.join(_json_members(values, time_ns))}}}")
        except self._failures as error:
            raise RecordingError(f"{self._address} no longer accepts states: {error}") from error

    def close(self) -> None:
        """Stop sending."""
        self._opened.close()


def datagrams(values: Mapping[str, Any], time_ns: int) -> Iterator[bytes]:
    """A state as JSON objects that each fit into a datagram and have its ``timestamp`` [s since 1970].

    The robot's own clock is called ``robot_time``. Variables that are not finite are left out: JSON cannot express
    them, and PlotJuggler stops its server when it receives invalid JSON.
    """
    head, *parts = _json_members(values, time_ns)
    packed, size = [head], len(head) + 1
    for part in parts:
        if size + 1 + len(part) > _MAX_DATAGRAM and len(packed) > 1:
            yield f"{{{','.join(packed)}}}".encode()
            packed, size = [head], len(head) + 1
        packed.append(part)
        size += 1 + len(part)
    yield f"{{{','.join(packed)}}}".encode()


def _json_members(values: Mapping[str, Any], time_ns: int) -> Iterator[str]:
    """The members of a JSON object, starting with the time."""
    yield f'"timestamp":{time_ns * 1e-9:.6f}'
    for name, value in values.items():
        if _is_finite(value):
            yield f'"{"robot_time" if name == "timestamp" else name}":{json.dumps(value, separators=(",", ":"))}'


def _is_finite(value: Any) -> bool:
    return all(map(math.isfinite, value if isinstance(value, tuple | list) else (value,)))


class FoxgloveServer:
    """Serves states to Foxglove at ``ws://host:port``, on the same topics as in MCAP files.

    urdf: description of the arm for the 3D panel, published on /robot_description. Raises RecordingError if the
    address is in use.
    """

    def __init__(
        self, names: Collection[str], host: str = "127.0.0.1", port: int = FOXGLOVE_PORT, urdf: str | None = None
    ) -> None:
        with extra("live", "streaming to Foxglove"):
            import foxglove
        self._topics = Topics(names)
        self._pictures = Pictures()
        self._urdf = message("/robot_description", "std_msgs/msg/String", {"data": urdf}) if urdf else None
        self._described_ns = 0
        self._context = foxglove.Context()
        self._channels: dict[str, Channel] = {}
        try:
            self._server = foxglove.start_server(name="ur-client", host=host, port=port, context=self._context)
        except (OSError, RuntimeError) as error:
            raise RecordingError(f"cannot listen on {host}:{port}: {error}") from error
        for topic in self._topics.topics:  # before any message, so that clients see all topics when they connect
            self._channel(topic.name, topic.type)

    @property
    def port(self) -> int:
        """The port it listens on."""
        return self._server.port

    def write(self, values: Mapping[str, Any], time_ns: int) -> None:
        """Publish a state."""
        for one in self._topics.encoded(values, time_ns):
            self._log(one, time_ns)
        if self._urdf and not 0 <= time_ns - self._described_ns < _DESCRIPTION_NS:
            self._log(self._urdf, time_ns)
            self._described_ns = time_ns

    def write_markers(self, topic: str, markers: Sequence[Mapping[str, Any]], time_ns: int) -> None:
        """Publish a visualization_msgs/msg/MarkerArray; see `Recorder.write_markers`."""
        self._log(markers_message(topic, markers), time_ns)

    def write_shot(self, shot: Shot, time_ns: int) -> None:
        """Publish a camera image, its camera info and the camera's frames."""
        for one in self._pictures.encoded(shot, time_ns):
            self._log(one, time_ns)

    def close(self) -> None:
        """Disconnect all clients."""
        self._server.stop()

    def _log(self, one: Message, time_ns: int) -> None:
        self._channel(one.topic, one.type).log(one.data, log_time=time_ns)

    def _channel(self, name: str, kind: MessageType) -> "Channel":
        if name not in self._channels:
            import foxglove

            schema = foxglove.Schema(name=kind.name, encoding="ros2msg", data=kind.definition.encode())
            self._channels[name] = foxglove.Channel(name, schema=schema, message_encoding="cdr", context=self._context)
        return self._channels[name]
