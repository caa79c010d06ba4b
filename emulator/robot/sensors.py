"""Sensors of a dynamic arm: resolution of the encoders, noise, and delay.

The angles a controller reports are those half a millisecond before the targets reported with them. That is a property
of the reports, not of the loops: recordings show the same delay for all joints at all speeds, on an arm with periods of
8 ms and on one with 2 ms, while the deviations left by the loops differ from joint to joint.
"""

from collections.abc import Sequence
from math import pi
from random import Random
from typing import Final

from emulator.robot.body import Body
from emulator.robot.chance import Chances
from urproto.robots import RobotModel
from urproto.robots.measured import accelerometer_noise_of, drivetrain_of, encoders_of, wrench_noise_of
from urproto.vectors import ZERO6, Vector3, Vector6, as_six

_GEAR: Final = 101
_CREEP_RAD_S: Final = 0.005  # a slower joint has the noise of one at rest (guess)
_DRAWN: Final = 4096
_MAX_TAKEN: Final = 12
_ANGLE_STEP: Final = 2.0 * pi / 2**19  # rad
_MOTOR_STEP: Final = 2.0 * pi / (2**17 * _GEAR)  # rad, at the joint


class _Normals:
    """Standard normal random numbers, read at random positions of a table.

    Drawing them one by one would take a tenth of a dynamic arm's computing time.
    """

    def __init__(self, chances: Chances) -> None:
        self._chance = chances.stream("sensors")
        self._table: list[float] = []  # an ideal arm needs none

    def take(self, count: int) -> list[float]:
        """Return this many numbers, at most ``_MAX_TAKEN``."""
        if not self._table:
            drawn = Random(0)  # the table is the same on every arm, the places in it are not
            self._table = [drawn.gauss(0.0, 1.0) for _ in range(_DRAWN + _MAX_TAKEN)]
        place = int(_DRAWN * self._chance.random())
        return self._table[place : place + count]


class Sensors:
    """Encoders, current and force sensors of one arm."""

    def __init__(self, model: RobotModel, chances: Chances) -> None:
        drives = drivetrain_of(model)
        self._chance = _Normals(chances)
        self._rest_A, self._motion_A = drives.rest_noise_A, drives.motion_noise_A
        self._wrench = wrench_noise_of(model)
        self._accelerometer = accelerometer_noise_of(model)
        encoders = encoders_of(model)
        self._delay_s = encoders.delay_s
        self._noise = tuple(
            zip(
                encoders.angle_noise_rad,
                encoders.angle_noise_s,
                encoders.speed_noise_rad_s,
                encoders.speed_noise,
                strict=True,
            )
        )

    def joints(self, body: Body, period_s: float) -> tuple[Vector6, Vector6]:
        """Angles and speeds rounded to the encoders' resolution."""
        return _stepped(body.q, _ANGLE_STEP), _stepped(body.qd, _MOTOR_STEP / period_s)

    def reported(self, q: Vector6, qd: Vector6) -> tuple[Vector6, Vector6]:
        """Angles and speeds as a controller reports them: delayed, and with the noise of each moving joint."""
        if qd == ZERO6:
            return q, qd
        delay, chance = self._delay_s, self._chance.take(12)
        angles, speeds = [], []
        for angle, speed, (rest, growth, slow, share), one, other in zip(
            q, qd, self._noise, chance[:6], chance[6:], strict=True
        ):
            pace = abs(speed)
            if pace < _CREEP_RAD_S:
                angles.append(angle - delay * speed)
                speeds.append(speed)
            else:
                angles.append(angle - delay * speed + one * (rest + growth * pace))
                speeds.append(speed + other * (slow + share * pace))
        return as_six(angles), as_six(speeds)

    def currents(self, current: Vector6, qd: Vector6) -> Vector6:
        """Joint currents [A] with noise, which is larger in a moving joint."""
        a, b, c, d, e, f = [
            value + chance * (resting if -_CREEP_RAD_S < speed < _CREEP_RAD_S else moving)
            for value, speed, resting, moving, chance in zip(
                current, qd, self._rest_A, self._motion_A, self._chance.take(6), strict=True
            )
        ]
        return (a, b, c, d, e, f)

    def wrench(self, wrench: Sequence[float]) -> Vector6:
        """A wrench [N, Nm] with noise."""
        chances = self._chance.take(6)
        a, b, c, d, e, f = (
            value + chance * size for value, size, chance in zip(wrench, self._wrench, chances, strict=True)
        )
        return (a, b, c, d, e, f)

    def accelerometer(self, acceleration: Vector3) -> Vector3:
        """An acceleration at the tool [m/s2] with noise."""
        size = self._accelerometer
        u, v, w = self._chance.take(3)
        x, y, z = acceleration
        return (x + u * size, y + v * size, z + w * size)


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
