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
from typing import Final

from emulator.clock import Clock, ClockStatistics, RealClock
from emulator.config import ConfigError, EmulatorConfig
from emulator.control.control import LiveControl
from emulator.control.http import ControlServer
from emulator.control.metrics import metrics
from emulator.control.timing import ManualPace
from emulator.control.verbs import Waiting
from emulator.controller import Controller
from emulator.devices.tool_line import SerialDevice
from emulator.faults.catalogue import describe
from emulator.faults.fault import Fault, FaultError, FaultImpossibleError, publish_no_controller, rebooted
from emulator.faults.injector import FaultInjector
from emulator.journal.file import JournalWriter
from emulator.journal.recorder import Recorder, header_of
from emulator.journal.replay import Replay, executed
from emulator.journal.ring import Ring
from emulator.journal.stops import StopJournals
from emulator.logs import ReportedErrors
from emulator.ports import PORTS
from emulator.robotapi.server import RobotApiServer
from emulator.servers.cameras import CameraServer, has_cameras
from emulator.servers.modbus_client import ModbusClient
from emulator.servers.port import Port, PortServer
from emulator.servers.primary import PrimaryServer, RealtimeServer
from emulator.servers.primary_state import robot_state
from emulator.servers.program_state import ProgramReporter
from emulator.servers.read_budget import ReadBudget
from emulator.servers.requests import DashboardServer, GripperServer, InterpreterServer, ModbusServer
from emulator.servers.rtde import RTDEServer
from emulator.servers.script_sockets import NetworkSockets, OwnPorts, ScriptPort
from emulator.servers.send_scheduler import STATES_PER_SECOND, SendScheduler
from emulator.servers.tool_device import ToolCommunicationServer, open_tool_device
from emulator.snapshot import Snapshot
from urproto.compat import Self
from urproto.dashboard import AVAILABLE as DASHBOARD
from urproto.durable import growing
from urproto.interpreter import AVAILABLE as INTERPRETER_MODE
from urproto.primary.state import encode_robot_state
from urproto.rtde.fields import AVAILABLE as RTDE

_RETRY_LISTEN_S: Final = 0.5  # between attempts to reopen the ports after an outage (guess)

_logger = logging.getLogger(__name__)


