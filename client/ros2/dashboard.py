"""The node ``dashboard_client``: a service for each command of a robot's dashboard.

Names, types and results are those of the ROS 2 driver. A service whose command takes time answers when a query of the
dashboard shows the effect (`Effect`). The message of a response is the robot's line; without success, it says what is
wrong and what to do about it.
"""

import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Any, Final

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from std_srvs.srv import Trigger

from client import dashboard, robotapi
from client.dashboard import BlockingDashboardClient, Operation
from client.driver import DriverConfig
from client.errors import ClientError, ConnectionLostError, FileError, RobotUnreachableError
from client.robotapi import BlockingRobotAPIClient
from client.ros2.host import HostedNode, NodeHost, interface_if_any
from urproto.dashboard import ProgramState
from urproto.durable import write_file
from urproto.errors import RemoteProtocolError, RobotRefused, URError
from urproto.modes import RobotMode

NAME: Final = "dashboard_client"
# source of these four: the ROS 2 driver and its client library
_RECEIVE_TIMEOUT_S: Final = 20.0  # default of the parameter
_EFFECT_S: Final = 30.0  # time limit for an effect
_POWER_ON_S: Final = 300.0  # the same for power_on, whose command is repeated
_POWER_ON_RETRY_S: Final = 1.0  # interval at which it is repeated
_POLL_S: Final = 0.1
_MAX_UINT64: Final = 2**64 - 1  # uint64
_POLYSCOPE_X: Final = "this robot has no Robot API"
_NOT_POLYSCOPE_X: Final = "it is for PolyScope X: elsewhere, copy programs to the robot's folder and use load_program"
_PROGRAM_STATE: Final = replace(  # with the name that the robot gives no program
    dashboard.PROGRAM_STATE, read=lambda reply: (dashboard.PROGRAM_STATE.read(reply)[0], reply.partition(" ")[2])
)


@dataclass(frozen=True)
class Effect:
    """How to see that a command has taken effect.

    query: the query to repeat. seen: whether its answer shows the effect of the request. within_s: time limit.
    again_s: time without effect after which the command is sent again.
    """

    query: Operation[Any]
    seen: Callable[[Any, Any], bool]
    within_s: float = _EFFECT_S
    again_s: float = math.inf


@dataclass(frozen=True)
class DashboardService:
    """A row of the table.

    type: in std_srvs or ur_dashboard_msgs. operation: the dashboard operation for a request. values: dotted names of
    fields of the response, and functions that take their values from the answer. parts: whether the robot closes the
    connection afterwards.
    """

    name: str
    type: str
    operation: Callable[[Any], Operation[Any]]
    values: Mapping[str, Callable[[Any], Any]] = field(default_factory=lambda: MappingProxyType({}))
    effect: Effect | None = None
    parts: bool = False


def _always(operation: Operation[Any]) -> Callable[[Any], Operation[Any]]:
    return lambda request: operation


def _mode(*modes: RobotMode, **more: float) -> Effect:
    return Effect(dashboard.ROBOT_MODE, lambda mode, request: mode in modes, **more)


def _state(state: ProgramState) -> Effect:
    return Effect(dashboard.PROGRAM_STATE, lambda program, request: program[0] is state)


def _has_loaded(program: "tuple[ProgramState, str | None]", request: Any) -> bool:
    return program == (ProgramState.STOPPED, PurePosixPath(request.filename).name)


def _with_program(operation: Operation[Any], name: Callable[[Any], str | None]) -> Operation[Any]:
    """An operation that fails if its answer does not name a program."""

    def read(reply: str) -> Any:
        answer = operation.read(reply)
        if name(answer) is None:
            raise RemoteProtocolError(f"{reply!r} names no program")
        return answer

    return replace(operation, read=read)


def _trigger(
    name: str, operation: Operation[Any], effect: Effect | None = None, *, parts: bool = False
) -> DashboardService:
    return DashboardService(name, "Trigger", _always(operation), effect=effect, parts=parts)


def _query(name: str, of_type: str, operation: Operation[Any], **values: Callable[[Any], Any]) -> DashboardService:
    return DashboardService(
        name, of_type, _always(operation), {path.replace("__", "."): of for path, of in values.items()}
    )


def _identity(answer: Any) -> Any:
    return answer


def _second(answer: Any) -> Any:
    return answer[1]


