"""The network of a world: sockets and selectors in memory, on lines whose faults have a seed.

The sockets have the behaviour of TCP that programs see: the bytes of a connection arrive in order, in any portions;
those of two connections in any order. A line delays, stalls, resets or swallows; a peer that is gone looks like a peer
that is silent. `Network` replaces `socket.socket` and the selectors of event loops inside the context of its world.
"""

import errno
import os
import selectors
import socket
import struct
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Final
from unittest.mock import patch
from zlib import crc32

from tests.simulation.world import SimulatedThread, World
from urproto.compat import Self

_FIRST_DESCRIPTOR: Final = 200  # above those of the test, below any limit
_FIRST_PORT: Final = 40_000
_WINDOW: Final = 128 * 1024  # bytes under way in one direction; a sender has to wait beyond that
_SYN_S: Final = 130.0  # Linux gives up connecting after so long
_FOREVER: Final = float("inf")
_LINGER: Final = struct.Struct("ii")
_TIMEVAL: Final = struct.Struct("@ll")
_KEEP_ALIVE: Final = {socket.TCP_KEEPIDLE: 7200, socket.TCP_KEEPINTVL: 75, socket.TCP_KEEPCNT: 9}  # Linux's values
_INHERITED: Final = (socket.SO_LINGER,)

Address = tuple[str, int]


class Pipe:
    """One direction of a connection. blocked_until_s: nothing arrives before."""

    def __init__(self, network: "Network", name: str) -> None:
        self.network = network
        self.name = name
        self.receiver: Stream | None = None  # None once it is closed
        self.sender: Stream | None = None
        self.under_way: deque[tuple[float, bytes | None]] = deque()  # times of arrival; None is the end (FIN)
        self.received = bytearray()
        self.ended = False
        self.size = 0  # bytes sent and not read
        self.blocked_until_s = 0.0
        self._last_s = 0.0

    @property
    def free(self) -> int:
        """Bytes that can be sent now."""
        return max(0, _WINDOW - self.size)

    def send(self, data: bytes | None) -> None:
        """Let bytes, or the end, be on their way."""
        network = self.network
        for part in [None] if data is None else network.portions(data):
            self._last_s = max(self._last_s, network.world.now + network.delay_s(self))
            self.under_way.append((self._last_s, part))
            self.size += len(part or b"")
            if len(self.under_way) == 1:
                network.world.call_at(self._last_s, self._arrive)

    def _arrive(self) -> None:
        """Deliver what is due; the rest when its time comes."""
        world = self.network.world
        while self.under_way and self.under_way[0][0] <= world.now:
            if self.blocked_until_s > world.now:
                if self.blocked_until_s < _FOREVER:
                    world.call_at(self.blocked_until_s, self._arrive)
                return
            self._deliver(self.under_way.popleft()[1])
        if self.under_way:
            world.call_at(self.under_way[0][0], self._arrive)

    def _deliver(self, data: bytes | None) -> None:
        receiver = self.receiver
        if receiver is not None:
            self.network.arrived_s[receiver.local, receiver.remote] = self.network.world.now
        self.network.world.note(f"{self.name} {'end' if data is None else f'{len(data)} {crc32(data):08x}'}")
        if receiver is None:
            if data is not None and self.sender is not None:
                self.sender.reset()  # nobody is there any more
            return
        if data is None:
            self.ended = True
        else:
            self.received += data
        receiver.changed()

    def read(self, count: int) -> bytes:
        """Take bytes that have arrived."""
        data = bytes(self.received[:count])
        del self.received[:count]
        self.size -= len(data)
        if self.sender is not None:
            self.sender.changed()
        return data


class Endpoint:
    """What descriptors refer to. Those who wait for it are informed by `changed`."""

    def __init__(self, network: "Network") -> None:
        self.network = network
        self.descriptors = 0
        self.waiting: list[SimulatedThread] = []
        self.selectors: dict[Selector, None] = {}
        self.options: dict[tuple[int, int], Any] = {}
        self.local: Address = ("", 0)
        self.remote: Address | None = None

    readable = False
    writable = False

    def changed(self) -> None:
        waiting, self.waiting = self.waiting, []
        for thread in waiting:
            self.network.world.wake(thread)
        for selector in self.selectors:
            selector.changed(self)

    def wait(self, until_s: float | None) -> bool:
        """Wait for a change; False if the time comes first."""
        self.waiting.append(self.network.world.here)
        return self.network.world.wait(until_s)

    def close(self) -> None:
        """The last descriptor was closed."""


