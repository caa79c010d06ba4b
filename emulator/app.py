"""The whole emulator: controller, clock and servers, started and stopped together.

async with Emulator(EmulatorConfig(controller=ControllerConfig(model=load_model("ur3")))) as emulator:
    print(emulator.ports)
    await emulator.stopped.wait()
"""

import asyncio
import errno
import logging
from collections import ChainMap
from collections.abc import Awaitable, Callable, Iterable, Mapping
from contextlib import AsyncExitStack
from types import TracebackType
from typing import TYPE_CHECKING, Final, cast

from emulator.clock import Clock, RealClock
from emulator.config import ConfigError, EmulatorConfig
from emulator.control.control import LiveControl
from emulator.control.http import ControlServer
from emulator.control.timing import OwnPace
from emulator.controller import Controller
from emulator.devices.tool_line import SerialDevice
from emulator.faults.fault import Fault, FaultError, FaultImpossible, rebooted, show_gone
from emulator.faults.injector import FaultInjector
from emulator.logs import Novelty
from emulator.ports import PORTS
from emulator.robotapi.server import RobotApiServer
from emulator.servers.cameras import CameraServer
from emulator.servers.dashboard import DashboardServer
from emulator.servers.gripper import GripperServer
from emulator.servers.interpreter import InterpreterServer
from emulator.servers.modbus import ModbusServer
from emulator.servers.modbus_client import ModbusClient
from emulator.servers.port import PortServer
from emulator.servers.primary import PrimaryServer, RealtimeServer
from emulator.servers.primary_state import robot_state
from emulator.servers.program_state import ProgramReporter
from emulator.servers.read_budget import Intake
from emulator.servers.rtde import RTDEServer
from emulator.servers.script_sockets import NetworkSockets, OwnPorts, ScriptPort
from emulator.servers.tool_device import ToolCommunicationServer, open_tool_device
from emulator.servers.turns import Turns
from emulator.snapshot import Snapshot
from urproto.compat import Self
from urproto.dashboard import AVAILABLE as DASHBOARD
from urproto.interpreter import AVAILABLE as INTERPRETER_MODE
from urproto.primary.state import encode_robot_state

if TYPE_CHECKING:
    from emulator.physics.world import PhysicsWorld

_LISTEN_AGAIN_S: Final = 0.5  # between attempts to have the ports back after an outage (guess)

_logger = logging.getLogger(__name__)


