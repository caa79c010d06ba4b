"""Voltages, currents, temperatures and energy: plausible, not modelled.

All numbers are guesses of the size a real arm shows.
"""

from operator import mul
from typing import Final

from emulator.robot.arm import Arm
from emulator.snapshot import Snapshot, Vector6

__all__ = ["Electrics"]

_RAIL_V: Final = 48.0  # robot supply, user manual
_STANDBY_A: Final = 0.25  # control electronics of a powered arm
_LOSS_OHM: Final = 0.5  # per joint, motor and drive
_IO_CURRENT_A: Final = 0.02
_CURRENT_WINDOW_A: Final[Vector6] = (3.0, 3.0, 3.0, 1.5, 1.5, 1.5)
_JOINT_TEMPERATURES_C: Final[Vector6] = (29.0, 29.5, 30.0, 31.0, 31.5, 32.0)
_TOOL_TEMPERATURE_C: Final = 30.0
_OFF6: Final[Vector6] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_ON6: Final[Vector6] = (_RAIL_V,) * 6


class Electrics:
    """Supply current and energy, derived from the joint currents."""

    def __init__(self) -> None:
        self.robot_current_A = 0.0
        self.energy_J = 0.0

    def advance(self, arm: Arm, period_s: float, *, powered: bool, changed: bool) -> None:
        """One control period. ``changed``: the arm's torques or its power are not those of the last one."""
        if changed:
            self.robot_current_A = _supply_current(arm) if powered else 0.0
        self.energy_J += _RAIL_V * self.robot_current_A * period_s

    def publish(self, snapshot: Snapshot, *, powered: bool) -> None:
        """Write to a snapshot."""
        snapshot.actual_main_voltage = _RAIL_V
        snapshot.actual_robot_voltage = _RAIL_V if powered else 0.0
        snapshot.actual_robot_current = self.robot_current_A
        snapshot.actual_joint_voltage = _ON6 if powered else _OFF6
        snapshot.actual_current_window = _CURRENT_WINDOW_A
        snapshot.joint_temperatures = _JOINT_TEMPERATURES_C
        snapshot.tool_temperature = _TOOL_TEMPERATURE_C
        snapshot.io_current = _IO_CURRENT_A
        snapshot.actual_robot_energy_consumed = self.energy_J


def _supply_current(arm: Arm) -> float:
    """Standby, ohmic losses and mechanical power; power fed back is not stored."""
    losses: float = _LOSS_OHM * sum(map(mul, arm.actual_current, arm.actual_current))
    mechanical: float = sum(map(mul, arm.actual_torque, arm.qd))
    return _STANDBY_A + max(0.0, losses + mechanical) / _RAIL_V
