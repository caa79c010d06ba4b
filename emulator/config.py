"""Configuration from options and files, checked: every error is reported in one line."""

import logging
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from emulator.machine import ControllerConfig
from emulator.physics import SCENE_FILES, PhysicsPlan, read_physics
from emulator.ports import PORTS
from emulator.realtime import RealTime
from emulator.robot.kinds import ArmKind
from emulator.safety.files import load_safety_file
from emulator.servers.admission import ClientLimits
from emulator.services.sockets import ScriptNetwork
from emulator.services.urcap import DriverAddress
from emulator.world.file import read_world
from emulator.world.world import Plan, WorldError
from urproto import robots
from urproto.addresses import is_loopback
from urproto.dashboard import AVAILABLE as DASHBOARD_SERVER
from urproto.extras import how_to_install
from urproto.facts import Personality
from urproto.interpreter import AVAILABLE as INTERPRETER_MODE
from urproto.joints import JOINT_NAMES
from urproto.ports import LAST_PORT
from urproto.robotapi import WEB_SERVER
from urproto.robotiq import MODELS, GripperModel
from urproto.robots import Calibration, CalibrationError, RobotModel, calibration_hash, load_model
from urproto.robots.drivetrain import Drivetrain, DrivetrainError
from urproto.robots.model import Joints
from urproto.rtde.fields import AVAILABLE as RTDE
from urproto.structures import InvalidYamlError, converted, load_yaml
from urproto.text import unknown
from urproto.vectors import as_six
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series
from urproto.worldfile import WorldFileError
from urscript.polyscope.safety_configuration import SafetyConfiguration, factory_configuration
from urscript.polyscope.safety_section import SafetySettingsError

if TYPE_CHECKING:
    from emulator.faults.fault import Fault

_FIRST_VERSION: Final = {  # the other ports are as old as the series
    "interpreter": INTERPRETER_MODE,
    "dashboard": DASHBOARD_SERVER,
    "robot api": WEB_SERVER,
    "rtde": RTDE,
}
_LOOPBACK: Final = "127.0.0.1"
_FASTEST_ENCODER: Final = 40_000  # ticks/s: what the controller's pulse decoder can count (Script Manual)


_logger = logging.getLogger(__name__)


class ConfigError(ValueError):
    """An option or a file is invalid, or does not fit the others."""


@contextmanager
def _refusing(kind: type[ValueError] = ValueError) -> Iterator[None]:
    """Raise errors of this kind as ConfigErrors with the same text."""
    try:
        yield
    except kind as error:
        raise ConfigError(str(error)) from error


