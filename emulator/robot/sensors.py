"""What a dynamic arm's sensors make of the truth: steps of encoders, noise of currents, forces and accelerations."""

from collections.abc import Sequence
from math import pi
from random import Random
from typing import Final

from emulator.robot.body import Body
from urproto.robots import RobotModel
from urproto.robots.measured import accelerometer_noise_of, drivetrain_of, wrench_noise_of
from urproto.vectors import Vector3, Vector6

_GEAR: Final = 101
_CREEP_RAD_S: Final = 0.005  # slower than this is as noisy as standing (guess)
_ANGLE_STEP: Final = 2.0 * pi / 2**19  # rad
_MOTOR_STEP: Final = 2.0 * pi / (2**17 * _GEAR)  # rad, at the joint


class Sensors:
    """Encoders, current and force sensors of one arm."""

    def __init__(self, model: RobotModel, seed: int) -> None:
        drives = drivetrain_of(model)
        self._chance = Random(seed)
        self._rest_A, self._motion_A = drives.rest_noise_A, drives.motion_noise_A
        self._wrench = wrench_noise_of(model)
        self._accelerometer = accelerometer_noise_of(model)

    def joints(self, body: Body, period_s: float) -> tuple[Vector6, Vector6]:
        """Angles and speeds as the encoders tell them."""
        return _stepped(body.q, _ANGLE_STEP), _stepped(body.qd, _MOTOR_STEP / period_s)

    def currents(self, current: Vector6, qd: Vector6) -> Vector6:
        """Joint currents [A] with noise, which is larger in a joint that moves."""
        gauss = self._chance.gauss
        a, b, c, d, e, f = [
            value + gauss(0.0, resting if -_CREEP_RAD_S < speed < _CREEP_RAD_S else moving)
            for value, speed, resting, moving in zip(current, qd, self._rest_A, self._motion_A, strict=True)
        ]
        return (a, b, c, d, e, f)

    def wrench(self, wrench: Sequence[float]) -> Vector6:
        """A wrench [N, Nm] with noise."""
        gauss = self._chance.gauss
        a, b, c, d, e, f = (value + gauss(0.0, size) for value, size in zip(wrench, self._wrench, strict=True))
        return (a, b, c, d, e, f)

    def accelerometer(self, acceleration: Vector3) -> Vector3:
        """An acceleration at the tool [m/s2] with noise."""
        gauss, size = self._chance.gauss, self._accelerometer
        x, y, z = acceleration
        return (x + gauss(0.0, size), y + gauss(0.0, size), z + gauss(0.0, size))


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