class Emulator:
    """A controller that answers on its ports while the context is entered.

    clock: what drives it, real time unless given. stopped: set when a client shut the
    controller down, or by ``stop``. moved: why a server listens on another port than wanted.
    tool_device: what is connected to the tool's serial line, "" for nothing; a pseudo terminal's path.
    control: the verbs of the control API, for whoever runs in the same event loop; its port stays open
    while a fault keeps the controller off. ``controller`` and ``servers`` are others after that, their hooks the same.
    """

    def __init__(self, config: EmulatorConfig, clock: Clock | None = None) -> None:
        self.config = config
        self.controller = Controller(config.controller)
        self.clock = clock or RealClock(self.controller.period_s, config.speed)
        self.servers: dict[str, PortServer] = {}
        self._intake = Intake(self.controller.period_s)
        self._turns = Turns(self.controller.period_s)
        self._control_turns = Turns(self.controller.period_s)  # of RTDE: control loops do not wait for who only watches
        self._renew_servers()
        real = self.clock if isinstance(self.clock, RealClock) else None
        self._scripts = ScriptPort(lambda: self.controller.snapshot.timestamp)
        self._scripts.intake = self._intake
        places = ChainMap[str, PortServer]({self._scripts.name: self._scripts}, self.servers)
        self.faults = FaultInjector(self.controller, places, real, self)
        self.control = LiveControl(self.controller, real or OwnPace(), self.servers, self.faults)
        if config.control:
            self.servers["control"] = ControlServer(self.controller, self.control, config.control_token)
            self.servers["control"].limits = config.client_limits
        self.stopped = asyncio.Event()
        self.tool_device = ""
        self.moved: dict[str, str] = {}
        self._own_ports = OwnPorts()
        self._line: SerialDevice | None = None
        self._running = AsyncExitStack()
        self._box = AsyncExitStack()  # what is there while the controller is on
        self._power = PowerSwitch()
        self._novelty = Novelty()

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
            if self.config.tool_device is not None:
                self._line, self.tool_device = starting.enter_context(open_tool_device(self.config.tool_device))
            starting.push_async_callback(self._close_box)
            await self._open_box(self.config.wanted_ports)
            if "control" in self.servers:
                starting.push_async_callback(self.servers["control"].stop)
                await self._open(self.servers["control"], self.config.wanted_ports["control"])
            starting.push_async_callback(self._power.close)
            starting.callback(self.faults.clear_all)
            starting.callback(self.clock.close)
            self.inject(self.config.faults)
            self.clock.start(self._period)
            self._running = starting.pop_all()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        await self._running.aclose()

    def inject(self, faults: Iterable[Fault]) -> None:
        """Let faults happen. Raises ConfigError for one that this robot cannot have."""
        for fault in faults:
            try:
                self.faults.inject(fault)
            except (FaultError, FaultImpossible) as error:
                raise ConfigError(f"fault {fault.kind}: {error}") from error

    # the controller's box

    def _renew_servers(self) -> None:
        """Servers of the controller; the hooks of those before them go on."""
        wanted = self.config.wanted_ports
        for server in make_servers(self.controller, tool_line="tool line" in wanted, cameras="cameras" in wanted):
            server.limits = self.config.client_limits
            server.intake = self._intake
            server.turns = self._control_turns if isinstance(server, RTDEServer) else self._turns
            if server.name in self.servers:
                server.succeed(self.servers[server.name])
            self.servers[server.name] = server

    async def _open_box(self, ports: Mapping[str, int]) -> None:
        async with AsyncExitStack() as opening:
            controller = self.controller
            for name, port in ports.items():
                if name != "control":
                    server = self.servers[name]
                    opening.push_async_callback(server.stop)
                    await self._open(server, port)
            own = {PORTS[name]: port for name, port in self.ports.items() if name != "control"}
            self._own_ports.opened(self.config.host, own)
            if self._line is not None:
                controller.tool_line.connect(self._line)
            sockets = NetworkSockets(
                self.config.script_network, controller.messages.note, self._own_ports, self._scripts
            )
            opening.push_async_callback(sockets.close)
            controller.programs.socket_backend = sockets
            modbus = ModbusClient(self.config.modbus_unit_port, self._own_ports)
            opening.push_async_callback(modbus.close)
            controller.programs.modbus.backend = modbus
            self._box = opening.pop_all()

    async def _close_box(self) -> None:
        await self._box.aclose()

    async def _open(self, server: PortServer, port: int) -> None:
        """Some servers rather move than keep the robot off: only administrators may listen where Modbus belongs."""
        host = self.config.host_of(server.name)
        self.moved.pop(server.name, None)
        try:
            await server.start(host, port)
        except OSError as error:
            if server.name not in self.config.movable or error.errno not in (errno.EACCES, errno.EADDRINUSE):
                raise
            await server.start(host, 0)
            self.moved[server.name] = error.strerror or str(error)

    # power, for faults

    def switch_off(self, *, silent: bool) -> None:
        """The controller is gone after this period. silent: so suddenly that nobody's connection is ended."""
        self._power.off(silent=silent)

    def switch_on(self, boot_s: float) -> None:
        """A new controller boots; its uptime begins at 0."""
        self._power.on(boot_s)

    def _go_down(self) -> None:
        controller = self.controller
        self.faults.controller_gone()
        show_gone(controller)
        for server in (*self._own_servers(), self._scripts):
            server.leave()
            for connection in tuple(server.connections):
                if self._power.silent:
                    connection.stall(self)
                else:
                    connection.close_now()
        if not self._power.silent:
            controller.programs.stop("the controller ended")

    def _own_servers(self) -> list[PortServer]:
        return [server for name, server in self.servers.items() if name != "control"]

    async def _come_back(self) -> None:
        before, ports = self.controller, self.ports
        for server in (*self._own_servers(), self._scripts):
            for connection in tuple(server.connections):
                connection.reset()
        before.programs.stop("the controller was off")
        await self._close_box()
        self.controller = rebooted(before, self._power.boot_s, self._power.periods_off * before.period_s)
        self._renew_servers()
        await self._open_box_again({name: ports[name] for name in ports if name != "control"})
        self.control.switched_on(self.controller)
        if "control" in self.servers:
            self.servers["control"].follow(self.controller)
        self.faults.controller_back(self.controller)

    async def _open_box_again(self, ports: Mapping[str, int]) -> None:
        """Tries on while another program has one of the ports."""
        while True:
            try:
                return await self._open_box(ports)
            except OSError as error:
                _logger.warning("%s", error)
                await asyncio.sleep(_LISTEN_AGAIN_S)

    def _period(self) -> None:
        """The controller has a guard of its own; this one is for the machine around it."""
        try:
            self._tick()
        except Exception as error:
            if self._novelty.of(error):
                _logger.exception("a control period failed outside of the controller")

    def _tick(self) -> None:
        power = self._power
        if power.is_off:
            self._tick_without_controller()
            return
        controller = self.controller
        controller.execution_time_ms = self.clock.last_tick_s * 1000.0
        controller.tick()
        if controller.shutdown_requested:
            self.stop()
        if not power.wanted:
            power.is_off = True
            self._go_down()

    def _tick_without_controller(self) -> None:
        """Time goes by for faults and for who waits behind the scenes."""
        self._power.periods_off += 1
        self.faults.step()
        if "control" in self.servers:
            self.servers["control"].publish(self.controller.snapshot)
        if self._power.wanted:
            self._power.come_back(self._come_back)