@dataclass(frozen=True, kw_only=True)
class EmulatorConfig:
    """A controller, the addresses and ports it listens on, and the speed of its time.

    host: an address of this machine.
    port_offset: added to each of the usual ports. ephemeral_ports: use free ports instead.
    speed: simulated seconds per second of real time.
    realtime: whether the process asks the system for real-time priority and locked memory.
    script_network: addresses that sockets and remote procedure calls of scripts may connect to.
    modbus_unit_port: port of the Modbus units whose signals programs add (URScript names no port).
    robot_api_port: port of the Robot API of PolyScope X; None for port 80, changed by port_offset like the others.
    tool_device: the device on the tool's serial line of an e-Series arm: "echo", "pty", or the path of a serial port;
    None for no device, and no port for it.
    control: whether the control API is served. control_host: the address it listens on; "" for host, or 127.0.0.1 if
    host is reachable from other machines. control_token: a token that its clients must present; required if other
    machines can reach the API.
    client_limits: maximum number of clients of each port.
    faults: faults to inject, at the start or later.
    journal: file that records the run. stop_journals: whether the command writes the journals of unexpected stops.
    """

    controller: ControllerConfig
    host: str = "127.0.0.1"
    port_offset: int = 0
    ephemeral_ports: bool = False
    speed: float = 1.0
    realtime: RealTime = RealTime.AUTO
    script_network: ScriptNetwork = ScriptNetwork.ANY
    modbus_unit_port: int = 502
    robot_api_port: int | None = None
    tool_device: str | None = None
    control: bool = True
    control_host: str = ""
    control_token: str = ""
    client_limits: ClientLimits = field(default_factory=ClientLimits)
    faults: tuple["Fault", ...] = ()
    journal: Path | None = None
    stop_journals: bool = True

    def __post_init__(self) -> None:
        if not 0.0 < self.speed < math.inf:
            raise ConfigError(f"the speed must be a positive number, not {self.speed}")
        if self.realtime is RealTime.ON and self.speed != 1.0:
            raise ConfigError(f"--realtime on requires a speed of 1, not {self.speed:g}: leave out one of them")
        if self.tool_device is not None and self._version.series is not Series.E:
            raise ConfigError(f"{self.controller.model.title} has no serial line at its tool: leave out --tool-device")
        most = LAST_PORT - max(PORTS[name] for name in self._port_names)
        if not 0 <= self.port_offset <= most:
            raise ConfigError(f"the port offset must be from 0 to {most}, not {self.port_offset}")
        if self.control and not self.control_token and not is_loopback(self.host_of("control")):
            raise ConfigError(f"anybody could use the control API on {self.control_host}: set --control-token")
        if self.robot_api_port is not None and "robot api" not in self._port_names:
            raise ConfigError(f"PolyScope {self._version.short} has no Robot API: leave out --robot-api-port")
        if self.robot_api_port is not None and not 0 <= self.robot_api_port <= LAST_PORT:
            raise ConfigError(f"the Robot API's port must be from 0 to {LAST_PORT}, not {self.robot_api_port}")
        if not 1 <= self.modbus_unit_port <= LAST_PORT:
            raise ConfigError(f"the port of Modbus units must be from 1 to {LAST_PORT}, not {self.modbus_unit_port}")

    @property
    def wanted_ports(self) -> dict[str, int]:
        """The port that each server of this configuration is to listen on, by its name; 0 for any free port."""
        ports = {name: 0 if self.ephemeral_ports else PORTS[name] + self.port_offset for name in self._port_names}
        return ports if self.robot_api_port is None else {**ports, "robot api": self.robot_api_port}

    @property
    def movable(self) -> tuple[str, ...]:
        """Servers that use a free port if theirs is in use, or reserved for administrators."""
        return ("modbus", "control") if self.robot_api_port is not None else ("modbus", "control", "robot api")

    def host_of(self, server: str) -> str:
        """The address that a server listens on, by the server's name."""
        if server != "control":
            return self.host
        return self.control_host or (self.host if is_loopback(self.host) else _LOOPBACK)

    @property
    def _has_physics(self) -> bool:
        return isinstance(self.controller.world, PhysicsPlan)

    @property
    def _version(self) -> PolyscopeVersion:
        return self.controller.version or DEFAULT_VERSION[self.controller.model.series]

    @property
    def _port_names(self) -> list[str]:
        switched = {
            "tool line": self.tool_device is not None,
            "gripper": self.controller.gripper is not None,
            "control": self.control,
            "cameras": self._has_physics,
        }
        there = (name for name in PORTS if switched.get(name, True))
        return [name for name in there if name not in _FIRST_VERSION or _FIRST_VERSION[name].covers(self._version)]


def controller_config(
    model: str | None = None,
    *,
    polyscope: str | None = None,
    calibration: Path | str | None = None,
    initial_positions: Path | str | None = None,
    programs: Path | str | None = None,
    enforce_remote_control: bool = False,
    encoder0_speed: float = 0.0,
    encoder1_speed: float = 0.0,
    arm: str = ArmKind.IDEAL,
    gripper: str | None = None,
    gripper_object: float | None = None,
    safety: Path | str | SafetyConfiguration | None = None,
    external_control: str | None = None,
    world: Path | str | Plan | None = None,
    physics: bool = False,
    personality: str = Personality.URSIM,
    **fields: Any,
) -> ControllerConfig:
    """Create the configuration of a controller from the options of ``ur-emulator``, which have the same names here.

    ``fields``: any fields of `ControllerConfig`, by name. Files are read and values checked. Raises ConfigError, and
    TypeError for a name that is neither an option nor a field.
    """
    given = {name: value for name, value in locals().items() if name not in ("model", "fields")} | fields
    chosen, dynamic = choose_arm(model, polyscope, arm)
    if dynamic and find_spec("pinocchio") is None:
        _logger.warning("without Pinocchio, a dynamic arm takes five times the time: %s", how_to_install("pinocchio"))
    with _refusing():
        version = robots.choose_version(polyscope, chosen)
        driver = DriverAddress() if external_control is None else DriverAddress.parse(external_control)
    if fields.get("self_collision"):
        require_coal("--self-collision")
    identity = ControllerConfig(model=chosen, version=version, personality=Personality(personality))
    if (q_rad := fields.pop("initial_q", None)) is None:
        path = _path(initial_positions)
        q_rad = identity.start_q if path is None else read_initial_positions(path, chosen)
    if (speeds := fields.pop("encoder_speeds", None)) is None:
        speeds = (encoder0_speed, encoder1_speed)
    mounted = choose_gripper(gripper, gripper_object)
    if world is None or isinstance(world, Path | str):
        surroundings = read_surroundings(_path(world), physics=physics, gripper=mounted, object_mm=gripper_object)
    else:
        surroundings = world
    if surroundings is not None:
        with _refusing(WorldError):
            surroundings.check(chosen, q_rad)
    return replace(
        identity,
        model=read_calibration(_path(calibration), chosen),
        initial_q=as_six(q_rad),
        programs_dir=read_programs_dir(_path(programs)),
        enforce_remote_control=check_enforced_remote_control(enforce_remote_control, chosen),
        encoder_speeds=check_encoder_speeds(*speeds),
        gripper=mounted,
        gripper_object_mm=gripper_object,
        safety=safety if isinstance(safety, SafetyConfiguration) else read_safety(_path(safety), chosen),
        external_control=driver,
        world=surroundings,
        options=given,
        **{"dynamic": dynamic, **fields},
    )