_OFF: Final = _mode(RobotMode.POWER_OFF)
_ON: Final = _mode(RobotMode.IDLE, RobotMode.RUNNING, within_s=_POWER_ON_S, again_s=_POWER_ON_RETRY_S)
_RUNNING: Final = _mode(RobotMode.RUNNING)


SERVICES: Final = (
    _trigger("power_on", dashboard.POWER_ON, _ON),
    _trigger("power_off", dashboard.POWER_OFF, _OFF),
    _trigger("brake_release", dashboard.BRAKE_RELEASE, _RUNNING),
    _trigger("unlock_protective_stop", dashboard.UNLOCK_PROTECTIVE_STOP, _RUNNING),
    _trigger("restart_safety", dashboard.RESTART_SAFETY, _OFF),
    _trigger("play", dashboard.PLAY, _state(ProgramState.PLAYING)),
    _trigger("pause", dashboard.PAUSE, _state(ProgramState.PAUSED)),
    _trigger("stop", dashboard.STOP, _state(ProgramState.STOPPED)),
    _trigger("close_popup", dashboard.CLOSE_POPUP),
    _trigger("close_safety_popup", dashboard.CLOSE_SAFETY_POPUP),
    _trigger("clear_operational_mode", dashboard.CLEAR_OPERATIONAL_MODE),
    _trigger("shutdown", dashboard.SHUTDOWN),
    _trigger("quit", dashboard.QUIT, parts=True),
    DashboardService(
        "load_program", "Load", lambda request: dashboard.load(request.filename),
        effect=Effect(dashboard.PROGRAM_STATE, _has_loaded),
    ),
    DashboardService("load_installation", "Load", lambda request: dashboard.load_installation(request.filename)),
    DashboardService("popup", "Popup", lambda request: dashboard.popup(request.message)),
    DashboardService("add_to_log", "AddToLog", lambda request: dashboard.add_to_log(request.message)),
    DashboardService("set_user_role", "SetUserRole", lambda request: dashboard.set_user_role(request.user_role.role)),
    DashboardService(
        "set_operational_mode", "SetOperationalMode",
        lambda request: dashboard.set_operational_mode(request.operational_mode.mode),
    ),
    DashboardService(
        "generate_flight_report", "GenerateFlightReport",
        lambda request: dashboard.generate_flight_report(request.report_type), {"report_id": _identity},
    ),
    DashboardService(
        "generate_support_file", "GenerateSupportFile",
        lambda request: dashboard.generate_support_file(request.dir_path), {"generated_file_name": _identity},
    ),
    DashboardService("raw_request", "RawRequest", lambda request: dashboard.command(request.query)),
    _query("get_robot_mode", "GetRobotMode", dashboard.ROBOT_MODE, robot_mode__mode=int),
    _query("get_safety_mode", "GetSafetyMode", dashboard.SAFETY_MODE, safety_mode__mode=int),
    _query("get_safety_status", "GetSafetyStatus", dashboard.SAFETY_STATUS, safety_status__status=int),
    _query("program_running", "IsProgramRunning", dashboard.IS_RUNNING, program_running=_identity),
    _query(
        "program_state", "GetProgramState", _PROGRAM_STATE,
        state__state=lambda answer: answer[0].name, program_name=_second,
    ),
    _query(
        "program_saved", "IsProgramSaved", _with_program(dashboard.IS_PROGRAM_SAVED, _second),
        program_saved=lambda answer: answer[0], program_name=_second,
    ),
    _query(
        "get_loaded_program", "GetLoadedProgram",
        _with_program(dashboard.LOADED_PROGRAM, _identity), program_name=_identity,
    ),
    _query("is_in_remote_control", "IsInRemoteControl", dashboard.IS_IN_REMOTE_CONTROL, remote_control=_identity),
    _query("get_user_role", "GetUserRole", dashboard.USER_ROLE, user_role__role=lambda role: role.name),
    _query(
        "get_operational_mode", "GetOperationalMode", dashboard.OPERATIONAL_MODE,
        operational_mode__mode=lambda mode: mode.name,
    ),
    _query("get_robot_model", "GetRobotModel", dashboard.ROBOT_MODEL, robot_model=_identity),
    _query(
        "get_serial_number", "GetSerialNumber", dashboard.SERIAL_NUMBER,
        serial_number=lambda number: min(int(number), _MAX_UINT64),
    ),
    _query(
        "get_polyscope_version", "GetPolyScopeVersion", dashboard.POLYSCOPE_VERSION,
        version__major=lambda version: version.major, version__minor=lambda version: version.minor,
        version__bugfix=lambda version: version.bugfix, version__build=lambda version: version.build,
    ),
)  # fmt: skip


