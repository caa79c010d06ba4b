"""The controllers of ros2_control, without ROS: loaded by name from a controllers file, updated at the robot's rate."""

from client.controllers.blocking import BlockingRobotControl
from client.controllers.configuration import ControllersFile, read_controllers, usual_controllers
from client.controllers.control import RobotControl
from client.controllers.goals import (
    ErrorCode,
    FollowJointTrajectory,
    GoalHandle,
    GoalStatus,
    JointTrajectory,
    JointTrajectoryPoint,
    MotionPrimitive,
    PrimitiveType,
    Result,
    Tolerance,
)
from client.controllers.loop import ControlLoop
from client.controllers.manager import ControllerManager
from client.controllers.ur_states import RTDE_OUTPUTS
from urproto.joints import JOINT_NAMES

__all__ = [
    "JOINT_NAMES",
    "RTDE_OUTPUTS",
    "BlockingRobotControl",
    "ControlLoop",
    "ControllerManager",
    "ControllersFile",
    "ErrorCode",
    "FollowJointTrajectory",
    "GoalHandle",
    "GoalStatus",
    "JointTrajectory",
    "JointTrajectoryPoint",
    "MotionPrimitive",
    "PrimitiveType",
    "Result",
    "RobotControl",
    "Tolerance",
    "read_controllers",
    "usual_controllers",
]