def _path(value: Path | str | None) -> Path | None:
    return None if value is None else Path(value)


@_refusing()
def choose_model(name: str | None, polyscope: str | None = None) -> RobotModel:
    """The arm of this name; by default a UR3, or a UR3e if the requested version is of the e-Series.

    Raises ConfigError listing the known arms.
    """
    return load_model((name or robots.default_model(polyscope)).lower())


def choose_arm(name: str | None, polyscope: str | None, arm: str) -> tuple[RobotModel, bool]:
    """The model, and whether it is dynamic. ``arm``: ideal, dynamic, or a file written by ``ur-client identify``.

    Raises ConfigError.
    """
    if arm in list(ArmKind):
        return choose_model(name, polyscope), arm == ArmKind.DYNAMIC
    path = Path(arm)
    if not path.exists() and not path.suffix:
        raise ConfigError(f"arm {arm!r} is neither {' nor '.join(ArmKind)} nor an existing file")
    values = read_yaml(path)
    if not isinstance(values, dict) or not isinstance(values.get("model"), str):
        raise ConfigError(f"{path} is not an arm file: model is missing. ur-client identify writes such files")
    chosen = choose_model(name or values["model"], polyscope)
    if chosen.name != values["model"]:
        raise ConfigError(f"{path} describes a {values['model']}, not a {chosen.name}: leave out --model")
    try:
        return replace(chosen, drivetrain=Drivetrain.from_mapping(values)), True
    except DrivetrainError as error:
        raise ConfigError(f"{path}: {error}") from error


def read_calibration(path: Path | None, model: RobotModel) -> RobotModel:
    """The arm with the calibration from a YAML file, in ur_description's format or as lists of DH parameters.

    A file with nominal parameters, such as ur_description's default_kinematics.yaml, has no effect. Raises ConfigError
    if the file contains no calibration, or that of another model.
    """
    if path is None:
        return model
    try:
        calibration = Calibration.from_mapping(read_yaml(path), str(path))
        calibration.check_model(model)
    except CalibrationError as error:
        raise ConfigError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from error
    if not calibration.is_whole:
        _logger.warning(
            "%s: its hash is %s, but that of its parameters is %s: the robot reports the latter",
            *(path, calibration.hash, calibration_hash(calibration.dh)),
        )
    nominal = calibration_hash(calibration.dh) == calibration_hash(model.dh)
    return model if nominal else replace(model, calibration=calibration.dh)


def read_yaml(path: Path) -> Any:
    """The content of a YAML file. Raises ConfigError."""
    try:
        return load_yaml(path.read_bytes())
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error
    except InvalidYamlError as error:
        raise ConfigError(f"{path} is not YAML: {error}") from error


def read_initial_positions(path: Path, model: RobotModel) -> Joints:
    """Joint angles [rad] from a YAML file of joint names, such as ur_description's.

    Raises ConfigError if the file is unreadable, does not name exactly the six joints, or contains an angle outside
    the joint limits.
    """
    content = read_yaml(path)
    if not isinstance(content, dict) or set(content) != set(JOINT_NAMES):
        raise ConfigError(f"{path} must give radians for each of {', '.join(JOINT_NAMES)}, and nothing else")
    q_rad = [converted(content[name], float, f"{path}: {name}", ConfigError) for name in JOINT_NAMES]
    for name, angle, low, high in zip(JOINT_NAMES, q_rad, model.q_min, model.q_max, strict=True):
        if not low <= angle <= high:
            raise ConfigError(f"{path}: {name} is {angle:g} rad; {model.title} allows {low:.3f} to {high:.3f} rad")
    return as_six(q_rad)


