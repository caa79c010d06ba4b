"""What an arm is for LeRobot, whether it leads or follows: always calibrated, and with names for its numbers."""

from typing import Final

from client.robot import Robot
from urproto.joints import JOINT_NAMES

JOINTS, TCP = "joints", "tcp"
ACTIONS: Final = (JOINTS, TCP)
GRIPPER_KEY: Final = "gripper.pos"
JOINT_KEYS: Final = tuple(f"{name}.pos" for name in JOINT_NAMES)
TCP_KEYS: Final = tuple(f"tcp.{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz"))


class ConnectedArm:
    """An arm that is never calibrated or configured from here."""

    _robot: Robot | None = None

    @property
    def is_connected(self) -> bool:
        return self._robot is not None

    @property
    def is_calibrated(self) -> bool:
        return True

    def calibrate(self) -> None: ...

    def configure(self) -> None: ...
