"""What LeRobot imports to find the robot ``ur``, the teleoperator ``ur_leader`` and cameras ``ur_emulator``."""

from client.lerobot.devices import (
    UR,
    URConfig,
    UREmulatorCamera,
    UREmulatorCameraConfig,
    URLeader,
    URLeaderConfig,
)

__all__ = ["UR", "URConfig", "UREmulatorCamera", "UREmulatorCameraConfig", "URLeader", "URLeaderConfig"]
