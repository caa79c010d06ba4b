"""The External Control driver: moves a robot through a control program that runs on the robot.

`URDriver` and `BlockingURDriver` combine everything; the endpoints can also be used alone.
"""

from client.driver import points
from client.driver.blocking import BlockingURDriver
from client.driver.config import DriverConfig, calibration_hash
from client.driver.driver import URDriver
from client.driver.endpoint import Endpoint
from client.driver.results import ScriptCommandEndpoint, TrajectoryEndpoint
from client.driver.reverse import ReverseEndpoint
from client.driver.script_sender import ScriptSender
from urproto.external_control import TrajectoryPoint, TrajectoryResult

__all__ = [
    "BlockingURDriver",
    "DriverConfig",
    "Endpoint",
    "ReverseEndpoint",
    "ScriptCommandEndpoint",
    "ScriptSender",
    "TrajectoryEndpoint",
    "TrajectoryPoint",
    "TrajectoryResult",
    "URDriver",
    "calibration_hash",
    "points",
]
