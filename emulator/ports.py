"""Where each server of the emulator listens."""

from collections.abc import Mapping
from typing import Final

from urproto.ports import CAMERA_PORT, CONTROL_API_PORT, CONTROLLER_PORTS

PORTS: Final[Mapping[str, int]] = {
    **CONTROLLER_PORTS,
    "control": CONTROL_API_PORT,
    "cameras": CAMERA_PORT,
}  # a controller's, and two of our own
