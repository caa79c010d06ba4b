"""The device on the tool's serial line if it is outside the emulator: a pseudo terminal or a serial port.

    with open_tool_device("pty") as (device, name):  # in a running event loop
        print(name)

Requires Unix; on other systems only the echo is available.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from emulator.commands.requests import ToolBytes
from emulator.devices.tool_line import EchoDevice, SerialDevice
from emulator.servers.command_queue import CommandQueue
from emulator.servers.connection import Connection
from emulator.servers.hooks import Direction
from emulator.servers.port import PortServer, ServedController
from emulator.snapshot import Snapshot

ECHO: Final = "echo"
PTY: Final = "pty"


class ToolCommunicationServer(PortServer):
    """Forwards bytes in both directions, without interpreting them."""

    def __init__(self, controller: ServedController) -> None:
        super().__init__("tool line", controller)

    def connect(self) -> Connection:
        return _ToolConnection(self)

    def publish(self, snapshot: Snapshot) -> None:
        if snapshot.tool_bytes:
            self.connections[0].send(snapshot.tool_bytes)


class _ToolConnection(Connection):
    patient = False  # a device may answer a single letter

    def __init__(self, server: PortServer) -> None:
        super().__init__(server)
        self._queue = CommandQueue(server.controller, self._read_on, client=self)

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
        """Read only from the owner of the line."""
        self.read_on(going and self.server.connections[:1] == [self])


@contextmanager
def open_tool_device(choice: str) -> Iterator[tuple[SerialDevice, str]]:
    """The device and its name: ``echo``, a new pseudo terminal for ``pty``, otherwise the serial port at this path.

    Raises OSError for a path that cannot be opened or is not a terminal.
    """
    if choice == ECHO:
        yield EchoDevice(), "an echo"
        return
    if sys.platform == "win32":
        raise OSError(None, f"the tool device {choice} requires Linux or macOS: use {ECHO}")
    from emulator.servers import terminal  # not on every system

    descriptors, name = terminal.pseudo_terminal() if choice == PTY else terminal.serial_port(choice)
    device = terminal.TerminalDevice(descriptors[0], name)
    try:
        yield device, name
    finally:
        device.close()
        for descriptor in descriptors:
            os.close(descriptor)
