"""One robot with a client on each of its ports, put into a state, and what it shows after an event.

`tests/golden/interactions.tsv` says what is expected; docs/reference/states.md shows that table.
"""

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from emulator.app import make_servers
from emulator.controller import Controller
from emulator.lifecycle.power import PowerTimings
from emulator.lifecycle.runstate import SCRIPT_PROTECTIVE_STOP
from emulator.machine import ControllerConfig
from emulator.safety.signals import SafetyDevice
from tests.commands import SetSafetyDevice
from tests.networks import MemorySocket, MemorySockets
from tests.programs.tree_rig import main, tag, urp
from tests.servers.server_rig import MemoryClient
from urproto.modes import RobotMode, RuntimeState, SafetyMode
from urproto.primary.framing import PrimaryDecoder
from urproto.primary.messages import (
    ErrorCodeMessage,
    KeyMessage,
    RobotMessage,
    RuntimeExceptionMessage,
    SafetyModeMessage,
    TextMessage,
)
from urproto.robots import load_model
from urproto.rtde.codec import InputData, RequestProtocol, RTDEDecoder, SetupInputs, SetupOutputs, Start, decode_reply
from urproto.rtde.fields import OUTPUT_FIELDS
from urproto.rtde.recipes import Recipe
from urproto.versions import PolyscopeVersion, Series

PORTS: Final = ("primary", "secondary", "realtime")
"""Where programs are sent; which of them makes no difference."""
ARMS: Final = {Series.CB3: "ur5", Series.E: "ur5e"}
SHOWN: Final = ("runtime_state", "robot_mode", "safety_mode", "actual_qd", "actual_digital_output_bits")
WATCHED: Final = "input_int_register_20"
PEER: Final = ("10.0.0.1", 50001)
SILENT: Final = ("10.0.0.2", 50001)
_QUICK: Final = PowerTimings(joint_boot_s=0.08, power_on_s=0.04, brake_release_s=0.08)
_HOME: Final = (0.0, -1.5, 1.5, -1.6, -1.57, 0.0)
_SETTLED_S: Final = 1.0  # from an event to what is shown: a pause, a stop and the next state on each port fit into it
_SOCKET_S: Final = 2.5  # a read that times out takes 2 s
_LOCAL: Final = PolyscopeVersion.parse("5.26.0")

# It moves for ten seconds; the thread reads from a socket, and a client has to write a register twice a second.
_PROGRAM: Final = (
    f'rtde_set_watchdog("{WATCHED}", 2, "stop")',
    f'socket_open("{PEER[0]}", {PEER[1]})',
    "thread reader():",
    '  received = socket_read_line("socket_0", 2)',
    '  textmsg("received ", received)',
    "end",
    "run reader()",
    "movej([1.5, -1.5, 1.5, -1.6, -1.57, 0.0], a=1.0, v=0.15)",
)


def sent(name: str, *lines: str) -> str:
    """A program as a client sends it."""
    return f"def {name}():\n" + "".join(f"  {text}\n" for text in lines) + "end\n"


