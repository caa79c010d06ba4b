"""Configuration of a driver."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, get_args, get_type_hints

from client import dashboard, primary, robotapi, rtde
from client.calibration import parameters
from client.driver.control_program import ToolCommunicationSettings
from client.driver.results import COMMAND_PORT, TRAJECTORY_PORT
from client.driver.reverse import KEEP_ALIVE_TIMEOUT_S, MAX_REAL_TIME_S, REVERSE_PORT
from client.driver.scheduling import RealTime
from client.driver.script_sender import SENDER_PORT
from client.quantities import check_fields
from urproto import robots
from urproto.modes import KinematicsStatus
from urproto.primary.subpackages import KinematicsInfo
from urproto.robots import Calibration

ROBOT_PORTS: Final[Mapping[str, int]] = {
    "dashboard": dashboard.PORT,
    "robot api": robotapi.PORT,
    "primary": primary.PORT,
    "rtde": rtde.PORT,
}
"""The ports of a robot that a driver connects to."""
_SETTINGS: Final = ("own_address", "listen_on", "reverse_port", "sender_port", "trajectory_port", "command_port",
                    "frequency_hz", "keep_alive_timeout_s", "max_age_s", "servoj_lookahead_s", "servoj_gain",
                    "tool_voltage")  # fmt: skip


def robot_ports(offset: int) -> dict[str, int]:
    """These ports, for ``DriverConfig.robot_ports``, of an emulator with this --port-offset."""
    return {name: port + offset for name, port in ROBOT_PORTS.items()}


def calibration_hash(kinematics: KinematicsInfo) -> str:
    """Hash of these calibration parameters, identical to the one in ur_description's files and the vendor's driver."""
    return robots.calibration_hash(parameters(kinematics))


def calibration_problem(kinematics: KinematicsInfo, expected: Calibration | str | None) -> str | None:
    """Say what is wrong with the calibration, and what to do; None if nothing is."""
    if kinematics.status == KinematicsStatus.NOT_LINEARISED:
        return f"its calibration status is {kinematics.status}: calibrate the robot or restore its calibration"
    found = calibration_hash(kinematics)
    wanted = expected.hash if isinstance(expected, Calibration) else expected
    if wanted is not None and found != wanted:
        return (
            f"its calibration is {found}, not {wanted}: this is another arm, or it was calibrated again. If it is the "
            "right one, read its calibration with `ur-client calibration`"
        )
    return None


def read_settings(texts: Iterable[str]) -> dict[str, Any]:
    """Read fields of `DriverConfig` from texts ``name=value``; ``tool_communication.baud_rate`` is a field of a field.

    Raises ValueError, which names the text, for an unknown name and for a value of another type.
    """
    of_driver, of_line = get_type_hints(DriverConfig), get_type_hints(ToolCommunicationSettings)
    types = {name: of_driver[name] for name in _SETTINGS}
    types |= {f"tool_communication.{name}": kind for name, kind in of_line.items()}
    kinds = {name: next(iter(get_args(kind)), kind) for name, kind in types.items()}  # without the None of an optional
    settings: dict[str, Any] = {}
    line: dict[str, Any] = {}
    for text in texts:
        name, found, value = text.partition("=")
        outer, _, inner = name.rpartition(".")
        if not found or name not in kinds:
            names = ", ".join(kinds)
            raise ValueError(f"{text!r} is not a setting of the driver, such as reverse_port=50001. There are {names}")
        try:
            (line if outer else settings)[inner] = kinds[name](value)
        except ValueError as error:
            raise ValueError(f"{text!r}: {error}") from None
    return {**settings, **({"tool_communication": ToolCommunicationSettings(**line)} if line else {})}


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverConfig:
    """How the driver reaches a robot and how the robot reaches the driver.

    Addresses and the control program:

    - host: address of the robot.
    - headless: True if the driver sends the control program itself. Otherwise the robot's External Control URCap
      fetches it when the robot plays ``program``, which the driver loads and plays through the dashboard; None plays
      the program that is already loaded.
    - own_address: the driver's address as the robot sees it; None determines it.
    - listen_on: local address on which the four ports listen; None for own_address.
    - restart: start the control program again if it ended only because this machine was late. The arm then rests until
      the next motion.

    Data received from the robot:

    - outputs: RTDE variables to receive in addition to those the driver needs.
    - outputs_if_any: further RTDE variables, received only if the robot offers them.
    - frequency_hz: rate of the states [Hz]; None for the robot's maximum.
    - max_age_s: states that are older [s] are not used: reading them raises StaleStateError (`client.Robot.q`), and
      controllers wait. Two periods of the states are allowed in addition.
    - silence_s: a robot that sends no state for this long [s] counts as frozen, and its program is disconnected.
    - calibration: the expected calibration of the robot, as `client.read_calibration` returns it, or its hash; None
      accepts any.

    Timing:

    - keep_alive_s: interval of the driver's keep-alive messages while it sends nothing else [s].
    - keep_alive_timeout_s: how long the control program waits for them [s].
    - start_timeout_s: how long to wait for the control program to connect after its start [s].
    - hang_s: an event loop that hangs for this long [s] ends the control program; 0 disables this. During a shorter
      hang the program is kept alive, and a motion continues.
    - realtime: real-time priority of the threads that feed the robot: "auto" takes it if allowed, "on" requires it,
      "off" does without.
    """

    host: str
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
    max_age_s: float = MAX_REAL_TIME_S
    silence_s: float = 1.0
    start_timeout_s: float = 5.0
    hang_s: float = 10.0
    restart: bool = True
    realtime: RealTime = "auto"
    calibration: Calibration | str | None = None
    servoj_lookahead_s: float = 0.03
    servoj_gain: int = 2000
    tool_voltage: int | None = None
    tool_communication: ToolCommunicationSettings | None = None

    def __post_init__(self) -> None:
        check_fields(self)
