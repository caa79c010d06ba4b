"""A Universal Robots arm as the hardware of a controller manager, through the driver.

While the robot waits (during a stop or a pause, while its program restarts, after late setpoints), nothing is commanded
and the speed scaling is 0, so that trajectories wait too. When the robot continues, the scaling rises gradually;
setpoints start at the arm's position and gradually return to the commanded ones. A paused program is sent the arm's
position once, because its first step would otherwise be to its last setpoint.
"""

import logging
from collections.abc import Mapping, Sequence
from typing import Any, Final

from client.controllers.controller import NO_COMMAND
from client.controllers.modes import MOTION, CommandMode, conflict, mode_of
from client.controllers.ur_commands import Spawn, URCommands
from client.controllers.ur_execution import PassthroughExecution, PrimitivesExecution
from client.controllers.ur_states import URStates
from client.driver import URDriver
from client.driver.availability import refusal
from client.driver.link import MOVABLE
from client.driver.reverse import MAX_REAL_TIME_S
from client.errors import ControllerError, LateSetpointError
from urproto.errors import LocalProtocolError, URError
from urproto.joints import JOINT_NAMES
from urproto.modes import RobotMode, RuntimeState, SafetyMode, mode_name
from urproto.versions import PolyscopeVersion

_WAITING: Final = (SafetyMode.PROTECTIVE_STOP, SafetyMode.SAFEGUARD_STOP)  # a program is paused in these, not ended
_RESTART_S: Final = 10.0  # guess: how long after such a stop the program may take to be restarted
_SCALING_STEP: Final = 0.01  # rise of the speed scaling after a pause; source: Universal_Robots_ROS2_Driver
_RETURN_S: Final = 0.5  # guess: to bring the arm back to its path after a stop
_ENDED: Final = "the control program on the robot has ended: start it, then activate again"
_AT_REST_RAD_S: Final = 0.005  # guess: above the noise of an arm at rest

_logger = logging.getLogger(__name__)


