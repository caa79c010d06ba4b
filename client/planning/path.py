"""Smooth paths: sequences of quintic polynomials, and straight segments with rounded corners.

A corner at c between the unit directions u and v is rounded by the quintic Bezier curve with the control points
c - d u, c - d u / 2, c, c, c + d v / 2, c + d v. The curve joins both straight segments with their direction and zero
curvature, so that speed and acceleration are continuous. It passes the corner at a distance of 0.11 d |v - u|.
"""

from collections.abc import Callable, Sequence
from math import comb
from typing import Final

import numpy as np
import numpy.typing as npt

from client.planning.parameterisation import Array, subdivide

_MAX_CORNER_RAD: Final = 0.6  # length of each segment that a corner takes (guess): rounder is longer and no faster
_MAX_CORNER_SHARE: Final = 0.45  # share of a straight segment that each of its corners may take
_GRIDPOINTS: Final = 24  # per piece, at which limits are evaluated
_TOLERANCE: Final = 1e-9
_POWERS: Final = np.arange(6)
# the six Bernstein polynomials in t, by powers 0..5: one row for each control point
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
    """A sequence of polynomials in the path parameter s. The first six columns are joints [rad]; more may follow.

    coefficients: (pieces, 6, columns), by powers of s from the start of each piece. sizes: the length of each piece in
    s. length: of the whole path in s. gridpoints: the values of s at which limits are evaluated, ``parts`` intervals
    per piece.
    """

    def __init__(self, coefficients: Array, sizes: Sequence[float] | Array, parts: int = _GRIDPOINTS) -> None:
        self.coefficients = coefficients
        self.sizes = np.asarray(sizes, dtype=float)
        self.ends = np.cumsum(self.sizes)
        self.starts = np.concatenate(((0.0,), self.ends[:-1]))
        self.length = float(self.ends[-1])
        self.gridpoints = subdivide(self.sizes.tolist(), parts)

    def at(self, s: float) -> Array:
        """All columns at one place s."""
        q: Array = self(np.array([s]))[0][0]
        return q

    def __call__(self, s: Array) -> tuple[Array, Array, Array]:
        """q, dq/ds and d2q/ds2 at the places s (n,), each (n, columns)."""
        piece = self.piece_at(s)
        t = s - self.starts[piece]
        c = self.coefficients[piece]
        powers = t[:, None] ** _POWERS
        q = np.einsum("np,npj->nj", powers, c)
        first = np.einsum("np,npj->nj", powers[:, :5] * np.arange(1, 6), c[:, 1:])
        second = np.einsum("np,npj->nj", powers[:, :4] * (np.arange(2, 6) * np.arange(1, 5)), c[:, 2:])
        return q, first, second

    def piece_at(self, s: Array) -> npt.NDArray[np.intp]:
        """The number of the piece at each place s (n,)."""
        return np.clip(np.searchsorted(self.ends, s, side="left"), 0, len(self.ends) - 1)

    def piece_function(self, piece: int) -> Callable[[float], Array]:
        """The configuration (6,) [rad] in one piece as a function of the share of its length, 0 to 1."""
        scaled = self.coefficients[piece, :, :6] * (self.sizes[piece] ** _POWERS)[:, None]

        def at(share: float) -> Array:
            angles: Array = (share**_POWERS) @ scaled
            return angles

        return at

    def max_travel(self, piece: int) -> Array:
        """Upper bound of each column's travel in a piece: its highest rate of change, kept up for the whole piece.

        A piece is a Bezier curve, so its derivative lies within the differences of its control points.
        """
        scaled = self.coefficients[piece] * (self.sizes[piece] ** _POWERS)[:, None]
        points = _TO_BEZIER @ scaled
        farthest: Array = 5.0 * abs(np.diff(points, axis=0)).max(axis=0)
        return farthest

    def subpath(self, low: float, high: float) -> "PiecewisePath":
        """The part from one place to a later one."""
        first, last = (int(i) for i in self.piece_at(np.array([low, high])))
        if first < last and self.ends[first] - low < _TOLERANCE * self.length:
            first, low = first + 1, float(self.ends[first])
        coefficients, sizes = self.coefficients[first : last + 1].copy(), self.sizes[first : last + 1].copy()
        sizes[-1] = high - self.starts[last]
        before = low - self.starts[first]
        coefficients[0] = _shift_origin(coefficients[0], before)
        sizes[0] -= before
        return PiecewisePath(coefficients, sizes, self._parts)

    def scaled(self, factor: float) -> "PiecewisePath":
        """The same path with s multiplied by a factor."""
        coefficients = self.coefficients / (factor**_POWERS)[None, :, None]
        return PiecewisePath(coefficients, self.sizes * factor, self._parts)

    def with_columns(self, columns: int) -> "PiecewisePath":
        """The same path with further columns, all zero."""
        more = columns - self.coefficients.shape[2]
        return PiecewisePath(np.pad(self.coefficients, ((0, 0), (0, 0), (0, more))), self.sizes, self._parts)

    @property
    def _parts(self) -> int:
        return (len(self.gridpoints) - 1) // len(self.sizes)


