"""The driver library: dashboard, data exchange and scripts for a robot, emulated or real.

Each client comes in two shells over the same logic: ``X`` for asyncio, ``BlockingX`` for plain scripts.
"""

from client.dashboard import BlockingDashboardClient, DashboardClient
from client.driver import BlockingURDriver, URDriver
from client.errors import (
    ClientError,
    ConnectionLostError,
    DeviceError,
    NoAnswerError,
    ProgramEndedError,
    ProgramNotRunningError,
    RobotUnreachableError,
    ScriptFailedError,
)
from client.primary import BlockingPrimaryClient, PrimaryClient, ScriptResult
from client.realtime import BlockingRealtimeClient, RealtimeClient
from client.rtde import BlockingRTDEClient, RTDEClient, read_recipe
from client.tool_communication import ToolCommunication

__all__ = [
    "BlockingDashboardClient",
    "BlockingPrimaryClient",
    "BlockingRTDEClient",
    "BlockingRealtimeClient",
    "BlockingURDriver",
    "ClientError",
    "ConnectionLostError",
    "DashboardClient",
    "DeviceError",
    "NoAnswerError",
    "PrimaryClient",
    "ProgramEndedError",
    "ProgramNotRunningError",
    "RTDEClient",
    "RealtimeClient",
    "RobotUnreachableError",
    "ScriptFailedError",
    "ScriptResult",
    "ToolCommunication",
    "URDriver",
    "read_recipe",
]
