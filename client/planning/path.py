"""Ways without corners, as polynomials of fifth degree one after the other; and straight ways, rounded where they turn.

A corner at c between the unit directions u and v is rounded by the Bezier curve of fifth degree with the points
c - d u, c - d u / 2, c, c, c + d v / 2, c + d v. It leaves the one straight piece and meets the other with their
direction and no curvature, so that speed and acceleration go on; it passes the corner at 0.11 d |v - u|.
"""

from collections.abc import Callable, Sequence
from math import comb
from typing import Final

import numpy as np
import numpy.typing as npt

from client.planning.timing import Array, spread

_LARGEST: Final = 0.6  # rad that a corner takes of each piece (guess): rounder ones are longer and no faster
_SHARE: Final = 0.45  # of a straight piece that each of its corners may take
_PARTS: Final = 24  # of each piece, where limits are looked at
_SAME: Final = 1e-9
_POWERS: Final = np.arange(6)
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
_TO_BEZIER: Final = np.linalg.inv(_BEZIER.T)


class PiecewisePath:
    """One polynomial after the other. The first six columns are joints [rad]; more may go with them.

    coefficients: (pieces, 6, columns), by powers of the way s since the piece began. sizes: of the pieces, in s.
    length: of the whole in s. places: where limits are looked at, ``parts`` of each piece.
    """

    def __init__(self, coefficients: Array, sizes: Sequence[float] | Array, parts: int = _PARTS) -> None:
        self.coefficients = coefficients
        self.sizes = np.asarray(sizes, dtype=float)
        self.ends = np.cumsum(self.sizes)
        self.starts = np.concatenate(((0.0,), self.ends[:-1]))
        self.length = float(self.ends[-1])
        self.places = spread(self.sizes.tolist(), parts)

    def at(self, s: float) -> Array:
        """All columns at one place."""
        q: Array = self(np.array([s]))[0][0]
        return q

    def __call__(self, s: Array) -> tuple[Array, Array, Array]:
        """q, dq/ds and d2q/ds2 at these places (n,), each (n, columns)."""
        piece = self.piece_at(s)
        t = s - self.starts[piece]
        c = self.coefficients[piece]
        powers = t[:, None] ** _POWERS
        q = np.einsum("np,npj->nj", powers, c)
        first = np.einsum("np,npj->nj", powers[:, :5] * np.arange(1, 6), c[:, 1:])
        second = np.einsum("np,npj->nj", powers[:, :4] * (np.arange(2, 6) * np.arange(1, 5)), c[:, 2:])
        return q, first, second

    def piece_at(self, s: Array) -> npt.NDArray[np.intp]:
        """The number of the piece at each of these places (n,)."""
        return np.clip(np.searchsorted(self.ends, s, side="left"), 0, len(self.ends) - 1)

    def within(self, piece: int) -> Callable[[float], Array]:
        """The joints (6,) [rad] in one piece, of the share of its size."""
        scaled = self.coefficients[piece, :, :6] * (self.sizes[piece] ** _POWERS)[:, None]

        def at(share: float) -> Array:
            angles: Array = (share**_POWERS) @ scaled
            return angles

        return at

    def travel(self, piece: int) -> Array:
        """How far each column goes at most in a piece as fast as in its fastest place.

        It is a Bezier curve, and its derivative lies among the differences of its points.
        """
        scaled = self.coefficients[piece] * (self.sizes[piece] ** _POWERS)[:, None]
        points = _TO_BEZIER @ scaled
        farthest: Array = 5.0 * abs(np.diff(points, axis=0)).max(axis=0)
        return farthest

    def part(self, low: float, high: float) -> "PiecewisePath":
        """From one place to a later one."""
        first, last = (int(i) for i in self.piece_at(np.array([low, high])))
        if first < last and self.ends[first] - low < _SAME * self.length:
            first, low = first + 1, float(self.ends[first])
        coefficients, sizes = self.coefficients[first : last + 1].copy(), self.sizes[first : last + 1].copy()
        sizes[-1] = high - self.starts[last]
        before = low - self.starts[first]
        coefficients[0] = _shifted(coefficients[0], before)
        sizes[0] -= before
        return PiecewisePath(coefficients, sizes, self._parts)

    def scaled(self, factor: float) -> "PiecewisePath":
        """The same way with an s that is so much longer."""
        coefficients = self.coefficients / (factor**_POWERS)[None, :, None]
        return PiecewisePath(coefficients, self.sizes * factor, self._parts)

    def widened(self, columns: int) -> "PiecewisePath":
        """With more columns, in which nothing happens."""
        more = columns - self.coefficients.shape[2]
        return PiecewisePath(np.pad(self.coefficients, ((0, 0), (0, 0), (0, more))), self.sizes, self._parts)

    @property
    def _parts(self) -> int:
        return (len(self.places) - 1) // len(self.sizes)


