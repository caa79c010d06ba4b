"""Where each server of the emulator listens."""

from collections.abc import Mapping
from typing import Final

from urproto.ports import CONTROLLER_PORTS

__all__ = ["PORTS"]

PORTS: Final[Mapping[str, int]] = {**CONTROLLER_PORTS, "control": 30080}  # a controller's, and one of our own
