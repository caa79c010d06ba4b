"""Is a controller really there? A true handshake on each port, as its clients do it.

    await check_ready("127.0.0.1", emulator.ports)

Works against any controller of known ports, emulated or not.
"""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Final

from urproto.dashboard import GREETING, LineDecoder
from urproto.errors import RemoteProtocolError
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
from urproto.primary.messages import VersionMessage
from urproto.primary.state import RobotStateData
from urproto.realtime import RealtimeDecoder
from urproto.robotiq import Get, encode_value
from urproto.rtde.codec import (
    GetVersion,
    ProtocolReply,
    Reply,
    RequestProtocol,
    RTDEDecoder,
    VersionReply,
    decode_reply,
)

__all__ = ["NotReady", "check_ready"]

_TIMEOUT_S: Final = 5.0  # guess; an idle machine needs 0.2 s
_READ_BYTES: Final = 4096
_PROTOCOL: Final = 2
_UNSPECIFIED: Final = {"0.0.0.0": "127.0.0.1", "::": "::1", "": "127.0.0.1"}  # listen anywhere, ask here


class NotReady(Exception):  # noqa: N818 - named for what is the case
    """A port does not answer as a controller does."""


class _Stream:
    """One connection to ask on."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader = reader
        self._writer = writer

    def send(self, data: bytes) -> None:
        self._writer.write(data)

    async def read(self) -> bytes:
        data = await self._reader.read(_READ_BYTES)
        if not data:
            raise NotReady("the connection was closed")
        return data


async def _dashboard(stream: _Stream) -> None:
    decoder = LineDecoder()
    while not (lines := decoder.feed(await stream.read())):
        pass
    if lines[0] != GREETING:
        raise NotReady(f"the greeting is {lines[0]!r}")
    stream.send(b"robotmode\n")
    while not (lines := decoder.feed(await stream.read())):
        pass
    if not lines[0].startswith("Robotmode: "):
        raise NotReady(f"the answer to robotmode is {lines[0]!r}")


async def _primary(stream: _Stream) -> None:
    """The version message first, then a robot state with kinematics and configuration."""
    decoder = PrimaryDecoder()
    messages = decoder.feed(await stream.read())
    while len(messages) < 2:
        messages += decoder.feed(await stream.read())
    if not isinstance(messages[0], VersionMessage):
        raise NotReady(f"the first message is no version message but {type(messages[0]).__name__}")
    state = next((message for message in messages if isinstance(message, RobotStateData)), None)
    if state is None or state.configuration is None:
        raise NotReady("there is no full robot state after the version message")


async def _realtime(stream: _Stream) -> None:
    decoder = RealtimeDecoder()
    while not decoder.feed(await stream.read()):
        pass


async def _rtde(stream: _Stream) -> None:
    decoder = RTDEDecoder()
    stream.send(RequestProtocol(_PROTOCOL).encode(1))
    if await _rtde_reply(stream, decoder) != ProtocolReply(accepted=True):
        raise NotReady(f"protocol {_PROTOCOL} is refused")
    stream.send(GetVersion().encode(_PROTOCOL))
    if not isinstance(await _rtde_reply(stream, decoder), VersionReply):
        raise NotReady("the version is not told")


async def _interpreter(stream: _Stream) -> None:
    """A state without a program is no state: both answers are good."""
    decoder = StatementDecoder()
    stream.send(b"statelastexecuted\n")
    while not (lines := decoder.feed(await stream.read())):
        pass
    if isinstance(lines[0], TooLong) or parse_answer(lines[0]).line != "statelastexecuted":
        raise NotReady(f"the answer to statelastexecuted is {lines[0]!r}")


async def _rtde_reply(stream: _Stream, decoder: RTDEDecoder) -> Reply:
    while not (packages := decoder.feed(await stream.read())):
        pass
    return decode_reply(packages[0], _PROTOCOL)


async def _modbus(stream: _Stream) -> None:
    """The major version of the software, register 256."""
    decoder = FrameDecoder()
    request = ModbusRequest(Function.READ_HOLDING_REGISTERS, 256)
    stream.send(encode_frame(Frame(1, 255, encode_request(request))))
    while not (frames := decoder.feed(await stream.read())):
        pass
    try:
        decode_response(request, frames[0].pdu)
    except ModbusException as error:
        raise NotReady(f"register 256 cannot be read: {error}") from error


async def _tool_line(stream: _Stream) -> None:
    """That it takes the connection is all one can ask of a line without a protocol."""


async def _gripper(stream: _Stream) -> None:
    """Driver state: there with and without power."""
    request = Get("DST")
    stream.send(f"GET {request.name}\n".encode())
    answer = await stream.read()
    if not answer.startswith(encode_value(request, "").rstrip(b"\n")):
        raise NotReady(f"the answer to GET {request.name} is {answer!r}")


async def _control(stream: _Stream) -> None:
    """Its start page needs no token."""
    stream.send(b"GET /health HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
    answer = await stream.read()
    if not answer.startswith(b"HTTP/1.1 200 "):
        raise NotReady(f"the answer to GET /health is {answer[:40]!r}")


_HANDSHAKES: Final[Mapping[str, Callable[[_Stream], Awaitable[None]]]] = {
    "dashboard": _dashboard,
    "primary": _primary,
    "secondary": _primary,
    "realtime": _realtime,
    "rtde": _rtde,
    "modbus": _modbus,
    "interpreter": _interpreter,
    "tool line": _tool_line,
    "gripper": _gripper,
    "control": _control,
}


async def check_ready(
    host: str, ports: Mapping[str, int], timeout_s: float = _TIMEOUT_S, elsewhere: Mapping[str, str] | None = None
) -> None:
    """Shake hands on every port at once; the read-only ones as those they mirror.

    elsewhere: addresses of servers that do not listen on host. Raises NotReady naming the port
    and what is wrong with it.
    """
    hosts = {name: (elsewhere or {}).get(name, host) for name in ports}
    checks = (_check(name, _UNSPECIFIED.get(hosts[name], hosts[name]), port, timeout_s) for name, port in ports.items())
    for problem in await asyncio.gather(*checks, return_exceptions=True):
        if problem is not None:
            raise problem


async def _check(name: str, host: str, port: int, timeout_s: float) -> None:
    handshake = _HANDSHAKES[name.removesuffix(" read-only")]
    try:
        async with asyncio.timeout(timeout_s):
            reader, writer = await asyncio.open_connection(host, port)
            try:
                await handshake(_Stream(reader, writer))
            finally:
                writer.close()
    except TimeoutError as error:
        raise NotReady(f"{name} port {port} on {host} does not answer within {timeout_s:g} s") from error
    except (OSError, RemoteProtocolError, NotReady) as error:
        raise NotReady(f"{name} port {port} on {host}: {error}") from error
