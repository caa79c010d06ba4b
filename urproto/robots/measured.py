"""Parameters of each model's drives and sensors, from recordings of real arms.

The numbers are in ``measured.toml``, which states for each where it was measured, or the rule by which it is derived
from another arm.
"""

from dataclasses import dataclass
from functools import cache, lru_cache
from math import log
from pathlib import Path
from typing import Any, Final

from urproto.compat import load_toml
from urproto.robots.drivetrain import Drivetrain
from urproto.robots.model import RobotModel
from urproto.vectors import Vector6, as_six

_FILE: Final = Path(__file__).with_name("measured.toml")


@lru_cache(maxsize=32)
def drivetrain_of(model: RobotModel) -> Drivetrain:
    """The identified drives of this arm; otherwise those of its model, measured or derived from another arm."""
    if model.drivetrain is not None:
        return model.drivetrain
    table = _table()
    known, noise = table["knowledge"], table["noise"]
    rows = [row for row in table["sizes"] if row["series"] == model.series.value]
    sizes = [min(rows, key=lambda row: abs(log(row["torque_max_Nm"] / limit))) for limit in model.torque_max]
    values = {name: [size[name] for size in sizes] for name in ("coulomb_Nm", "viscous_Nm_s", "rotor_kg_m2")}
    values["torque_constants_Nm_A"] = list(model.torque_constants)
    values["rest_noise_A"] = noise[model.series.value]["current_A"]
    measured = table["models"].get(model.name, {})
    values |= measured
    values.setdefault("known_coulomb_Nm", values["coulomb_Nm"])
    values.setdefault("known_viscous_Nm_s", [known["slow_share"] * viscous for viscous in values["viscous_Nm_s"]])
    values.setdefault("known_fast_viscous_Nm_s", [known["fast_share"] * viscous for viscous in values["viscous_Nm_s"]])
    limits = zip(model.torque_max, values["torque_constants_Nm_A"], strict=True)
    values.setdefault("motion_noise_A", [noise["motion_share"] * limit / constant for limit, constant in limits])
    return Drivetrain.from_mapping(values)


def wrench_noise_of(model: RobotModel) -> Vector6:
    """Standard deviation of the TCP force of a real arm at rest [N, Nm]."""
    return as_six(_table()["noise"][model.series.value]["wrench"])


def accelerometer_noise_of(model: RobotModel) -> float:
    """Standard deviation of each axis of a real arm's tool accelerometer [m/s2]."""
    return float(_table()["noise"][model.series.value]["accelerometer_m_s2"])


@dataclass(frozen=True, slots=True)
class Encoders:
    """Delay and noise of the joint angles and speeds that a controller reports while a joint moves.

    The standard deviation of an angle is ``angle_noise_rad`` + ``angle_noise_s`` * speed, and that of a speed
    accordingly.
    """

    delay_s: float
    angle_noise_rad: Vector6
    angle_noise_s: Vector6
    speed_noise_rad_s: Vector6
    speed_noise: Vector6


def encoders_of(model: RobotModel) -> Encoders:
    """The values for the model's series."""
    table = _table()["encoders"]
    rows = table[model.series.value]
    names = ("angle_noise_rad", "angle_noise_s", "speed_noise_rad_s", "speed_noise")
    return Encoders(table["delay_s"], *(as_six(rows[name]) for name in names))


@dataclass(frozen=True, slots=True)
class Loops:
    """Gains of a drive: torque per rad, rad/s and rad s of deviation, divided by the joint's largest inertia."""

    stiffness_1_s2: Vector6
    damping_1_s: Vector6
    integral_1_s3: Vector6


def loops() -> Loops:
    """The gains of all arms' drives, which were measured on one arm."""
    return Loops(**{name: as_six(values) for name, values in _table()["loops"].items()})


@dataclass(frozen=True, slots=True)
class Supply:
    """Supply of a real controller at rest: mean voltages, and standard deviations [V, A]."""

    main_V: float
    main_noise_V: float
    robot_V: float
    robot_noise_V: float
    joint_noise_V: float
    current_noise_A: float


def supply_of(model: RobotModel) -> Supply:
    """The values for the model's series."""
    return Supply(**_table()["supply"][model.series.value])


@cache
def _table() -> dict[str, Any]:
    return load_toml(_FILE.read_text(encoding="utf-8"))
