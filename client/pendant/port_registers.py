"""The general purpose registers of a robot's Modbus server, read while somebody looks at them."""

import asyncio
from contextlib import suppress
from typing import Final

from client.errors import ClientError
from client.modbus import GENERAL_REGISTERS, ModbusClient
from urproto.errors import ProtocolError, RobotRefused

__all__ = ["PortRegisters"]

_EVERY_S: Final = 0.2
_AGAIN_S: Final = 1.0
_TIMEOUT_S: Final = 2.0
_AT_ONCE: Final = 64  # a request takes 125 at most
_LOST: Final = (ClientError, ProtocolError, RobotRefused, OSError)


class PortRegisters:
    """words: 128 of them, none while they are not known. trouble: why not."""

    def __init__(self, host: str, port: int) -> None:
        self.host = host
        self.port = port
        self.words: tuple[int, ...] = ()
        self.trouble = ""
        self._lookers = 0
        self._task: asyncio.Task[None] | None = None

    def look(self) -> None:
        """Begin to look, until ``leave``."""
        self._lookers += 1
        if self._task is None:
            self._task = asyncio.create_task(self._follow())

    def leave(self) -> None:
        """Look no more; the last one to leave ends the connection."""
        self._lookers -= 1
        if not self._lookers and self._task is not None:
            self._task.cancel()
            self._task = None
            self.words = ()

    async def write(self, address: int, word: int) -> None:
        """Set a register. Raises RobotRefused, ClientError."""
        async with ModbusClient(self.host, self.port, _TIMEOUT_S) as client:
            await client.write_register(address, word)

    async def close(self) -> None:
        """End the connection."""
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task

    async def _follow(self) -> None:
        while True:
            try:
                async with ModbusClient(self.host, self.port, _TIMEOUT_S) as client:
                    while True:
                        words = list[int]()
                        for first in GENERAL_REGISTERS[::_AT_ONCE]:
                            words += await client.read_registers(first, _AT_ONCE)
                        self.words, self.trouble = tuple(words), ""
                        await asyncio.sleep(_EVERY_S)
            except _LOST as error:
                self.words, self.trouble = (), str(error)
            await asyncio.sleep(_AGAIN_S)
