"""Check that a controller works: a real handshake on each port, as clients do it.

    await check_ready("127.0.0.1", emulator.ports)

Works with any controller whose ports are known, emulated or real, and changes nothing there; only ``run_script``
makes the robot execute something.
"""

import asyncio
import os
from collections import deque
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Final, TypeVar

from urproto.addresses import local_address
from urproto.compat_asyncio import timeout
from urproto.dashboard import GREETING, LineDecoder
from urproto.errors import RemoteProtocolError
from urproto.facts import rows
from urproto.interpreter import StatementDecoder, TooLong, parse_answer
from urproto.modbus import (
    Frame,
    FrameDecoder,
    Function,
    ModbusException,
    ModbusRequest,
    decode_response,
    encode_frame,
    encode_request,
)
from urproto.primary.framing import PrimaryDecoder
from urproto.primary.messages import TextMessage, VersionMessage
from urproto.primary.state import RobotStateData
from urproto.realtime import RealtimeDecoder
from urproto.robotapi import URCAPS
from urproto.robotiq import Get, encode_value
from urproto.rtde import codec
from urproto.rtde.fields import IN_USE, OUTPUT_FIELDS

_TIMEOUT_S: Final = 15.0  # guess; 0.2 s on an idle machine, some seconds if eight robots start together
_READ_BYTES: Final = 4096
_PROTOCOL: Final = 2
_RTDE_VARIABLE: Final = OUTPUT_FIELDS["timestamp"]
_RTDE_RATE_HZ: Final = 10.0
_RTDE_INPUT: Final = "speed_slider_mask"  # every driver writes it
_SILENCE_S: Final = 0.5  # guess: longer than any network and any controller under load
_UNCONFIRMED: Final = rows("safety_setup.unconfirmed")[0].value.encode()

_T = TypeVar("_T")


class NotReady(Exception):  # noqa: N818 - named for what is the case
    """A port does not answer like a controller."""


@dataclass(frozen=True)
class Finding:
    """The result for one port. text: information from the port, or the problem; error: the exception, if it failed."""

    name: str
    host: str
    port: int
    text: str
    error: Exception | None = None


