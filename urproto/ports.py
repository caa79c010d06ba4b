"""Ports of the servers on a controller."""

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
    "robot api": 80,  # PolyScope X only, instead of the dashboard
    "gripper": GRIPPER_PORT,
    "tool line": 54321,  # as in the vendor's RS485 URCap
}

LAST_PORT: Final = 65535
"""Highest number of a port."""

CONTROL_API_PORT: Final = 30080
"""Only on an emulator."""

CAMERA_PORT: Final = 30081
"""Only on an emulator whose scene may have cameras."""

PENDANT_PORT: Final = 6080
"""Port of the teach pendant for browsers, the same as for PolyScope's screen in the vendor's simulator."""