@dataclass(frozen=True)
class RobotApiService:
    """A service that only PolyScope X has. execute: calls the Robot API; returns the message and values of fields."""

    name: str
    type: str
    execute: Callable[[BlockingRobotAPIClient, Any], tuple[str, Mapping[str, Any]]]


_Perform = Callable[[Any], tuple[str, Mapping[str, Any]]]  # of a request: the message, and values of fields


def _resume(api: BlockingRobotAPIClient, request: Any) -> tuple[str, Mapping[str, Any]]:
    api.request(robotapi.RESUME)
    return "the program resumes", {}


def _get_programs(api: BlockingRobotAPIClient, request: Any) -> tuple[str, Mapping[str, Any]]:
    make = interface_if_any("ur_dashboard_msgs/msg/ProgramInformation")
    stored = api.request(robotapi.PROGRAMS)
    programs = [
        make(
            name=one.name,
            description=one.description,
            created_date=max(one.created_ms or 0, 0),
            last_modified_date=max(one.modified_ms or 0, 0),
            last_saved_date=max(one.saved_ms or 0, 0),
            program_state=one.state,
        )
        for one in stored
    ]
    return f"{len(programs)} programs", {"programs": programs}


def _upload(api: BlockingRobotAPIClient, request: Any, *, replaces: bool) -> tuple[str, Mapping[str, Any]]:
    path = Path(request.file_path)
    with FileError.accessing(path):
        file = path.read_bytes()
    name = api.request(robotapi.upload(file, replace=replaces))
    return f"{name} is {'replaced' if replaces else 'stored'}", {"program_name": name}


def _download(api: BlockingRobotAPIClient, request: Any) -> tuple[str, Mapping[str, Any]]:
    path = Path(request.target_path)
    file = api.request(robotapi.download(request.program_name))
    with FileError.accessing(path):
        write_file(path, file)
    return f"{request.program_name} is saved as {path}", {}


ROBOT_API_SERVICES: Final = (
    RobotApiService("resume", "Trigger", _resume),
    RobotApiService("get_programs", "GetPrograms", _get_programs),
    RobotApiService("upload_program", "UploadProgram", partial(_upload, replaces=False)),
    RobotApiService("update_program", "UploadProgram", partial(_upload, replaces=True)),
    RobotApiService("download_program", "DownloadProgram", _download),
)