class _Stream:
    """A connection for requests and answers."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader = reader
        self._writer = writer

    def send(self, data: bytes) -> None:
        self._writer.write(data)

    async def receive(self, feed: Callable[[bytes], list[_T]]) -> list[_T]:
        """Read until a decoder has something."""
        while not (decoded := feed(await self.read())):
            pass
        return decoded

    async def read(self) -> bytes:
        data = await self._reader.read(_READ_BYTES)
        if not data:
            raise NotReady("the controller closed the connection")
        return data


_Handshake = Callable[[_Stream], Awaitable[str]]


async def _dashboard(stream: _Stream) -> str:
    decoder = LineDecoder()
    lines = await stream.receive(decoder.feed)
    if lines[0] != GREETING:
        raise NotReady(f"the greeting is {lines[0]!r}")
    stream.send(b"robotmode\n")
    lines = await stream.receive(decoder.feed)
    if not lines[0].startswith("Robotmode: "):
        raise NotReady(f"the answer to robotmode is {lines[0]!r}")
    return lines[0]


async def _primary(stream: _Stream) -> str:
    """The version message first, then a robot state with kinematics and configuration."""
    decoder = PrimaryDecoder()
    messages = decoder.feed(await stream.read())
    while not any(isinstance(message, RobotStateData) for message in messages):
        messages += decoder.feed(await stream.read())
    version = messages[0]
    if not isinstance(version, VersionMessage):
        raise NotReady(f"the first message is {type(version).__name__}, not a version message")
    state = next(message for message in messages if isinstance(message, RobotStateData))
    if state.configuration is None:
        raise NotReady("the version message is not followed by a full robot state")
    return f"{version.project} {version.major}.{version.minor}.{version.bugfix}"


async def _realtime(stream: _Stream) -> str:
    decoder = RealtimeDecoder()
    await stream.receive(decoder.feed)
    return "state packages"


class _RtdeExchange:
    """Requests and replies on one RTDE connection."""

    def __init__(self, stream: _Stream) -> None:
        self._stream = stream
        self._decoder = codec.RTDEDecoder()
        self._packages: deque[codec.Package] = deque()
        self.texts: list[bytes] = []
        self.receives_data = False

    async def request(self, request: codec.Request, protocol: int = _PROTOCOL) -> codec.Reply:
        self._stream.send(request.encode(protocol))
        return await self.next()

    async def reply_to(self, request: codec.Request) -> codec.Reply:
        """Like ``request``, on a connection that receives data."""
        reply = await self.request(request)
        while isinstance(reply, codec.OutputData):
            reply = await self.next()
        return reply

    async def next(self) -> codec.Reply:
        """The next package other than a text message, which is never an answer."""
        while not self._packages or self._packages[0].type == codec.PackageType.TEXT_MESSAGE:
            if self._packages:
                self.texts.append(self._packages.popleft().payload)
            else:
                self._packages += self._decoder.feed(await self._stream.read())
        return codec.decode_reply(self._packages.popleft(), _PROTOCOL)

    @property
    def unconfirmed(self) -> bool:
        """Whether the controller has said that it sends no data, because its safety setup is not confirmed."""
        return any(_UNCONFIRMED in text for text in self.texts)


async def _rtde(stream: _Stream) -> str:
    """Negotiate the protocol, query the version, and receive data for a recipe."""
    return await _receive(_RtdeExchange(stream))


async def _rtde_stream(stream: _Stream, seconds: float) -> str:
    """Receive data for a while, and see whether another client holds the inputs of drivers."""
    rtde = _RtdeExchange(stream)
    await _receive(rtde)
    loop = asyncio.get_running_loop()
    longest_s, last_s, end_s = 0.0, loop.time(), loop.time() + seconds
    while rtde.receives_data and last_s < end_s:
        await rtde.next()
        before_s, last_s = last_s, loop.time()
        longest_s = max(longest_s, last_s - before_s)
    if longest_s > _SILENCE_S:
        raise NotReady(f"it fell silent for {longest_s:.1f} s while {seconds:g} s of data were received")
    inputs = await rtde.reply_to(codec.SetupInputs((_RTDE_INPUT,)))
    held = isinstance(inputs, codec.SetupInputsReply) and IN_USE in inputs.types
    return "steady" + (f"; another client holds the inputs of drivers ({_RTDE_INPUT}): a second one is refused" * held)


async def _receive(rtde: _RtdeExchange) -> str:
    """Set up a connection until data arrive; returns version and state."""
    if await rtde.request(codec.RequestProtocol(_PROTOCOL), protocol=1) != codec.ProtocolReply(accepted=True):
        raise NotReady(f"protocol {_PROTOCOL} is refused")
    version = await rtde.request(codec.GetVersion())
    if not isinstance(version, codec.VersionReply):
        raise NotReady("the version was not reported")
    name = f"PolyScope {version.version}"
    if not _RTDE_VARIABLE.available.covers(version.version):
        return f"{name}, which has no variable {_RTDE_VARIABLE.name}"
    recipe = await rtde.request(codec.SetupOutputs((_RTDE_VARIABLE.name,), _RTDE_RATE_HZ))
    if not isinstance(recipe, codec.SetupOutputsReply) or not recipe.recipe_id:
        raise NotReady(f"a recipe of {_RTDE_VARIABLE.name} is refused: {recipe}")
    if await rtde.request(codec.Start()) != codec.StartReply(accepted=True):
        if rtde.unconfirmed:
            return f"{name}, sends no data until its safety setup is confirmed"
        raise NotReady("the recipe could not be started")
    if not isinstance(data := await rtde.next(), codec.OutputData):
        raise NotReady(f"expected data, received {type(data).__name__}")
    rtde.receives_data = True
    return f"{name}, sends data"


async def _interpreter(stream: _Stream) -> str:
    """Query the last executed statement; without a program the answer says so, which is just as good."""
    decoder = StatementDecoder()
    stream.send(b"statelastexecuted\n")
    lines = await stream.receive(decoder.feed)
    if isinstance(lines[0], TooLong) or parse_answer(lines[0]).line != "statelastexecuted":
        raise NotReady(f"the answer to statelastexecuted is {lines[0]!r}")
    return "answers"


async def _modbus(stream: _Stream) -> str:
    """Read register 256, the major version of the software."""
    decoder = FrameDecoder()
    request = ModbusRequest(Function.READ_HOLDING_REGISTERS, 256)
    stream.send(encode_frame(Frame(1, 255, encode_request(request))))
    frames = await stream.receive(decoder.feed)
    try:
        decode_response(request, frames[0].pdu)
    except ModbusException as error:
        raise NotReady(f"register 256 cannot be read: {error}") from error
    return "registers can be read"


async def _tool_line(stream: _Stream) -> str:
    """Connecting is all that can be checked: the line has no protocol."""
    return "accepts connections"


async def _gripper(stream: _Stream) -> str:
    """Read the driver state, which is available with and without power."""
    request = Get("DST")
    stream.send(f"GET {request.name}\n".encode())
    answer = await stream.read()
    if not answer.startswith(encode_value(request, "").rstrip(b"\n")):
        raise NotReady(f"the answer to GET {request.name} is {answer!r}")
    return "answers"


def _get(path: str, text: str = "answers") -> _Handshake:
    """Query what a web server has under this path."""

    async def query(stream: _Stream) -> str:
        stream.send(f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
        answer = await stream.read()
        if not answer.startswith(b"HTTP/1.1 200 "):
            raise NotReady(f"the answer to GET {path} is {answer[:40]!r}")
        return text

    return query


_HANDSHAKES: Final[Mapping[str, _Handshake]] = {
    "dashboard": _dashboard,
    "primary": _primary,
    "secondary": _primary,
    "realtime": _realtime,
    "rtde": _rtde,
    "modbus": _modbus,
    "interpreter": _interpreter,
    "tool line": _tool_line,
    "gripper": _gripper,
    "control": _get("/health", "this is an emulator"),  # needs no token
    "cameras": _get("/cameras"),  # the list: nothing is rendered
    "robot api": _get(URCAPS),  # software before 10.11 offers nothing else
}


async def check_ready(
    host: str, ports: Mapping[str, int], timeout_s: float = _TIMEOUT_S, elsewhere: Mapping[str, str] | None = None
) -> None:
    """Do the handshake on every port at the same time; on a read-only port, that of the port it mirrors.

    elsewhere: addresses of servers that do not listen on host. Raises NotReady, which names the port and the problem.
    """
    hosts = {name: (elsewhere or {}).get(name, host) for name in ports}
    checks = (probe(name, local_address(hosts[name]), ports[name], timeout_s) for name in ports)
    for finding in await asyncio.gather(*checks):
        if finding.error is not None:
            raise NotReady(f"{finding.name} port {finding.port} on {finding.host}: {finding.text}") from finding.error


async def probe(name: str, host: str, port: int, timeout_s: float = _TIMEOUT_S) -> Finding:
    """Do the handshake on the port of one server."""
    return await _probe(name, host, port, timeout_s, _HANDSHAKES[name.removesuffix(" read-only")])


async def watch_rtde(host: str, port: int, seconds: float, timeout_s: float = _TIMEOUT_S) -> Finding:
    """Receive RTDE data for some seconds: is the stream steady, and do other clients hold inputs of drivers?"""
    return await _probe("rtde stream", host, port, seconds + timeout_s, lambda stream: _rtde_stream(stream, seconds))


async def run_script(host: str, primary_port: int, timeout_s: float = _TIMEOUT_S) -> Finding:
    """Run a secondary program on the robot, which only writes to the log, and wait for its line."""
    return await _probe("script", host, primary_port, timeout_s, _script)


async def _script(stream: _Stream) -> str:
    decoder = PrimaryDecoder()
    decoder.feed(await stream.read())
    word = f"ur-emulator-check {os.getpid()}"
    stream.send(f'sec ur_emulator_check():\n  textmsg("{word}")\nend\n'.encode())
    while True:
        for message in decoder.feed(await stream.read()):
            if isinstance(message, TextMessage) and word in message.text:
                return "runs"


async def _probe(name: str, host: str, port: int, timeout_s: float, handshake: _Handshake) -> Finding:
    try:
        async with timeout(timeout_s):
            reader, writer = await asyncio.open_connection(host, port)
            try:
                return Finding(name, host, port, await handshake(_Stream(reader, writer)))
            finally:
                writer.close()
    except TimeoutError as error:
        return Finding(name, host, port, f"no answer within {timeout_s:g} s", error)
    except (OSError, RemoteProtocolError, NotReady) as error:
        return Finding(name, host, port, str(error), error)
