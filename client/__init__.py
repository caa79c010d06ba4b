"""The driver library: dashboard, data exchange and scripts for a robot, emulated or real.

Each client comes in two shells over the same logic: ``X`` for asyncio, ``BlockingX`` for plain scripts.
"""

from client.dashboard import BlockingDashboardClient, DashboardClient
from client.errors import (
    ClientError,
    ConnectionLostError,
    DeviceError,
    NoAnswerError,
    RobotUnreachableError,
    ScriptFailedError,
)
from client.primary import BlockingPrimaryClient, PrimaryClient
from client.rtde import BlockingRTDEClient, RTDEClient
from client.tool_communication import ToolCommunication

__all__ = [
    "BlockingDashboardClient",
    "BlockingPrimaryClient",
    "BlockingRTDEClient",
    "ClientError",
    "ConnectionLostError",
    "DashboardClient",
    "DeviceError",
    "NoAnswerError",
    "PrimaryClient",
    "RTDEClient",
    "RobotUnreachableError",
    "ScriptFailedError",
    "ToolCommunication",
]
