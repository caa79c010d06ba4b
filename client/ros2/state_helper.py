"""The node ``ur_robot_state_helper``: its action ``~/set_mode`` brings the arm to a mode, from any other mode."""

import asyncio
from collections.abc import Callable, Mapping
from typing import Any, Final

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.action import ActionServer, CancelResponse, GoalResponse

from client import dashboard
from client.dashboard import DashboardClient
from client.driver.link import MOVABLE
from client.errors import ClientError
from client.primary import BRAKE_RELEASE, POWER_OFF, POWER_ON, STOP_PROGRAM, PrimaryClient, TextCommand
from client.robot import AsyncRobot
from client.ros2.host import NodeHost, interface
from urproto.errors import RobotRefused, URError
from urproto.modes import RobotMode, RuntimeState, SafetyMode, mode_of

NAME: Final = "ur_robot_state_helper"
_EFFECT_S: Final = 30.0  # as long as the dashboard's services wait
_PLAY_AFTER_S: Final = 1.0  # the ROS 2 driver: a robot refuses to play immediately after releasing its brakes

_COMMANDS: Final[Mapping[int, TextCommand]] = {
    RobotMode.POWER_OFF: POWER_OFF,
    RobotMode.IDLE: POWER_ON,
    RobotMode.RUNNING: BRAKE_RELEASE,
}
"""The modes that can be requested, with the command that leads there; they are also the modes to start from."""
_ADVICE: Final[Mapping[int, str]] = {
    RobotMode.CONFIRM_SAFETY: "confirm the safety configuration on the teach pendant",
    RobotMode.BOOTING: "wait until it has booted",
    RobotMode.POWER_ON: "wait until it is IDLE",
    RobotMode.BACKDRIVE: "let go of the teach button",
}
_EMERGENCY: Final = (SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP)
_BROKEN: Final = (SafetyMode.VIOLATION, SafetyMode.FAULT)


