"""Where each server listens on a controller."""

from collections.abc import Mapping
from typing import Final

from urproto.robotiq import PORT as GRIPPER_PORT

CONTROLLER_PORTS: Final[Mapping[str, int]] = {
    "dashboard": 29999,
    "primary": 30001,
    "secondary": 30002,
    "realtime": 30003,
    "rtde": 30004,
    "primary read-only": 30011,
    "secondary read-only": 30012,
    "realtime read-only": 30013,
    "interpreter": 30020,
    "modbus": 502,
    "robot api": 80,  # of PolyScope X, which has no dashboard instead
    "gripper": GRIPPER_PORT,
    "tool line": 54321,  # as the vendor's RS485 URCap has it
}

CONTROL_API_PORT: Final = 30080
"""Of an emulator; a controller has none."""

CAMERA_PORT: Final = 30081
"""Of an emulator whose scene may have cameras; a controller has none."""

PENDANT_PORT: Final = 6080
"""Where browsers find the teach pendant, as they find PolyScope's screen of the vendor's simulator."""
