"""Makes the serial line at the robot's tool available as a serial device of this machine.

    async with ToolCommunication("192.168.56.101", device=Path("/tmp/ttyUR")) as line:
        await line.run()

Data that a program writes to the device is sent to the tool, and vice versa. The robot (e-Series) offers its serial
line through the vendor's RS485 URCap. Requires pseudo terminals: Linux or macOS.
"""

import asyncio
import logging
import os
import stat
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final, cast

from client.connection import DEFAULT_TIMEOUT_S
from client.errors import DeviceError, RobotUnreachableError
from client.quantities import checked
from urproto.compat import Self
from urproto.compat_asyncio import timeout

PORT: Final = 54321
_PAUSE_S: Final = 0.5  # between attempts to reconnect (guess)
_READ_BYTES: Final = 4096

_logger = logging.getLogger(__name__)


@checked
class ToolCommunication:
    """Provides the device as long as the context is open; ``run`` keeps it connected to the robot.

    device: path of a link to the pseudo terminal. report: called with a message when the connection is lost or
    restored. Bytes that cannot be delivered, because one side is not connected or does not read, are lost, as on any
    serial line.
    """

    def __init__(
        self,
        host: str,
        port: int = PORT,
        device: Path = Path("/tmp/ttyUR"),
        report: Callable[[str], None] = _logger.info,
    ) -> None:
        self.host = host
        self.port = port
        self.device = device
        self._report = report
        self._near = self._far = -1
        self._stream: _Stream | None = None

    async def __aenter__(self) -> Self:
        """Create the device and connect. Raises DeviceError and RobotUnreachableError."""
        try:
            self._open()
            self._stream = await self._connect()
        except BaseException:
            self._close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        stream = self._stream
        self._close()
        if stream is not None:
            stream.end()
            await stream.lost.wait()

    async def run(self) -> None:
        """Forward bytes forever; reconnects whenever the connection is lost."""
        while True:
            if self._stream is not None:
                await self._stream.lost.wait()
                self._stream = None
                self._report(f"{self.host}:{self.port} closed the connection; trying again")
            try:
                self._stream = await self._connect()
                self._report(f"{self.host}:{self.port} is connected again")
            except RobotUnreachableError:
                await asyncio.sleep(_PAUSE_S)

    async def _connect(self) -> "_Stream":
        try:
            async with timeout(DEFAULT_TIMEOUT_S):
                _, stream = await asyncio.get_running_loop().create_connection(
                    lambda: _Stream(self._near, self._read), self.host, self.port
                )
        except OSError as error:  # TimeoutError is one
            reason = "no answer in time" if isinstance(error, TimeoutError) else error.strerror or str(error)
            raise RobotUnreachableError(self.host, self.port, reason) from error
        return stream

    # the device

    def _open(self) -> None:
        """Keep both ends open, so that programs may open and close the device at any time."""
        if sys.platform == "win32":
            raise DeviceError(self.device, "Windows has no pseudo terminals")
        import tty

        try:
            self._near, self._far = os.openpty()
            tty.setraw(self._far)
        except OSError as error:
            raise DeviceError(self.device, f"no pseudo terminal is available: {error}") from error
        os.set_blocking(self._near, False)
        self._link(os.ttyname(self._far))
        self._read(True)

    def _link(self, name: str) -> None:
        try:
            if self.device.is_symlink() and _may_replace(self.device):
                self.device.unlink()
            self.device.symlink_to(name)
        except FileExistsError as error:
            raise DeviceError(self.device, "another file has this name") from error
        except OSError as error:
            raise DeviceError(self.device, error.strerror or str(error)) from error

    def _close(self) -> None:
        if self._near < 0 or sys.platform == "win32":
            return
        self._read(False)
        if self.device.is_symlink() and str(self.device.readlink()) == os.ttyname(self._far):
            self.device.unlink()
        os.close(self._near)
        os.close(self._far)
        self._near = self._far = -1

    def _read(self, going: bool) -> None:
        loop = asyncio.get_running_loop()
        if going:
            loop.add_reader(self._near, self._readable)
        else:
            loop.remove_reader(self._near)

    def _readable(self) -> None:
        try:
            data = os.read(self._near, _READ_BYTES)
        except BlockingIOError:
            return
        if self._stream is not None:
            self._stream.send(data)


class _Stream(asyncio.Protocol):
    """The connection to the robot. ``lost``: set when it has ended."""

    def __init__(self, device: int, read_device: Callable[[bool], None]) -> None:
        self.lost = asyncio.Event()
        self._device = device
        self._read_device = read_device
        self._transport: asyncio.Transport | None = None
        self._held = False

    def send(self, data: bytes) -> None:
        if self._transport is not None:
            self._transport.write(data)

    def end(self) -> None:
        """Close the connection; no more data reaches the device."""
        self._device = -1
        if self._transport is not None:
            self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)  # uvloop's is not a subclass of it

    def data_received(self, data: bytes) -> None:
        if self._device < 0:
            return
        try:
            os.write(self._device, data)
        except BlockingIOError:
            _logger.debug("%d bytes from the tool are lost: no program reads the device", len(data))

    def pause_writing(self) -> None:
        self._held = True
        self._read_device(False)

    def resume_writing(self) -> None:
        self._held = False
        self._read_device(True)

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None
        if self._held and self._device >= 0:
            self._read_device(True)
        self.lost.set()


def _may_replace(link: Path) -> bool:
    """True for a stale link: to a terminal, or to a missing file."""
    return not link.exists() or stat.S_ISCHR(link.stat().st_mode)
