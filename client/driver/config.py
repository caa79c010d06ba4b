"""What a driver is told about its robot."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from client import dashboard, primary, robotapi, rtde
from client.calibration import parameters
from client.driver.control_program import ToolCommunication
from client.driver.endpoint import KEEP_ALIVE_TIMEOUT_S, REVERSE_PORT, SENDER_PORT
from client.driver.results import COMMAND_PORT, TRAJECTORY_PORT
from client.driver.scheduling import RealTime
from urproto import robots
from urproto.modes import KinematicsStatus
from urproto.primary.state import KinematicsInfo
from urproto.robots import Calibration


def calibration_hash(kinematics: KinematicsInfo) -> str:
    """The name of these parameters, the same as in ur_description's files and in the vendor's driver."""
    return robots.calibration_hash(parameters(kinematics))


def calibration_problem(kinematics: KinematicsInfo, expected: Calibration | str | None) -> str | None:
    """What is wrong with the calibration, and what to do; None when nothing is."""
    if kinematics.status != KinematicsStatus.OK:
        return f"its calibration status is {kinematics.status}: calibrate the robot or restore its calibration"
    found = calibration_hash(kinematics)
    wanted = expected.hash if isinstance(expected, Calibration) else expected
    if wanted is not None and found != wanted:
        return (
            f"its calibration is {found}, not {wanted}: this is another arm, or it was calibrated again. If it is the "
            "right one, read its calibration with `ur-client calibration`"
        )
    return None


ROBOT_PORTS: Final[Mapping[str, int]] = {
    "dashboard": dashboard.PORT,
    "robot api": robotapi.PORT,
    "primary": primary.PORT,
    "rtde": rtde.PORT,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverConfig:
    """How to reach a robot and be reached by it.

    robot: its address. headless: the driver sends the program itself; otherwise the External
    Control URCap on the robot fetches it, from `program`, which the driver loads (None: the
    one that is loaded) and plays through the dashboard.
    own_address: the driver's address as the robot sees it; found by itself when None.
    listen_on: the own addresses the four ports are opened on, the own address when None.
    outputs: RTDE variables to receive beside those the driver needs; outputs_if_any: more of them, where the robot
    has them; frequency_hz: how often, None as often as the robot can.
    keep_alive_s: how often the driver says that it is alive while it has nothing to say;
    keep_alive_timeout_s: how long the program waits for that. silence_s: a robot whose state
    does not come for so long counts as frozen, and its program is disconnected.
    hang_s: an event loop that hangs for so long ends the control program; 0 never does. While it hangs for less the
    program is kept alive, and a motion goes on.
    restart: start the control program again when it ended only because this machine was late; the arm rests until
    somebody moves it.
    realtime: real-time priority for the threads that feed the robot: "auto" where it is allowed, "on" or else an
    error, "off" without.
    calibration: what the robot's calibration has to be, as `client.read_calibration` reads it, or its hash; None
    takes any.
    """

    robot: str
    headless: bool = True
    program: str | None = None
    own_address: str | None = None
    listen_on: str | None = None
    reverse_port: int = REVERSE_PORT
    sender_port: int = SENDER_PORT
    trajectory_port: int = TRAJECTORY_PORT
    command_port: int = COMMAND_PORT
    robot_ports: Mapping[str, int] = field(default_factory=lambda: dict(ROBOT_PORTS))
    outputs: tuple[str, ...] = ()
    outputs_if_any: tuple[str, ...] = ()
    frequency_hz: float | None = None
    keep_alive_s: float = 0.1
    keep_alive_timeout_s: float = KEEP_ALIVE_TIMEOUT_S
    silence_s: float = 1.0
    start_timeout_s: float = 5.0
    hang_s: float = 10.0
    restart: bool = True
    realtime: RealTime = "auto"
    calibration: Calibration | str | None = None
    servoj_lookahead_s: float = 0.03
    servoj_gain: int = 2000
    tool_voltage: int | None = None
    tool_communication: ToolCommunication | None = None
