"""Temperatures of joints, tool and control box: first-order warming, worked out once a second.

Each part heads for the room's temperature plus what its electronics and, in a joint, the
losses of its motor add. The rises are fitted to one capture of a warm CB3 arm that stands
(joints 32 to 41 degC, wrists the warmest though they carry least; box 37 degC), the room is
what simulators report. How the rise divides, and how long it takes, are guesses.

Simulators do not warm: early ones stand at 40 degC in every joint and 30 in the box, in
recordings of a UR5 and a UR10. Later ones, here no warmer than the room to begin with, stand at
23 to 25.5.
"""

from math import exp
from operator import add, mul
from typing import Final

from emulator.snapshot import Vector6

__all__ = ["ROOM_C", "Thermals"]

ROOM_C: Final = 24.0
_PERIOD_S: Final = 1.0
_TIME_CONSTANT_S: Final = 1800.0
_SHARE: Final = 1.0 - exp(-_PERIOD_S / _TIME_CONSTANT_S)  # of the way to go, made in one period
_DRIVE_RISE_K: Final[Vector6] = (8.0, 8.0, 10.0, 13.0, 15.0, 16.0)  # powered, without load
_MOTOR_RISE_K_A2: Final[Vector6] = (0.04, 0.04, 0.04, 0.5, 0.5, 0.5)
_FRICTION_RISE_K_W: Final = 0.2
_TOOL_RISE_K: Final = 6.0
_BOX_RISE_K: Final = 13.0  # always on
_EARLY_JOINT_C: Final = 40.0
_EARLY_BOX_C: Final = 30.0
_NO_RISE: Final[Vector6] = (0.0,) * 6


class Thermals:
    """Temperatures [degC]. A controller begins cold; those of an ``early_simulator`` stay as they are."""

    def __init__(self, *, early_simulator: bool = False) -> None:
        self.joints: Vector6 = (ROOM_C,) * 6
        self.tool = ROOM_C
        self.box = ROOM_C
        self._elapsed_s = 0.0
        self._constant = early_simulator
        if early_simulator:
            self.joints, self.tool, self.box = (_EARLY_JOINT_C,) * 6, 0.0, _EARLY_BOX_C

    def advance(self, current: Vector6, period_s: float, *, powered: bool, friction_W: Vector6 = _NO_RISE) -> bool:
        """One control period with these joint currents [A] and this heat of friction [W].

        True when the temperatures were renewed.
        """
        if self._constant:
            return False
        self._elapsed_s += period_s
        if self._elapsed_s < _PERIOD_S:
            return False
        self._elapsed_s -= _PERIOD_S
        self.joints = _towards6(self.joints, _joint_rises(current, friction_W) if powered else _NO_RISE)
        self.tool = _towards(self.tool, _TOOL_RISE_K if powered else 0.0)
        self.box = _towards(self.box, _BOX_RISE_K)
        return True


def _joint_rises(current: Vector6, friction_W: Vector6) -> Vector6:
    motors = map(add, _DRIVE_RISE_K, map(mul, _MOTOR_RISE_K_A2, map(mul, current, current)))
    a, b, c, d, e, f = map(add, motors, [_FRICTION_RISE_K_W * heat for heat in friction_W])
    return (a, b, c, d, e, f)


def _towards(temperature: float, rise: float) -> float:
    return temperature + _SHARE * (ROOM_C + rise - temperature)


def _towards6(temperatures: Vector6, rises: Vector6) -> Vector6:
    a, b, c, d, e, f = map(_towards, temperatures, rises)
    return (a, b, c, d, e, f)
