"""Settings that return once their effect is visible in the robot's state, and analog signals and registers."""

from collections.abc import Callable, Sequence
from typing import Any, Final

from client.blocking import thread_safe
from client.driver import URDriver
from client.driver.link import MOVABLE
from client.quantities import checked
from client.robot.motion import MotionRunner
from client.robot.readiness import LOCAL_CONTROL
from client.robot.state import RobotState, check_signal
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.modes import RobotMode, SafetyMode
from urproto.signals import digital_signal

_EFFECT_S: Final = 2.0  # guess: ten times the slowest, which is visible through the primary interface only
_TOLERANCE: Final = 1e-5  # m or rad

_ANALOG: Final = 2
_REGISTERS: Final = 48
_VOLTS: Final = 10.0
_AMPERES: Final = (0.004, 0.020)


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


@checked
class IO:
    """Analog signals, tool voltage and registers, with or without the control program and during motions.

    Outputs and input registers are written through RTDE, which raises RobotRefused if another client writes them.
    """

    def __init__(self, driver: URDriver) -> None:
        self._driver = driver

    async def set_analog_voltage(self, number: int, volts: float) -> None:
        """Set analog output 0 or 1 to a voltage, 0 to 10 V."""
        if volts > _VOLTS:
            raise LocalProtocolError(f"an analog output gives 0 to {_VOLTS:g} V, not {volts}")
        await self._set_analog(number, 1, volts / _VOLTS)

    async def set_analog_current(self, number: int, amperes: float) -> None:
        """Set analog output 0 or 1 to a current, 0.004 to 0.020 A."""
        low, high = _AMPERES
        await self._set_analog(number, 0, (amperes - low) / (high - low))

    @thread_safe
    def analog_in(self, number: int) -> float:
        """Value of analog input 0 or 1 [V or A, depending on its configuration]."""
        return float(self._value(f"standard_analog_input{_analog(number)}"))

    @thread_safe
    def analog_out(self, number: int) -> float:
        """Value of analog output 0 or 1 [V or A, depending on its configuration]."""
        return float(self._value(f"standard_analog_output{_analog(number)}"))

    async def set_tool_voltage(self, volts: int) -> None:
        """Set the supply voltage at the tool: 0, 12 or 24 V."""
        await self._driver.set_tool_voltage(volts)

    async def set_int_register(self, number: int, value: int) -> None:
        """Write input register 0 to 47, for programs on the robot to read; 24 to 47 are reserved for clients."""
        await self._driver.link.write_inputs(**{f"input_int_register_{_register(number)}": value})

    async def set_double_register(self, number: int, value: float) -> None:
        """Write input register 0 to 47, for programs on the robot to read; 24 to 47 are reserved for clients."""
        await self._driver.link.write_inputs(**{f"input_double_register_{_register(number)}": value})

    @thread_safe
    def int_register(self, number: int) -> int:
        """Value of output register 0 to 47, written by a program on the robot; ``outputs`` must include it."""
        return int(self._value(f"output_int_register_{_register(number)}"))

    @thread_safe
    def double_register(self, number: int) -> float:
        """Value of output register 0 to 47, written by a program on the robot; ``outputs`` must include it."""
        return float(self._value(f"output_double_register_{_register(number)}"))

    async def _set_analog(self, number: int, domain: int, share: float) -> None:
        bit = 1 << _analog(number)
        values: dict[str, Any] = {"standard_analog_output_mask": bit, "standard_analog_output_type": domain * bit}
        await self._driver.link.write_inputs(**values, **{f"standard_analog_output_{number}": share})

    def _value(self, name: str) -> Any:
        values = self._driver.link.feed.fresh()
        if name not in values:
            raise LocalProtocolError(
                f"{name} is not received: request it when connecting, Robot(host, outputs=({name!r},))"
            )
        return values[name]


def _analog(number: int) -> int:
    if not 0 <= number < _ANALOG:
        raise LocalProtocolError(f"there is no analog signal {number}: they are 0 and 1")
    return number


def _register(number: int) -> int:
    if not 0 <= number < _REGISTERS:
        raise LocalProtocolError(f"there is no register {number}: they are 0 to {_REGISTERS - 1}")
    return number
