"""What a newcomer reads first: what this is, and what to do next."""

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from emulator.app import Emulator

__all__ = ["first_screen", "ready_line"]

_ABOUT = {
    "dashboard": "power, brakes, programs, one line of text each way",
    "primary": "robot state and messages at 10 Hz; takes URScript",
    "secondary": "robot state at 10 Hz; takes URScript",
    "realtime": "fixed state packet every control period; takes URScript",
    "rtde": "chosen variables both ways, up to the control rate",
}


def first_screen(emulator: Emulator) -> RenderableType:
    """Model, version, ports, and three things to try."""
    controller = emulator.controller
    title = f"{controller.model.title} with PolyScope {controller.version}, emulated"
    parts = (_ports(emulator), Text(), Text("Try next:", style="bold"), _first_steps(emulator))
    return Panel(Group(*parts), title=title, title_align="left", expand=False)


def ready_line(emulator: Emulator) -> Text:
    """Says what it says only after every port has answered."""
    state = "the brakes are released" if emulator.controller.power.running else "the arm is powered off"
    host = emulator.config.host
    return Text(f"Ready: every port on {host} answers, {state}. Ctrl-C ends it.", style="bold green")


def _ports(emulator: Emulator) -> Table:
    table = Table.grid(padding=(0, 2))
    ports = emulator.ports
    for name, about in _ABOUT.items():
        table.add_row(name, str(ports[name]), about)
    read_only = ", ".join(str(port) for name, port in ports.items() if name.endswith("read-only"))
    table.add_row("read-only", read_only, "primary, secondary, realtime without URScript")
    return table


def _first_steps(emulator: Emulator) -> Text:
    host, ports = emulator.config.host, emulator.ports
    home = ", ".join(f"{angle:g}" for angle in emulator.controller.model.home_q)
    power = "" if emulator.controller.power.running else f"  echo 'brake release' | nc {host} {ports['dashboard']}\n"
    return Text(
        f"{power}"
        f"  echo 'movej([{home}])' | nc -N {host} {ports['secondary']}\n"
        f"  pip install ur-rtde    # then, in Python:\n"
        f"    import rtde_control\n"
        f'    robot = rtde_control.RTDEControlInterface("{host}")\n'
        f"    robot.moveJ([0.3, -1.2, 1.0, -1.4, -1.57, 0.0])"
    )
