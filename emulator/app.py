"""The whole emulator: controller, clock and servers, started and stopped together.

async with Emulator(EmulatorConfig(controller=ControllerConfig(model=load_model("ur3")))) as emulator:
    print(emulator.ports)
    await emulator.stopped.wait()
"""

import asyncio
import errno
from contextlib import AsyncExitStack
from types import TracebackType
from typing import Final, Self

from emulator.clock import Clock, RealClock
from emulator.config import PORTS, EmulatorConfig
from emulator.control.live import LiveControl
from emulator.control.timing import OwnPace
from emulator.controller import Controller
from emulator.reporting.primary_state import robot_state
from emulator.reporting.program_state import ProgramReporter
from emulator.servers.base import PortServer
from emulator.servers.control import ControlServer
from emulator.servers.dashboard import DashboardServer
from emulator.servers.gripper import GripperServer
from emulator.servers.interpreter import InterpreterServer
from emulator.servers.modbus import ModbusServer
from emulator.servers.modbus_client import ModbusClient
from emulator.servers.own_ports import OwnPorts
from emulator.servers.primary import PrimaryServer
from emulator.servers.realtime import RealtimeServer
from emulator.servers.rtde import RTDEServer
from emulator.servers.script_sockets import NetworkSockets
from emulator.servers.tool_communication import ToolCommunicationServer
from emulator.servers.tool_device import open_tool_device
from emulator.snapshot import Snapshot
from urproto.interpreter import AVAILABLE as INTERPRETER_MODE
from urproto.primary.state import encode_robot_state

__all__ = ["Emulator", "make_servers"]

_MAY_MOVE: Final = ("modbus", "control")


class Emulator:
    """A controller that answers on its ports while the context is entered.

    clock: what drives it, real time unless given. stopped: set when a client shut the
    controller down, or by ``stop``. moved: why a server listens on another port than wanted.
    tool_device: what is connected to the tool's serial line, "" for nothing; a pseudo terminal's path.
    control: the verbs of the control API, for whoever runs in the same event loop.
    """

    def __init__(self, config: EmulatorConfig, clock: Clock | None = None) -> None:
        self.config = config
        self.controller = Controller(config.controller)
        self.clock = clock or RealClock(self.controller.period_s, config.speed)
        servers = make_servers(self.controller, tool_line=config.tool_device is not None)
        self.servers: dict[str, PortServer] = {server.name: server for server in servers}
        pace = self.clock if isinstance(self.clock, RealClock) else OwnPace()
        self.control = LiveControl(self.controller, pace, self.servers)
        if config.control:
            self.servers["control"] = ControlServer(self.controller, self.control, config.control_token)
        self.stopped = asyncio.Event()
        self.tool_device = ""
        self._own_ports = OwnPorts()
        self._sockets = NetworkSockets(config.script_network, self.controller.messages.note, self._own_ports)
        self.moved: dict[str, str] = {}
        self._running = AsyncExitStack()

    @property
    def ports(self) -> dict[str, int]:
        """The port each server listens on, by its name."""
        return {name: server.port for name, server in self.servers.items()}

    def stop(self) -> None:
        """Let whoever waits for ``stopped`` go on."""
        self.stopped.set()

    async def __aenter__(self) -> Self:
        """Open the ports and start the clock. Raises OSError for a port that cannot be opened."""
        async with AsyncExitStack() as starting:
            for name, port in self.config.wanted_ports.items():
                server = self.servers[name]
                starting.push_async_callback(server.stop)
                await self._open(server, port)
            own = {PORTS[name]: port for name, port in self.ports.items() if name != "control"}
            self._own_ports.opened(self.config.host, own)
            if self.config.tool_device is not None:
                device, self.tool_device = starting.enter_context(open_tool_device(self.config.tool_device))
                self.controller.tool_line.connect(device)
            starting.push_async_callback(self._sockets.close)
            self.controller.programs.socket_backend = self._sockets
            modbus = ModbusClient(self.config.modbus_unit_port, self._own_ports)
            starting.push_async_callback(modbus.close)
            self.controller.programs.modbus.backend = modbus
            starting.callback(self.clock.close)
            self.clock.start(self._tick)
            self._running = starting.pop_all()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        await self._running.aclose()

    async def _open(self, server: PortServer, port: int) -> None:
        """Some servers rather move than keep the robot off: only administrators may listen where Modbus belongs."""
        host = self.config.host_of(server.name)
        self.moved.pop(server.name, None)
        try:
            await server.start(host, port)
        except OSError as error:
            if server.name not in _MAY_MOVE or error.errno not in (errno.EACCES, errno.EADDRINUSE):
                raise
            await server.start(host, 0)
            self.moved[server.name] = error.strerror or str(error)

    def _tick(self) -> None:
        controller = self.controller
        controller.execution_time_ms = self.clock.last_tick_s * 1000.0
        controller.tick()
        if controller.shutdown_requested:
            self.stop()


def make_servers(controller: Controller, *, tool_line: bool = False) -> tuple[PortServer, ...]:
    """One server for each port of a controller, not listening yet. tool_line: also of its tool's serial line."""

    def state(snapshot: Snapshot, full: bool) -> bytes:
        return encode_robot_state(robot_state(snapshot, controller.model), controller.version, full=full)

    def primary(name: str, read_only: bool) -> PrimaryServer:
        reporter = ProgramReporter(controller.programs, controller.version)
        return PrimaryServer(name, controller, state, messages=True, read_only=read_only, reporter=reporter)

    servers: tuple[PortServer, ...] = (
        ModbusServer(controller),
        DashboardServer(controller),
        primary("primary", read_only=False),
        PrimaryServer("secondary", controller, state, messages=False, read_only=False),
        RealtimeServer("realtime", controller, read_only=False),
        RTDEServer(controller),
        primary("primary read-only", read_only=True),
        PrimaryServer("secondary read-only", controller, state, messages=False, read_only=True),
        RealtimeServer("realtime read-only", controller, read_only=True),
    )
    if INTERPRETER_MODE.covers(controller.version):
        servers = (*servers, InterpreterServer(controller))
    if tool_line:
        servers = (*servers, ToolCommunicationServer(controller))
    if controller.gripper is not None:
        servers = (*servers, GripperServer(controller))
    return servers