class URHardware:
    """The arm of a driver as hardware; see `client.controllers.controller.Hardware`.

    spawn: runs work that takes longer than a cycle. version: the robot's version. prefix: prefix of all names.
    setpoint_timeout_s: how long the robot continues without the next setpoint [s]. withheld: why no request is sent to
    the robot, regardless of its state; None if requests are permitted.
    """

    def __init__(
        self,
        driver: URDriver,
        version: PolyscopeVersion,
        spawn: Spawn,
        *,
        prefix: str = "",
        setpoint_timeout_s: float = MAX_REAL_TIME_S,
    ) -> None:
        self._driver = driver
        self._version = version
        self._prefix = prefix
        self._timeout_s = setpoint_timeout_s
        self._states = URStates(prefix, version)
        self._ur_commands = URCommands(prefix, driver, self._states, spawn)
        self.states, self.commands = self._states.all, self._ur_commands.all
        self.failure: str | None = None
        self.withheld: str | None = None
        self._modes: set[CommandMode] = set()
        self._positions = self._ur_commands.joints("position")
        self._velocities = self._ur_commands.joints("velocity")
        self._efforts = self._ur_commands.joints("effort")
        self._actual = self._states.joints("position")
        self._speeds = self._states.joints("velocity")
        self._ready = False
        self._scaling = 1.0
        self._waits = False
        self._late = False  # setpoints were late
        self._unsendable = ""  # why a command cannot be sent
        self._position_sent = False  # the arm is at rest, and the program has been sent its position
        self._absent_until_s = 0.0  # until when the program may be absent, by the robot's clock
        self._offset = [0.0] * len(JOINT_NAMES)
        self._return_s = 0.0
        self._executions: dict[CommandMode, PassthroughExecution | PrimitivesExecution] = {
            CommandMode.PASSTHROUGH: PassthroughExecution(self._ur_commands, driver, spawn),
            CommandMode.MOTION_PRIMITIVE: PrimitivesExecution(self._ur_commands, self._states, driver, spawn),
        }

    # read

    def read(self, state: Mapping[str, Any], period_s: float) -> None:
        self._states.take(state)
        running = self._driver.program_running
        self._states["gpio/program_running"] = float(running)
        mode = state["safety_mode"]
        was_late, self._late = self._late, False
        if was_late:  # this machine was late, so the robot has stopped the arm; continue as after a pause
            self._scaling, self._waits = 0.0, True
        was_ready, self._ready = (
            self._ready and not was_late,
            (running and mode in MOVABLE and state["runtime_state"] == RuntimeState.PLAYING),
        )
        self._scale(state, period_s)
        if self._ready and not was_ready:
            self._begin_return()
        unsendable, self._unsendable = self._unsendable, ""
        problem = self._find_failure(state["timestamp"], mode, state["robot_mode"], running)
        self.failure = self.withheld or problem or unsendable or None

    def _scale(self, state: Mapping[str, Any], period_s: float) -> None:
        full = state["speed_scaling"] * state["target_speed_fraction"]
        if not self._ready:
            self._scaling = 0.0
            self._waits = self.failure is None  # with a failure, everything that could wait ends instead
        elif self._waits:
            self._scaling += _SCALING_STEP * period_s / self._version.series.period_s
            self._waits = self._scaling < full
            self._scaling = min(self._scaling, full)
        else:
            self._scaling = full
        self._states["speed_scaling/speed_scaling_factor"] = self._scaling

    def _begin_return(self) -> None:
        commands = self._positions.get()
        if CommandMode.POSITION in self._modes and not any(value != value for value in commands):
            self._offset = [actual - command for actual, command in zip(self._actual.get(), commands, strict=True)]
            self._return_s = _RETURN_S

    def _find_failure(self, time_s: float, safety: int, robot_mode: int, running: bool) -> str | None:
        if safety in _WAITING:
            self._absent_until_s = time_s + _RESTART_S
            return None
        if safety not in MOVABLE:
            return f"its safety mode is {mode_name(SafetyMode, safety)}: clear the cause, then activate again"
        if robot_mode != RobotMode.RUNNING:
            return (
                f"its mode is {mode_name(RobotMode, robot_mode)}: power it on, start the program, then activate again"
            )
        if running:
            self._absent_until_s = 0.0 if self._ready else self._absent_until_s
            return None
        if time_s < self._absent_until_s:
            return None
        if why := self._driver.loss_reason:
            return f"the control program on the robot has ended, since {why}: make sure it runs, then activate again"
        return _ENDED

    def take_halt(self) -> str | None:
        halt, self._ur_commands.contact = self._ur_commands.contact, None
        return halt

    # switching

    def prepare_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        starting, stopping = self._modes_of(start), self._modes_of(stop)
        for kind in (CommandMode.POSITION, CommandMode.VELOCITY, CommandMode.EFFORT):
            if kind in starting and not set(self._ur_commands.joints(kind).names) <= set(start):
                raise ControllerError("hardware", f"all {len(JOINT_NAMES)} joints must be commanded in {kind}")
        if pair := conflict((self._modes - stopping) | starting):
            raise ControllerError("hardware", f"{pair[0]} and {pair[1]} cannot be commanded at the same time")
        if CommandMode.EFFORT in starting and (why := refusal("torque", self._version)):
            raise ControllerError("hardware", f"effort cannot be commanded: {why}")
        if starting & MOTION and self.failure:
            raise ControllerError("hardware", self.failure)

    def perform_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        starting, stopping = self._modes_of(start), self._modes_of(stop)
        self._modes = (self._modes - stopping) | starting
        self._ur_commands.all.lend(list(stop)).fill(NO_COMMAND)
        self._send(lambda: self._end_modes(stopping))
        for mode, execution in self._executions.items():
            if mode in stopping:
                execution.end()
            if mode in starting:
                execution.begin()
        if CommandMode.POSITION in starting:
            self._positions.put(self._actual.get())
            self._return_s = 0.0
        for kind, part in ((CommandMode.VELOCITY, self._velocities), (CommandMode.EFFORT, self._efforts)):
            if kind in starting:
                part.fill(0.0)

    def _modes_of(self, interfaces: Sequence[str]) -> set[CommandMode]:
        return {mode for name in interfaces if (mode := mode_of(name, self._prefix)) is not None}

    def _end_modes(self, ended: set[CommandMode]) -> None:
        if not self._driver.program_running:
            return
        if CommandMode.FORCE_MODE in ended:
            self._driver.end_force_mode()
        if CommandMode.TOOL_CONTACT in ended:
            self._driver.end_tool_contact()
        if CommandMode.FREEDRIVE in ended:
            self._driver.stop_freedrive()
        if ended & MOTION and not self._modes & MOTION and not ended & self._executions.keys():
            self._driver.idle()

    # write

    def write(self, time_s: float, period_s: float) -> None:
        if self.withheld:
            self._ur_commands.refuse(self.withheld)
            return
        for mode, execution in self._executions.items():
            if mode in self._modes:
                execution.step(ready=self._ready)
        if self._ready:
            self._send(lambda: self._move(period_s))
            self._position_sent = False
        elif not self._position_sent:
            self._send(self._send_position)
        self._ur_commands.process()

    def _send_position(self) -> None:
        at_rest = max(map(abs, self._speeds.get())) < _AT_REST_RAD_S
        if at_rest and CommandMode.POSITION in self._modes and self._driver.program_running:
            self._driver.servoj(self._actual.get(), self._timeout_s)
            self._position_sent = True

    def _move(self, period_s: float) -> None:
        if CommandMode.POSITION in self._modes:
            commands = self._positions.get()
            if not any(value != value for value in commands):
                self._driver.servoj(self._returning(commands, period_s), self._timeout_s)
        elif CommandMode.VELOCITY in self._modes:
            self._driver.speedj(self._velocities.get(), self._timeout_s)
        elif CommandMode.EFFORT in self._modes:
            self._driver.torque(self._efforts.get(), self._timeout_s)

    def _returning(self, commands: list[float], period_s: float) -> list[float]:
        """The commands; after a stop, blended from the arm's position."""
        if self._return_s <= 0.0:
            return commands
        share = self._return_s / _RETURN_S
        self._return_s -= period_s
        smooth = share * share * (3.0 - 2.0 * share)
        return [command + smooth * offset for command, offset in zip(commands, self._offset, strict=True)]

    def _send(self, send: Any) -> None:
        try:
            send()
        except LateSetpointError:  # logged where it was noticed
            self._late = True
        except LocalProtocolError as error:  # a number that no message can carry; the next one will be similar
            self._unsendable = f"the command cannot be sent: {error}"
        except URError as error:  # the program has just disconnected: read() will notice
            _logger.warning("%s", error)
