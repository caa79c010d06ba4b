"""The time of the program, in which its threads run and its movements take place.

A pause, a safeguard stop or a protective stop slows this time down until it stands still, and `resume` lets it gain its
full pace again, so that the leading joint brakes and accelerates with a known ramp. Everything that the program has
commanded happens in this time: a speed held for 2 ms is held for 2 ms of it, a target is followed, a force pushes, and
the threads get their next frame once a control period of it is over. A pause therefore changes when the arm is
somewhere, and never where it goes.

While the time has not its full pace, the end of a frame seldom coincides with the end of a control period: threads run
in the period nearest to it, or when a command has ended. At full pace, the arm would be ahead of the threads by the
same fraction of a frame for ever. So that a program continues in step with the control periods, the time is held back
a little longer until that fraction is gone.
"""

from math import inf, sqrt

from urproto.robots.model import Joints
from urproto.vectors import largest, lerp

RAMP_RAD_S2 = 10.0  # leading joint, when the speed fraction changes or a program pauses (guess)
_TOLERANCE = 1e-6  # of full pace: slower is standing still
_SAME = 1e-9  # frames: rounding errors


class ProgramTime:
    """``pace``: periods of this time in the last control period, from 0 (standing) to 1."""

    def __init__(self, period_s: float) -> None:
        self.pace = 1.0
        self._period = period_s
        self._frames = 1.0  # periods of this time since the frame of the threads that was due last
        self._called = False  # a command has ended, and the program may give the next one
        self._speed = 0.0  # of the leading joint in this time [rad/s]
        self._gain = 0.0  # its rate of change [rad/s2]
        self._in_step = True  # full pace, and frames coincide with control periods

    def restart(self) -> None:
        """Run at full pace; threads run in this control period."""
        self.pace, self._frames, self._called, self._in_step = 1.0, 1.0, False, True

    def run_on(self) -> None:
        """Run at full pace immediately: what moved in this time has its actual speed from now on."""
        self.pace = 1.0

    def freeze(self) -> None:
        """Stand still immediately, and later continue as immediately: nothing moves in this time."""
        self.pace = self._speed = self._gain = 0.0
        self._in_step = False

    def call(self) -> None:
        """A command has ended: the threads run in the next period, so that another one can follow without a gap."""
        self._called = True

    @property
    def late_s(self) -> float:
        """How late the frame comes that now runs [s]; negative: how early."""
        return 0.0 if self._in_step else self._ahead * self._period

    @property
    def _ahead(self) -> float:
        return self._frames - round(self._frames)

    def frame(self) -> bool:
        """Whether the threads run in this control period; asked once a period while the program is not held."""
        due = self._called or self._frames >= 1.0 - 0.5 * self.pace - _SAME
        self._called = False
        if due:
            self._frames -= 1.0
        return due

    def advance(self, qd: Joints, qdd: Joints, *, held: bool, ramp: float) -> None:
        """Begin a control period; the arm had these target speeds and accelerations in the last one.

        ``held``: slow down, the leading joint by ``ramp`` [rad/s2]; otherwise gain full pace.
        """
        if held or not self._in_step:
            self._measure(qd, qdd)
            self._in_step = False
            self.pace = self._ramped(0.0, ramp) if held else self._regained(ramp)
        self._frames += self.pace
        if self._frames >= 2.0:
            self._frames -= 1.0  # no program runs; a later one must not make up for it

    def _measure(self, qd: Joints, qdd: Joints) -> None:
        """Measure the speed of the leading joint in this time. It is kept while the time stands still."""
        if self._in_step:
            self._speed = largest(qd)
            self._gain = (self._speed - largest(lerp(qd, qdd, -self._period))) / self._period
        elif self.pace > 0.0:
            speed = largest(qd) / self.pace
            self._gain = (speed - self._speed) / (self.pace * self._period)
            self._speed = speed

    def _ramped(self, goal: float, ramp: float) -> float:
        return ramped(self.pace, goal, self._speed, self._gain, ramp * self._period, self._period)

    def _regained(self, ramp: float) -> float:
        """The next pace on the way to full pace, in step with the control periods."""
        pace = self._ramped(1.0, ramp)
        ahead = self._ahead
        if abs(ahead) > _SAME:
            change = ramp * self._period / self._speed if self._speed > 0.0 else inf
            return min(pace, 1.0 - min(change, ahead % 1.0))
        if pace >= 1.0:
            self._frames, self._in_step = float(round(self._frames)), True
        return pace


def ramped(scale: float, goal: float, pace: float, gain: float, change: float, period_s: float) -> float:
    """The next value of a time scale that approaches its goal.

    ``pace``: speed of the leading joint in scaled time [rad/s], ``gain`` its rate of change [rad/s2], ``change``: what
    its actual speed may change by in a control period [rad/s].
    """
    if pace <= 0.0 or goal == scale:
        return goal  # a movement that begins at rest accelerates by its own profile
    if goal > scale:
        return min(goal, scale + change / pace)
    # the pace changes along the step itself: speed = scale * (pace + gain * scale * period)
    speed = scale * pace - change
    if speed <= _TOLERANCE * pace:
        return goal
    root = pace**2 + 4.0 * gain * period_s * speed
    if root <= 0.0:
        return scale  # the path itself decelerates by more than the ramp
    return max(goal, min(scale, 2.0 * speed / (pace + sqrt(root))))
