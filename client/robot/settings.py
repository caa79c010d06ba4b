"""Settings that return once their effect is visible in the robot's state."""

from collections.abc import Callable, Sequence
from typing import Final

from client.blocking import thread_safe
from client.driver.link import MOVABLE
from client.robot.motion import MotionRunner
from client.robot.readiness import LOCAL_CONTROL
from client.robot.state import RobotState, check_signal
from urproto.errors import RobotRefused
from urproto.modes import RobotMode, SafetyMode
from urproto.signals import digital_signal

_EFFECT_S: Final = 2.0  # guess: ten times the slowest, which is visible through the primary interface only
_TOLERANCE: Final = 1e-5  # m or rad


class Settings:
    """Settings made by a script or a command, and confirmed by the robot's state.

    They are waited for because the next motion travels on another connection and could overtake them. Raises
    RobotRefused if no effect is seen.
    """

    def __init__(self, motion: MotionRunner) -> None:
        self._motion = motion
        self._driver = motion.driver
        self._diagnosis = motion.diagnosis

    async def set_digital_out(self, number: int, on: bool) -> None:
        """Switch a digital output: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool."""
        group, index = digital_signal(check_signal(number))
        await self._send_statement(group.statement(index, on))
        await self._wait_for_effect(f"digital output {number}", lambda state: state.digital_out(number) is bool(on))

    async def set_tcp(self, pose_flange_tcp: Sequence[float]) -> None:
        """Set the TCP as a pose in the flange frame (6,) [m, rotation vector]; not possible during a motion."""
        if self._motion.busy:
            await self._motion.check_free("set_tcp")
        if self._driver.program_running and self._accepts_commands:
            self._driver.set_tcp(pose_flange_tcp)
        else:
            await self._send_statement(f"set_tcp(p[{', '.join(str(float(value)) for value in pose_flange_tcp)}])")
        await self._wait_for_effect("set_tcp", lambda _: self._has_tcp(pose_flange_tcp))

    async def set_speed_slider(self, fraction: float) -> None:
        """Set the speed slider, 0.01 to 1, which scales the speed of every motion."""
        await self._driver.set_speed_slider(fraction)
        await self._wait_for_effect("speed slider", lambda state: abs(state.speed_fraction - fraction) < 1e-3)

    async def trigger_protective_stop(self) -> None:
        """Put the robot into a protective stop, as after a collision, from any motion. See `recover`."""
        await self._send_statement("protective_stop()")
        await self._wait_for_effect("protective stop", lambda state: state.safety_mode == SafetyMode.PROTECTIVE_STOP)

    @thread_safe
    def set_watchdog(self, longest_s: float) -> None:
        """End the control program, and so stop the arm, if `kick_watchdog` is not called for ``longest_s``; 0 is off.

        Without a watchdog the arm keeps moving as long as this process lives, even if the caller's own loop hangs.
        """
        self._driver.keep_alive.watch(longest_s)

    @thread_safe
    def kick_watchdog(self) -> None:
        """Report that the caller's own program is alive; takes no time."""
        self._driver.keep_alive.kick()

    async def _send_statement(self, statement: str) -> None:
        await self._driver.link.send_script(f"sec setting():\n  {statement}\nend")

    async def _wait_for_effect(self, title: str, done: Callable[[RobotState], bool]) -> None:
        try:
            await self._motion.wait_for(done, _EFFECT_S)
        except TimeoutError:
            await self._diagnosis.refuse_in_stop(title)
            raise RobotRefused(title, *await self._no_effect_reason()) from None

    @property
    def _accepts_commands(self) -> bool:
        """True if the control program executes commands, that is, no pause or stop is in effect."""
        return not self._diagnosis.paused and self._driver.link.safety_mode in MOVABLE

    async def _no_effect_reason(self) -> tuple[str, str]:
        link = self._driver.link
        failure = link.pop_script_error()
        why = str(failure) if failure else self._diagnosis.reported()
        if not why and await self._diagnosis.in_local_control():
            return LOCAL_CONTROL
        if not why and link.robot_mode is not RobotMode.RUNNING:
            return f"its mode is {link.robot_mode.name}", "make_ready() powers it on and releases its brakes"
        return f"{why or 'nothing changed'} within {_EFFECT_S:g} s", "check the pendant and its log"

    def _has_tcp(self, pose_flange_tcp: Sequence[float]) -> bool:
        state = self._driver.link.primary_state
        if state is None or state.cartesian is None:
            return False
        return all(abs(a - b) < _TOLERANCE for a, b in zip(state.cartesian.tcp_offset, pose_flange_tcp, strict=True))
