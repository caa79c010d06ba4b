"""Outputs, payload, TCP and speed: set, and seen to be in effect before the call returns."""

from collections.abc import Callable, Sequence
from typing import Final, cast

from client.driver.core import MOVABLE
from client.robot.core import RobotCore
from client.robot.readiness import LOCAL_CONTROL
from client.robot.state import RobotState, check_signal
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.external_control import Question, to_words
from urproto.modes import RobotMode, SafetyMode
from urproto.robots import Joints
from urproto.robots.pose import Pose

__all__ = ["Settings"]

_EFFECT_S: Final = 2.0  # guess: ten times what the slowest takes, which the primary interface shows
_SAME_M: Final = 1e-5  # m or rad
_SET_OUTPUT: Final = ("set_standard_digital_out", "set_configurable_digital_out", "set_tool_digital_out")


class Settings(RobotCore):
    """Any of these works with and without the control program, and beside a motion.

    Raises LocalProtocolError for values that make no sense, RobotRefused when no effect is seen.
    """

    async def set_digital_out(self, number: int, on: bool) -> None:
        """Switch a digital output: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool."""
        bank, index = divmod(check_signal(number), 8)
        await self._say(f"{_SET_OUTPUT[bank]}({index}, {bool(on)})")
        await self._take_effect(f"digital output {number}", lambda state: state.digital_out(number) is bool(on))

    async def set_payload(self, mass_kg: float, cog_m: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        """Mass and its centre of gravity (3,) in the flange frame; takes effect within a few control periods."""
        await self.driver.set_payload(mass_kg, cog_m)

    async def set_target_payload(
        self,
        mass_kg: float,
        cog_m: Sequence[float],
        inertia_kg_m2: Sequence[float] = (0.0,) * 6,
        transition_time_s: float = 0.0,
    ) -> None:
        """As set_payload with the inertia Ixx, Iyy, Izz, Ixy, Ixz, Iyz (6,), taking effect gradually; from 5.10 on."""
        await self.driver.set_target_payload(mass_kg, cog_m, inertia_kg_m2, transition_time_s)

    async def set_gravity(self, gravity_m_s2: Sequence[float]) -> None:
        """Acceleration of the base (3,) in its frame: [0, 0, 9.82] for an upright arm."""
        await self.driver.set_gravity(gravity_m_s2)

    def set_watchdog(self, longest_s: float) -> None:
        """End the control program, and so stop the arm, when `kick_watchdog` is not called for so long; 0 ends that.

        Without one the arm goes on as long as this process lives, also if the caller's own loop hangs.
        """
        self.driver.pulse.watch(longest_s)

    def kick_watchdog(self) -> None:
        """Say that the caller's own program works; takes no time."""
        self.driver.pulse.kick()

    async def trigger_protective_stop(self) -> None:
        """Stop the arm as the robot would after a collision, from any motion. See `recover`."""
        await self._say("protective_stop()")
        await self._take_effect("protective stop", lambda state: state.safety_mode == SafetyMode.PROTECTIVE_STOP)

    # asked for

    async def tcp_offset(self) -> Pose:
        """Flange to TCP (6,) [m, rotation vector], as it is in effect. From 3.6 on."""
        return cast(Pose, await self.ask("tcp_offset", Question.TCP_OFFSET, gate="tcp_offset"))

    async def history(self, steps: int) -> Joints:
        """Joint angles (6,) [rad] as measured some control periods ago. From 5.4 on."""
        if steps < 0:
            raise LocalProtocolError(f"history goes back 0 periods or more, not {steps}")
        question = Question.JOINT_POSITIONS_HISTORY
        return cast(Joints, await self.ask("history", question, number=steps, gate="contact"))

    async def is_steady(self) -> bool:
        """Whether the arm has stood for a while, and is in neither force mode nor freedrive."""
        return bool((await self.ask("is_steady", Question.STEADY))[0])

    async def step_time(self) -> float:
        """The control period [s]."""
        return (await self.ask("step_time", Question.STEP_TIME))[0]

    async def target_waypoint(self) -> Pose:
        """Pose of the TCP (6,) that the move under way leads to. From 5.3 on."""
        return cast(Pose, await self.ask("target_waypoint", Question.TARGET_WAYPOINT, gate="target_waypoint"))

    async def set_tcp(self, pose_flange_tcp: Sequence[float]) -> None:
        """Flange to TCP (6,) [m, rotation vector]; not while a motion is under way."""
        if self.moving or self._has_context:
            await self._check_free("set_tcp")
        to_words(pose_flange_tcp)
        if len(pose_flange_tcp) != 6:
            raise LocalProtocolError(f"a pose has 6 numbers, not {len(pose_flange_tcp)}")
        if self.driver.program_running and self._obeys:
            self.driver.set_tcp(pose_flange_tcp)
        else:
            await self._say(f"set_tcp(p[{', '.join(str(float(value)) for value in pose_flange_tcp)}])")
        await self._take_effect("set_tcp", lambda _: self._tcp_is(pose_flange_tcp))

    async def set_speed_slider(self, fraction: float) -> None:
        """Scale the speed of everything by 0.01 to 1."""
        await self.driver.set_speed_slider(fraction)
        await self._take_effect("speed slider", lambda state: abs(state.speed_fraction - fraction) < 1e-3)

    async def _say(self, statement: str) -> None:
        await self.driver.robot.send_script(f"sec setting():\n  {statement}\nend")

    async def _take_effect(self, what: str, done: Callable[[RobotState], bool]) -> None:
        try:
            await self.wait_for(done, _EFFECT_S)
        except TimeoutError:
            await self._refuse_in_stop(what)
            raise RobotRefused(what, *await self._why_no_effect()) from None

    @property
    def _obeys(self) -> bool:
        """The control program executes commands: it is not held by a pause or a stop."""
        return not self._paused and self.driver.robot.safety_mode in MOVABLE

    async def _why_no_effect(self) -> tuple[str, str]:
        link = self.driver.robot
        failure = link.take_script_error()
        why = str(failure) if failure else self._reported()
        if not why and await self._in_local_control():
            return LOCAL_CONTROL
        if not why and link.robot_mode is not RobotMode.RUNNING:
            return f"its mode is {link.robot_mode.name}", "make_ready() powers it on and releases the brakes"
        return f"{why or 'nothing changed'} within {_EFFECT_S:g} s", "look at the pendant and its log"

    def _tcp_is(self, pose_flange_tcp: Sequence[float]) -> bool:
        state = self.driver.robot.primary_state
        if state is None or state.cartesian is None:
            return False
        return all(abs(a - b) < _SAME_M for a, b in zip(state.cartesian.tcp_offset, pose_flange_tcp, strict=True))
