"""What a dynamic arm measures of itself: encoder steps and noise, the same for the same seed.

Amounts are guesses: 19 bits a turn at the joint, 17 bits a turn of the motor behind the gear for the speed.
"""

from collections.abc import Sequence
from math import pi
from random import Random
from typing import Final

from emulator.robot.body import Body
from emulator.snapshot import Vector6

__all__ = ["Senses"]

_GEAR: Final = 101
_ANGLE_STEP: Final = 2.0 * pi / 2**19  # rad
_MOTOR_STEP: Final = 2.0 * pi / (2**17 * _GEAR)  # rad, at the joint
_CURRENT_A: Final = 0.02  # standard deviations
_FORCE_N: Final = 0.2
_TORQUE_NM: Final = 0.01
_WRENCH: Final = (_FORCE_N, _FORCE_N, _FORCE_N, _TORQUE_NM, _TORQUE_NM, _TORQUE_NM)


class Senses:
    """Encoders, current and force sensors of one arm."""

    def __init__(self, seed: int) -> None:
        self._chance = Random(seed)

    def joints(self, body: Body, period_s: float) -> tuple[Vector6, Vector6]:
        """Angles and speeds as the encoders tell them."""
        return _stepped(body.q, _ANGLE_STEP), _stepped(body.qd, _MOTOR_STEP / period_s)

    def currents(self, current: Vector6) -> Vector6:
        """Joint currents [A] with noise."""
        gauss = self._chance.gauss
        a, b, c, d, e, f = current
        return (
            a + gauss(0.0, _CURRENT_A),
            b + gauss(0.0, _CURRENT_A),
            c + gauss(0.0, _CURRENT_A),
            d + gauss(0.0, _CURRENT_A),
            e + gauss(0.0, _CURRENT_A),
            f + gauss(0.0, _CURRENT_A),
        )

    def wrench(self, wrench: Sequence[float]) -> Vector6:
        """A wrench [N, Nm] with noise."""
        gauss = self._chance.gauss
        a, b, c, d, e, f = (value + gauss(0.0, size) for value, size in zip(wrench, _WRENCH, strict=True))
        return (a, b, c, d, e, f)


def _stepped(values: Vector6, step: float) -> Vector6:
    a, b, c, d, e, f = values
    return (
        step * round(a / step),
        step * round(b / step),
        step * round(c / step),
        step * round(d / step),
        step * round(e / step),
        step * round(f / step),
    )
