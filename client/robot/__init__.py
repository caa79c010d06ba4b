"""High-level interface to a robot: power it on, move it, read its state, and get errors that name the cause.

    with Robot("192.168.1.10") as robot:
        robot.make_ready()
        robot.move_j([0.2, -1.4, 1.5, -1.7, -1.5, 0.1])
        x, y, z, *turn = robot.tcp_pose
        robot.move_l([x, y, z + 0.05, *turn], speed_m_s=0.1)

`AsyncRobot` is the counterpart for asyncio programs. Both are built on the driver `client.URDriver`.
"""

from client.robot.blocking import Robot
from client.robot.robot import AsyncRobot
from client.robot.state import RobotState

__all__ = ["AsyncRobot", "Robot", "RobotState"]
