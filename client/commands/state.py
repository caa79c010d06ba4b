"""``ur-client state``: what the robot is doing, once."""

from typing import Any

from rich.table import Table

from client import rtde
from client.commands.options import PortOffset, RobotIP
from urproto.commandline import AsJson, console, print_json
from urproto.modes import RobotMode, RuntimeState, SafetyMode, mode_name
from urproto.rtde.fields import OUTPUT_FIELDS

__all__ = ["state_command"]

_STATE = (
    "timestamp", "robot_mode", "safety_mode", "runtime_state", "target_speed_fraction",
    "actual_q", "actual_qd", "actual_TCP_pose",
)  # fmt: skip
_NAMES = {"robot_mode": RobotMode, "safety_mode": SafetyMode, "runtime_state": RuntimeState}


def state_command(as_json: AsJson = False, robot_ip: RobotIP = "127.0.0.1", port_offset: PortOffset = 0) -> None:
    """Print what the robot is doing right now."""
    with rtde.BlockingRTDEClient(robot_ip, _STATE, port=rtde.PORT + port_offset) as robot:
        state = robot.receive()
        version = robot.core.version
    if as_json:
        modes = {name: mode_name(_NAMES[name], state[name]) for name in _NAMES}
        print_json({"robot_ip": robot_ip, "polyscope": str(version), **state, **modes})
        return
    table = Table("variable", "value", "unit", title=f"{robot_ip}, PolyScope {version}")
    for name, value in state.items():
        table.add_row(name, _readable(name, value), OUTPUT_FIELDS[name].unit)
    console().print(table)


def _readable(name: str, value: Any) -> str:
    if name in _NAMES:
        return mode_name(_NAMES[name], value)
    numbers = value if isinstance(value, tuple) else (value,)
    return ", ".join(f"{number:.4f}" for number in numbers)
