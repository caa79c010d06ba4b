"""The connections to Modbus units that serve the Modbus signals of programs.

Each unit has one connection. The first request opens it. After it was lost, the first request after a pause opens it
again; the pause grows with each failure. A request that is not answered in time has failed, and several consecutive
time-outs close the connection.
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

_CONNECT_S: Final = 2.0  # guess, the same as for a script socket
_ANSWER_S: Final = 1.0  # guess
_PAUSES_S: Final = (0.1, 0.2, 0.5, 1.0, 2.0)  # before the next attempt to connect (guess)
_MAX_TIMEOUTS: Final = 3  # consecutive ones, after which the connection is considered dead (guess)
_MAX_UNITS: Final = 512  # guess; there are fewer signals, only custom commands can address more units
_MAX_WAITING: Final = 256  # requests to one unit that have not been sent yet (guess)

_logger = logging.getLogger(__name__)


class ModbusClient:
    """Sends requests to units in the running event loop. ``port``: TCP port of the units; URScript does not name one.

    own_ports: the ports of the controller itself, which is a unit as well.
    """

    def __init__(self, port: int = 502, own_ports: OwnPorts | None = None) -> None:
        self._port = port
        self._own_ports = own_ports or OwnPorts()
        self._connections: dict[ModbusUnit, _UnitConnection] = {}
        self._closing: list[_UnitConnection] = []

    def request(self, unit: ModbusUnit, request: ModbusRequest, *, sequential: bool) -> ModbusExchange:
        """Send a request to a unit; the exchange that is returned gets the answer."""
        exchange = ModbusExchange()
        try:
            pdu = encode_request(request)
        except LocalProtocolError as error:
            _logger.warning("%s", error)
            exchange.complete(connection_error=errno.EMSGSIZE)
            return exchange
        self._put(unit, _PendingRequest(pdu, sequential, request, exchange))
        return exchange

    def send(self, unit: ModbusUnit, pdu: bytes) -> None:
        self._put(unit, _PendingRequest(pdu, False))

    def reset(self, address: str) -> None:
        for unit in [unit for unit in self._connections if unit.address == address]:
            self.release(unit)

    def release(self, unit: ModbusUnit) -> None:
        connection = self._connections.pop(unit, None)
        if connection is not None:
            connection.close()
            self._closing = [*(other for other in self._closing if not other.disconnected), connection]

    async def close(self) -> None:
        """Close all connections and wait until they are closed."""
        for unit in tuple(self._connections):
            self.release(unit)
        for connection in self._closing:
            await connection.closed()

    def _put(self, unit: ModbusUnit, pending: "_PendingRequest") -> None:
        connection = self._connections.get(unit)
        if connection is None:
            if len(self._connections) >= _MAX_UNITS:
                pending.fail(errno.EMFILE)
                return
            connection = _UnitConnection(unit, *self._own_ports.reach(unit.address, self._port))
            self._connections[unit] = connection
        connection.put(pending)


@dataclass(slots=True, eq=False)
class _PendingRequest:
    """A request that is queued or sent but not answered. exchange: gets the answer; None to ignore it."""

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
        """Complete the exchange with the answer. Raises RemoteProtocolError if it does not fit the request."""
        if self.request is None or self.exchange is None:
            return
        try:
            self.exchange.complete(decode_response(self.request, pdu))
        except ModbusException as error:
            self.exchange.complete(device_error=error.code)


class _UnitConnection(asyncio.Protocol):
    """The connection to one unit, open or not, and the requests to it."""

    def __init__(self, unit: ModbusUnit, address: str, port: int) -> None:
        self._unit = unit
        self._address = address
        self._port = port
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[_PendingRequest] = deque()
        self._sent: dict[int, _PendingRequest] = {}
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
    def disconnected(self) -> bool:
        """Whether there is no connection, and none is being opened."""
        return self._connecting is None and self._transport is None

    def put(self, item: _PendingRequest) -> None:
        """Send a request when its turn comes; connect first if necessary."""
        if len(self._waiting) >= _MAX_WAITING:
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
        """Close the connection; all pending requests fail."""
        self._closed = True
        if self._connecting is not None:
            self._connecting.cancel()
        if self._transport is not None:
            self._transport.abort()
        self._fail_all(DISCONNECTED)

    async def closed(self) -> None:
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
        except OSError as failure:  # the resolver has error numbers of its own, which are negative
            error = failure.errno if failure.errno is not None and failure.errno > 0 else errno.EHOSTUNREACH
        except (OverflowError, ValueError):  # the port is out of range, or the host name is malformed
            error = errno.EINVAL
        finally:
            self._connecting = None
        if error:
            self._failed(error, f"cannot connect: {os.strerror(error)}")

    def _failed(self, error: int, why: str) -> None:
        """There is no connection: all pending requests fail, and so do new ones until the pause is over."""
        level = logging.DEBUG if self._failures else logging.INFO  # only the first of several failures is news
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
        """Send the requests that may be sent now; while a sequential one is unanswered, no other request is."""
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
        if self._timeouts >= _MAX_TIMEOUTS and self._transport is not None:
            self._transport.abort()
        else:
            self._send()

    def _take(self, frame: Frame) -> None:
        item = self._sent.pop(frame.transaction, None)
        if item is None:  # the request has timed out already
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
