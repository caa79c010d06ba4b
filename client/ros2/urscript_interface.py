"""The node ``urscript_interface``: run scripts on the robot, through a topic or an action that reports how they end.

A program (``def``) replaces the control program, as on any robot; start the control program again afterwards.
"""

import math
from typing import Any, Final

from std_msgs.msg import String

from client.driver import DriverConfig
from client.driver.link import RobotLink
from client.errors import ScriptFailedError
from client.primary import STOP_PROGRAM, PrimaryClient
from client.ros2.control_side import LINK
from client.ros2.host import HostedNode, NodeHost
from client.ros2.one_goal import OneGoalAction
from client.scripts import FATAL_LEVELS, is_secondary
from urproto.errors import LocalProtocolError, URError
from urproto.modes import ReportLevel

NAME: Final = "urscript_interface"
_WITH_WARNINGS: Final = (ReportLevel.WARNING, *FATAL_LEVELS)


class URScriptNode(HostedNode):
    """The node; a program that it has sent keeps running when it is closed.

    ``~/script_command`` sends a script, ``~/execute_script`` also waits for its end. The action executes one goal at a
    time, and the topic is ignored meanwhile. Cancelling stops the program. The end of a secondary program (``sec``)
    cannot be observed: its goal succeeds if no error is reported soon.
    """

    def __init__(self, host: NodeHost, config: DriverConfig) -> None:
        super().__init__(host, NAME)
        self._address = self._fixed("robot_ip", config.host)
        self._port = config.robot_ports["primary"]
        self._cancelled = False
        self._primary: PrimaryClient | None = None  # the connection that executes a goal
        self.node.create_subscription(String, "~/script_command", self._send, 1)
        self._action = OneGoalAction(
            self.node,
            "execute_script",
            "ur_msgs/action/SendScript",
            begin=self._begin,
            execute=self._execute,
            cancel=self._cancel,
        )
        self._type = self._action.type
        host.spin(self.node)

    # in the node's thread

    async def _send(self, script: Any) -> None:
        if self._action.busy:
            self.node.get_logger().error("script_command: not sent, because a goal of execute_script is being executed")
            return
        try:
            await self._host.task(self.node, self._host.call(RobotLink.send_script, LINK, script.data))
        except URError as error:
            self.node.get_logger().error(f"script_command: {error}")

    async def _begin(self, goal: Any) -> bool:
        self._cancelled = False
        return True

    async def _cancel(self) -> None:
        self._cancelled = True
        try:
            await self._host.task(self.node, self._stop())
        except URError as error:
            self.node.get_logger().error(f"execute_script: cannot stop the script: {error}")

    async def _execute(self, handle: Any) -> Any:
        try:
            await self._host.task(self.node, self._run(handle.request))
            why = ""
        except URError as error:
            why = str(error)
            self.node.get_logger().error(f"execute_script: {why}")
        if handle.is_cancel_requested:
            handle.canceled()
            return self._type.Result(success=False, message=why or "the script was stopped on request")
        if why:
            handle.abort()
        else:
            handle.succeed()
        return self._type.Result(success=not why, message=why or "the script has finished")

    # in the event loop

    async def _run(self, goal: Any) -> None:
        if not any(line.split("#")[0].strip() for line in goal.program.splitlines()):
            raise LocalProtocolError("the script is empty except for comments")
        failing = _WITH_WARNINGS if goal.fail_on_warnings else FATAL_LEVELS
        start_s = goal.start_timeout.sec + goal.start_timeout.nanosec * 1e-9
        start_s = start_s if start_s > 0.0 else math.inf
        async with PrimaryClient(self._address, self._port) as primary:
            core = primary.core
            self._primary = primary
            try:
                if self._cancelled:
                    return
                if is_secondary(goal.program):
                    await primary.run(core.send_secondary(goal.program))
                    return
                started = await primary.run(
                    core.start(goal.program, goal.script_name or None, timeout_s=start_s, failing=failing), math.inf
                )
                if self._cancelled:  # it may have been too early to stop it
                    await self._stop()
                await primary.run(core.finish(started), math.inf)
            except ScriptFailedError as error:
                if error.errors:  # as the official client does: a program with an error must not continue
                    await self._stop()
                raise
            finally:
                self._primary = None

    async def _stop(self) -> None:
        if (primary := self._primary) is not None:
            await primary.run(primary.core.send_script(STOP_PROGRAM.line))
