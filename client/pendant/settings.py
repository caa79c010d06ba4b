"""Commands that set outputs, tool, payload and mounting of a robot over its public ports.

RTDE inputs with masks switch outputs, so that only the selected ones change. If another client has reserved these
inputs, a secondary program does it instead. Both work with the arm switched off.
"""

import math
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Final

from client.pendant.page import send_and_verify
from client.pendant.station import Station
from urproto.errors import RobotRefused
from urproto.modes import AnalogDomain
from urproto.robots.pose import Pose
from urproto.signals import DigitalGroup
from urproto.versions import Availability

_TOLERANCE: Final = 1e-6
_TARGET_PAYLOAD: Final = Availability.since(None, "5.10")


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


async def set_digital(station: Station, group: DigitalGroup, index: int, level: bool) -> None:
    """Switch an output. Raises ClientError."""
    bit = 1 << index
    inputs = {f"{group.name}_digital_output_mask": bit, f"{group.name}_digital_output": bit if level else 0}
    await _with_fallback(lambda: station.write(**inputs), lambda: station.run_statements(group.statement(index, level)))


async def set_analog(station: Station, index: int, domain: AnalogDomain, ratio: float) -> None:
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


def active_tcp(station: Station) -> Pose | None:
    """The active TCP in the flange frame; from the primary interface if RTDE does not provide it."""
    tcp = station.values.get("tcp_offset")
    if tcp is not None:
        return tcp  # type: ignore[no-any-return]
    state = station.primary_state
    return None if state is None or state.cartesian is None else state.cartesian.tcp_offset


def same_tcp(a: Sequence[float] | None, b: Sequence[float]) -> bool:
    """Whether two TCPs are equal except for rounding in transit."""
    return a is not None and all(abs(x - y) < _TOLERANCE for x, y in zip(a, b, strict=True))


async def apply_tcp(station: Station, tcp: Sequence[float]) -> None:
    """Set the active TCP. Raises NotAcceptedError, ClientError."""
    await send_and_verify(
        station,
        lambda: station.run_statements(f"set_tcp(p{_script_list(tcp)})"),
        lambda now: same_tcp(active_tcp(now), tcp),
        "this TCP",
    )


async def apply_payload(station: Station, mass_kg: float, cog_m: Sequence[float]) -> bool:
    """Set the payload; returns whether the robot has confirmed it, which old versions cannot. Raises URError.

    It is set in parallel to the running program; on an emulator in local control, by a verb.
    """
    if station.emulator.available and station.remote_control.value is False:
        await station.emulator.change("set_payload", mass_kg=mass_kg, cog_m=cog_m)
        return True
    version = station.version
    name = "set_target_payload" if version is not None and _TARGET_PAYLOAD.covers(version) else "set_payload"
    script = f"{name}({float(mass_kg)!r}, {_script_list(cog_m)})"
    if not station.unavailable.isdisjoint({"payload", "payload_cog"}):
        await station.run_statements(script)
        return False

    def accepted(now: Station) -> bool:
        mass, cog = now.values.get("payload"), now.values.get("payload_cog")
        return mass is not None and cog is not None and same_tcp((mass, *cog), (mass_kg, *cog_m))

    await send_and_verify(station, lambda: station.run_statements(script), accepted, "this payload")
    return True


def tilt_of(gravity: Sequence[float]) -> tuple[float, float]:
    """Tilt and turn [rad] of the base for a gravity vector in its frame; turn is 0 if it is upright or inverted."""
    x, y, z = gravity
    across = math.hypot(x, y)
    return math.atan2(across, z), math.atan2(x, -y) if across > _TOLERANCE else 0.0


async def apply_gravity(station: Station, gravity: Sequence[float]) -> bool:
    """Set the mounting; returns whether the robot has confirmed it, which few versions can. Raises ClientError."""
    script = f"set_gravity({_script_list(gravity)})"
    if "target_gravity" in station.unavailable:
        await station.run_statements(script)
        return False
    await send_and_verify(
        station,
        lambda: station.run_statements(script),
        lambda now: same_tcp(now.values.get("target_gravity"), gravity),
        "this mounting",
    )
    return True


def _script_list(values: Sequence[float]) -> str:
    return f"[{', '.join(repr(float(value)) for value in values)}]"
