"""Options of the ROS 2 driver."""

import re
from dataclasses import dataclass
from typing import Final

from client.controllers.running import ManagerOptions
from client.errors import Ros2Error
from urproto.ports import CAMERA_PORT
from urproto.robotiq import PORT as GRIPPER_PORT

_PREFIX: Final = re.compile(r"|[A-Za-z_][A-Za-z0-9_]*")


@dataclass(frozen=True)
class DriverOptions(ManagerOptions):
    """Options as in `ur_control.launch.py`, under this project's names.

    namespace: of all nodes. domain: ROS domain, None for ROS_DOMAIN_ID. dashboard_client, robot_state_publisher:
    whether there are nodes of these names. use_sim_time: stamps are the robot's time, which is published as ``/clock``.
    gripper: name in `urproto.robotiq.MODELS`; empty for none. cameras: names of the cameras to publish;
    `client.cameras.ALL_CAMERAS` for all. camera_port: the emulator's camera port. camera_hz: images per second of each.
    """

    namespace: str = ""
    domain: int | None = None
    ros_arguments: tuple[str, ...] = ()
    dashboard_client: bool = True
    robot_state_publisher: bool = True
    use_sim_time: bool = False
    gripper: str = ""
    gripper_port: int = GRIPPER_PORT
    cameras: tuple[str, ...] = ()
    camera_port: int = CAMERA_PORT
    camera_hz: float = 10.0

    def __post_init__(self) -> None:
        """Raise Ros2Error for an invalid tf_prefix."""
        if not _PREFIX.fullmatch(self.tf_prefix):
            raise Ros2Error(f"{self.tf_prefix!r} is not a valid prefix: use letters, digits and _, as in left_")
