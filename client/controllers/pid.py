"""The law that turns errors of position into speeds or torques."""

from dataclasses import dataclass
from math import inf


@dataclass(frozen=True, slots=True)
class Gains:
    """Of one joint: proportional, integral, derivative, and the share of the planned speed that is added.

    Clamps limit the integral's part (i) and the sum of all parts (u).
    """

    p: float = 0.0
    i: float = 0.0
    d: float = 0.0
    ff_velocity_scale: float = 0.0
    i_clamp_max: float = inf
    i_clamp_min: float = -inf
    u_clamp_max: float = inf
    u_clamp_min: float = -inf


class Pid:
    """One joint's controller; errors are desired minus actual [rad, rad/s]."""

    def __init__(self, gains: Gains) -> None:
        self.gains = gains
        self._integral = 0.0

    def reset(self) -> None:
        """Forget the past."""
        self._integral = 0.0

    def command(self, error: float, error_rate: float, period_s: float) -> float:
        """What to do about an error."""
        gains = self.gains
        part = self._integral + gains.i * error * period_s
        self._integral = min(max(part, gains.i_clamp_min), gains.i_clamp_max)
        total = gains.p * error + self._integral + gains.d * error_rate
        return min(max(total, gains.u_clamp_min), gains.u_clamp_max)
