"""Where each server listens on a controller."""

from collections.abc import Mapping
from typing import Final

from urproto.robotiq import PORT as GRIPPER_PORT

__all__ = ["PORTS"]

PORTS: Final[Mapping[str, int]] = {
    "modbus": 502,
    "dashboard": 29999,
    "primary": 30001,
    "secondary": 30002,
    "realtime": 30003,
    "rtde": 30004,
    "primary read-only": 30011,
    "secondary read-only": 30012,
    "realtime read-only": 30013,
    "interpreter": 30020,
    "control": 30080,  # this emulator's own
    "tool line": 54321,  # as the vendor's RS485 URCap has it
    "gripper": GRIPPER_PORT,
}