class Stream(Endpoint):
    """One end of a connection, or of one that is being opened."""

    def __init__(self, network: "Network") -> None:
        super().__init__(network)
        self.incoming: Pipe | None = None
        self.outgoing: Pipe | None = None
        self.error = 0
        self.broken = False  # reset: no more can be sent, and nothing arrives
        self.connecting = False
        self.sent_end = False
        self.shut = False  # for reading

    @property
    def readable(self) -> bool:  # type: ignore[override]
        if self.incoming is None:
            return bool(self.error)
        return bool(self.incoming.received) or self.incoming.ended or self.broken or self.shut

    @property
    def writable(self) -> bool:  # type: ignore[override]
        if self.outgoing is None:
            return bool(self.error)
        return self.broken or self.outgoing.free > 0

    def reset(self) -> None:
        """A reset (RST) arrives."""
        if not self.broken:
            self.broken, self.error = True, errno.ECONNRESET
            self.network.world.note(f"{self.outgoing.name if self.outgoing else self.local} reset")
            self.changed()

    @property
    def keep_alive_s(self) -> float:
        """After how long without a sign of the other end the system gives it up [s]; infinite without SO_KEEPALIVE."""
        idle_s, interval_s, count = (
            self.options.get((socket.IPPROTO_TCP, option), usual) for option, usual in _KEEP_ALIVE.items()
        )
        on = self.options.get((socket.SOL_SOCKET, socket.SO_KEEPALIVE))
        return float(idle_s + interval_s * count) if on else _FOREVER

    def check_alive(self) -> None:
        """Give the other end up, if nothing has passed for so long.

        Not while sent bytes are without an answer: then the system repeats them, for a quarter of an hour.
        """
        incoming, outgoing = self.incoming, self.outgoing
        is_silent = incoming is not None and incoming.blocked_until_s > self.network.world.now
        if is_silent and (outgoing is None or not outgoing.under_way):
            self.reset()

    def finish(self) -> None:
        """Send the end, once."""
        if self.outgoing is not None and not self.sent_end and not self.broken:
            self.outgoing.send(None)
        self.sent_end = True

    def close(self) -> None:
        incoming, outgoing = self.incoming, self.outgoing
        if incoming is None or outgoing is None:
            self.network.connecting.discard(self)
            return
        abrupt = self.options.get((socket.SOL_SOCKET, socket.SO_LINGER), b"") == _LINGER.pack(1, 0)
        if (incoming.received or abrupt) and not self.broken:
            peer = outgoing.receiver
            if peer is not None and outgoing.blocked_until_s < _FOREVER:
                late_s = max(outgoing.blocked_until_s - self.network.world.now, 0.0)
                self.network.world.call_later(late_s + self.network.delay_s(outgoing), peer.reset)
        else:
            self.finish()
        incoming.receiver = outgoing.sender = None
        self.network.note_closed(self)


class Listener(Endpoint):
    """A listening socket. queue: connections that it has not accepted yet."""

    def __init__(self, network: "Network") -> None:
        super().__init__(network)
        self.queue: deque[Stream] = deque()

    @property
    def readable(self) -> bool:  # type: ignore[override]
        return bool(self.queue)

    def close(self) -> None:
        self.network.listeners.pop(self.local, None)
        for stream in self.queue:
            stream.options[socket.SOL_SOCKET, socket.SO_LINGER] = _LINGER.pack(1, 0)
            stream.close()


@dataclass
class Line:
    """How connections between two machines are: delays [s], and when it is down.

    latency_s, jitter_s: of each portion. slow: probability that one is late, by up to slow_s. cut_until_s: nothing
    passes until then, also no new connection.
    """

    latency_s: float = 0.0002
    jitter_s: float = 0.0002
    slow: float = 0.0
    slow_s: float = 0.0
    portion: float = 0.0  # probability that bytes arrive in portions
    cut_until_s: float = 0.0


