"""What the driver offers only from some PolyScope version on."""

from dataclasses import dataclass
from typing import Final

from urproto.errors import RobotRefused
from urproto.versions import PolyscopeVersion, Series

_POLYSCOPE_X: Final = 10


@dataclass(frozen=True, slots=True)
class Gate:
    """First versions with a feature: on PolyScope 5, on PolyScope X, and on CB3, None where it has none."""

    e_series: str
    polyscope_x: str = "10.0"
    cb3: str | None = None

    def refusal(self, version: PolyscopeVersion) -> str | None:
        """Why this version does not offer it, and what to do; None when it does."""
        if version.series is Series.CB3 and self.cb3 is not None:
            first = self.cb3
        elif version.series is Series.CB3:
            return f"CB3 robots ({version}) do not have it, only e-Series and newer ones"
        else:
            first = self.polyscope_x if version.major >= _POLYSCOPE_X else self.e_series
        if version < PolyscopeVersion.parse(first):
            return f"PolyScope {version} does not have it: update the robot to {first} or newer"
        return None


# Source: the version checks of Universal_Robots_Client_Library 2.14 and of its control program; of the questions, and
# of freedrive's axes, those of ur_rtde 1.6.5's.
GATES: Final = {
    "zero_ftsensor": Gate("5.0"),
    "start_tool_contact": Gate("5.0"),
    "end_tool_contact": Gate("5.0"),
    "set_target_payload": Gate("5.10"),
    "optimove": Gate("5.21", "10.8"),
    "torque": Gate("5.23", "10.11"),
    "set_friction_compensation": Gate("5.23", "10.10"),
    "set_friction_scales": Gate("5.25.1", "10.12.1"),
    "contact": Gate("5.4"),
    "freedrive_axes": Gate("5.10"),
    "inverse_kin": Gate("5.10", cb3="3.15"),
    "tcp_offset": Gate("5.0", cb3="3.6"),
    "target_waypoint": Gate("5.3"),
    "dynamics": Gate("5.23", "10.11"),
}


def require(feature: str, version: PolyscopeVersion) -> None:
    """Raise RobotRefused when this version lacks the feature."""
    refusal = GATES[feature].refusal(version)
    if refusal is not None:
        raise RobotRefused(feature, refusal)
