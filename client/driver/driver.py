"""The driver: everything a robot with External Control can do.

async with URDriver("192.168.56.101") as driver:
    await driver.start_program()
    await driver.execute([points.movej(q) for q in path])

with BlockingURDriver("192.168.56.101") as driver:
    driver.start_program()
    while driver.next_state()["timestamp"] < end:
        driver.servoj(target())
"""

from collections.abc import Mapping
from typing import Any

from client.driver.blocking import Blocking, blocking, straight
from client.driver.commands import Commands
from client.driver.config import DriverConfig
from client.driver.core import Recovery, Setpoints
from client.driver.trajectories import Trajectories


class URDriver(Setpoints, Trajectories, Commands, Recovery):
    """A robot as a driver sees it, for asyncio programs; options are those of `DriverConfig`."""

    def __init__(self, robot: str, **options: Any) -> None:
        super().__init__(DriverConfig(robot=robot, **options))


class BlockingURDriver(Blocking[URDriver]):
    """The same for scripts, notebooks and control loops; its connections live in a thread of its own.

    Callbacks are called in that thread.
    """

    def __init__(self, robot: str, **options: Any) -> None:
        super().__init__(lambda: URDriver(robot, **options))

    start_program = blocking(URDriver.start_program)
    stop_program = blocking(URDriver.stop_program)
    wait_for_program = blocking(URDriver.wait_for_program)
    on_program_state = blocking(URDriver.on_program_state)
    on_safety_mode = blocking(URDriver.on_safety_mode)
    recover = blocking(URDriver.recover)
    set_speed_slider = blocking(URDriver.set_speed_slider)

    servoj = straight(URDriver.servoj)
    servo_pose = straight(URDriver.servo_pose)
    speedj = straight(URDriver.speedj)
    speedl = straight(URDriver.speedl)
    torque = straight(URDriver.torque)
    idle = straight(URDriver.idle)
    start_freedrive = straight(URDriver.start_freedrive)
    keep_freedrive = straight(URDriver.keep_freedrive)
    stop_freedrive = straight(URDriver.stop_freedrive)

    execute = blocking(URDriver.execute)
    start_trajectory = blocking(URDriver.start_trajectory)
    trajectory_result = blocking(URDriver.trajectory_result)
    cancel_trajectory = blocking(URDriver.cancel_trajectory)
    start_stream = blocking(URDriver.start_stream)
    stream = blocking(URDriver.stream)
    end_stream = blocking(URDriver.end_stream)

    ask = blocking(URDriver.ask)
    set_stream_parameters = blocking(URDriver.set_stream_parameters)
    set_freedrive_axes = blocking(URDriver.set_freedrive_axes)
    set_force_mode_parameters = blocking(URDriver.set_force_mode_parameters)
    start_contact_detection = blocking(URDriver.start_contact_detection)
    stop_contact_detection = blocking(URDriver.stop_contact_detection)
    zero_ftsensor = blocking(URDriver.zero_ftsensor)
    set_payload = blocking(URDriver.set_payload)
    set_target_payload = blocking(URDriver.set_target_payload)
    set_tool_voltage = blocking(URDriver.set_tool_voltage)
    set_gravity = blocking(URDriver.set_gravity)
    set_tcp = blocking(URDriver.set_tcp)
    start_force_mode = blocking(URDriver.start_force_mode)
    end_force_mode = blocking(URDriver.end_force_mode)
    start_tool_contact = blocking(URDriver.start_tool_contact)
    end_tool_contact = blocking(URDriver.end_tool_contact)
    tool_contact_result = blocking(URDriver.tool_contact_result)
    ft_rtde_input_enable = blocking(URDriver.ft_rtde_input_enable)
    set_friction_compensation = blocking(URDriver.set_friction_compensation)
    set_friction_scales = blocking(URDriver.set_friction_scales)

    def next_state(self) -> Mapping[str, Any]:
        """The RTDE state after the newest one."""
        feed = self.inner.robot.feed
        return feed.wait(feed.count, self.inner.config.silence_s)

    @property
    def lost_why(self) -> str:
        """Why the last control program has ended, when that was this machine's doing; else empty."""
        return self.inner.lost_why

    @property
    def program_running(self) -> bool:
        """True while the control program is connected."""
        return self.inner.program_running

    @property
    def protective_stopped(self) -> bool:
        """True during a protective stop."""
        return self.inner.protective_stopped

    @property
    def state(self) -> Any:
        """The newest RTDE state, by variable name."""
        return self.inner.state
