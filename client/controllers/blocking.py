"""`BlockingRobotControl`: control of a robot by controllers, for scripts and notebooks.

with BlockingRobotControl("192.168.1.10", make_ready=True) as control:
    control.activate("forward_velocity_controller")
    control.command("forward_velocity_controller", [0, 0, 0, 0, 0, 0.1])
"""

from client.blocking import Blocking
from client.controllers.control import RobotControl
from client.driver.scheduling import real_time_thread


class BlockingRobotControl(Blocking[RobotControl], without=("manager",)):
    """Blocking form of `RobotControl`: controllers run in a separate thread, in real time if allowed.

    `do` calls the controller manager.
    """

    async def _enter(self) -> RobotControl:
        control = await super()._enter()
        real_time_thread(control.driver.config.realtime)
        return control
