"""`Robot`: the blocking form of `AsyncRobot`, for scripts and notebooks."""

from client.blocking import Blocking
from client.robot.robot import AsyncRobot


class Robot(Blocking[AsyncRobot]):
    """A robot for scripts and notebooks; use it with ``with``.

    The blocking form of `AsyncRobot`, which documents units, frames and errors. `stop` may be called from another
    thread. A KeyboardInterrupt during a move stops the arm.
    """
