"""Collision detection: the joints' currents against those of the controller's model.

Each joint has a window. A current further off the model for long enough is a collision
(`emulator.safety.supervision`). A stop leaves the arm where it is, and it may press with more than that; once the stop
is released, it has to be moved away. What the arm carries at that moment is therefore no new collision: the window of
a joint that is outside it is widened to what it carries and a little more. A joint that is loaded further leaves this
window, too. While it is relieved, the window follows, down to the usual one. That a controller does it this way is a
guess; that one unlocks the stop and moves the arm away is PolyScope's routine (user manual, "Protective stop").
"""

from typing import Final

from urproto.vectors import ZERO6, Vector6, as_six

CURRENT_WINDOW_A: Final[Vector6] = (4.0, 4.0, 4.0, 2.0, 2.0, 2.0)  # guess
# of its window: by how much a joint may be loaded beyond what it carried, as by friction if the tool slides (guess)
_FURTHER: Final = 0.5


class CollisionWindows:
    """How far each joint's current is off the model [A], and how far it may be.

    ``excess``: actual minus expected currents. ``windows``: the present window of each joint. ``ratio``: the largest
    share that an excess has of its window, up to 1: then a joint is outside.
    """

    def __init__(self) -> None:
        self.excess: Vector6 = ZERO6
        self.windows: Vector6 = CURRENT_WINDOW_A
        self.ratio = 0.0
        self._carried: Vector6 = ZERO6  # what remains of the excess that was accepted

    @property
    def shares(self) -> Vector6:
        """The share that each joint's excess has of its window."""
        return as_six(abs(excess) / window for excess, window in zip(self.excess, self.windows, strict=True))

    def compare(self, excess: Vector6) -> None:
        """Take the period's excess of the currents over the model [A]."""
        self.excess = excess
        if self._carried != ZERO6:
            self._carry(as_six(map(_relieved, self._carried, excess)))
        u, v, w, x, y, z = self.windows
        a, b, c, d, e, f = excess
        self.ratio = min(1.0, max(abs(a) / u, abs(b) / v, abs(c) / w, abs(d) / x, abs(e) / y, abs(f) / z))

    def clear(self) -> None:
        """The currents are those of the model, or there are none."""
        self.excess, self.windows, self.ratio, self._carried = ZERO6, CURRENT_WINDOW_A, 0.0, ZERO6

    def accept(self) -> None:
        """The arm has been released from a stop: what it carries now is no collision."""
        self._carry(self.excess)
        self.compare(self.excess)

    def _carry(self, load: Vector6) -> None:
        self._carried = load
        windows = zip(load, CURRENT_WINDOW_A, strict=True)
        self.windows = as_six(max(window, abs(carried) + _FURTHER * window) for carried, window in windows)


def _relieved(carried: float, excess: float) -> float:
    """What is left of a carried load: it only decreases, and has gone once the load pushes the other way."""
    if carried * excess <= 0.0:
        return 0.0
    return excess if abs(excess) < abs(carried) else carried
