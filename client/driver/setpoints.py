"""Setpoints: one message a control period or so, followed at once."""

from collections.abc import Sequence

from client.driver.core import DriverCore
from client.driver.timeouts import LONGEST_REAL_TIME_S
from urproto.external_control import ControlMode, FreedriveAction

__all__ = ["Setpoints"]


class Setpoints(DriverCore):
    """Servoing, speeds, torques and freedrive.

    timeout_s: how long the robot waits for the next message before it stops the arm, from one
    control period to 0.2 s. Until `idle`, or another mode, the next one has to come within it; one
    that comes later is not sent but a LateSetpointError, and the program goes on. May be called from
    any thread. Raises ProgramNotRunningError, LocalProtocolError and, for what this version does not
    have, RobotRefused.
    """

    def servoj(self, q_rad: Sequence[float], timeout_s: float = LONGEST_REAL_TIME_S) -> None:
        """Joint angles (6,) [rad] to be at one control period from now."""
        self.reverse.setpoint(ControlMode.SERVOJ, q_rad, timeout_s)

    def servo_pose(self, pose_base_tcp: Sequence[float], timeout_s: float = LONGEST_REAL_TIME_S) -> None:
        """Pose of the TCP in the base frame (6,) [m, rotation vector], reached by the nearest joint angles."""
        self.reverse.setpoint(ControlMode.POSE, pose_base_tcp, timeout_s)

    def speedj(self, qd_rad_s: Sequence[float], timeout_s: float = LONGEST_REAL_TIME_S) -> None:
        """Joint speeds (6,) [rad/s]."""
        self.reverse.setpoint(ControlMode.SPEEDJ, qd_rad_s, timeout_s)

    def speedl(self, velocity_base: Sequence[float], timeout_s: float = LONGEST_REAL_TIME_S) -> None:
        """Velocity of the TCP in the base frame (6,) [m/s, rad/s]."""
        self.reverse.setpoint(ControlMode.SPEEDL, velocity_base, timeout_s)

    def torque(self, torque_Nm: Sequence[float], timeout_s: float = LONGEST_REAL_TIME_S) -> None:
        """Joint torques (6,) [Nm] on top of what gravity needs; from 5.23 on."""
        self._require("torque")
        self.reverse.setpoint(ControlMode.TORQUE, torque_Nm, timeout_s)

    def idle(self) -> None:
        """Bring the arm to rest and keep the program running, for as long as the driver lives."""
        self.reverse.keep_alive(self.config.keep_alive_timeout_s)

    def start_freedrive(self) -> None:
        """Let the arm be moved by hand until `stop_freedrive`, `idle` or another mode."""
        self.reverse.freedrive(FreedriveAction.START, self.config.keep_alive_timeout_s)

    def keep_freedrive(self) -> None:
        """Say that freedrive goes on; the driver does so by itself too."""
        self.reverse.freedrive(FreedriveAction.NOOP, self.config.keep_alive_timeout_s)

    def stop_freedrive(self) -> None:
        """Hold the arm where it is."""
        self.reverse.freedrive(FreedriveAction.STOP, self.config.keep_alive_timeout_s)
