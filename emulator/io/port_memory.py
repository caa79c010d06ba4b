"""What the Modbus server of the robot keeps by itself."""

from typing import Final

GENERAL_PURPOSE: Final = range(128, 256)
"""Registers that mean what programs and clients agree on."""


class PortMemory:
    """What only the server keeps: the general purpose registers 128 to 255, and the up-time latched last."""

    def __init__(self) -> None:
        self.general = [0] * len(GENERAL_PURPOSE)
        self.uptime = [0] * 5  # ms, s, min, h, days

    def latch_uptime(self, seconds: float) -> None:
        """Keep the time since the controller started until the next call."""
        milliseconds = round(seconds * 1000.0)
        whole = milliseconds // 1000
        self.uptime = [milliseconds % 1000, whole % 60, whole // 60 % 60, whole // 3600 % 24, whole // 86400]
