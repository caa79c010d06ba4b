"""The device on the tool's serial line, when it is not inside the emulator: a pseudo terminal or a serial port.

    with open_tool_device("pty") as (device, name):  # in a running event loop
        print(name)

Needs a Unix: elsewhere only the echo is there.
"""

import asyncio
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, Final

from emulator.commands.requests import ToolBytes
from emulator.devices.tool_line import EchoDevice, SerialDevice, SerialSettings
from emulator.servers.command_queue import CommandQueue
from emulator.servers.connection import Connection
from emulator.servers.hooks import Direction
from emulator.servers.port import PortServer, ServedController
from emulator.snapshot import Snapshot


class ToolCommunicationServer(PortServer):
    """Bytes both ways, whatever they mean."""

    def __init__(self, controller: ServedController) -> None:
        super().__init__("tool line", controller)

    def connect(self) -> Connection:
        return _ToolConnection(self)

    def publish(self, snapshot: Snapshot) -> None:
        if snapshot.tool_bytes and self.connections:
            self.connections[0].send(snapshot.tool_bytes)


class _ToolConnection(Connection):
    patient = False  # a device may answer to a single letter

    def __init__(self, server: PortServer) -> None:
        super().__init__(server)
        self._queue = CommandQueue(server.controller, self._read_on)

    def opened(self) -> None:
        self._read_on(True)

    def received(self, data: bytes) -> None:
        passed = self.server.hooks.message(self, Direction.RECEIVED, data)
        if passed:
            self._queue.put(ToolBytes(passed))

    def lost(self) -> None:
        if self.server.connections:
            self.server.connections[0].read_on(True)

    def _read_on(self, going: bool) -> None:
        """Only the owner of the line is read."""
        self.read_on(going and self.server.connections[:1] == [self])


ECHO: Final = "echo"
PTY: Final = "pty"
_READ_BYTES: Final = 4096
_MOST_UNREAD: Final = 65536  # bytes the device may be ahead of the line (guess)

_logger = logging.getLogger(__name__)


@contextmanager
def open_tool_device(choice: str) -> Iterator[tuple[SerialDevice, str]]:
    """The device and what to call it: ``echo``, a new pseudo terminal for ``pty``, else a serial port by its path.

    Raises OSError for a path that cannot be opened or is not a terminal.
    """
    if choice == ECHO:
        yield EchoDevice(), "an echo"
        return
    try:
        descriptors, name = _pseudo_terminal() if choice == PTY else _serial_port(choice)
    except ImportError as error:
        raise OSError(None, f"the tool device {choice} needs Linux or macOS: here there is only {ECHO}") from error
    device = TerminalDevice(descriptors[0], name)
    try:
        yield device, name
    finally:
        device.close()
        for descriptor in descriptors:
            os.close(descriptor)


def _pseudo_terminal() -> tuple[list[int], str]:
    """Both ends: as long as one holds the far end, it can be opened and closed by others without an error here."""
    import tty  # not on every system

    near, far = os.openpty()
    tty.setraw(far)
    os.set_blocking(near, False)
    return [near, far], os.ttyname(far)


def _serial_port(path: str) -> tuple[list[int], str]:
    import tty

    try:
        descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError as error:
        raise OSError(error.errno, f"cannot open the tool device {path}: {error.strerror}") from error
    if not os.isatty(descriptor):
        os.close(descriptor)
        raise OSError(None, f"the tool device {path} is not a serial port")
    tty.setraw(descriptor)
    return [descriptor], path


class TerminalDevice:
    """A terminal's descriptor, read by the running event loop; the line looks at it once per control period."""

    def __init__(self, descriptor: int, name: str) -> None:
        self._descriptor = descriptor
        self._name = name
        self._inbox = bytearray()
        self._loop = asyncio.get_running_loop()
        self._reading = True
        self._loop.add_reader(descriptor, self._readable)

    def close(self) -> None:
        """Read no longer."""
        self._loop.remove_reader(self._descriptor)

    def configure(self, settings: SerialSettings) -> None:
        """Baud rate, parity and stop bits of the port; a pseudo terminal takes note of them."""
        import termios

        try:
            termios.tcsetattr(self._descriptor, termios.TCSANOW, _attributes(self._descriptor, settings))
        except (AttributeError, termios.error) as error:
            _logger.warning("the tool device %s cannot do %d baud: %s", self._name, settings.baud_rate, error)

    def write(self, data: bytes) -> None:
        """What the device does not take, because nobody reads it, is lost."""
        with suppress(BlockingIOError, OSError):
            os.write(self._descriptor, data)

    def read(self, most: int) -> bytes:
        taken = bytes(self._inbox[:most])
        del self._inbox[:most]
        if not self._reading and len(self._inbox) < _MOST_UNREAD:
            self._reading = True
            self._loop.add_reader(self._descriptor, self._readable)
        return taken

    def _readable(self) -> None:
        try:
            data = os.read(self._descriptor, _READ_BYTES)
        except BlockingIOError:
            return
        except OSError:  # as some systems say it
            data = b""
        self._inbox += data
        if not data:
            _logger.warning("the tool device %s is gone", self._name)
            self._loop.remove_reader(self._descriptor)
        elif len(self._inbox) >= _MOST_UNREAD:
            self._reading = False
            self._loop.remove_reader(self._descriptor)


def _attributes(descriptor: int, settings: SerialSettings) -> list[Any]:
    """Raises AttributeError for a baud rate this system does not know."""
    import termios

    attributes = termios.tcgetattr(descriptor)
    flags = attributes[2] & ~(termios.PARENB | termios.PARODD | termios.CSTOPB)
    flags |= {0: 0, 1: termios.PARENB | termios.PARODD, 2: termios.PARENB}[settings.parity]
    flags |= termios.CSTOPB if settings.stop_bits > 1 else 0
    speed = getattr(termios, f"B{settings.baud_rate}")
    return [*attributes[:2], flags, attributes[3], speed, speed, attributes[6]]