def choose_gripper(name: str | None, object_mm: float | None) -> GripperModel | None:
    """The gripper of this name, if any. Raises ConfigError if it is unknown, or cannot hold the object."""
    if name is None:
        if object_mm is not None:
            raise ConfigError("--gripper-object has no effect without a gripper: add --gripper")
        return None
    model = MODELS.get(name.lower())
    if model is None:
        raise ConfigError(unknown("gripper", name, MODELS))
    if object_mm is not None and not 0.0 < object_mm < model.stroke_mm:
        raise ConfigError(
            f"the object must be wider than 0 and narrower than {model.stroke_mm:g} mm, not {object_mm:g}"
        )
    return model


def check_encoder_speeds(*ticks_per_s: float) -> tuple[float, float]:
    """Speeds of encoder 0 and 1 [ticks/s]. Raises ConfigError for a speed that the controller cannot count."""
    for index, speed in enumerate(ticks_per_s):
        if not abs(speed) <= _FASTEST_ENCODER:
            raise ConfigError(
                f"the speed of encoder {index} must be from -{_FASTEST_ENCODER} to {_FASTEST_ENCODER} ticks/s"
            )
    first, second = ticks_per_s
    return first, second


def check_client_limits(port: int, address: int | None) -> ClientLimits:
    """Limits on the clients of a port, in total and from one address (by default half). Raises ConfigError."""
    if port < 1:
        raise ConfigError(f"a port must accept at least 1 client, not {port}")
    if address is None:
        return ClientLimits(port, max(1, port // 2))
    if not 1 <= address <= port:
        raise ConfigError(f"the limit of clients from one address must be from 1 to {port}, not {address}")
    return ClientLimits(port, address)


def check_enforced_remote_control(wanted: bool, model: RobotModel) -> bool:
    """Return ``wanted``. Raises ConfigError for an arm without local and remote control."""
    if wanted and model.series is not Series.E:
        raise ConfigError(
            f"{model.title} is a {model.series.value} arm without remote control: leave out --enforce-remote-control"
        )
    return wanted


def read_programs_dir(path: Path | None) -> Path | None:
    """The absolute path of an existing folder. Raises ConfigError if it is not a folder."""
    if path is None:
        return None
    if not path.is_dir():
        raise ConfigError(f"--programs: {path} is not a folder")
    return path.resolve()


def read_safety(path: Path | None, model: RobotModel) -> SafetyConfiguration | None:
    """The safety configuration in a file, or "factory"; None for that of a simulator. Raises ConfigError."""
    if path is None:
        return None
    if path == Path("factory"):
        return factory_configuration(model)
    try:
        with _refusing(SafetySettingsError):
            return load_safety_file(path, model)
    except (OSError, UnicodeError) as error:
        raise ConfigError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from error


def read_surroundings(
    path: Path | None,
    *,
    physics: bool = False,
    gripper: GripperModel | None = None,
    object_mm: float | None = None,
) -> Plan | None:
    """The objects around the arm, from a world file, or an MJCF or URDF scene, which always has physics.

    Raises ConfigError.
    """
    if path is None:
        if physics:
            raise ConfigError("--physics needs a scene: add --world with a world file, MJCF or URDF")
        return None
    moves = physics or path.suffix.lower() in SCENE_FILES
    if moves and object_mm is not None:
        raise ConfigError("with physics the gripper grips the objects of the world: leave out --gripper-object")
    try:
        with _refusing(WorldFileError):
            plan: Plan = read_world(path) if not moves else read_physics(path, gripper)
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error
    if plan.links and not moves:
        require_coal(f"links: true in {path}")
    return plan


def require_coal(option: str) -> None:
    """Raises ConfigError if coal, the collision library that comes with Pinocchio, is not installed."""
    if find_spec("coal") is None:
        raise ConfigError(
            f"{option} needs Pinocchio: {how_to_install('pinocchio')}; on native Windows, which has "
            "no packages of it, use WSL, a container or another machine"
        )


def read_faults(texts: Sequence[str]) -> tuple["Fault", ...]:
    """Faults from their texts on the command line. Raises ConfigError."""
    from emulator.faults.catalogue import parse_fault  # imported here: `urscript run` rarely needs it
    from emulator.faults.fault import FaultError

    try:
        return tuple(map(parse_fault, texts))
    except FaultError as error:
        raise ConfigError(f"fault: {error}") from error
