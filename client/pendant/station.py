"""The state of one robot and the requests to it, as a pendant needs them. All browsers share it."""

import asyncio
import socket
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import AsyncExitStack
from math import ceil
from pathlib import Path
from typing import Any, Final, TypeVar

from client import dashboard, primary, robotapi, rtde
from client.calibration import model_of
from client.dashboard import NOT_ON_POLYSCOPE_X, DashboardClient
from client.dashboard_commands import Operation
from client.errors import NoAnswerError, RobotUnreachableError
from client.pendant.cameras import CameraLink
from client.pendant.dialogues import Dialogues, Stops
from client.pendant.draft import check_forever
from client.pendant.emulator_control import POLL_PERIOD_S, EmulatorControl
from client.pendant.events import EventLog
from client.pendant.feeds import Feeds
from client.pendant.manager_link import ManagerLink
from client.pendant.mover import Mover
from client.pendant.polling import Audience, GeneralRegisters, Poller, follow_forever
from client.pendant.program_draft import ProgramDraft
from client.pendant.programs import Programs
from client.pendant.saved import Poses, ProgramFile, Tools
from client.pendant.scene_monitor import MonitoredScene, SceneMonitor, SceneSources
from client.pendant.situation import RobotStatus, Situation, situation
from client.pendant.variables import Variables
from client.primary import PrimaryClient, PrimaryCore
from client.robot import AsyncRobot
from client.rtde import RTDEClient
from urproto.compat import Self
from urproto.dashboard import NOT_IN_REMOTE_CONTROL
from urproto.errors import RobotRefused
from urproto.modes import RobotMode, RuntimeState, SafetyMode
from urproto.ports import CAMERA_PORT, CONTROL_API_PORT, CONTROLLER_PORTS
from urproto.primary.messages import ErrorCodeMessage
from urproto.primary.state import RobotStateData
from urproto.primary.subpackages import ConfigurationData
from urproto.robots import RobotModel
from urproto.text import readable_in
from urproto.versions import PolyscopeVersion, Series

Answer = TypeVar("Answer")
Mode = TypeVar("Mode", RobotMode, SafetyMode, RuntimeState)

FRAME_HZ: Final = 30.0
"""States per second that the robot sends and a browser receives."""

OUTPUTS: Final = (
    "timestamp", "robot_mode", "joint_mode", "safety_mode", "safety_status", "safety_status_bits", "runtime_state",
    "robot_status_bits", "speed_scaling", "target_speed_fraction", "script_control_line",
    "actual_q", "target_q", "actual_qd", "actual_current", "joint_temperatures", "joint_control_output",
    "actual_TCP_pose", "actual_TCP_speed", "actual_TCP_force", "tcp_offset", "payload", "payload_cog",
    "actual_digital_input_bits", "actual_digital_output_bits", "analog_io_types",
    "standard_analog_input0", "standard_analog_input1", "standard_analog_output0", "standard_analog_output1",
    "tool_analog_input_types", "tool_analog_input0", "tool_analog_input1", "tool_output_voltage",
    "tool_output_current", "tool_temperature", "tool_mode", "actual_robot_voltage", "actual_robot_current",
    "actual_main_voltage", "target_gravity",
)  # fmt: skip
_MAX_HANG_S: Final = 1.0  # guess: after a longer hang, the user no longer controls the held button
_STATE_TIMEOUT_S: Final = 1.0  # guess: a robot that sends nothing for this long is lost
_FEED_TIMEOUT_S: Final = 4.0  # guess: in a recording, a late state is better than a gap
_REMOTE_CONTROL_PERIOD_S: Final = 2.0
_UNWATCHED_STATE_PERIOD_S: Final = 0.2  # while no page is open: a delay that users do not notice when they open one
_UNWATCHED_CONTROL_PERIOD_S: Final = 2.0  # the same for an emulator's control API
_DEVICES: Final = {  # stop -> device of an emulator that causes it; the stop may outlast it
    SafetyMode.SAFEGUARD_STOP: "safeguard",
    SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP: "automatic_safeguard",
}
_READ_ONLY_CODE: Final = 210  # for a script over a connection that was opened in local control


