"""Client library for Universal Robots controllers, real or emulated: motion, state, dashboard and scripts.

Most programs need `Robot` only. The clients of the individual ports come in two variants with the same logic: ``X`` for
asyncio programs, ``BlockingX`` for plain scripts. For the robot itself these are `AsyncRobot` and `Robot`.

The names below are imported from their modules on first use. Programs that need few of them, like most commands of
``ur-client``, start in half the time.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from urproto.lazy import exports

if TYPE_CHECKING:
    from client.calibration import read_calibration, write_calibration
    from client.dashboard import BlockingDashboardClient, DashboardClient
    from client.driver import BlockingURDriver, URDriver, points
    from client.errors import (
        ClientError,
        ConnectionLostError,
        DeviceError,
        FileError,
        LateSetpointError,
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
        StaleStateError,
    )
    from client.gripper import GripperClient
    from client.modbus import BlockingModbusClient, ModbusClient
    from client.primary import BlockingPrimaryClient, PrimaryClient
    from client.realtime import BlockingRealtimeClient, RealtimeClient
    from client.robot import AsyncRobot, Robot, RobotState
    from client.robotapi import BlockingRobotAPIClient, RobotAPIClient
    from client.rtde import BlockingRTDEClient, RTDEClient, read_recipe
    from client.scripts import ScriptResult
    from client.tool_communication import ToolCommunication
    from urproto.errors import URError

__all__ = [
    "AsyncRobot",
    "BlockingDashboardClient",
    "BlockingModbusClient",
    "BlockingPrimaryClient",
    "BlockingRTDEClient",
    "BlockingRealtimeClient",
    "BlockingRobotAPIClient",
    "BlockingURDriver",
    "ClientError",
    "ConnectionLostError",
    "DashboardClient",
    "DeviceError",
    "FileError",
    "GripperClient",
    "LateSetpointError",
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
    "RobotAPIClient",
    "RobotState",
    "RobotUnreachableError",
    "SafetyStopError",
    "ScriptFailedError",
    "ScriptResult",
    "StaleStateError",
    "ToolCommunication",
    "URDriver",
    "URError",
    "points",
    "read_calibration",
    "read_recipe",
    "write_calibration",
]

_MODULES: Final[Mapping[str, tuple[str, ...]]] = {
    "client.calibration": ("read_calibration", "write_calibration"),
    "client.dashboard": ("BlockingDashboardClient", "DashboardClient"),
    "client.driver": ("BlockingURDriver", "URDriver", "points"),
    "client.errors": (
        "ClientError",
        "ConnectionLostError",
        "DeviceError",
        "FileError",
        "LateSetpointError",
        "MotionError",
        "MotionStoppedError",
        "NoAnswerError",
        "OutOfReachError",
        "ProgramEndedError",
        "ProgramNotRunningError",
        "ProtectiveStopError",
        "RobotUnreachableError",
        "SafetyStopError",
        "ScriptFailedError",
        "StaleStateError",
    ),
    "client.gripper": ("GripperClient",),
    "client.modbus": ("BlockingModbusClient", "ModbusClient"),
    "client.primary": ("BlockingPrimaryClient", "PrimaryClient"),
    "client.realtime": ("BlockingRealtimeClient", "RealtimeClient"),
    "client.robot": ("AsyncRobot", "Robot", "RobotState"),
    "client.robotapi": ("BlockingRobotAPIClient", "RobotAPIClient"),
    "client.rtde": ("BlockingRTDEClient", "RTDEClient", "read_recipe"),
    "client.scripts": ("ScriptResult",),
    "client.tool_communication": ("ToolCommunication",),
    "urproto.errors": ("URError",),
}
__getattr__, __dir__ = exports(globals(), _MODULES)
