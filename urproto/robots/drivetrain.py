"""What sits between a joint's motor and its link: friction, the rotor behind the gear, and motor currents.

The numbers of each arm come from ``drivetrain.toml``, which says of each where it was measured or by which rule it is
carried over from another; those of one arm can be measured and given instead (``RobotModel.drivetrain``).
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from math import isfinite, log
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from urproto.compat import Self, load_toml
from urproto.vectors import Vector6, as_six

if TYPE_CHECKING:
    from urproto.robots.model import RobotModel

_FILE: Final = Path(__file__).with_name("drivetrain.toml")


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
        band, bend = friction_knowledge()
        a, b, c, d, e, f = (
            (dry * v / band if -band < v < band else dry if v > 0.0 else -dry)
            + (slow * v if -bend <= v <= bend else fast * v + (bend if v > 0.0 else -bend) * (slow - fast))
            for v, dry, slow, fast in zip(
                qd, self.known_coulomb_Nm, self.known_viscous_Nm_s, self.known_fast_viscous_Nm_s, strict=True
            )
        )
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


def drivetrain_of(model: "RobotModel") -> Drivetrain:
    """What was measured of this arm; otherwise that of its model, measured or carried over."""
    if model.drivetrain is not None:
        return model.drivetrain
    table = _table()
    known, noise = table["knowledge"], table["noise"]
    rows = [row for row in table["sizes"] if row["series"] == model.series.value]
    sizes = [min(rows, key=lambda row: abs(log(row["torque_max_Nm"] / most))) for most in model.torque_max]
    values = {name: [size[name] for size in sizes] for name in ("coulomb_Nm", "viscous_Nm_s", "rotor_kg_m2")}
    values["torque_constants_Nm_A"] = list(model.torque_constants)
    values["rest_noise_A"] = noise[model.series.value]["current_A"]
    measured = table["models"].get(model.name, {})
    values |= measured
    values.setdefault("known_coulomb_Nm", values["coulomb_Nm"])
    values.setdefault("known_viscous_Nm_s", [known["slow_share"] * slope for slope in values["viscous_Nm_s"]])
    values.setdefault("known_fast_viscous_Nm_s", [known["fast_share"] * slope for slope in values["viscous_Nm_s"]])
    limits = zip(model.torque_max, values["torque_constants_Nm_A"], strict=True)
    values.setdefault("motion_noise_A", [noise["motion_share"] * most / constant for most, constant in limits])
    return Drivetrain.from_mapping(values)


def wrench_noise_of(model: "RobotModel") -> Vector6:
    """Standard deviation of the TCP force of a real arm at rest [N, Nm]."""
    return as_six(_table()["noise"][model.series.value]["wrench"])


@cache
def _table() -> dict[str, Any]:
    return load_toml(_FILE.read_text(encoding="utf-8"))


@cache
def friction_knowledge() -> tuple[float, float]:
    """Speeds [rad/s] in the controller's model: where Coulomb friction is whole, where viscous friction bends."""
    known = _table()["knowledge"]
    return known["coulomb_rad_s"], known["bend_rad_s"]