class Cell:
    """A robot, its clients, and shorthands for what people and programs do with them."""

    def __init__(self, folder: Path, series: Series, port: str, **config: Any) -> None:
        self.port = port
        config = {"running": True, "timings": _QUICK, **config}
        for name in ("moves.urp", "other.urp"):
            (folder / name).write_bytes(urp(main(_script_node(_PROGRAM)), name=name))
        model = load_model(ARMS[series])
        self.controller = Controller(ControllerConfig(model=model, programs_dir=folder, initial_q=_HOME, **config))
        self.network = MemorySockets(PEER)
        self.network.silent.add(SILENT)
        self.controller.programs.socket_backend = self.network
        servers = {server.name: server for server in make_servers(self.controller)}
        self.clients = {name: MemoryClient(servers[name]) for name in ("dashboard", "rtde", *PORTS)}
        self.feeding = True  # the RTDE client writes the watched register
        self.messages: list[RobotMessage] = []
        self.state: dict[str, Any] = {}
        self._decoder = PrimaryDecoder(self.controller.version)
        self._rtde = RTDEDecoder()
        self._recipe = Recipe.of(SHOWN, OUTPUT_FIELDS)
        self.rtde(RequestProtocol(2).encode(1))
        self.rtde(SetupOutputs(SHOWN, 125.0).encode(2) + SetupInputs((WATCHED,)).encode(2))
        self.rtde(SetupInputs(("standard_digital_output_mask", "standard_digital_output")).encode(2))
        self.rtde(SetupInputs(("speed_slider_mask", "speed_slider_fraction")).encode(2) + Start().encode(2))
        self.seconds(0.2)
        self.clients["dashboard"].take()

    def tick(self) -> None:
        if self.feeding:
            self.rtde(InputData(1, struct.pack(">i", 1)).encode(2))
        self.controller.tick()
        self.messages += [m for m in self._decoder.feed(self.clients["primary"].take()) if isinstance(m, RobotMessage)]
        for package in self._rtde.feed(self.clients["rtde"].take()):
            reply = decode_reply(package, 2)
            if hasattr(reply, "data"):
                self.state = dict(zip(SHOWN, self._recipe.unpack(reply.data), strict=True))

    def seconds(self, duration: float) -> None:
        for _ in range(round(duration / self.controller.period_s)):
            self.tick()

    def until(self, condition: Callable[[], Any]) -> None:
        for _ in range(round(5.0 / self.controller.period_s)):
            if condition():
                return
            self.tick()
        raise AssertionError(f"not reached: {self.state}, {self.messages}")

    def rtde(self, data: bytes) -> None:
        self.clients["rtde"].feed(data)

    def ask(self, text: str) -> str:
        """The dashboard's answer."""
        client = self.clients["dashboard"]
        client.feed(text.encode() + b"\n")
        answer = b""
        for _ in range(round(5.0 / self.controller.period_s)):
            self.tick()
            answer += client.take()
            if answer.endswith(b"\n"):
                return answer.decode().rstrip("\n")
        raise AssertionError(f"no answer to {text}")

    def send(self, text: str) -> None:
        self.clients[self.port].feed(text.encode())

    def press(self, device: SafetyDevice, active: bool = True) -> None:
        self.controller.post(SetSafetyDevice(device, active))

    @property
    def playing(self) -> bool:
        return self.controller.programs.state is RuntimeState.PLAYING

    @property
    def moving(self) -> bool:
        return any(abs(speed) > 1e-3 for speed in self.state["actual_qd"])

    @property
    def peer(self) -> MemorySocket | None:
        """The other end of the program's connection."""
        mine = [socket for socket in self.network.opened if socket.state == "open"]
        return mine[-1] if mine else None

    def shown(self) -> dict[str, str]:
        """What the ports show now, as in the table."""
        state, running = self.ask("programState"), self.ask("running")
        return {
            "program": f"{_nameless(state)}; {running.removeprefix('Program running: ')}",
            "runtime state": RuntimeState(self.state["runtime_state"]).name,
            "robot mode": RobotMode(self.state["robot_mode"]).name,
            "safety mode": SafetyMode(self.state["safety_mode"]).name,
            "arm": "moves" if self.moving else "stands",
        }

    def heard(self) -> str:
        """What the primary client was told, in order."""
        return ", ".join(filter(None, map(_word, self.messages))) or "-"


def _nameless(answer: str) -> str:
    """The answer without the series' own word for no name."""
    return answer.replace("<unnamed>", "-").replace("null", "-")


def _short(answer: str) -> str:
    """The answer without the installation, which only e-Series add, and without advice."""
    return answer.split(", ")[0]


def _script_node(lines: tuple[str, ...]) -> str:
    text = "\n".join(lines) + "\n"
    return tag("Script", tag("cachedContents", text), tag("file", "/programs/moves.script"), type="File")


def _word(message: RobotMessage) -> str:
    if isinstance(message, KeyMessage):
        return f"{message.title.removeprefix('PROGRAM_XXX_').lower()} {message.text}"
    if isinstance(message, ErrorCodeMessage):
        return f"C{message.code}A{message.argument}"
    if isinstance(message, RuntimeExceptionMessage):
        return message.text
    if isinstance(message, TextMessage):
        return f"'{message.text}'"
    return "safety mode" if isinstance(message, SafetyModeMessage) else ""


# states


def _loaded(cell: Cell) -> None:
    assert cell.ask("load moves.urp").startswith("Loading program")


def _playing(cell: Cell) -> None:
    _loaded(cell)
    assert cell.ask("play") == "Starting program", cell.messages
    cell.seconds(0.6)
    assert cell.moving, cell.messages


def _sent(cell: Cell) -> None:
    cell.send(sent("client", *_PROGRAM))
    cell.until(lambda: cell.playing)
    cell.seconds(0.6)
    assert cell.moving, cell.messages


def _paused(cell: Cell) -> None:
    assert cell.ask("pause") == "Pausing program"
    cell.seconds(0.5)


