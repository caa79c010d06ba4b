"""The serial line through the tool connector of an e-Series arm (RS-485).

Bytes from the network reach the tool's device as fast as the baud rate allows, and those of the
device return the same way. Unless a program or the installation has enabled the line and the tool
has power, everything sent on it is lost. Unlike on a real two-wire line, both directions work at
the same time.
"""

from typing import Final, NamedTuple, Protocol

_MAX_WAITING: Final = 4096  # bytes per direction; more stay in the network, or are lost on the device's side (guess)
_DATA_BITS: Final = 8


class SerialSettings(NamedTuple):
    """``set_tool_communication``. parity: 0 none, 1 odd, 2 even. The defaults are those in a capture of a simulator."""

    enabled: bool = False
    baud_rate: int = 115200
    parity: int = 0
    stop_bits: int = 1
    rx_idle_chars: float = 1.5
    tx_idle_chars: float = 3.5

    @property
    def bytes_per_s(self) -> float:
        """Capacity of the line: start, data, parity and stop bits are all sent."""
        return self.baud_rate / (1 + _DATA_BITS + (self.parity != 0) + self.stop_bits)


AS_DELIVERED: Final = SerialSettings()


class SerialDevice(Protocol):
    """A device connected to the line."""

    def configure(self, settings: SerialSettings) -> None:
        """The line's settings changed."""

    def write(self, data: bytes) -> None:
        """Bytes for the device."""

    def read(self, most: int) -> bytes:
        """Take at most this many bytes from the device."""


class EchoDevice:
    """Sends back every byte it receives."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def configure(self, settings: SerialSettings) -> None:
        """Understands every baud rate."""

    def write(self, data: bytes) -> None:
        self._bytes += data
        del self._bytes[_MAX_WAITING:]

    def read(self, most: int) -> bytes:
        taken = bytes(self._bytes[:most])
        del self._bytes[:most]
        return taken


class ToolLine:
    """The line. device: None when nothing is connected. ``received``: from the device in this period."""

    def __init__(self, period_s: float) -> None:
        self.device: SerialDevice | None = None
        self.received = b""
        self.live = False
        self._period_s = period_s
        self._settings = AS_DELIVERED
        self._waiting = bytearray()
        self._credit = 0.0  # bytes per direction that the line could have carried but has not

    @property
    def settings(self) -> SerialSettings:
        return self._settings

    @settings.setter
    def settings(self, settings: SerialSettings) -> None:
        if self.device is not None and settings != self._settings:
            self.device.configure(settings)
        self._settings = settings

    @property
    def full(self) -> bool:
        """True while the line is behind."""
        return len(self._waiting) >= _MAX_WAITING

    def connect(self, device: SerialDevice) -> None:
        self.device = device
        device.configure(self._settings)

    def send(self, data: bytes) -> None:
        """Bytes for the device; lost on a dead line."""
        if self.live:
            self._waiting += data

    def advance(self, *, powered: bool) -> None:
        """One control period. powered: the tool has a supply voltage."""
        device = self.device
        if device is None:
            return
        self.live = powered and self._settings.enabled
        if not self.live:
            self._drop(device)
            return
        self._credit += self._settings.bytes_per_s * self._period_s
        share = int(self._credit)
        self._credit -= share
        if self._waiting:
            device.write(bytes(self._waiting[:share]))
            del self._waiting[:share]
        self.received = device.read(share)

    def _drop(self, device: SerialDevice) -> None:
        self._waiting.clear()
        self._credit = 0.0
        self.received = b""
        device.read(_MAX_WAITING)