class Network:
    """The network of a world; use it with ``with``, inside that of the world."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.line = Line()
        self.descriptors: dict[int, Endpoint] = {}
        self.listeners: dict[Address, Listener] = {}
        self.connecting: set[Stream] = set()
        self.open: list[tuple[Stream, Stream]] = []
        self.arrived_s: dict[tuple[Address, Address | None], float] = {}  # when something arrived last, at whom
        self._port = _FIRST_PORT
        self._patches = ExitStack()

    def __enter__(self) -> Self:
        global _network
        _network = self
        replaced: Mapping[Any, Mapping[str, Any]] = {
            socket: {"socket": Socket, "socketpair": self._pair},
            selectors: {"DefaultSelector": Selector},
            os: {"dup": self._dup(os.dup), "read": self._read(os.read)},
        }
        for module, names in replaced.items():
            for name, replacement in names.items():
                self._patches.enter_context(patch.object(module, name, replacement))
        return self

    def __exit__(self, *_: object) -> None:
        global _network
        self._patches.close()
        _network = None

    # the line

    def delay_s(self, pipe: Pipe) -> float:
        """How long the next portion takes [s]."""
        if not pipe.name:
            return 0.0
        line, random = self.line, self.world.random
        delay_s = line.latency_s + line.jitter_s * random.random()
        if line.slow and random.random() < line.slow:
            delay_s += line.slow_s * random.random()
        return delay_s

    def portions(self, data: bytes) -> list[bytes]:
        """How bytes are divided on their way."""
        random = self.world.random
        if len(data) < 2 or not self.line.portion or random.random() >= self.line.portion:
            return [data]
        at = random.randrange(1, len(data))
        return [data[:at], data[at:]]

    def cut(self, seconds: float, chosen: Callable[[Stream], bool] = lambda stream: True) -> None:
        """Nothing passes for some time, in these connections, and all new ones; infinity for half-open connections."""
        until_s = self.world.now + seconds
        if seconds < _FOREVER:
            self.line.cut_until_s = max(self.line.cut_until_s, until_s)
        for stream, _ in self.open:
            if chosen(stream):
                self.stall(stream, seconds)

    def stall(self, stream: Stream, seconds: float) -> None:
        """Nothing passes in this connection for some time [s], in both directions."""
        self.world.note(f"{stream.outgoing.name if stream.outgoing else ''} stalled {seconds:.3f}")
        for pipe in (stream.incoming, stream.outgoing):
            if pipe is not None:
                pipe.blocked_until_s = max(pipe.blocked_until_s, self.world.now + seconds)
                if pipe.receiver is not None and pipe.receiver.keep_alive_s < seconds:
                    self.world.call_later(pipe.receiver.keep_alive_s, pipe.receiver.check_alive)

    def cut_off(self, stream: Stream) -> None:
        """Both ends of a connection receive a reset."""
        for end in (pair for pair in self.open if stream in pair):
            for one in end:
                one.reset()
            break

    def note_closed(self, stream: Stream) -> None:
        """An end of a connection was closed."""
        self.open = [pair for pair in self.open if not (stream in pair and all(_is_closed(one) for one in pair))]

    # connecting

    def next_port(self) -> int:
        self._port += 1
        return self._port

    def connect(self, stream: Stream, address: Address) -> None:
        """Begin to connect; `Stream.changed` is called at the end."""
        world = self.world
        stream.remote, stream.connecting = address, True
        stream.local = (world.here.host, self.next_port())
        self.connecting.add(stream)
        name = f"{stream.local[0]}:{stream.local[1]}>{address[0]}:{address[1]}"
        outgoing, incoming = Pipe(self, name), Pipe(self, f"{name} back")
        took_s = self.delay_s(outgoing)
        arrive_s = max(world.now, self.line.cut_until_s) + took_s
        if arrive_s - world.now > _SYN_S:
            world.call_later(_SYN_S, lambda: self._connected(stream, None, errno.ETIMEDOUT))
            return

        def arrive() -> None:
            listener = self.listeners.get(address) or self.listeners.get(("", address[1]))
            back_s = self.delay_s(incoming)
            if listener is None or stream not in self.connecting:
                world.call_later(back_s, lambda: self._connected(stream, None, errno.ECONNREFUSED))
                return
            other = Stream(self)
            other.local, other.remote = address, stream.local
            other.options = {key: value for key, value in listener.options.items() if key[1] not in _INHERITED}
            other.incoming, other.outgoing = outgoing, incoming
            outgoing.sender, outgoing.receiver = stream, other
            incoming.sender, incoming.receiver = other, stream
            self.open.append((stream, other))
            listener.queue.append(other)
            listener.changed()
            world.call_later(back_s, lambda: self._connected(stream, (incoming, outgoing), 0))

        world.call_at(arrive_s, arrive)

    def _connected(self, stream: Stream, pipes: tuple[Pipe, Pipe] | None, error: int) -> None:
        if stream not in self.connecting:
            if pipes is not None and pipes[0].sender is not None:  # given up meanwhile
                pipes[0].receiver = pipes[1].sender = None
                pipes[0].sender.reset()
            return
        self.connecting.discard(stream)
        self.world.note(f"{stream.local[0]}:{stream.local[1]}>{stream.remote} {'refused' if error else 'open'}")
        stream.connecting, stream.error = False, error
        if pipes is not None:
            stream.incoming, stream.outgoing = pipes
        stream.changed()

    def _pair(self, *_: Any) -> tuple["Socket", "Socket"]:
        ends = Stream(self), Stream(self)
        there, back = Pipe(self, ""), Pipe(self, "")
        for end, other, incoming, outgoing in ((ends[0], ends[1], back, there), (ends[1], ends[0], there, back)):
            end.incoming, end.outgoing = incoming, outgoing
            incoming.receiver, incoming.sender = end, other
        return Socket.of(ends[0]), Socket.of(ends[1])

    # descriptors

    def register(self, endpoint: Endpoint) -> int:
        """A new descriptor."""
        descriptor = next(n for n in range(_FIRST_DESCRIPTOR, 1 << 16) if n not in self.descriptors)
        self.descriptors[descriptor] = endpoint
        endpoint.descriptors += 1
        return descriptor

    def unregister(self, descriptor: int) -> None:
        """Close a descriptor."""
        endpoint = self.descriptors.pop(descriptor)
        endpoint.descriptors -= 1
        if not endpoint.descriptors:
            endpoint.close()

    def _dup(self, real: Callable[[int], int]) -> Callable[[int], int]:
        return lambda fd: self.register(self.descriptors[fd]) if fd in self.descriptors else real(fd)

    def _read(self, real: Callable[[int, int], bytes]) -> Callable[[int, int], bytes]:
        def read(fd: int, count: int) -> bytes:
            if (endpoint := self.descriptors.get(fd)) is None:
                return real(fd, count)
            return _receive(endpoint, count, 0.0)

        return read


def _is_closed(stream: Stream) -> bool:
    return stream.incoming is not None and stream.incoming.receiver is not stream


def _receive(endpoint: Endpoint, count: int, timeout_s: float | None) -> bytes:
    world = endpoint.network.world
    assert isinstance(endpoint, Stream)
    until_s = None if timeout_s is None else world.now + timeout_s
    while not endpoint.readable:
        if endpoint.incoming is None:
            raise OSError(errno.ENOTCONN, os.strerror(errno.ENOTCONN))
        if timeout_s == 0.0:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        if not endpoint.wait(until_s) and not endpoint.readable:
            raise TimeoutError("timed out")
    incoming = endpoint.incoming
    if incoming is not None and incoming.received:
        return incoming.read(count)
    if endpoint.error:
        error, endpoint.error = endpoint.error, 0
        raise ConnectionResetError(error, os.strerror(error))
    return b""


class Socket:
    """What `socket.socket` is in a world: a descriptor, with a timeout."""

    def __init__(
        self,
        family: int = -1,
        type: int = -1,  # noqa: A002 - its name in the standard library
        proto: int = -1,
        fileno: int | None = None,
    ) -> None:
        assert _network is not None
        self._network = _network
        self.family = socket.AF_INET if family == -1 else socket.AddressFamily(family)
        self.type = socket.SOCK_STREAM if type == -1 else socket.SocketKind(type)
        self.proto = 0 if proto == -1 else proto
        self._endpoint = Stream(_network) if fileno is None else _network.descriptors[fileno]
        self._fd = _network.register(self._endpoint) if fileno is None else fileno
        self._timeout_s: float | None = None
        self._receive_timeout_s: float | None = None  # the system's, SO_RCVTIMEO

    @classmethod
    def of(cls, endpoint: Endpoint) -> Self:
        return cls(fileno=_require_network().register(endpoint))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.close()

    def fileno(self) -> int:
        return self._fd

    def settimeout(self, seconds: float | None) -> None:
        self._timeout_s = seconds

    def gettimeout(self) -> float | None:
        return self._timeout_s

    def setblocking(self, blocking: bool) -> None:
        self._timeout_s = None if blocking else 0.0

    def setsockopt(self, level: int, option: int, value: int | bytes) -> None:
        self._check_open()
        if (level, option) == (socket.SOL_SOCKET, socket.SO_RCVTIMEO):
            assert isinstance(value, bytes)
            seconds, micros = _TIMEVAL.unpack(value)
            self._receive_timeout_s = seconds + micros / 1e6
        self._endpoint.options[level, option] = value

    def getsockopt(self, level: int, option: int) -> int:
        self._check_open()
        if (level, option) == (socket.SOL_SOCKET, socket.SO_ERROR) and isinstance(self._endpoint, Stream):
            error, self._endpoint.error = self._endpoint.error, 0
            return error
        return int(self._endpoint.options.get((level, option), 0))

    def getsockname(self) -> Address:
        self._check_open()
        return self._endpoint.local

    def getpeername(self) -> Address:
        self._check_open()
        if self._endpoint.remote is None or not isinstance(self._endpoint, Stream) or self._endpoint.incoming is None:
            raise OSError(errno.ENOTCONN, os.strerror(errno.ENOTCONN))
        return self._endpoint.remote

    def bind(self, address: Address) -> None:
        host, port = address[:2]
        taken = {local[1] for local in self._network.listeners if local[0] == host}
        if port in taken:
            raise OSError(errno.EADDRINUSE, os.strerror(errno.EADDRINUSE))
        self._endpoint.local = (host, port or self._network.next_port())

    def listen(self, backlog: int = 128) -> None:
        listener = Listener(self._network)
        listener.local, listener.options = self._endpoint.local, self._endpoint.options
        listener.descriptors = 1
        self._network.descriptors[self._fd] = self._endpoint = listener
        self._network.listeners[listener.local] = listener

    def accept(self) -> tuple["Socket", Address]:
        self._check_open()
        assert isinstance(self._endpoint, Listener)
        if not self._endpoint.queue:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        stream = self._endpoint.queue.popleft()
        assert stream.remote is not None
        return Socket.of(stream), stream.remote

    def connect(self, address: Address) -> None:
        stream = self._endpoint
        assert isinstance(stream, Stream)
        if self.type == socket.SOCK_DGRAM:
            stream.local, stream.remote = (self._network.world.here.host, self._network.next_port()), address
            return
        self._network.connect(stream, address)
        if self._timeout_s == 0.0:
            raise BlockingIOError(errno.EINPROGRESS, os.strerror(errno.EINPROGRESS))
        until_s = None if self._timeout_s is None else self._network.world.now + self._timeout_s
        while stream.connecting:
            if not stream.wait(until_s) and stream.connecting:
                raise TimeoutError("timed out")
        if stream.error:
            error, stream.error = stream.error, 0
            raise OSError(error, os.strerror(error))

    def send(self, data: bytes | bytearray | memoryview, flags: int = 0) -> int:
        self._check_open()
        stream, world = self._endpoint, self._network.world
        assert isinstance(stream, Stream)
        world.interrupt()
        self._check_open()
        until_s = None if self._timeout_s is None else world.now + self._timeout_s
        while not stream.writable and stream.outgoing is not None:
            if self._timeout_s == 0.0:
                raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
            if not stream.wait(until_s) and not stream.writable:
                raise TimeoutError("timed out")
        if stream.broken or stream.sent_end:
            raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))
        if stream.outgoing is None:
            raise OSError(errno.ENOTCONN, os.strerror(errno.ENOTCONN))
        part = bytes(memoryview(data)[: stream.outgoing.free])
        stream.outgoing.send(part)
        return len(part)

    def sendall(self, data: bytes, flags: int = 0) -> None:
        rest = memoryview(data)
        while rest:
            rest = rest[self.send(rest) :]

    def sendmsg(self, buffers: Any) -> int:
        return self.send(b"".join(bytes(part) for part in buffers))

    def recv(self, count: int, flags: int = 0) -> bytes:
        self._check_open()
        if self._timeout_s is None and self._receive_timeout_s is not None:
            try:
                return _receive(self._endpoint, count, self._receive_timeout_s)
            except TimeoutError:
                raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN)) from None
        return _receive(self._endpoint, count, self._timeout_s)

    def recv_into(self, buffer: Any, count: int = 0, flags: int = 0) -> int:
        data = self.recv(count or len(buffer))
        buffer[: len(data)] = data
        return len(data)

    def shutdown(self, how: int) -> None:
        self._check_open()
        stream = self._endpoint
        assert isinstance(stream, Stream)
        if stream.incoming is None or stream.broken:
            raise OSError(errno.ENOTCONN, os.strerror(errno.ENOTCONN))
        if how in (socket.SHUT_WR, socket.SHUT_RDWR):
            stream.finish()
        if how in (socket.SHUT_RD, socket.SHUT_RDWR):
            stream.shut = True
        stream.changed()

    def close(self) -> None:
        if self._fd >= 0:
            descriptor, self._fd = self._fd, -1
            if descriptor in self._network.descriptors:
                self._network.unregister(descriptor)

    def _check_open(self) -> None:
        if self._fd < 0:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))


class Selector(selectors._BaseSelectorImpl):
    """The selector of an event loop in a world: waits until a socket is ready, or for the time of the next timer."""

    def __init__(self) -> None:
        super().__init__()
        self._network = _require_network()
        self._hot: dict[Endpoint, int] = {}  # endpoints that may be ready, and their descriptors
        self._watched: dict[Endpoint, int] = {}
        self._thread: SimulatedThread | None = None  # that waits

    def changed(self, endpoint: Endpoint) -> None:
        """Something happened to one that is watched."""
        self._hot[endpoint] = self._watched[endpoint]
        if self._thread is not None:
            self._network.world.wake(self._thread)

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        key: selectors.SelectorKey = super().register(fileobj, events, data)
        endpoint = self._network.descriptors[key.fd]
        endpoint.selectors[self] = None
        self._watched[endpoint] = self._hot[endpoint] = key.fd
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        key: selectors.SelectorKey = super().unregister(fileobj)
        for endpoint in [one for one, fd in self._watched.items() if fd == key.fd]:
            del self._watched[endpoint]
            self._hot.pop(endpoint, None)
            endpoint.selectors.pop(self, None)
        return key

    def modify(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        key: selectors.SelectorKey = super().modify(fileobj, events, data)
        for endpoint, fd in self._watched.items():
            if fd == key.fd:
                self._hot[endpoint] = fd
        return key

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        world = self._network.world
        until_s = None if timeout is None else world.now + max(timeout, 0.0)
        while not (ready := self._ready()):
            if until_s is not None and until_s <= world.now:
                break
            self._thread = world.here
            world.wait(until_s)
            self._thread = None
        if len(ready) > 1:
            world.random.shuffle(ready)
        return ready

    def _ready(self) -> list[tuple[selectors.SelectorKey, int]]:
        ready = []
        keys = self._fd_to_key
        for endpoint, fd in tuple(self._hot.items()):
            key = keys[fd]
            events = selectors.EVENT_READ * endpoint.readable | selectors.EVENT_WRITE * endpoint.writable
            if events & key.events:
                ready.append((key, events & key.events))
            else:
                del self._hot[endpoint]
        return ready


_network: Network | None = None


def _require_network() -> Network:
    assert _network is not None, "not in a network"
    return _network
