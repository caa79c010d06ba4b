"""What a terminal shows of an emulator: its ports, three things to try, and the line that says it is ready."""

import sys
from collections.abc import Sequence
from pathlib import Path
from shutil import which
from typing import Final

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from emulator.app import Emulator
from emulator.ports import PORTS
from urproto.addresses import local_address
from urproto.dashboard import COMMANDS
from urproto.robotapi import AVAILABLE as ROBOT_API
from urproto.robotapi import BASE, GET_PROGRAM_STATE, PUT_STATE

_LOOPBACK = "127.0.0.1"
_ABOUT = {
    "robot api": "power, brakes, programs: HTTP (/universal-robots/robot-api)",
    "dashboard": "power, brakes, programs: text commands",
    "primary": "state and messages at 10 Hz; accepts URScript",
    "secondary": "state at 10 Hz; accepts URScript",
    "realtime": "state at the control rate; accepts URScript",
    "rtde": "variables of your choice, in both directions",
    "modbus": "registers and coils (Modbus/TCP)",
    "interpreter": "statements for a program in interpreter_mode()",
    "control": "this emulator's own API: inputs, faults, time (ur-emulator ctl)",
    "cameras": "images of the scene: HTTP, also for a browser",
    "tool line": "the tool's serial line",
    "gripper": "text commands",
}
_REMOTE_CONTROL: Final = COMMANDS["is in remote control"].available
_SIMULATOR_ADDRESSES: Final = ("127.0.0.1", "localhost", "192.168.56.101")  # what ur_rtde takes for a simulator


def first_screen(emulator: Emulator) -> RenderableType:
    """Model, version, ports, and three things to try."""
    controller = emulator.controller
    title = f"{controller.model.title} with PolyScope {controller.version}, emulated"
    parts = (_ports(emulator), Text(), Text("Try next:", style="bold"), _first_steps(emulator))
    return Panel(Group(*parts), title=title, title_align="left", expand=False)


def ready_line(emulator: Emulator, granted: Sequence[str]) -> Text:
    """The line that is printed once every port has answered. granted: what `claim_real_time` returned."""
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
    for reason in emulator.port_fallbacks.values():
        table.add_row("", "", f"{reason}; using a free port instead")
    return table


def _about(emulator: Emulator, name: str, about: str) -> str:
    if name == "tool line":
        return f"{about}, to {emulator.tool_device}"
    mounted = emulator.controller.gripper
    return f"{mounted.model.title}: {about}" if name == "gripper" and mounted else about


def _dashboard_line(emulator: Emulator) -> str:
    """A shell command that releases the brakes, or queries the robot mode if they are released."""
    command = "robotmode" if emulator.controller.power.running else "brake release"
    config = emulator.config
    if "dashboard" not in emulator.ports:
        return _api_line(emulator)
    if config.ephemeral_ports:
        return f"printf '{command}\\nquit\\n' | nc {local_address(emulator.config.host)} {emulator.ports['dashboard']}"
    options = (
        "" if local_address(emulator.config.host) == _LOOPBACK else f" --robot-ip {local_address(emulator.config.host)}"
    )
    options += f" --port-offset {config.port_offset}" if config.port_offset else ""
    return f'{_client()} dashboard "{command}"{options}'


def _api_line(emulator: Emulator) -> str:
    """The same for PolyScope X, whose first versions can be controlled from their pendant only."""
    if not ROBOT_API.covers(emulator.controller.version):
        return "# this version has no Robot API yet: switch the arm on with its pendant, or start with --running"
    base = f"http://{emulator.config.host}:{emulator.ports['robot api']}{BASE}"
    if emulator.controller.power.running:
        return f"curl {base}{GET_PROGRAM_STATE.path}"
    body = '{"action": "BRAKE_RELEASE"}'
    return f"curl -X PUT -H 'Content-Type: application/json' -d '{body}' {base}{PUT_STATE.path}"


def _client() -> str:
    """The command ``ur-client`` as this terminal can call it: with its path if that is not in PATH."""
    return "ur-client" if which("ur-client") else str(Path(sys.executable).with_name("ur-client"))


def _first_steps(emulator: Emulator) -> Text:
    host = local_address(emulator.config.host)
    steps = f"  {_dashboard_line(emulator)}\n"
    if "rtde" not in emulator.ports:
        return Text(f"{steps}  ur_rtde needs RTDE, which this version does not have yet")
    if emulator.config.wanted_ports["rtde"] != PORTS["rtde"]:
        return Text(
            f"{steps}  ur_rtde connects to the usual ports only: give each of several robots its own --host 127.0.0.x"
        )
    controller = emulator.controller
    has_remote_control = _REMOTE_CONTROL.covers(controller.version) and "dashboard" in emulator.ports
    is_required = has_remote_control and host not in _SIMULATOR_ADDRESSES and not controller.remote_control
    remote = "  ur_rtde requires remote control at this address: start with --remote-control\n" if is_required else ""
    return Text(
        f"{steps}{remote}"
        "  pip install ur-rtde    # then in Python, once the brakes are released:\n"
        "    from rtde_control import RTDEControlInterface\n"
        f'    robot = RTDEControlInterface("{host}")\n'
        "    robot.moveJ([0.3, -1.2, 1.0, -1.4, -1.57, 0.0])"
    )