class StateHelperNode:
    """The node; it spins from its creation until `close`.

    Goals are executed one after the other and cannot be cancelled. With ``headless_mode``, ``play_program`` sends the
    control program; without it, it plays the program that is loaded on the pendant. A goal is rejected while the robot
    sends no states.
    """

    def __init__(self, host: NodeHost, robot: AsyncRobot) -> None:
        config = robot.driver.config
        self.node = host.node(NAME)
        fixed = ParameterDescriptor(read_only=True)
        self._headless = self.node.declare_parameter("headless_mode", config.headless, fixed).value
        self._address = self.node.declare_parameter("robot_ip", config.host, fixed).value
        self._type = interface("ur_dashboard_msgs/action/SetMode")
        self._host = host
        self._driver = robot.driver
        self._link = robot.driver.link
        self._one_at_a_time = asyncio.Lock()
        self._server = ActionServer(
            self.node,
            self._type,
            "~/set_mode",
            self._execute,
            goal_callback=self._accept,
            cancel_callback=lambda handle: CancelResponse.REJECT,
        )
        host.spin(self.node)

    def close(self) -> None:
        """End the node; a goal in execution is abandoned."""
        self._host.close(self.node)

    # in the node's thread

    def _accept(self, goal: Any) -> GoalResponse:
        if self._link.feed.silent:
            self.node.get_logger().error("set_mode: goal rejected: the robot sends no states, so its mode is unknown")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    async def _execute(self, handle: Any) -> Any:
        why = await self._host.task(self.node, self._execute_goal(handle))
        if why:
            self.node.get_logger().error(f"set_mode: {why}")
            handle.abort()
        else:
            handle.succeed()
        return self._type.Result(success=not why, message=why or "the robot is in the requested mode")

    # in the event loop

    async def _execute_goal(self, handle: Any) -> str:
        """Execute a goal; return the reason if it fails, otherwise an empty string."""
        report = self._feedback(handle)
        self._link.on_modes.append(report)
        try:
            async with self._one_at_a_time:
                await self._set_mode(handle.request)
        except URError as error:
            return str(error)
        finally:
            self._link.on_modes.remove(report)
        return ""

    def _feedback(self, handle: Any) -> Callable[[Mapping[str, Any]], None]:
        """A function that publishes each change of a mode as feedback."""
        last = [self._modes]

        def report(state: Mapping[str, Any]) -> None:
            if self._modes != last[0]:
                last[0] = self._modes
                robot_mode, safety_mode = self._modes
                handle.publish_feedback(
                    self._type.Feedback(current_robot_mode=int(robot_mode), current_safety_mode=int(safety_mode))
                )

        return report

    @property
    def _modes(self) -> "tuple[RobotMode, SafetyMode]":
        return self._link.robot_mode, self._link.safety_mode

    async def _set_mode(self, goal: Any) -> None:
        target = mode_of(RobotMode, goal.target_robot_mode)
        if target not in _COMMANDS:
            raise ClientError(f"{target.name} cannot be requested: choose POWER_OFF (3), IDLE (5) or RUNNING (7)")
        if goal.stop_program and self._driver.program_running:
            await self._command(STOP_PROGRAM)
        if self._link.robot_mode != target or self._link.safety_mode not in MOVABLE:
            await self._recover()
            await self._switch(target)
        await self._wait_until(lambda: self._link.robot_mode == target, target.name)
        if goal.play_program and target is RobotMode.RUNNING and not self._driver.program_running:
            await self._play()

    async def _recover(self) -> None:
        """Resolve safety modes that prevent any change of mode."""
        mode = self._link.safety_mode
        if mode in _EMERGENCY:
            raise RobotRefused("set_mode", f"it is in {mode.name}", "release the emergency stop")
        if mode is SafetyMode.PROTECTIVE_STOP:
            await self._link.unlock_protective_stop()
        elif mode in _BROKEN:
            await self._send_dashboard(dashboard.RESTART_SAFETY)
            await self._wait_until(self._is_safe_and_off, "POWER_OFF after its safety was restarted")

    def _is_safe_and_off(self) -> bool:
        return self._link.robot_mode is RobotMode.POWER_OFF and self._link.safety_mode in MOVABLE

    async def _switch(self, target: RobotMode) -> None:
        mode = self._link.robot_mode
        if mode not in _COMMANDS:
            raise RobotRefused("set_mode", f"its mode is {mode.name}", _ADVICE.get(mode, "check its teach pendant"))
        if mode is RobotMode.RUNNING and target is RobotMode.IDLE:  # brakes are engaged by switching the arm off only
            await self._command(POWER_OFF)
        await self._command(_COMMANDS[target])

    async def _play(self) -> None:
        if self._headless:
            await self._driver.start_program()
            return
        await asyncio.sleep(_PLAY_AFTER_S)
        await self._send_dashboard(dashboard.PLAY)
        await self._wait_until(lambda: self._link.state["runtime_state"] == RuntimeState.PLAYING, "PLAYING")

    async def _command(self, command: TextCommand) -> None:
        """Send a command through a new connection: one opened in local control takes no commands in remote control."""
        async with PrimaryClient(self._address, self._driver.config.robot_ports["primary"]) as primary:
            await primary.run(primary.core.command(command))

    async def _send_dashboard(self, operation: "dashboard.Operation[None]") -> None:
        ports = self._driver.config.robot_ports
        async with DashboardClient(self._address, ports["dashboard"], robot_api_port=ports.get("robot api")) as board:
            await board.request(operation)

    async def _wait_until(self, reached: Callable[[], bool], state_text: str) -> None:
        until_s = self._host.loop.time() + _EFFECT_S
        while not reached():
            if self._host.loop.time() > until_s:
                modes = " and ".join(mode.name for mode in self._modes)
                raise RobotRefused("set_mode", f"it is not {state_text} after {_EFFECT_S:g} s, but {modes}")
            await self._link.next_state()
