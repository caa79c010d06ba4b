"""The drivetrain between a joint's motor and its link: friction, rotor inertia, and motor currents.

``urproto.robots.measured`` has the numbers for each model; those of an individual arm can be identified and used
instead (``RobotModel.drivetrain``).
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Final

from urproto.compat import Self
from urproto.structures import converted
from urproto.vectors import ZERO6, Vector6

# Parameters of the controller's friction model. Measured in shamilmamedov/dynamic_calibration (a real UR10e, 20 files):
# in target current * torque constant - target moment, both are at the same speed on every joint
KNOWN_COULOMB_RAD_S: Final = 0.012  # up to this speed, Coulomb friction increases in proportion to the speed
KNOWN_BEND_RAD_S: Final = 0.5  # at this speed, the slope of viscous friction changes
_POSITIVE: Final = ("torque_constants_Nm_A", "rotor_kg_m2")


class DrivetrainError(ValueError):
    """The parameters of an arm's drives are invalid; the message names the entry."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drivetrain:
    """The drives of an arm, base to wrist 3; all values refer to the joint side of the gear.

    Friction is viscous * speed + Coulomb * sign(speed). The controller has its own friction model, which it uses for
    its target current: Coulomb friction that increases over a narrow band of speeds, and viscous friction with one
    change of slope.
    """

    torque_constants_Nm_A: Vector6
    rotor_kg_m2: Vector6
    coulomb_Nm: Vector6
    viscous_Nm_s: Vector6  # per rad, like all viscous friction
    known_coulomb_Nm: Vector6
    known_viscous_Nm_s: Vector6
    known_fast_viscous_Nm_s: Vector6  # beyond the bend
    rest_noise_A: Vector6  # standard deviation of the actual current
    motion_noise_A: Vector6

    def known_friction(self, qd: Vector6) -> Vector6:
        """Friction at these speeds according to the controller's model [Nm]; 0 at rest."""
        if qd == ZERO6:
            return ZERO6
        band, bend = KNOWN_COULOMB_RAD_S, KNOWN_BEND_RAD_S
        a, b, c, d, e, f = [
            dry + slow * bend + fast * (v - bend)
            if v > bend
            else fast * (v + bend) - slow * bend - dry
            if v < -bend
            else slow * v + (dry if v > band else -dry if v < -band else dry * v / band)
            for v, dry, slow, fast in zip(
                qd, self.known_coulomb_Nm, self.known_viscous_Nm_s, self.known_fast_viscous_Nm_s, strict=True
            )
        ]
        return (a, b, c, d, e, f)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Self:
        """Read the entries of a file, which are named like the fields. Raises DrivetrainError for a missing or invalid
        entry."""
        found = converted({field.name: values.get(field.name) for field in fields(cls)}, cls, "", DrivetrainError)
        for name, numbers in asdict(found).items():
            if min(numbers) < 0.0 or (name in _POSITIVE and not all(numbers)):
                limit = " above 0" if name in _POSITIVE else ", none of them negative"
                raise DrivetrainError(f"{name} must be six numbers{limit}, not {numbers}")
        return found

    def to_mapping(self) -> dict[str, list[float]]:
        """The entries of a file that `from_mapping` reads."""
        return {field.name: list(getattr(self, field.name)) for field in fields(self)}
