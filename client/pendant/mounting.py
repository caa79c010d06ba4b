"""Tool, payload and mounting of an arm: commands that set them, and the values that the robot reports."""

import math
from collections.abc import Sequence
from typing import Final

from client.pendant.page import send_and_verify
from client.pendant.station import Station
from urproto.robots.pose import Pose
from urproto.versions import Availability

_TOLERANCE: Final = 1e-6
_TARGET_PAYLOAD: Final = Availability.since(None, "5.10")


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
