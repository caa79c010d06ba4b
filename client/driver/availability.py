"""Features of the driver that require a minimum PolyScope version."""

from typing import Final

from urproto.errors import RobotRefused
from urproto.versions import Availability, PolyscopeVersion

# Source: the version checks of Universal_Robots_Client_Library 2.14 and of its control program; for the queries and
# the axes of freedrive, those of ur_rtde 1.6.5; for torques on PolyScope X, the Script Manual 5.25.1.
GATES: Final = {
    "zero_ftsensor": Availability.since(None, "5.0"),
    "start_tool_contact": Availability.since(None, "5.0"),
    "end_tool_contact": Availability.since(None, "5.0"),
    "set_target_payload": Availability.since(None, "5.10"),
    "optimove": Availability.since(None, "5.21", "10.8"),
    "torque": Availability.since(None, "5.23", "10.10"),
    "set_friction_compensation": Availability.since(None, "5.23", "10.10"),
    "set_friction_scales": Availability.since(None, "5.25.1", "10.12.1"),
    "contact": Availability.since(None, "5.4"),
    "force_mode_gain_scaling": Availability.since(None, "5.0"),
    "ft_rtde_input": Availability.since("3.14.1", "5.9.1"),
    "freedrive_axes": Availability.since(None, "5.10"),
    "inverse_kin": Availability.since("3.15", "5.10"),
    "tcp_offset": Availability.since("3.6", "5.0"),
    "target_waypoint": Availability.since(None, "5.3"),
    "dynamics": Availability.since(None, "5.23", "10.11"),
}


def offers(feature: str, version: PolyscopeVersion) -> bool:
    """Whether a robot of this version has a feature."""
    return GATES[feature].covers(version)


def refusal(feature: str, version: PolyscopeVersion) -> str | None:
    """Say why this version does not offer a feature, and what to do; None if it does."""
    gate = GATES[feature]
    if gate.covers(version):
        return None
    first = gate.first(version)
    if first is None:
        return f"CB3 robots ({version}) do not have it: it requires an e-Series or newer robot"
    wanted = first.short if first.bugfix else f"{first.major}.{first.minor}"
    return f"PolyScope {version} does not have it: update the robot to {wanted} or newer"


def require(feature: str, version: PolyscopeVersion) -> None:
    """Raise RobotRefused if this version lacks the feature."""
    why = refusal(feature, version)
    if why is not None:
        raise RobotRefused(feature, why)