class Emulator:
    """A controller that answers on its ports while the context is entered.

    clock: drives the controller; real time by default. replay: a run to go on with. stopped: set by ``stop``, and when
    a client shuts the controller down. stop_journals: if set, writes the journals of unexpected stops. port_fallbacks:
    by server name, why a server listens on a free port instead of its usual one. tool_device: the device connected to
    the tool's serial line, for example the path of a pseudo terminal; "" for none. control: the verbs of the control
    API, for callers in the same event loop; the API's port stays open while a fault keeps the controller off. After
    such an outage, ``controller`` and ``servers`` refer to new objects; the hooks of the servers are kept.
    """

    def __init__(self, config: EmulatorConfig, clock: Clock | None = None, replay: Replay | None = None) -> None:
        self.config = config
        self.controller = Controller(config.controller) if replay is None else replay.leave(self)
        self.clock = clock or RealClock(self.controller.period_s, config.speed)
        self.servers: dict[str, Port] = {}
        self._control_server: ControlServer | None = None
        self.read_budget = ReadBudget(self.controller.period_s)
        self._send_scheduler = SendScheduler(self.controller.period_s, STATES_PER_SECOND)
        self._rtde_scheduler = SendScheduler(self.controller.period_s)  # control loops don't wait for viewers
        self._renew_servers()
        real = self.clock if isinstance(self.clock, RealClock) else None
        self._scripts = ScriptPort(lambda: self.controller.time_s)
        self._scripts.read_budget = self.read_budget
        ports = ChainMap[str, Port]({self._scripts.name: self._scripts}, self.servers)
        self.faults = FaultInjector(self.controller, ports, real, self)
        if replay is not None:
            self.faults.take_over(replay.faults)
        self.control = LiveControl(
            self.controller, real or ManualPace(), self.servers, self.faults, self._journal, self._go_on_from
        )
        if config.control:
            server = ControlServer(self.controller, self.control, config.control_token, lambda: metrics(self))
            server.limits, server.read_budget = config.client_limits, self.read_budget
            self.servers["control"] = self._control_server = server
        self.stopped = asyncio.Event()
        self.tool_device = ""
        self.port_fallbacks: dict[str, str] = {}
        self._own_ports = OwnPorts()
        self._line: SerialDevice | None = None
        self._running = AsyncExitStack()
        self._services = AsyncExitStack()  # ports and outgoing connections, open while the controller is on
        self._power = PowerSwitch()
        self._reported = ReportedErrors()
        self._recorder: Recorder | None = None if replay is None else replay.recorder
        self._successor: Replay | None = None  # what the robot becomes when it is switched on
        self.stop_journals: StopJournals | None = None

    @property
    def ports(self) -> dict[str, int]:
        """The port each server listens on, by its name."""
        return {name: server.port for name, server in self.servers.items()}

    @property
    def statistics(self) -> ClockStatistics | None:
        """How punctual the clock is; None unless it is one of real time."""
        return self.clock.statistics if isinstance(self.clock, RealClock) else None

    def stop(self) -> None:
        self.stopped.set()

    async def __aenter__(self) -> Self:
        """Open the ports and start the clock. Raises OSError for a port that cannot be opened."""
        async with AsyncExitStack() as starting:
            if self._recorder is None:
                self._record(starting)
            starting.callback(self._end_journal)
            if self.config.tool_device is not None:
                self._line, self.tool_device = starting.enter_context(open_tool_device(self.config.tool_device))
            starting.push_async_callback(self._stop_services)
            await self._start_services(self.config.wanted_ports)
            if self._control_server is not None:
                starting.push_async_callback(self._control_server.stop)
                await self._open(self._control_server, self.config.wanted_ports["control"])
            starting.push_async_callback(self._power.close)
            starting.callback(self.faults.clear_all)
            starting.callback(self.clock.close)
            self.inject(self.config.faults)
            self.clock.start(self._period)
            self._running = starting.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._running.aclose()

    def inject(self, faults: Iterable[Fault]) -> None:
        """Inject faults. Raises ConfigError for a fault that this robot cannot have."""
        for fault in faults:
            try:
                self._inject(fault)
            except (FaultError, FaultImpossibleError) as error:
                raise ConfigError(f"fault {fault.kind}: {error}") from error

    def _inject(self, fault: Fault) -> None:
        if self._recorder is None:
            self.faults.inject(fault)
        else:
            arguments = {"kind": fault.kind, **describe(fault)}
            self._recorder.called("inject_fault", arguments, lambda: self.faults.inject(fault))

    # the journal

    def _record(self, starting: AsyncExitStack) -> None:
        """Record from now on, in a file or in memory. Raises OSError."""
        header, path = header_of(self.config.controller), self.config.journal
        if path is None and header["problem"]:
            return  # nobody could replay it
        if path is None:
            memory = Ring()
            self._recorder = Recorder(JournalWriter(memory, background=True), header, memory)
        else:
            file = starting.enter_context(growing(path))
            self._recorder = Recorder(JournalWriter(file, background=True), header)
        self._recorder.attach(self.controller)

    def _go_on_from(self, journal: bytes) -> Waiting[None]:
        """Restart as the robot at the end of a journal; time runs meanwhile. Raises BadArguments, NotPossible."""
        executing = asyncio.get_running_loop().run_in_executor(None, executed, journal)
        pace = self.control.pace
        paused = pace.paused
        pace.resume()
        try:
            while not executing.done():
                yield
            self._successor = executing.result()
            self._power.off(silent=False)
            while self._successor is not None or self._power.is_off:
                yield
        finally:
            if paused:
                pace.pause()

    def _journal(self) -> bytes:
        return b"" if self._recorder is None else self._recorder.journal

    def _end_journal(self) -> None:
        if self._recorder is not None:
            if self.stop_journals is not None:
                self.stop_journals.write(self.controller, self._recorder)
            self._recorder.close()
            self.controller.recorder = None

    # servers and connections of the controller

    def _renew_servers(self) -> None:
        """Create the servers of the controller; they take over the hooks of their predecessors."""
        wanted = self.config.wanted_ports
        for server in make_servers(self.controller, tool_line="tool line" in wanted, cameras="cameras" in wanted):
            server.limits = self.config.client_limits
            server.read_budget = self.read_budget
            server.send_scheduler = self._rtde_scheduler if isinstance(server, RTDEServer) else self._send_scheduler
            if server.name in self.servers:
                server.take_over(self.servers[server.name])
            self.servers[server.name] = server

    async def _start_services(self, ports: Mapping[str, int]) -> None:
        async with AsyncExitStack() as opening:
            controller = self.controller
            for name, port in ports.items():
                if name != "control":
                    server = self.servers[name]
                    opening.push_async_callback(server.stop)
                    await self._open(server, port)
            opened = {PORTS[name]: port for name, port in self.ports.items() if name != "control"}
            self._own_ports.opened(self.config.host, opened)
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
            if self._recorder is not None:
                self._recorder.wrap_backends(controller)
            self._services = opening.pop_all()

    async def _stop_services(self) -> None:
        await self._services.aclose()

    async def _open(self, server: Port, port: int) -> None:
        """Start a server; some use a free port if theirs is not available.

        Otherwise an emulator without administrator rights could not start: it may not listen on Modbus' port 502.
        """
        host = self.config.host_of(server.name)
        self.port_fallbacks.pop(server.name, None)
        try:
            await server.start(host, port)
        except OSError as error:
            if server.name not in self.config.movable or error.errno not in (errno.EACCES, errno.EADDRINUSE):
                raise
            await server.start(host, 0)
            self.port_fallbacks[server.name] = error.strerror or str(error)

    # power, for faults

    def switch_off(self, *, silent: bool) -> None:
        """Switch the controller off after this period.

        silent: without closing any connection, as in a power failure.
        """
        self._power.off(silent=silent)

    def switch_on(self, boot_s: float) -> None:
        """Boot a new controller, whose uptime begins at 0."""
        self._power.on(boot_s)

    def _shut_down(self) -> None:
        controller = self.controller
        self.faults.controller_gone()
        publish_no_controller(controller)
        for server in (*self._own_servers(), self._scripts):
            server.leave()
            for connection in tuple(server.connections):
                if self._power.silent:
                    connection.stall(self)
                else:
                    connection.close_now()
        if not self._power.silent:
            controller.programs.stop("the controller was shut down")

    def _own_servers(self) -> list[Port]:
        return [server for name, server in self.servers.items() if name != "control"]

    async def _reboot(self) -> None:
        before, ports = self.controller, self.ports
        for server in (*self._own_servers(), self._scripts):
            for connection in tuple(server.connections):
                connection.reset()
        before.programs.stop("the controller was off")
        await self._stop_services()
        replay, self._successor = self._successor, None
        if replay is not None:
            self._become(replay)
        else:
            self.controller = rebooted(before, self._power.boot_s, self._power.periods_off * before.period_s)
            if self._recorder is not None:
                self._recorder.rebooted(self.controller, self._power.boot_s, self._power.periods_off)
        self._renew_servers()
        await self._retry_start_services({name: ports[name] for name in ports if name != "control"})
        self.control.switched_on(self.controller)
        if self._control_server is not None:
            self._control_server.follow(self.controller)
        if replay is None:
            self.faults.controller_back(self.controller)

    def _become(self, replay: Replay) -> None:
        self._end_journal()
        self.controller, self._recorder = replay.leave(self), replay.recorder
        self.faults.take_over(replay.faults)
        self._power.on(0.0)

    async def _retry_start_services(self, ports: Mapping[str, int]) -> None:
        """Keep trying while another program uses one of the ports."""
        while True:
            try:
                return await self._start_services(ports)
            except OSError as error:
                _logger.warning("%s", error)
                await asyncio.sleep(_RETRY_LISTEN_S)

    def _period(self) -> None:
        """Run one control period; log errors outside the controller, which guards itself against its own."""
        try:
            self._tick()
        except Exception as error:
            if self._reported.is_new(error):
                _logger.exception("a control period failed outside the controller")

    def _tick(self) -> None:
        power = self._power
        if power.is_off:
            self._tick_without_controller()
            return
        controller = self.controller
        controller.execution_time_ms = self.clock.last_tick_s * 1000.0
        controller.tick()
        if self.stop_journals is not None and self._recorder is not None:
            self.stop_journals.look(controller, self._recorder)
        if controller.shutdown_requested:
            self.stop()
        if not power.requested:
            power.is_off = True
            self._shut_down()

    def _tick_without_controller(self) -> None:
        """Advance faults, and verbs of the control API that wait."""
        self._power.periods_off += 1
        self.faults.step()
        if self._control_server is not None:
            self._control_server.publish(self.controller.snapshot)
        if self._power.requested or self._successor is not None:
            self._power.start_reboot(self._reboot)


