"""Which robot a recording is of, in words for its first block."""

from typing import Any

from client.dashboard import PORT, DashboardClient
from client.errors import ClientError
from client.operations import POLYSCOPE_VERSION, ROBOT_MODEL, Operation
from urproto.errors import ProtocolError, RobotRefused

__all__ = ["ask_identity"]

_PATIENCE_S = 2.0
_UNKNOWN = "unknown"


async def ask_identity(host: str, port_offset: int = 0) -> list[str]:
    """Model and version, asked of the dashboard: nothing that changes the robot, nor its serial number."""
    try:
        async with DashboardClient(host, PORT + port_offset, _PATIENCE_S) as dashboard:
            version = await _ask(dashboard, POLYSCOPE_VERSION)
            model = await _ask(dashboard, ROBOT_MODEL)
    except (ClientError, ProtocolError):
        version = model = _UNKNOWN
    return [f"robot: {model}", f"PolyScope: {version}"]


async def _ask(dashboard: DashboardClient, operation: Operation[Any]) -> str:
    try:
        return str(await dashboard.ask(operation))
    except RobotRefused:
        return _UNKNOWN