def concatenate(paths: Sequence[PiecewisePath]) -> PiecewisePath:
    """Join paths, each of which begins where the one before ends and with the same derivatives."""
    whole = PiecewisePath(
        np.concatenate([path.coefficients for path in paths]), np.concatenate([path.sizes for path in paths])
    )
    gridpoints, begin = [np.zeros(1)], 0.0
    for path in paths:
        gridpoints.append(path.gridpoints[1:] + begin)
        begin += path.length
    whole.gridpoints = np.concatenate(gridpoints)
    return whole


def hermite(begin: Sequence[Array], end: Sequence[Array], size: float) -> Array:
    """The quintic polynomial (6, columns) with these values and first and second derivatives at its ends."""
    (p0, v0, a0), (p5, v5, a5) = begin, end
    p1, p4 = p0 + v0 * size / 5.0, p5 - v5 * size / 5.0
    p2, p3 = 2.0 * p1 - p0 + a0 * size**2 / 20.0, 2.0 * p4 - p5 + a5 * size**2 / 20.0
    of_t: Array = _BEZIER.T @ np.array([p0, p1, p2, p3, p4, p5])
    return of_t / size ** _POWERS[:, None]


def _shift_origin(coefficients: Array, by: float) -> Array:
    """The same polynomial with its origin moved."""
    shift = np.array([[comb(j, k) * by ** (j - k) if j >= k else 0.0 for j in range(6)] for k in range(6)])
    moved: Array = shift @ coefficients
    return moved


class RoundedPath(PiecewisePath):
    """A path through points (n, 6) [rad] with rounded corners; n is at least 2, and neighbouring points differ.

    roundness: 0 to 1, the share of the available room that each corner takes. On straight pieces s is the joint-space
    distance [rad].
    """

    def __init__(
        self, points: Sequence[Sequence[float] | Array] | Array, roundness: float | Sequence[float] = 1.0
    ) -> None:
        corners = np.asarray(points, dtype=float)
        legs = np.diff(corners, axis=0)
        lengths = np.linalg.norm(legs, axis=1)
        directions = legs / lengths[:, None]
        share = np.broadcast_to(np.asarray(roundness, dtype=float), (max(0, len(corners) - 2),))
        around = zip(lengths[:-1].tolist(), lengths[1:].tolist(), share.tolist(), strict=True)
        cut = [_corner_length(one, other, r) for one, other, r in around]
        pieces, sizes = [], []
        before = [0.0, *cut]
        after = [*cut, 0.0]
        for i, (start, direction) in enumerate(zip(corners[:-1], directions, strict=True)):
            straight = float(lengths[i]) - before[i] - after[i]
            pieces.append(_straight(start + before[i] * direction, direction))
            sizes.append(straight)
            if i < len(cut) and cut[i] > _TOLERANCE:
                pieces.append(_corner(corners[i + 1], direction, directions[i + 1], cut[i]))
                sizes.append(2.5 * cut[i])
        super().__init__(np.array(pieces), sizes)


def rounded_corner(before: Array, corner: Array, after: Array, roundness: float) -> PiecewisePath:
    """Just the corner of a `RoundedPath` through these three points (6,) [rad]."""
    legs = (corner - before, after - corner)
    one, other = (float(np.linalg.norm(leg)) for leg in legs)
    cut = _corner_length(one, other, roundness)
    return PiecewisePath(_corner(corner, legs[0] / one, legs[1] / other, cut)[None], [2.5 * cut])


def _corner_length(before: float, after: float, roundness: float) -> float:
    """The length [rad] that a corner takes of each neighbouring segment."""
    return float(roundness * min(_MAX_CORNER_RAD, _MAX_CORNER_SHARE * before, _MAX_CORNER_SHARE * after))


def _straight(start: Array, direction: Array) -> Array:
    coefficients = np.zeros((6, len(start)))
    coefficients[0], coefficients[1] = start, direction
    return coefficients


def _corner(corner: Array, u: Array, v: Array, d: float) -> Array:
    still = np.zeros_like(u)
    return hermite((corner - d * u, u, still), (corner + d * v, v, still), 2.5 * d)
