"""What a newcomer reads first: what this is, and what to do next."""

import sys
from collections.abc import Sequence
from pathlib import Path
from shutil import which

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from emulator.app import Emulator
from emulator.config import PORTS

__all__ = ["first_screen", "ready_line"]

_LOCALHOST = "127.0.0.1"
_ABOUT = {
    "dashboard": "power, brakes, programs: lines of text",
    "primary": "state and messages at 10 Hz; takes URScript",
    "secondary": "state at 10 Hz; takes URScript",
    "realtime": "state at the control rate; takes URScript",
    "rtde": "variables of your choice, both ways",
    "modbus": "registers and coils (Modbus/TCP)",
    "interpreter": "statements for a program in interpreter_mode()",
    "control": "this emulator's own API: inputs, faults, time (ur-emulator ctl)",
    "tool line": "the tool's serial line",
    "gripper": "lines of text",
}


def first_screen(emulator: Emulator) -> RenderableType:
    """Model, version, ports, and three things to try."""
    controller = emulator.controller
    title = f"{controller.model.title} with PolyScope {controller.version}, emulated"
    parts = (_ports(emulator), Text(), Text("Try next:", style="bold"), _first_steps(emulator))
    return Panel(Group(*parts), title=title, title_align="left", expand=False)


def ready_line(emulator: Emulator, granted: Sequence[str]) -> Text:
    """Says what it says only after every port has answered. granted: what `claim_real_time` returned."""
    state = "the brakes are released" if emulator.controller.power.running else "the arm is powered off"
    host = emulator.config.host
    punctual = f"in real time ({', '.join(granted)})" if granted else "without real-time priority"
    return Text(f"Ready: every port on {host} answers, {state}; {punctual}. Ctrl-C ends it.", style="bold green")


def _ports(emulator: Emulator) -> Table:
    table = Table.grid(padding=(0, 2))
    ports = emulator.ports
    for name, about in _ABOUT.items():
        if name not in ports:
            continue
        table.add_row(name, str(ports[name]), _about(emulator, name, about))
    read_only = ", ".join(str(port) for name, port in ports.items() if name.endswith("read-only"))
    table.add_row("read-only", read_only, "as primary, secondary, realtime")
    for reason in emulator.moved.values():
        table.add_row("", "", f"{reason}; a free one serves instead")
    return table


def _about(emulator: Emulator, name: str, about: str) -> str:
    if name == "tool line":
        return f"{about}, to {emulator.tool_device}"
    mounted = emulator.controller.gripper
    return f"{mounted.model.title}: {about}" if name == "gripper" and mounted else about


def _dashboard_line(emulator: Emulator) -> str:
    """A shell command that wakes the arm up, or asks for its mode when it is awake."""
    command = "robotmode" if emulator.controller.power.running else "brake release"
    config = emulator.config
    if config.ephemeral_ports:
        return f"printf '{command}\\nquit\\n' | nc {config.host} {emulator.ports['dashboard']}"
    options = "" if config.host == _LOCALHOST else f" --robot-ip {config.host}"
    options += f" --port-offset {config.port_offset}" if config.port_offset else ""
    return f'{_client()} dashboard "{command}"{options}'


def _client() -> str:
    """The driver's command as this terminal can call it: installed beside the interpreter, on the PATH or not."""
    return "ur-client" if which("ur-client") else str(Path(sys.executable).with_name("ur-client"))


def _first_steps(emulator: Emulator) -> Text:
    host = emulator.config.host
    steps = f"  {_dashboard_line(emulator)}\n"
    if emulator.config.wanted_ports["rtde"] != PORTS["rtde"]:
        return Text(
            f"{steps}  ur_rtde knows the usual ports only: for several robots give each its own --host 127.0.0.x"
        )
    return Text(
        f"{steps}"
        "  pip install ur-rtde    # then in Python, once the brakes are released:\n"
        "    from rtde_control import RTDEControlInterface\n"
        f'    robot = RTDEControlInterface("{host}")\n'
        "    robot.moveJ([0.3, -1.2, 1.0, -1.4, -1.57, 0.0])"
    )
