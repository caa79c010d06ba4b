"""A UR as a robot of LeRobot, a second one that leads it by hand, and an emulator's cameras; needs ``lerobot``.

LeRobot finds them by the distribution ``lerobot_robot_ur`` (integrations/lerobot_robot_ur), and its commands take them
as ``--robot.type=ur``, ``--teleop.type=ur_leader`` and cameras of ``type: ur_emulator``. Its base classes, and what
their methods mean, are LeRobot's.
"""

from client.lerobot.devices.camera import UREmulatorCamera, UREmulatorCameraConfig
from client.lerobot.devices.leader import URLeader, URLeaderConfig
from client.lerobot.devices.robot import UR, URConfig

__all__ = ["UR", "URConfig", "UREmulatorCamera", "UREmulatorCameraConfig", "URLeader", "URLeaderConfig"]