class PowerSwitch:
    """Whether the controller is off, and is to be."""

    def __init__(self) -> None:
        self.wanted = True
        self.is_off = False
        self.silent = False
        self.boot_s = 0.0
        self.periods_off = 0
        self._coming: asyncio.Task[None] | None = None

    def off(self, *, silent: bool) -> None:
        """Switch off."""
        self.wanted, self.silent, self.periods_off = False, silent, 0

    def on(self, boot_s: float) -> None:
        """Switch on."""
        self.wanted, self.boot_s = True, boot_s

    def come_back(self, work: Callable[[], Awaitable[None]]) -> None:
        """Switch the controller on, in the time between two periods that it takes."""
        if self._coming is None:
            self._coming = asyncio.get_running_loop().create_task(self._come_back(work))

    async def close(self) -> None:
        """Give up what is under way."""
        if self._coming is not None:
            self._coming.cancel()
            await asyncio.wait([self._coming])

    async def _come_back(self, work: Callable[[], Awaitable[None]]) -> None:
        try:
            await work()
            self.is_off = False
        except Exception:
            self.wanted = False
            _logger.exception("the controller does not come back")
        finally:
            self._coming = None


def make_servers(controller: Controller, *, tool_line: bool = False, cameras: bool = False) -> tuple[PortServer, ...]:
    """One server for each port of a controller, not listening yet.

    tool_line: also of its tool's serial line. cameras: also of those in its world, which is one with physics.
    """

    newest: dict[bool, tuple[Snapshot, bytes]] = {}  # four ports send the same, in the same control period

    def state(snapshot: Snapshot, full: bool) -> bytes:
        known = newest.get(full)
        if known is None or known[0] is not snapshot:
            encoded = encode_robot_state(robot_state(snapshot, controller.model), controller.version, full=full)
            newest[full] = known = snapshot, encoded
        return known[1]

    def primary(name: str, read_only: bool) -> PrimaryServer:
        reporter = ProgramReporter(controller.programs, controller.version)
        return PrimaryServer(name, controller, state, messages=True, read_only=read_only, reporter=reporter)

    servers: tuple[PortServer, ...] = (
        ModbusServer(controller),
        DashboardServer(controller) if DASHBOARD.covers(controller.version) else RobotApiServer(controller),
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
    if cameras:
        servers = (*servers, CameraServer(controller, cast("PhysicsWorld", controller.world)))
    return servers
