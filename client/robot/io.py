"""Analog signals, tool voltage and registers; for digital signals see `AsyncRobot.set_digital_out`."""

from typing import Any, Final

from client.blocking import thread_safe
from client.driver import URDriver
from client.quantities import checked
from urproto.errors import LocalProtocolError

_ANALOG: Final = 2
_REGISTERS: Final = 48
_VOLTS: Final = 10.0
_AMPERES: Final = (0.004, 0.020)


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
