"""A way through joint configurations without a corner: straight, and rounded where it turns.

A corner at c between the unit directions u and v is rounded by the Bezier curve of fifth degree with the points
c - d u, c - d u / 2, c, c, c + d v / 2, c + d v. It leaves the one straight piece and meets the other with their
direction and no curvature, so that speed and acceleration go on; it passes the corner at 0.11 d |v - u|.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from client.planning.timing import Array, spread

_LARGEST: Final = 0.6  # rad that a corner takes of each piece (guess): rounder ones are longer and no faster
_SHARE: Final = 0.45  # of a straight piece that each of its corners may take
_PARTS: Final = 24  # of each piece, where limits are looked at
_SAME: Final = 1e-9
# the Bezier curve's polynomial in t of each of its six points, by powers 0..5
_BEZIER: Final = np.array(
    [
        [1, -5, 10, -10, 5, -1],
        [0, 5, -20, 30, -20, 5],
        [0, 0, 10, -30, 30, -10],
        [0, 0, 0, 10, -20, 10],
        [0, 0, 0, 0, 5, -5],
        [0, 0, 0, 0, 0, 1],
    ],
    dtype=float,
)


class RoundedPath:
    """Through these points (n, 6) [rad], n at least 2, neighbours apart.

    roundness: 0 to 1 of what each corner may take.

    length: of the parameter s, which is the way [rad] on straight pieces. steepest: the largest |dq/ds| (6,).
    """

    def __init__(
        self, points: Sequence[Sequence[float] | Array] | Array, roundness: float | Sequence[float] = 1.0
    ) -> None:
        corners = np.asarray(points, dtype=float)
        ways = np.diff(corners, axis=0)
        lengths = np.linalg.norm(ways, axis=1)
        directions = ways / lengths[:, None]
        share = np.broadcast_to(np.asarray(roundness, dtype=float), (max(0, len(corners) - 2),))
        cut = [
            float(r) * min(_LARGEST, _SHARE * float(one), _SHARE * float(other))
            for r, one, other in zip(share, lengths[:-1], lengths[1:], strict=True)
        ]
        pieces, sizes = [], []
        before = [0.0, *cut]
        after = [*cut, 0.0]
        for i, (start, direction) in enumerate(zip(corners[:-1], directions, strict=True)):
            straight = float(lengths[i]) - before[i] - after[i]
            pieces.append(_straight(start + before[i] * direction, direction))
            sizes.append(straight)
            if i < len(cut) and cut[i] > _SAME:
                pieces.append(_corner(corners[i + 1], direction, directions[i + 1], cut[i]))
                sizes.append(2.5 * cut[i])
        self._coefficients = np.array(pieces)  # (pieces, powers, joints)
        self._ends = np.cumsum(sizes)
        self._starts = np.concatenate(((0.0,), self._ends[:-1]))
        self.length = float(self._ends[-1])
        self.places = spread(sizes, _PARTS)
        # dq/ds of a corner lies between the directions of its pieces, but for a factor of at most 1 (see the class)
        self.steepest = abs(directions).max(axis=0)

    def at(self, s: float) -> Array:
        """q at one place (6,)."""
        q: Array = self(np.array([s]))[0][0]
        return q

    def __call__(self, s: Array) -> tuple[Array, Array, Array]:
        """q, dq/ds and d2q/ds2 at these places (n,), each (n, 6)."""
        piece = np.clip(np.searchsorted(self._ends, s, side="left"), 0, len(self._ends) - 1)
        t = s - self._starts[piece]
        c = self._coefficients[piece]
        powers = t[:, None] ** np.arange(6)
        q = np.einsum("np,npj->nj", powers, c)
        first = np.einsum("np,npj->nj", powers[:, :5] * np.arange(1, 6), c[:, 1:])
        second = np.einsum("np,npj->nj", powers[:, :4] * (np.arange(2, 6) * np.arange(1, 5)), c[:, 2:])
        return q, first, second


def _straight(start: Array, direction: Array) -> Array:
    coefficients = np.zeros((6, len(start)))
    coefficients[0], coefficients[1] = start, direction
    return coefficients


def _corner(corner: Array, u: Array, v: Array, d: float) -> Array:
    points = np.array([corner - d * u, corner - 0.5 * d * u, corner, corner, corner + 0.5 * d * v, corner + d * v])
    of_t: Array = _BEZIER.T @ points  # from 0 to 1
    return of_t / (2.5 * d) ** np.arange(6)[:, None]
