"""The connections to Modbus units that signals of programs live on.

One connection for each unit, opened by the first request and, once it is lost, by the first
request after a pause that grows from one failure to the next. A request that no answer came
to in time has failed; several of them in a row end the connection.
"""

import asyncio
import errno
import logging
import os
from collections import deque
from dataclasses import dataclass
from typing import Final

from emulator.servers.script_sockets import OwnPorts
from emulator.services.modbus import DISCONNECTED, ModbusExchange, ModbusUnit
from urproto.compat_asyncio import timeout
from urproto.errors import LocalProtocolError, RemoteProtocolError
from urproto.modbus import (
    Frame,
    FrameDecoder,
    ModbusException,
    ModbusRequest,
    decode_response,
    encode_frame,
    encode_request,
)

_CONNECT_S: Final = 2.0  # guess, as a script socket's
_ANSWER_S: Final = 1.0  # guess
_PAUSES_S: Final = (0.1, 0.2, 0.5, 1.0, 2.0)  # before another attempt to connect (guess)
_MOST_TIMEOUTS: Final = 3  # in a row, then the connection is taken for dead (guess)
_MOST_UNITS: Final = 512  # guess; signals are fewer, only custom commands can name more
_MOST_WAITING: Final = 256  # requests to one unit that are not sent yet (guess)

_logger = logging.getLogger(__name__)


class ModbusClient:
    """Carries requests to units in the running event loop. ``port``: where units listen, as URScript names none.

    own_ports: where the controller itself is reached, which is a unit too.
    """

    def __init__(self, port: int = 502, own_ports: OwnPorts | None = None) -> None:
        self._port = port
        self._own_ports = own_ports or OwnPorts()
        self._links: dict[ModbusUnit, _Link] = {}
        self._ending: list[_Link] = []

    def ask(self, unit: ModbusUnit, request: ModbusRequest, *, sequential: bool) -> ModbusExchange:
        """Send a request to a unit and take its answer."""
        exchange = ModbusExchange()
        try:
            pdu = encode_request(request)
        except LocalProtocolError as error:
            _logger.warning("%s", error)
            exchange.complete(connection_error=errno.EMSGSIZE)
            return exchange
        self._put(unit, _Item(pdu, sequential, request, exchange))
        return exchange

    def send(self, unit: ModbusUnit, pdu: bytes) -> None:
        """Send function code and data; the answer is ignored."""
        self._put(unit, _Item(pdu, False))

    def reset(self, address: str) -> None:
        """Close the connections to an address."""
        for unit in [unit for unit in self._links if unit.address == address]:
            self.release(unit)

    def release(self, unit: ModbusUnit) -> None:
        """Close the connection to a unit."""
        link = self._links.pop(unit, None)
        if link is not None:
            link.close()
            self._ending = [*(other for other in self._ending if not other.gone), link]

    async def close(self) -> None:
        """Close every connection and wait until they are gone."""
        for unit in tuple(self._links):
            self.release(unit)
        for link in self._ending:
            await link.closed()

    def _put(self, unit: ModbusUnit, item: "_Item") -> None:
        link = self._links.get(unit)
        if link is None:
            if len(self._links) >= _MOST_UNITS:
                item.fail(errno.EMFILE)
                return
            link = self._links[unit] = _Link(unit, *self._own_ports.reach(unit.address, self._port))
        link.put(item)


@dataclass(slots=True, eq=False)
class _Item:
    """A request on its way. Without an exchange nobody wants its answer."""

    pdu: bytes
    sequential: bool
    request: ModbusRequest | None = None
    exchange: ModbusExchange | None = None
    timeout: asyncio.TimerHandle | None = None

    def fail(self, connection_error: int) -> None:
        if self.timeout is not None:
            self.timeout.cancel()
        if self.exchange is not None:
            self.exchange.complete(connection_error=connection_error)

    def answered(self, pdu: bytes) -> None:
        """Raises RemoteProtocolError when this is not an answer to the request."""
        if self.request is None or self.exchange is None:
            return
        try:
            self.exchange.complete(decode_response(self.request, pdu))
        except ModbusException as error:
            self.exchange.complete(device_error=error.code)


