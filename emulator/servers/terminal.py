"""Terminals of this machine as the device on the tool's serial line: a pseudo terminal or serial port. Unix only."""

import asyncio
import logging
import os
import sys
import termios
import tty
from contextlib import suppress
from typing import Any, Final

from emulator.devices.tool_line import SerialSettings

assert sys.platform != "win32"  # for mypy, which there looks no further

_READ_BYTES: Final = 4096
_MAX_UNREAD: Final = 65536  # bytes the device may be ahead of the line (guess)

_logger = logging.getLogger(__name__)


def pseudo_terminal() -> tuple[list[int], str]:
    """Open both ends: while the far end stays open, other programs can open and close it without an error here."""
    near, far = os.openpty()
    tty.setraw(far)
    os.set_blocking(near, False)
    return [near, far], os.ttyname(far)


def serial_port(path: str) -> tuple[list[int], str]:
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
    """A terminal's descriptor, read by the running event loop; the line polls it once per control period."""

    def __init__(self, descriptor: int, name: str) -> None:
        self._descriptor = descriptor
        self._name = name
        self._inbox = bytearray()
        self._loop = asyncio.get_running_loop()
        self._reading = True
        self._loop.add_reader(descriptor, self._readable)

    def close(self) -> None:
        self._loop.remove_reader(self._descriptor)

    def configure(self, settings: SerialSettings) -> None:
        """Set baud rate, parity and stop bits of the port; a pseudo terminal only stores them."""
        try:
            termios.tcsetattr(self._descriptor, termios.TCSANOW, _attributes(self._descriptor, settings))
        except (AttributeError, termios.error) as error:
            _logger.warning("the tool device %s does not support %d baud: %s", self._name, settings.baud_rate, error)

    def write(self, data: bytes) -> None:
        """Write; bytes that the device does not accept, because nobody reads them, are lost."""
        with suppress(BlockingIOError, OSError):
            os.write(self._descriptor, data)

    def read(self, most: int) -> bytes:
        taken = bytes(self._inbox[:most])
        del self._inbox[:most]
        if not self._reading and len(self._inbox) < _MAX_UNREAD:
            self._reading = True
            self._loop.add_reader(self._descriptor, self._readable)
        return taken

    def _readable(self) -> None:
        try:
            data = os.read(self._descriptor, _READ_BYTES)
        except BlockingIOError:
            return
        except OSError:  # as reported on some systems
            data = b""
        self._inbox += data
        if not data:
            _logger.warning("the tool device %s was disconnected", self._name)
            self._loop.remove_reader(self._descriptor)
        elif len(self._inbox) >= _MAX_UNREAD:
            self._reading = False
            self._loop.remove_reader(self._descriptor)


def _attributes(descriptor: int, settings: SerialSettings) -> list[Any]:
    """Raises AttributeError for a baud rate this system does not know."""
    attributes = termios.tcgetattr(descriptor)
    flags = attributes[2] & ~(termios.PARENB | termios.PARODD | termios.CSTOPB)
    flags |= {0: 0, 1: termios.PARENB | termios.PARODD, 2: termios.PARENB}[settings.parity]
    flags |= termios.CSTOPB if settings.stop_bits > 1 else 0
    speed = getattr(termios, f"B{settings.baud_rate}")
    return [*attributes[:2], flags, attributes[3], speed, speed, attributes[6]]