def _connecting(cell: Cell) -> None:
    _sent(cell)
    cell.send(f'sec s():\n  socket_open("{SILENT[0]}", {SILENT[1]}, "s")\nend\n')
    cell.tick()
    cell.tick()


def _stopped_by(stop: Callable[[Cell], None]) -> Callable[[Cell], None]:
    def enter(cell: Cell) -> None:
        _playing(cell)
        stop(cell)
        cell.seconds(1.0)

    return enter


STATES: Final[dict[str, tuple[Callable[[Cell], Any], dict[str, Any]]]] = {
    "nothing loaded": (lambda cell: None, {}),
    ".urp stopped": (_loaded, {}),
    ".urp playing": (_playing, {}),
    ".urp paused": (lambda cell: (_playing(cell), _paused(cell)), {}),
    "sent program playing": (_sent, {}),
    "sent program paused": (lambda cell: (_sent(cell), _paused(cell)), {}),
    "secondary program connecting": (_connecting, {}),
    "power off": (_loaded, {"running": False}),
    "local control, simulator": (_loaded, {"version": _LOCAL}),
    "local control, arm": (lambda cell: None, {"enforce_remote_control": True}),
    "protective stop": (_stopped_by(lambda cell: cell.controller.protective_stop(SCRIPT_PROTECTIVE_STOP)), {}),
    "safeguard stop": (_stopped_by(lambda cell: cell.press(SafetyDevice.SAFEGUARD)), {}),
}
"""How to get into each state, and the robot's configuration."""

E_SERIES_ONLY: Final = frozenset({"local control, simulator", "local control, arm"})


# events: each returns the dashboard's answer, if it was asked


def _silent(cell: Cell) -> None:
    cell.feeding = False


def _digital_output(cell: Cell) -> None:
    cell.rtde(InputData(2, struct.pack(">BB", 1, 1)).encode(2))


def _slider(cell: Cell) -> None:
    cell.rtde(InputData(3, struct.pack(">Id", 1, 0.0)).encode(2))


def _unlock(cell: Cell) -> str:
    if cell.state["safety_mode"] == SafetyMode.PROTECTIVE_STOP:
        cell.seconds(5.0)  # before that it cannot be unlocked
    return cell.ask("unlock protective stop")


def _gone(cell: Cell) -> None:
    if cell.peer is not None:
        cell.peer.close()


EVENTS: Final[dict[str, Callable[[Cell], str | None]]] = {
    "program sent": lambda cell: cell.send(sent("next", "sleep(9)")),
    "program with an error sent": lambda cell: cell.send(sent("wrong", "nonsense()")),
    "secondary program sent": lambda cell: cell.send("sec set():\n  set_digital_out(1, True)\nend\n"),
    "play": lambda cell: cell.ask("play"),
    "pause": lambda cell: cell.ask("pause"),
    "stop": lambda cell: cell.ask("stop"),
    "load": lambda cell: cell.ask("load other.urp"),
    "RTDE client falls silent": _silent,
    "RTDE sets an output": _digital_output,
    "socket peer stays silent": lambda cell: cell.seconds(_SOCKET_S),
    "socket peer closes": _gone,
    "speed slider to 0": _slider,
    "brake release": lambda cell: cell.ask("brake release"),
    "unlock protective stop": _unlock,
    "emergency stop": lambda cell: cell.press(SafetyDevice.EMERGENCY_STOP),
}

COLUMNS: Final = ("answer", "program", "runtime state", "robot mode", "safety mode", "messages", "arm")
"""What a row of the table says: the dashboard's answer to the event, then, a second later, its answers to programState
and running, RTDE's modes, what the primary client got, and whether the arm moves."""


def series_of(state: str) -> Iterator[Series]:
    """The series that have a state."""
    return iter((Series.E,) if state in E_SERIES_ONLY else (Series.CB3, Series.E))


def observe(folder: Path, series: Series, state: str, event: str, port: str = PORTS[0]) -> dict[str, str]:
    """Put a robot into a state, let the event happen, and return what it shows."""
    enter, config = STATES[state]
    cell = Cell(folder, series, port, **config)
    enter(cell)
    cell.messages.clear()
    before = cell.state["actual_digital_output_bits"]
    answer = EVENTS[event](cell)
    cell.seconds(_SETTLED_S)
    outputs = ", output set" if cell.state["actual_digital_output_bits"] != before else ""
    return {"answer": _short(answer or "-"), **cell.shown(), "messages": cell.heard() + outputs}
