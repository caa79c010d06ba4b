"""The ports of a controller, and the ports of a driver to which the controller's programs connect."""

from collections.abc import Iterable, Iterator
from difflib import get_close_matches
from typing import Any

from client.dashboard import PORT, DashboardClient
from client.dashboard_commands import POLYSCOPE_VERSION, ROBOT_MODEL, Operation
from client.decoding.codecs import Side, codec_of_port
from urproto.errors import LocalProtocolError, RobotRefused, URError
from urproto.ports import CONTROLLER_PORTS

_TIMEOUT_S = 2.0
_UNKNOWN = "unknown"
ROBOT_PORTS = CONTROLLER_PORTS
DRIVER_PORTS = {"reverse": 50001, "script-sender": 50002, "trajectory": 50003, "script-command": 50004}
_NAMES = {port: name for name, port in {**ROBOT_PORTS, **DRIVER_PORTS}.items()}


async def query_identity(host: str, port_offset: int = 0) -> list[str]:
    """Ask the dashboard for model and version. This changes nothing on the robot and leaves out its serial number."""
    try:
        async with DashboardClient(host, PORT + port_offset, _TIMEOUT_S) as dashboard:
            version = await _request(dashboard, POLYSCOPE_VERSION)
            model = await _request(dashboard, ROBOT_MODEL)
    except URError:
        version = model = _UNKNOWN
    return [f"robot: {model}", f"PolyScope: {version}"]


async def _request(dashboard: DashboardClient, operation: Operation[Any]) -> str:
    try:
        return str(await dashboard.request(operation))
    except RobotRefused:
        return _UNKNOWN


def is_traffic(port: int) -> bool:
    """Whether a robot or its driver usually listens there."""
    return port in _NAMES


def port_name(port: int) -> str:
    """A port's name, or its number if it has none."""
    return _NAMES.get(port, str(port))


def server_is_robot(port: int) -> bool:
    """Whether the robot, rather than the driver, listens on this port."""
    codec = codec_of_port(port)
    return codec is None or codec.server is Side.ROBOT


def choose_ports(wanted: Iterable[str]) -> dict[str, int]:
    """Ports by name or number; all of a robot's if none is given. Raises LocalProtocolError for unknown ports."""
    chosen = {port_name(port): port for port in map(_port, _split(wanted))}
    return chosen or dict(ROBOT_PORTS)


def _split(wanted: Iterable[str]) -> Iterator[str]:
    for text in wanted:
        yield from (part.strip() for part in text.split(",") if part.strip())


def _port(text: str) -> int:
    if text in ROBOT_PORTS:
        return ROBOT_PORTS[text]
    if text.isdecimal() and 0 < int(text) < 1 << 16:
        return int(text)
    close = get_close_matches(text, ROBOT_PORTS, 1)
    hint = f"did you mean {close[0]}?" if close else f"choose one of {', '.join(ROBOT_PORTS)}, or give a number"
    raise LocalProtocolError(f"{text!r} is not a port of a robot: {hint}")
