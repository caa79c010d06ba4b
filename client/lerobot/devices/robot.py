"""``--robot.type=ur``: an arm, real or emulated, as a robot of LeRobot."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

from lerobot.cameras import CameraConfig, make_cameras_from_configs
from lerobot.cameras.camera import Camera
from lerobot.robots import Robot as LeRobot
from lerobot.robots import RobotConfig

from client.lerobot.devices.connected import ACTIONS, GRIPPER_KEY, JOINT_KEYS, JOINTS, TCP_KEYS, ConnectedArm
from client.lerobot.grippers import GRIPPERS, FollowingGripper
from client.robot import Robot
from client.robot.waypoints import MAX_SPEED_M_S, MAX_SPEED_RAD_S, WaypointFollower
from urproto.errors import LocalProtocolError, URError
from urproto.text import unknown


@RobotConfig.register_subclass("ur")
@dataclass(kw_only=True)
class URConfig(RobotConfig):  # type: ignore[misc] # LeRobot has no types
    """``--robot.type=ur``.

    host: the robot's address, or an emulator's. action: ``joints``, angles [rad], or ``tcp``, a pose base to TCP [m,
    rotation vector]. fps: of actions; each is approached for ``1 / fps``. gripper: ``robotiq``, ``digital`` (a digital
    output closes it: gripper_output), or none. max_speed_*: actions that ask for more are slowed. lookahead_s, gain: as
    of `Robot.servo_j`.
    """

    host: str
    action: str = JOINTS
    fps: float = 30.0
    gripper: str = ""
    gripper_output: int = 0
    max_speed_rad_s: float = MAX_SPEED_RAD_S
    max_speed_m_s: float = MAX_SPEED_M_S
    lookahead_s: float | None = None
    gain: float | None = None
    cameras: dict[str, CameraConfig] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.action not in ACTIONS:
            raise ValueError(unknown("action", self.action, ACTIONS))
        if self.gripper not in ("", *GRIPPERS):
            raise ValueError(unknown("gripper", self.gripper, GRIPPERS))
        if not self.fps > 0.0:
            raise ValueError(f"fps must be greater than 0, not {self.fps}")


class UR(ConnectedArm, LeRobot):  # type: ignore[misc] # LeRobot has no types
    """A UR. It sees joint angles [rad], the TCP pose [m, rotation vector], gripper (0 open, 1 closed) and pictures."""

    config_class = URConfig
    name = "ur"

    def __init__(self, config: URConfig) -> None:
        super().__init__(config)
        self.config = config
        self.cameras: dict[str, Camera] = make_cameras_from_configs(config.cameras)
        self._open = ExitStack()
        self._waypoints: WaypointFollower | None = None
        self._gripper: FollowingGripper | None = None
        self._reported: BaseException | None = None

    @property
    def observation_features(self) -> dict[str, Any]:
        pictures = {name: (camera.height, camera.width, 3) for name, camera in self.config.cameras.items()}
        return dict.fromkeys((*JOINT_KEYS, *TCP_KEYS, *self._gripper_keys), float) | pictures

    @property
    def action_features(self) -> dict[str, Any]:
        return dict.fromkeys((*self._moved_keys, *self._gripper_keys), float)

    def connect(self, calibrate: bool = True) -> None:
        """Connect, switch the robot on where it is off, and hold the arm where it is. Raises URError."""
        if self.is_connected:
            raise LocalProtocolError(f"{self} is connected already")
        config = self.config
        with ExitStack() as opening:
            robot = opening.enter_context(Robot(config.host))
            robot.make_ready()
            for camera in self.cameras.values():
                camera.connect()
                opening.callback(camera.disconnect)
            if config.gripper:
                gripper = GRIPPERS[config.gripper](robot, config.host, config.gripper_output)
                self._gripper = opening.enter_context(gripper)
            arm: Any = (
                robot.waypoints_j(
                    max_speed_rad_s=config.max_speed_rad_s, lookahead_s=config.lookahead_s, gain=config.gain
                )
                if config.action == JOINTS
                else robot.waypoints_pose(
                    max_speed_m_s=config.max_speed_m_s, lookahead_s=config.lookahead_s, gain=config.gain
                )
            )
            self._waypoints = opening.enter_context(arm)
            self._open, self._robot = opening.pop_all(), robot

    def disconnect(self) -> None:
        """Bring the arm to rest and disconnect. Raises what ended the motion, unless `send_action` has."""
        self._robot = self._waypoints = self._gripper = None
        try:
            self._open.close()
        except URError:
            if self._reported is None:
                raise

    def get_observation(self) -> dict[str, Any]:
        """The newest state and pictures. Raises URError, among others for a state that is too old."""
        if self._robot is None:
            raise self._not_connected
        places = (*self._robot.q, *self._robot.tcp_pose)
        seen: dict[str, Any] = dict(zip((*JOINT_KEYS, *TCP_KEYS), places, strict=True))
        if self._gripper is not None:
            seen[GRIPPER_KEY] = self._gripper.position
        return seen | {name: camera.read_latest() for name, camera in self.cameras.items()}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Approach an action, and return it. Raises URError: out of reach, not finite, or what stopped the arm."""
        if self._waypoints is None:
            raise self._not_connected
        try:
            self._waypoints.send(_numbers(action, self._moved_keys), 1.0 / self.config.fps)
            if self._gripper is not None:
                (position,) = _numbers(action, (GRIPPER_KEY,))
                self._gripper.follow(position)
        except URError as error:
            self._reported = error
            raise
        return {key: float(action[key]) for key in self.action_features}

    @property
    def _not_connected(self) -> LocalProtocolError:
        return LocalProtocolError(f"{self} is not connected: connect() first")

    @property
    def _moved_keys(self) -> tuple[str, ...]:
        return JOINT_KEYS if self.config.action == JOINTS else TCP_KEYS

    @property
    def _gripper_keys(self) -> tuple[str, ...]:
        return (GRIPPER_KEY,) if self.config.gripper else ()


def _numbers(action: dict[str, Any], keys: Sequence[str]) -> list[float]:
    if missing := [key for key in keys if key not in action]:
        raise LocalProtocolError(f"an action must have {', '.join(keys)}: it lacks {', '.join(missing)}")
    return [float(action[key]) for key in keys]
