"""A motion that excites everything `identify` needs: every joint, in both directions, fast and slow, within bounds.

Each joint follows its own sum of sines around the current configuration, faded in from rest and out again. Random
phases are drawn until no link comes below the floor or near another link; if that fails, smaller motions are tried.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np

from client.errors import OutOfReachError
from client.identification.samples import Array
from client.recording.motion import JointPath
from urproto.robots import RobotModel
from urproto.robots.shapes import ArmCapsules

_KNOT_S: Final = 0.05
_RAMP_S: Final = 2.0
_BASE_HZ: Final = 0.08
_HARMONICS: Final = 8
_ATTEMPTS: Final = 20  # sets of phases for each size
_SIZES: Final = (1.0, 0.8, 0.6, 0.45)
_MARGIN_M: Final = 0.05  # between links
_AXIS_SHARES: Final = np.linspace(0.0, 1.0, 5)  # points along a link at which distances are checked
_CHECKED_PAIRS: Final = (*product((0, 1), (3, 4, 5)), (0, 2))  # pairs that can collide, base to wrist 3
_DOING: Final = "the excitation"


@dataclass(frozen=True, slots=True)
class ExcitationBounds:
    """Bounds of the motion: angle of every joint from its start [rad], its speed [rad/s] and acceleration [rad/s2],
    and the lowest height of any link [m, base frame].
    """

    angle_rad: float = 0.5
    speed_rad_s: float = 1.0
    acceleration_rad_s2: float = 3.0
    floor_m: float = 0.05


def excitation(
    model: RobotModel,
    start_rad: Sequence[float],
    duration_s: float,
    bounds: ExcitationBounds | None = None,
    seed: int = 0,
) -> JointPath:
    """A motion that starts and ends at rest at start_rad. Raises OutOfReachError if none stays within the bounds."""
    bounds = bounds or ExcitationBounds()
    start = np.asarray(start_rad, float)
    chance = np.random.default_rng(seed)
    time_s = np.linspace(0.0, duration_s, max(3, round(duration_s / _KNOT_S) + 1))
    links = ArmCapsules(model)
    for size in _SIZES:
        for _ in range(_ATTEMPTS):
            offset, speed = _scaled(time_s, _waves(time_s, chance), model, bounds, size)
            if _is_clear(links, start + offset, bounds.floor_m):
                return JointPath(time_s, start + offset, speed)
    raise OutOfReachError(
        _DOING,
        f"no motion of at least {_SIZES[-1] * bounds.angle_rad:.2f} rad from here keeps the arm above "
        f"{bounds.floor_m:g} m and clear of itself: start elsewhere, or allow a smaller angle or a lower floor",
    )


def _waves(time_s: Array, chance: np.random.Generator) -> Array:
    """A random motion of each joint (n, 6) that starts and ends at rest, not yet scaled."""
    harmonics = np.arange(1, _HARMONICS + 1)
    phases, sizes = chance.uniform(0.0, 2.0 * np.pi, (2, _HARMONICS, 6))
    turning = 2.0 * np.pi * _BASE_HZ * time_s[:, None, None] * harmonics[None, :, None] + phases
    weights = (0.3 + sizes / (2.0 * np.pi)) / np.sqrt(harmonics)[:, None]
    u = np.clip(np.minimum(time_s, time_s[-1] - time_s) / min(_RAMP_S, time_s[-1] / 3.0), 0.0, 1.0)
    envelope = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    return np.asarray(envelope[:, None] * (np.sin(turning) * weights).sum(axis=1))


def _scaled(
    time_s: Array, waves: Array, model: RobotModel, bounds: ExcitationBounds, size: float
) -> tuple[Array, Array]:
    """Scale each joint's motion to the bounds: angles and speeds (n, 6)."""
    speed = np.gradient(waves, time_s, axis=0)
    speed[[0, -1]] = 0.0
    rate = np.gradient(speed, time_s, axis=0)
    max_speed = np.minimum(bounds.speed_rad_s, 0.9 * np.array(model.qd_max))
    allowed = (
        (waves, bounds.angle_rad * size),
        (speed, max_speed),
        (1.2 * rate, bounds.acceleration_rad_s2),  # the cubics between the knots may peak higher than the knots
    )
    scale = np.min([limit / np.abs(values).max(axis=0) for values, limit in allowed], axis=0)
    return scale * waves, scale * speed


def _is_clear(links: ArmCapsules, path: Array, floor_m: float) -> bool:
    """Whether the arm stays above the floor and clear of itself along the path."""
    radii = np.array(links.radii)
    for q in path[::2].tolist():
        ends = np.array(links.axes(q))
        if (ends[1:, 1, 2] - radii[1:]).min() < floor_m:
            return False
        points = ends[:, None, 0] + _AXIS_SHARES[None, :, None] * (ends[:, None, 1] - ends[:, None, 0])
        for a, b in _CHECKED_PAIRS:
            separation_s = np.linalg.norm(points[a][:, None] - points[b][None], axis=-1).min()
            if separation_s < radii[a] + radii[b] + _MARGIN_M:
                return False
    return True
