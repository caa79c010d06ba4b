"""``--teleop.type=ur_leader``: a second arm, moved by hand or on a pendant, which another one follows."""

from dataclasses import dataclass
from typing import Any

from lerobot.teleoperators import Teleoperator, TeleoperatorConfig

from client.lerobot.devices.connected import ACTIONS, GRIPPER_KEY, JOINT_KEYS, JOINTS, TCP_KEYS, ConnectedArm
from client.robot import Robot
from urproto.errors import LocalProtocolError
from urproto.text import unknown


@TeleoperatorConfig.register_subclass("ur_leader")
@dataclass(kw_only=True)
class URLeaderConfig(TeleoperatorConfig):  # type: ignore[misc] # LeRobot has no types
    """``--teleop.type=ur_leader``: a second UR, in freedrive, or an emulator, jogged on its pendant or by a program.

    host: its address. action: as of the robot that follows. gripper_output: digital output that stands for a closed
    gripper; -1 for a robot without one.
    """

    host: str
    action: str = JOINTS
    gripper_output: int = -1

    def __post_init__(self) -> None:
        if self.action not in ACTIONS:
            raise ValueError(unknown("action", self.action, ACTIONS))


class URLeader(ConnectedArm, Teleoperator):  # type: ignore[misc] # LeRobot has no types
    """Where another arm is, is where the robot goes. The leader is not commanded."""

    config_class = URLeaderConfig
    name = "ur_leader"

    def __init__(self, config: URLeaderConfig) -> None:
        super().__init__(config)
        self.config = config

    @property
    def action_features(self) -> dict[str, Any]:
        keys = JOINT_KEYS if self.config.action == JOINTS else TCP_KEYS
        return dict.fromkeys((*keys, *((GRIPPER_KEY,) if self.config.gripper_output >= 0 else ())), float)

    @property
    def feedback_features(self) -> dict[str, Any]:
        return {}

    def connect(self, calibrate: bool = True) -> None:
        """Connect. Raises ClientError."""
        if self.is_connected:
            raise LocalProtocolError(f"{self} is connected already")
        robot = Robot(self.config.host)
        robot.__enter__()
        self._robot = robot

    def get_action(self) -> dict[str, Any]:
        """Where it is now. Raises ClientError, among others for a state that is too old."""
        if self._robot is None:
            raise LocalProtocolError(f"{self} is not connected: connect() first")
        place = self._robot.q if self.config.action == JOINTS else self._robot.tcp_pose
        if self.config.gripper_output < 0:
            return dict(zip(self.action_features, place, strict=True))
        closed = float(self._robot.digital_out(self.config.gripper_output))
        return dict(zip(self.action_features, (*place, closed), strict=True))

    def send_feedback(self, feedback: dict[str, Any]) -> None: ...

    def disconnect(self) -> None:
        """Disconnect."""
        robot, self._robot = self._robot, None
        if robot is not None:
            robot.__exit__(None, None, None)