class PowerSwitch:
    """Whether the controller is off, and whether it is requested to be on."""

    def __init__(self) -> None:
        self.requested = True
        self.is_off = False
        self.silent = False
        self.boot_s = 0.0
        self.periods_off = 0
        self._booting: asyncio.Task[None] | None = None

    def off(self, *, silent: bool) -> None:
        """Request that the controller be off."""
        self.requested, self.silent, self.periods_off = False, silent, 0

    def on(self, boot_s: float) -> None:
        """Request that the controller be on."""
        self.requested, self.boot_s = True, boot_s

    def start_reboot(self, reboot: Callable[[], Awaitable[None]]) -> None:
        """Switch the controller on in a task, which may take several periods; nothing if one is under way."""
        if self._booting is None:
            self._booting = asyncio.get_running_loop().create_task(self._run(reboot))

    async def close(self) -> None:
        """Cancel a reboot that is under way."""
        if self._booting is not None:
            self._booting.cancel()
            await asyncio.wait([self._booting])

    async def _run(self, reboot: Callable[[], Awaitable[None]]) -> None:
        try:
            await reboot()
            self.is_off = False
        except Exception:
            self.requested = False
            _logger.exception("the controller could not be restarted")
        finally:
            self._booting = None


def make_servers(controller: Controller, *, tool_line: bool = False, cameras: bool = False) -> tuple[PortServer, ...]:
    """Create one server for each port of a controller; none listens yet.

    tool_line: whether to serve the tool's serial line. cameras: whether to serve the cameras of the controller's world,
    if it is one with physics.
    """

    newest: dict[bool, tuple[Snapshot, bytes]] = {}  # four ports send the same state in a control period

    def state(snapshot: Snapshot, full: bool) -> bytes:
        known = newest.get(full)
        if known is None or known[0] is not snapshot:
            encoded = encode_robot_state(robot_state(snapshot, controller.model), controller.version, full=full)
            newest[full] = known = snapshot, encoded
        return known[1]

    def primary(name: str, read_only: bool) -> PrimaryServer:
        def reporter() -> ProgramReporter:
            return ProgramReporter(controller.programs, controller.version)

        return PrimaryServer(name, controller, state, messages=True, read_only=read_only, reporter=reporter)

    servers: tuple[PortServer, ...] = (
        ModbusServer(controller),
        DashboardServer(controller) if DASHBOARD.covers(controller.version) else RobotApiServer(controller),
        primary("primary", read_only=False),
        PrimaryServer("secondary", controller, state, messages=False, read_only=False),
        RealtimeServer("realtime", controller, read_only=False),
        primary("primary read-only", read_only=True),
        PrimaryServer("secondary read-only", controller, state, messages=False, read_only=True),
        RealtimeServer("realtime read-only", controller, read_only=True),
    )
    if RTDE.covers(controller.version):
        servers = (*servers, RTDEServer(controller))
    if INTERPRETER_MODE.covers(controller.version):
        servers = (*servers, InterpreterServer(controller))
    if tool_line:
        servers = (*servers, ToolCommunicationServer(controller))
    if controller.gripper is not None:
        servers = (*servers, GripperServer(controller))
    if cameras and has_cameras(world := controller.world):
        servers = (*servers, CameraServer(controller, world))
    return servers
