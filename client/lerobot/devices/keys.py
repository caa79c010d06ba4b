"""Names of the numbers in observations and actions."""

from typing import Final

from urproto.joints import JOINT_NAMES

JOINTS, TCP = "joints", "tcp"
ACTIONS: Final = (JOINTS, TCP)
GRIPPER_KEY: Final = "gripper.pos"
JOINT_KEYS: Final = tuple(f"{name}.pos" for name in JOINT_NAMES)
TCP_KEYS: Final = tuple(f"tcp.{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz"))