class Station:
    """The connections of one pendant to one robot; use it with ``async with``.

    values: the newest RTDE state, by variable name; empty before the first one and while the robot is unreachable.
    core: state, kinematics and configuration of the primary interface, as far as received. log, variables, dialogues,
    stops, programs: collected from its messages and states. connected: whether states arrive. problem: why they do not.
    emulator: its control API, which a real arm lacks. cameras: those of an emulator's scene. remote_control: e-Series
    from 5.6. frame: number of states received. feeds: states of other recipes. general_registers: those of its Modbus
    server. meshes: the user's folder of meshes. poses, tools: saved poses and TCPs. manager: the controller manager
    that runs for the robot, if any. program_draft: the program that is being edited; drafts: the folder where it is
    saved, None for memory only. scene_monitor: the scene for motion planning; scene: the world file with the obstacles
    around the arm, None to use the emulator's world.
    """

    def __init__(
        self,
        robot_ip: str,
        port_offset: int = 0,
        control_port: int | None = None,
        modbus_port: int | None = None,
        token: str = "",
        meshes: Path | None = None,
        poses: Path | None = None,
        tools: Path | None = None,
        drafts: Path | None = None,
        scene: Path | None = None,
        robot_api_port: int | None = None,
        camera_port: int | None = None,
    ) -> None:
        self.robot_ip = robot_ip
        self.ports: Mapping[str, int] = {
            "dashboard": dashboard.PORT + port_offset,
            "robot api": (robotapi.PORT + port_offset) if robot_api_port is None else robot_api_port,
            "primary": primary.PORT + port_offset,
            "rtde": rtde.PORT + port_offset,
            "modbus": CONTROLLER_PORTS["modbus"] + port_offset if modbus_port is None else modbus_port,
        }
        self.meshes = meshes
        self.poses = Poses(poses)
        self.values: Mapping[str, Any] = {}
        self.version: PolyscopeVersion | None = None
        self.unavailable: frozenset[str] = frozenset()
        self.connected = False
        self.problem = "connecting"
        self.frame = 0
        self.log = EventLog()
        self.variables = Variables()
        self.dialogues = Dialogues()
        self.stops = Stops()
        self.programs = Programs()
        self._update_event = asyncio.Event()
        self.audience = Audience()
        self.emulator = EmulatorControl(
            robot_ip,
            CONTROL_API_PORT + port_offset if control_port is None else control_port,
            token,
            self.notify_pages,
            lambda: self.audience.sleep(POLL_PERIOD_S, _UNWATCHED_CONTROL_PERIOD_S),
        )
        self.cameras = CameraLink(
            robot_ip, CAMERA_PORT + port_offset if camera_port is None else camera_port, self.notify_pages
        )
        self.remote_control = Poller(self._query_remote_control, _REMOTE_CONTROL_PERIOD_S, self.notify_pages)
        self.tools = Tools(tools)
        draft_file = ProgramFile(drafts, f"{robot_ip}_{self.ports['primary']}")
        self.program_draft = ProgramDraft(
            draft_file, self.log.note, self.notify_pages, lambda: (self.version, self.model)
        )
        self.scene_monitor = SceneMonitor(scene, self.notify_pages)
        self.feeds = Feeds(self._open_feed)
        self.manager = ManagerLink(robot_ip, self.ports["rtde"], self.notify_pages)
        self.general_registers = GeneralRegisters(robot_ip, self.ports["modbus"], self.notify_pages)
        self.mover = Mover(self._open_robot)
        self._primary: PrimaryClient | None = None
        self._read_only = False  # the primary connection accepts no scripts; a new one may
        self._script_sent = False  # a script has been sent over this connection
        self.core = PrimaryCore()
        self._arm: ConfigurationData | None = None
        self._model: RobotModel | None = None
        self._exit_stack = AsyncExitStack()

    async def __aenter__(self) -> Self:
        async with AsyncExitStack() as stack:
            stack.push_async_callback(self.emulator.close)
            stack.push_async_callback(self.cameras.close)
            stack.push_async_callback(self.remote_control.close)
            stack.push_async_callback(self.mover.close)
            stack.push_async_callback(self.scene_monitor.close)
            stack.push_async_callback(self.feeds.close)
            stack.push_async_callback(self.general_registers.close)
            stack.push_async_callback(self.manager.close)
            for background_task in (
                follow_forever(self._follow_states, self._lose_states),
                follow_forever(self._follow_messages, lambda reason: self.log.note(f"no messages: {reason}")),
                self.emulator.follow(self.dialogues),
                self.programs.follow(self),
                check_forever(self.programs.draft, lambda: self.version, self.log.note),
                self.program_draft.keep_saving(),
            ):
                stack.push_async_callback(_cancel, asyncio.create_task(background_task))
            self._exit_stack = stack.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._exit_stack.aclose()

    # state

    @property
    def primary_state(self) -> RobotStateData | None:
        """The newest state of the primary interface; None while the robot is disconnected."""
        return self.core.state if self.connected else None

    @property
    def model(self) -> RobotModel | None:
        arm = self.core.configuration
        if arm is not self._arm:
            self._arm, self._model = arm, None if arm is None else model_of(arm)
        return self._model

    @property
    def planning_scene(self) -> MonitoredScene | None:
        """This arm and its obstacles, for motion planning; None until they are known, see ``scene_monitor.problem``."""
        offset, world = self.values.get("tcp_offset"), self.emulator.read("world")
        return self.scene_monitor.update(
            SceneSources(self.core.configuration, self.core.kinematics, offset and tuple(offset), world)
        )

    @property
    def has_surroundings(self) -> bool:
        """Whether obstacles around the arm are known."""
        world = self.emulator.read("world")
        return self.scene_monitor.file is not None or bool(world and world["objects"])

    @property
    def robot_mode(self) -> RobotMode:
        """The robot mode, NO_CONTROLLER while unknown."""
        return self._mode("robot_mode", RobotMode.NO_CONTROLLER)

    @property
    def safety_mode(self) -> SafetyMode:
        """The safety mode, with the type of a safeguard stop if reported; UNDEFINED_SAFETY_MODE while unknown."""
        mode = self._mode("safety_mode", SafetyMode.UNDEFINED_SAFETY_MODE)
        return self._mode("safety_status", mode) if mode is SafetyMode.SAFEGUARD_STOP else mode

    @property
    def runtime_state(self) -> RuntimeState:
        return self._mode("runtime_state", RuntimeState.STOPPED)

    def _mode(self, field: str, unknown: Mode) -> Mode:
        try:
            return type(unknown)(self.values.get(field, unknown))
        except ValueError:  # newer robots may have more modes
            return unknown

    @property
    def situation(self) -> Situation:
        if not self.connected:
            return situation(RobotStatus())
        mode = self.safety_mode
        return situation(
            RobotStatus(
                True,
                self.robot_mode,
                mode,
                self.runtime_state,
                moved_by_pendant=self.mover.in_control,
                safeguard_open=self._is_active(_DEVICES[mode]) if mode in _DEVICES else None,
                unlock_in_s=ceil(self.stops.unlock_in_s),
            )
        )

    @property
    def safeguard_open(self) -> bool | None:
        """Whether an emulator's safeguard is open; None if unknown, as with real robots."""
        return self._is_active("safeguard")

    def _is_active(self, device: str) -> bool | None:
        devices: Mapping[str, bool] = self.emulator.read("safety_devices") or {}
        return devices.get(device)

    @property
    def simulating(self) -> bool:
        """Whether the robot is in simulation, so that the real arm does not move."""
        state = self.primary_state
        return state is not None and state.mode is not None and not state.mode.real_robot_enabled

    @property
    def can_simulate(self) -> bool:
        """Whether simulation can be switched from here: on an emulator, and on CB3 by a command, not on e-Series."""
        series = self.version.series if self.version else None
        return "set_simulation" in self.emulator.verbs if self.emulator.available else series is Series.CB3

    @property
    def own_address(self) -> str:
        """The address at which the robot can reach this machine; empty without a network route."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:  # connecting sends nothing
            try:
                probe.connect((self.robot_ip, self.ports["rtde"]))
            except OSError:
                return ""
            return str(probe.getsockname()[0])

    async def next_frame(self) -> None:
        """Wait until there is something new to show."""
        await self._update_event.wait()

    # requests

    async def request(self, operation: Operation[Answer]) -> Answer:
        """Run a dashboard operation. Raises RobotRefused if the robot refuses it, URError.

        In local control, a robot accepts commands only from its own pendant, and PolyScope X offers some nowhere else.
        For an emulator, this pendant is the robot's own.
        """
        try:
            async with DashboardClient(
                self.robot_ip, self.ports["dashboard"], robot_api_port=self.ports["robot api"]
            ) as board:
                return readable_in(await board.request(operation))
        except RobotRefused as refused:
            locally = self.remote_control.last is False  # a simulator refuses `play` without giving that reason
            if not (self.emulator.available and (locally or _needs_own_pendant(refused))):
                raise
        return operation.answer(await self.emulator.call("dashboard", line=operation.line))

    async def _query_remote_control(self) -> bool | None:
        """Query remote control; None if unsupported. After a change, only new connections may send scripts."""
        if self.version is None or not dashboard.IS_IN_REMOTE_CONTROL.available.covers(self.version):
            return None
        before, remote = self.remote_control.last, await self.request(dashboard.IS_IN_REMOTE_CONTROL)
        self._read_only |= remote and before is False
        return remote

    async def send_script(self, text: str) -> None:
        """Send a script to the primary interface; its result is not awaited. Raises ClientError."""
        if self._primary is None:
            raise RobotUnreachableError(self.robot_ip, self.ports["primary"], "its primary interface is not connected")
        self._script_sent = True
        await self._primary.run(self._primary.core.send_script(text))

    async def run_statements(self, *statements: str) -> None:
        """Run statements in a secondary program, in parallel to the running program. Raises ClientError."""
        body = "".join(f"  {statement}\n" for statement in statements)
        await self.send_script(f"sec pendant():\n{body}end")

    async def write(self, **inputs: Any) -> None:
        """Write RTDE inputs once. Raises RobotRefused if another client uses them, ClientError."""
        async with RTDEClient(self.robot_ip, (), [tuple(inputs)], port=self.ports["rtde"]) as client:
            await client.send(**inputs)

    async def set_speed_slider(self, fraction: float) -> None:
        """Move the speed slider, 0 to 1. Raises RobotRefused, ClientError."""
        if self.mover.has_slider:
            await self.mover.set_speed_slider(fraction)
        else:
            await self.write(speed_slider_mask=1, speed_slider_fraction=fraction)

    async def set_simulation(self, on: bool) -> None:
        """Switch to Simulation, or back to Real Robot. No program may be running. Raises URError."""
        if self.emulator.available:
            await self.emulator.call("set_simulation", on=on)
        else:
            await self.send_script((primary.SIMULATE if on else primary.REAL_ROBOT).line)

    def _open_robot(self) -> AsyncRobot:
        options = {"frequency_hz": Mover.RATE_HZ, "hang_s": _MAX_HANG_S, "restart": False}
        return AsyncRobot(self.robot_ip, robot_ports=self.ports, **options)

    def _open_feed(self, names: Sequence[str], rate_hz: float, timeout_s: float = _FEED_TIMEOUT_S) -> RTDEClient:
        return RTDEClient(
            self.robot_ip,
            names,
            frequency_hz=rate_hz,
            ignore_unavailable=True,
            port=self.ports["rtde"],
            timeout_s=timeout_s,
        )

    # connections

    def _lose_states(self, reason: str) -> None:
        self.connected, self.problem = False, reason
        self._update({})

    async def _follow_states(self) -> None:
        async with self._open_feed(OUTPUTS, FRAME_HZ, _STATE_TIMEOUT_S) as client:
            self.version, self.unavailable = client.core.version, client.core.unavailable
            while True:
                values = await self._wait_through_pause(client.latest)
                self.connected, self.problem = True, ""
                self._update(values)
                await self.audience.sleep(0.0, _UNWATCHED_STATE_PERIOD_S)

    def _update(self, values: Mapping[str, Any]) -> None:
        """Store a new state, empty after a loss."""
        if values.get("safety_mode") != self.values.get("safety_mode"):
            self.emulator.watch("safety_devices").invalidate()  # the previous answer is outdated
        self.values = values
        self.stops.update(values)
        self.frame += 1
        self.notify_pages()

    async def _follow_messages(self) -> None:
        try:
            async with PrimaryClient(self.robot_ip, self.ports["primary"]) as client:
                await self._receive_messages(client)
        finally:
            self._primary = None
            self.variables.clear()

    async def _receive_messages(self, client: PrimaryClient) -> None:
        self._primary, self.core = client, client.core
        self._read_only = self._script_sent = False
        while not self._read_only:
            message = await self._wait_through_pause(lambda: client.run(client.core.next_message()))
            if not isinstance(message, RobotStateData):  # it has no texts
                message = readable_in(message)
            self.log.handle_message(message)
            self.variables.handle_message(message)
            self.dialogues.handle_message(message)
            self.stops.handle_message(message)
            self.programs.handle_message(message)
            if isinstance(message, ErrorCodeMessage) and message.code == _READ_ONLY_CODE:
                self._read_only |= self._script_sent

    async def _wait_through_pause(self, wait: Callable[[], Awaitable[Answer]]) -> Answer:
        """Wait for the next message or state, however long time is paused."""
        while True:
            try:
                return await wait()
            except NoAnswerError:
                if not await self.emulator.is_time_paused():
                    raise

    def notify_pages(self) -> None:
        """Update the pages: something other than the state has changed."""
        event, self._update_event = self._update_event, asyncio.Event()
        event.set()


async def _cancel(task: "asyncio.Task[Any]") -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


def _needs_own_pendant(refused: RobotRefused) -> bool:
    """Whether a robot would accept the request from its own pendant."""
    in_local_control = refused.answer == NOT_IN_REMOTE_CONTROL or refused.advice == robotapi.REMOTE_CONTROL
    return in_local_control or refused.answer == NOT_ON_POLYSCOPE_X
