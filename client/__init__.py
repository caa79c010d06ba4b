"""The driver library: dashboard, data exchange and scripts for a robot, emulated or real.

`Robot` is what most programs want. The clients below it come in two shells over the same logic: ``X`` for
asyncio, ``BlockingX`` for plain scripts; of the robot itself these are `AsyncRobot` and `Robot`.
"""

from client.calibration import read_calibration, write_calibration
from client.dashboard import BlockingDashboardClient, DashboardClient
from client.driver import BlockingURDriver, URDriver, points
from client.errors import (
    ClientError,
    ConnectionLostError,
    DeviceError,
    FileError,
    MotionError,
    MotionStoppedError,
    NoAnswerError,
    OutOfReachError,
    ProgramEndedError,
    ProgramNotRunningError,
    ProtectiveStopError,
    RobotUnreachableError,
    SafetyStopError,
    ScriptFailedError,
)
from client.modbus import BlockingModbusClient, ModbusClient
from client.primary import BlockingPrimaryClient, PrimaryClient, ScriptResult
from client.realtime import BlockingRealtimeClient, RealtimeClient
from client.robot import AsyncRobot, Robot, RobotState
from client.rtde import BlockingRTDEClient, RTDEClient, read_recipe
from client.tool_communication import ToolCommunication

__all__ = [
    "AsyncRobot",
    "BlockingDashboardClient",
    "BlockingModbusClient",
    "BlockingPrimaryClient",
    "BlockingRTDEClient",
    "BlockingRealtimeClient",
    "BlockingURDriver",
    "ClientError",
    "ConnectionLostError",
    "DashboardClient",
    "DeviceError",
    "FileError",
    "ModbusClient",
    "MotionError",
    "MotionStoppedError",
    "NoAnswerError",
    "OutOfReachError",
    "PrimaryClient",
    "ProgramEndedError",
    "ProgramNotRunningError",
    "ProtectiveStopError",
    "RTDEClient",
    "RealtimeClient",
    "Robot",
    "RobotState",
    "RobotUnreachableError",
    "SafetyStopError",
    "ScriptFailedError",
    "ScriptResult",
    "ToolCommunication",
    "URDriver",
    "points",
    "read_calibration",
    "read_recipe",
    "write_calibration",
]
