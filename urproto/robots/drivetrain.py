"""What sits between a joint's motor and its link: friction, the rotor behind the gear, and motor currents.

``urproto.robots.measured`` knows the numbers of each model; those of one arm can be identified and given instead
(``RobotModel.drivetrain``).
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import isfinite
from typing import Any, Final

from urproto.compat import Self
from urproto.vectors import ZERO6, Vector6, as_six

# Of the controller's model of friction. Measured, shamilmamedov/dynamic_calibration (a real UR10e, 20 files): target
# current * torque constant - target moment has both at the same speed on every joint
KNOWN_COULOMB_RAD_S: Final = 0.012  # up to here Coulomb friction rises in proportion to the speed
KNOWN_BEND_RAD_S: Final = 0.5  # here the slope of viscous friction changes


class DrivetrainError(ValueError):
    """Something is wrong with the numbers of an arm's drives; the text names the entry."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drivetrain:
    """Of one arm, base to wrist 3, everything at the joint's side of the gear.

    Friction is viscous * speed + Coulomb * sign(speed). What the controller knows of it, and puts into its target
    current, is a model of its own: Coulomb friction that rises over a narrow band of speeds, and viscous friction whose
    slope bends once.
    """

    torque_constants_Nm_A: Vector6
    rotor_kg_m2: Vector6
    coulomb_Nm: Vector6
    viscous_Nm_s: Vector6  # per rad, as all viscous friction
    known_coulomb_Nm: Vector6
    known_viscous_Nm_s: Vector6
    known_fast_viscous_Nm_s: Vector6  # beyond the bend
    rest_noise_A: Vector6  # standard deviation of the actual current
    motion_noise_A: Vector6

    def known_friction(self, qd: Vector6) -> Vector6:
        """What the controller takes friction for at these speeds [Nm]; none at rest."""
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
        """Of a file's entries, named as the fields are. Raises DrivetrainError for one that is missing or wrong."""
        return cls(**{field.name: _six(values, field.name) for field in fields(cls)})

    def to_mapping(self) -> dict[str, list[float]]:
        """The entries of a file that `from_mapping` reads."""
        return {field.name: list(getattr(self, field.name)) for field in fields(self)}


_POSITIVE: Final = ("torque_constants_Nm_A", "rotor_kg_m2")


def _six(values: Mapping[str, Any], name: str) -> Vector6:
    numbers = values.get(name)
    if (
        not isinstance(numbers, list | tuple)
        or len(numbers) != 6
        or not all(type(number) in (int, float) and isfinite(number) and number >= 0.0 for number in numbers)
    ):
        raise DrivetrainError(f"{name} must be six numbers, none of them negative, it is {numbers!r}")
    if name in _POSITIVE and not all(numbers):
        raise DrivetrainError(f"{name} must be six numbers above 0, it is {numbers!r}")
    return as_six([float(number) for number in numbers])