class DashboardNode(HostedNode):
    """The node.

    Services are executed one at a time: the next one waits until the effect of the first shows. They are offered even
    without a robot. If the robot has closed the connection, the next service reopens it. After ``quit``, or without the
    parameter ``autoconnect``, only ``connect`` does.
    """

    def __init__(self, host: NodeHost, config: DriverConfig) -> None:
        super().__init__(host, NAME)
        self._address = self._fixed("robot_ip", config.host)
        self._autoconnect = self._fixed("autoconnect", True)
        limits = ParameterDescriptor(
            description="time limit for an answer of the dashboard [s]; 0: none",
            floating_point_range=[FloatingPointRange(from_value=0.0, to_value=1e9)],
        )
        self.node.declare_parameter("receive_timeout", _RECEIVE_TIMEOUT_S, limits)
        self._port = config.robot_ports["dashboard"]
        self._robot_api_port = config.robot_ports.get("robot api")
        self._client: BlockingDashboardClient | None = None
        self._ended = threading.Event()
        self.node.create_service(Trigger, "~/connect", self._connect)
        for service in SERVICES:
            self._offer(service.name, service.type, partial(self._perform, service))
        for x_service in ROBOT_API_SERVICES:
            self._offer(x_service.name, x_service.type, partial(self._call_robot_api, x_service))
        host.spin(self.node)

    def close(self) -> None:
        """End the node and its connection; a service that waits for the robot ends without success."""
        self._ended.set()
        if (client := self._client) is not None:
            client.shut_down()
        super().close()
        self._disconnect()

    def _offer(self, name: str, type_name: str, perform: _Perform) -> None:
        kind = Trigger if type_name == "Trigger" else interface_if_any(f"ur_dashboard_msgs/srv/{type_name}")
        if kind is not None:  # otherwise this distribution of ROS does not have it
            self.node.create_service(kind, f"~/{name}", partial(self._serve, name, perform))

    # in the node's thread

    def _serve(self, name: str, perform: _Perform, request: Any, response: Any) -> Any:
        try:
            line, values = perform(request)
            for path, value in values.items():
                _set(response, path, value)
            success = True
        except URError as error:
            self.node.get_logger().error(f"{name}: {error}")
            line, success = str(error), False
        return _answered(response, success, line)

    def _call_robot_api(self, service: RobotApiService, request: Any) -> tuple[str, Mapping[str, Any]]:
        """Raises RobotRefused if the robot has no Robot API, FileError, and errors of the connection."""
        if self._robot_api_port is None:
            raise RobotRefused(service.name, _POLYSCOPE_X, _NOT_POLYSCOPE_X)
        try:
            with BlockingRobotAPIClient(self._address, self._robot_api_port) as api:
                return service.execute(api, request)
        except (RobotUnreachableError, RemoteProtocolError) as error:
            raise RobotRefused(service.name, f"{_POLYSCOPE_X} ({error})", _NOT_POLYSCOPE_X) from error

    def _connect(self, request: Any, response: Any) -> Any:
        if self._connected():
            return _answered(response, False, f"{self._server_name} is connected already")
        try:
            self._open()
        except URError as error:
            self.node.get_logger().error(f"connect: {error}")
            return _answered(response, False, str(error))
        self._autoconnect = True
        return _answered(response, True, f"{self._server_name} is connected")

    def _perform(self, service: DashboardService, request: Any) -> tuple[str, Mapping[str, Any]]:
        """The robot's line and the values of the response, once the effect shows."""
        operation = service.operation(request)
        both = replace(operation, read=lambda reply: (reply, operation.read(reply)))
        line, answer = self._request(both)
        if service.effect is not None:
            self._await_effect(service.effect, both, request)
        if service.parts:
            self._autoconnect = False
            self._disconnect()
        return line, {path: value(answer) for path, value in service.values.items()}

    def _await_effect(self, effect: Effect, command: Operation[Any], request: Any) -> None:
        since = sent = time.monotonic()
        while not effect.seen(found := self._request(effect.query), request):
            now = time.monotonic()
            if now - since > effect.within_s:
                shown = ", ".join(getattr(part, "name", str(part)) for part in _parts(found))
                why = f"it confirmed the command, but after {effect.within_s:g} s {effect.query.line} is still {shown}"
                raise RobotRefused(command.line, why, "check the robot's log")
            if now - sent > effect.again_s:
                sent = now
                self._request(command)
            self._ended.wait(_POLL_S)

    def _request(self, operation: Operation[Any]) -> Any:
        if not self._connected():
            if not self._autoconnect:
                raise ClientError(f"{self._server_name} is not connected: call ~/connect first")
            self._open()
        assert self._client is not None
        limit_s = self.node.get_parameter("receive_timeout").value
        limit_s = limit_s if limit_s > 0.0 else math.inf
        try:
            return self._client.request(operation, operation.timeout_s or limit_s)
        except (ConnectionLostError, RemoteProtocolError):
            self._disconnect()
            raise
        except RobotRefused as error:
            if "remote control" in error.answer.lower():  # on after this connection was opened
                self._disconnect()
            raise

    # the connection

    @property
    def _server_name(self) -> str:
        return f"the dashboard of {self._address}:{self._port}"

    def _connected(self) -> bool:
        if self._client is None:
            return False
        try:
            self._client.check()
        except (ConnectionLostError, RemoteProtocolError):
            self._disconnect()
        return self._client is not None

    def _open(self) -> None:
        if self._ended.is_set():
            raise ConnectionLostError(self._address, self._port)
        self._client = BlockingDashboardClient(
            self._address, self._port, robot_api_port=self._robot_api_port
        ).__enter__()

    def _disconnect(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None


def _answered(response: Any, success: bool, words: str) -> Any:
    _set(response, "message" if isinstance(response, Trigger.Response) else "answer", words)
    if hasattr(response, "success"):
        response.success = success
    return response


def _set(message: Any, path: str, value: Any) -> None:
    """Set a field by its dotted name. Text from the robot is converted to text that ROS can transmit."""
    *within, name = path.split(".")
    for part in within:
        message = getattr(message, part)
    if isinstance(value, str):
        value = value.encode("utf-8", "replace").decode().replace("\0", "?")
    setattr(message, name, value)


def _parts(answer: Any) -> "tuple[Any, ...]":
    return answer if isinstance(answer, tuple) else (answer,)