def joined(paths: Sequence[PiecewisePath]) -> PiecewisePath:
    """One after the other; each begins where and as the one before ends."""
    whole = PiecewisePath(
        np.concatenate([path.coefficients for path in paths]), np.concatenate([path.sizes for path in paths])
    )
    places, begin = [np.zeros(1)], 0.0
    for path in paths:
        places.append(path.places[1:] + begin)
        begin += path.length
    whole.places = np.concatenate(places)
    return whole


def hermite(begin: Sequence[Array], end: Sequence[Array], size: float) -> Array:
    """The polynomial (6, columns) with these values, and first and second derivatives, at both ends."""
    (p0, v0, a0), (p5, v5, a5) = begin, end
    p1, p4 = p0 + v0 * size / 5.0, p5 - v5 * size / 5.0
    p2, p3 = 2.0 * p1 - p0 + a0 * size**2 / 20.0, 2.0 * p4 - p5 + a5 * size**2 / 20.0
    of_t: Array = _BEZIER.T @ np.array([p0, p1, p2, p3, p4, p5])
    return of_t / size ** _POWERS[:, None]


def _shifted(coefficients: Array, by: float) -> Array:
    """The same polynomial with its zero moved."""
    shift = np.array([[comb(j, k) * by ** (j - k) if j >= k else 0.0 for j in range(6)] for k in range(6)])
    moved: Array = shift @ coefficients
    return moved


class RoundedPath(PiecewisePath):
    """Through these points (n, 6) [rad], n at least 2, neighbours apart.

    roundness: 0 to 1 of what each corner may take. s is the way [rad] on straight pieces.
    """

    def __init__(
        self, points: Sequence[Sequence[float] | Array] | Array, roundness: float | Sequence[float] = 1.0
    ) -> None:
        corners = np.asarray(points, dtype=float)
        ways = np.diff(corners, axis=0)
        lengths = np.linalg.norm(ways, axis=1)
        directions = ways / lengths[:, None]
        share = np.broadcast_to(np.asarray(roundness, dtype=float), (max(0, len(corners) - 2),))
        around = zip(lengths[:-1].tolist(), lengths[1:].tolist(), share.tolist(), strict=True)
        cut = [_cut(one, other, r) for one, other, r in around]
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
        super().__init__(np.array(pieces), sizes)


def rounded_corner(before: Array, corner: Array, after: Array, roundness: float) -> PiecewisePath:
    """The curve alone that a `RoundedPath` through these three points (6,) [rad] has."""
    ways = (corner - before, after - corner)
    one, other = (float(np.linalg.norm(way)) for way in ways)
    cut = _cut(one, other, roundness)
    return PiecewisePath(_corner(corner, ways[0] / one, ways[1] / other, cut)[None], [2.5 * cut])


def _cut(before: float, after: float, roundness: float) -> float:
    """How much of the pieces beside it a corner takes [rad]."""
    return float(roundness * min(_LARGEST, _SHARE * before, _SHARE * after))


def _straight(start: Array, direction: Array) -> Array:
    coefficients = np.zeros((6, len(start)))
    coefficients[0], coefficients[1] = start, direction
    return coefficients


def _corner(corner: Array, u: Array, v: Array, d: float) -> Array:
    still = np.zeros_like(u)
    return hermite((corner - d * u, u, still), (corner + d * v, v, still), 2.5 * d)