class _Link(asyncio.Protocol):
    """The connection to one unit, there or not."""

    def __init__(self, unit: ModbusUnit, address: str, port: int) -> None:
        self._unit = unit
        self._address = address
        self._port = port
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[_Item] = deque()
        self._sent: dict[int, _Item] = {}
        self._transport: asyncio.Transport | None = None
        self._connecting: asyncio.Task[None] | None = None
        self._lost = asyncio.Event()  # set while there is no connection
        self._lost.set()
        self._decoder = FrameDecoder()
        self._transaction = 0
        self._timeouts = 0
        self._failures = 0
        self._not_before = 0.0
        self._error = DISCONNECTED
        self._closed = False

    @property
    def gone(self) -> bool:
        """True when no connection is there or coming."""
        return self._connecting is None and self._transport is None

    def put(self, item: _Item) -> None:
        """Send a request when it is its turn; connect first if need be."""
        if len(self._waiting) >= _MOST_WAITING:
            item.fail(errno.EAGAIN)
            return
        if self._transport is None and self._connecting is None:
            if self._loop.time() < self._not_before:
                item.fail(self._error)
                return
            self._connecting = self._loop.create_task(self._connect())
        self._waiting.append(item)
        self._send()

    def close(self) -> None:
        """End the connection; whatever waits has failed."""
        self._closed = True
        if self._connecting is not None:
            self._connecting.cancel()
        if self._transport is not None:
            self._transport.abort()
        self._fail_all(DISCONNECTED)

    async def closed(self) -> None:
        """Wait until the connection is gone."""
        if self._connecting is not None:
            await asyncio.gather(self._connecting, return_exceptions=True)
        await self._lost.wait()

    async def _connect(self) -> None:
        error = 0
        try:
            async with timeout(_CONNECT_S):
                await self._loop.create_connection(lambda: self, self._address, self._port)
        except TimeoutError:
            error = errno.ETIMEDOUT
        except OSError as failure:  # the resolver's numbers are its own, and negative
            error = failure.errno if failure.errno is not None and failure.errno > 0 else errno.EHOSTUNREACH
        except (OverflowError, ValueError):  # no port, or no name of a host
            error = errno.EINVAL
        finally:
            self._connecting = None
        if error:
            self._failed(error, f"cannot connect to it: {os.strerror(error)}")

    def _failed(self, error: int, why: str) -> None:
        """No connection: everything that waits has failed, and so has what is asked before the pause is over."""
        level = logging.DEBUG if self._failures else logging.INFO  # say it once
        _logger.log(level, "Modbus unit %d at %s port %d: %s", self._unit.slave, self._unit.address, self._port, why)
        pause = _PAUSES_S[min(self._failures, len(_PAUSES_S) - 1)]
        self._failures += 1
        self._error = error
        self._not_before = self._loop.time() + pause
        self._fail_all(error)

    def _fail_all(self, error: int) -> None:
        items = [*self._sent.values(), *self._waiting]
        self._sent.clear()
        self._waiting.clear()
        for item in items:
            item.fail(error)

    def _send(self) -> None:
        """Send what may be sent: a sequential request and its answer have the connection for themselves."""
        while self._waiting and self._transport is not None:
            alone = self._waiting[0].sequential or any(item.sequential for item in self._sent.values())
            if alone and self._sent:
                return
            item = self._waiting.popleft()
            self._transaction = self._transaction % 0xFFFF + 1
            item.timeout = self._loop.call_later(_ANSWER_S, self._timed_out, self._transaction)
            self._sent[self._transaction] = item
            self._transport.write(encode_frame(Frame(self._transaction, self._unit.slave, item.pdu)))

    def _timed_out(self, transaction: int) -> None:
        self._sent.pop(transaction).fail(errno.ETIMEDOUT)
        self._timeouts += 1
        if self._timeouts >= _MOST_TIMEOUTS and self._transport is not None:
            self._transport.abort()
        else:
            self._send()

    def _take(self, frame: Frame) -> None:
        item = self._sent.pop(frame.transaction, None)
        if item is None:  # too late
            return
        self._timeouts = 0
        self._failures = 0
        try:
            item.answered(frame.pdu)
        except RemoteProtocolError:
            item.fail(errno.EPROTO)
            raise
        finally:
            if item.timeout is not None:
                item.timeout.cancel()

    # asyncio's side

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._lost.clear()
        self._decoder = FrameDecoder()
        self._timeouts = 0
        if self._closed:
            transport.abort()
        else:
            self._send()

    def data_received(self, data: bytes) -> None:
        try:
            for frame in self._decoder.feed(data):
                self._take(frame)
            if self._decoder.error is not None:
                raise self._decoder.error
        except RemoteProtocolError as error:
            _logger.info("Modbus unit %d at %s sends invalid data: %s", self._unit.slave, self._unit.address, error)
            assert self._transport is not None
            self._transport.abort()
        else:
            self._send()

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None
        self._lost.set()
        if not self._closed:
            self._failed(DISCONNECTED, "the connection was lost")
