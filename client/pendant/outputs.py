"""Switches the outputs of a robot over its public ports.

RTDE inputs with masks do it, so that only the selected outputs change. If another client has reserved these inputs, a
secondary program does it instead. Both work with the arm switched off.
"""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from urproto.errors import RobotRefused
from urproto.modes import AnalogDomain
from urproto.signals import DigitalGroup

if TYPE_CHECKING:
    from client.pendant.station import Station


@dataclass(frozen=True, slots=True)
class Range:
    """Range of an analog signal on the screen, in mA or V; ``factor`` converts from A or V."""

    low: float
    high: float
    unit: str
    factor: float

    def ratio(self, value: float) -> float:
        """A value as a share of the range. Raises ValueError if it is outside."""
        if not self.low <= value <= self.high:
            raise ValueError(f"{value:g} {self.unit} is outside of {self.low:g} to {self.high:g} {self.unit}")
        return (value - self.low) / (self.high - self.low)


def analog_range(domain: int) -> Range:
    """Range of the control box (User Manual: 4-20 mA or 0-10 V)."""
    return Range(0.0, 10.0, "V", 1.0) if domain == AnalogDomain.VOLTAGE else Range(4.0, 20.0, "mA", 1000.0)


async def set_digital(station: "Station", group: DigitalGroup, index: int, level: bool) -> None:
    """Switch an output. Raises ClientError."""
    bit = 1 << index
    inputs = {f"{group.name}_digital_output_mask": bit, f"{group.name}_digital_output": bit if level else 0}
    await _with_fallback(lambda: station.write(**inputs), lambda: station.run_statements(group.statement(index, level)))


async def set_analog(station: "Station", index: int, domain: AnalogDomain, ratio: float) -> None:
    """Set the domain of an analog output and its level as a share of the range. Raises ClientError."""
    inputs = {
        "standard_analog_output_mask": 1 << index,
        "standard_analog_output_type": domain << index,
        f"standard_analog_output_{index}": ratio,
    }
    await _with_fallback(
        lambda: station.write(**inputs),
        lambda: station.run_statements(
            f"set_analog_outputdomain({index}, {domain:d})", f"set_standard_analog_out({index}, {ratio!r})"
        ),
    )


async def _with_fallback(first: Callable[[], Awaitable[None]], fallback: Callable[[], Awaitable[None]]) -> None:
    try:
        await first()
    except RobotRefused:
        await fallback()
