"""A motion that shows everything `identify` looks for: every joint, both ways, fast and slow, within given bounds.

Each joint follows a sum of sines of its own around where the arm is, which swells from rest and dies away. Phases are
drawn until no link comes below the floor or near the arm itself, and smaller motions are tried where none does.
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
_TRIES: Final = 20  # phases for each size
_SIZES: Final = (1.0, 0.8, 0.6, 0.45)
_MARGIN_M: Final = 0.05  # between links
_ALONG: Final = np.linspace(0.0, 1.0, 5)  # of a link, where distances are looked at
_LINKS: Final = (*product((0, 1), (3, 4, 5)), (0, 2))  # pairs that can meet, base to wrist 3
_DOING: Final = "the excitation"


@dataclass(frozen=True, slots=True)
class Bounds:
    """What the motion keeps to: angles from where it starts [rad], speeds and accelerations of every joint [rad/s,
    rad/s2], and the height [m, base frame] that no link comes below.
    """

    angle_rad: float = 0.5
    speed_rad_s: float = 1.0
    acceleration_rad_s2: float = 3.0
    floor_m: float = 0.05


def excitation(
    model: RobotModel, start_rad: Sequence[float], duration_s: float, bounds: Bounds | None = None, seed: int = 0
) -> JointPath:
    """From rest to rest, where it began. Raises OutOfReachError when no motion keeps to the bounds."""
    bounds = bounds or Bounds()
    start = np.asarray(start_rad, float)
    chance = np.random.default_rng(seed)
    time_s = np.linspace(0.0, duration_s, max(3, round(duration_s / _KNOT_S) + 1))
    links = ArmCapsules(model)
    for size in _SIZES:
        for _ in range(_TRIES):
            way, speed = _scaled(time_s, _waves(time_s, chance), model, bounds, size)
            if _clear(links, start + way, bounds.floor_m):
                return JointPath(time_s, start + way, speed)
    raise OutOfReachError(
        _DOING,
        f"no motion of at least {_SIZES[-1] * bounds.angle_rad:.2f} rad from here keeps the arm above "
        f"{bounds.floor_m:g} m and off itself: start elsewhere, or allow a smaller angle or a lower floor",
    )


def _waves(time_s: Array, chance: np.random.Generator) -> Array:
    """Of each joint (n, 6), from rest to rest, of no particular size."""
    harmonics = np.arange(1, _HARMONICS + 1)
    phases, sizes = chance.uniform(0.0, 2.0 * np.pi, (2, _HARMONICS, 6))
    turning = 2.0 * np.pi * _BASE_HZ * time_s[:, None, None] * harmonics[None, :, None] + phases
    weights = (0.3 + sizes / (2.0 * np.pi)) / np.sqrt(harmonics)[:, None]
    u = np.clip(np.minimum(time_s, time_s[-1] - time_s) / min(_RAMP_S, time_s[-1] / 3.0), 0.0, 1.0)
    swell = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    return np.asarray(swell[:, None] * (np.sin(turning) * weights).sum(axis=1))


def _scaled(time_s: Array, waves: Array, model: RobotModel, bounds: Bounds, size: float) -> tuple[Array, Array]:
    """As large as the bounds let each joint be: angles and speeds (n, 6)."""
    speed = np.gradient(waves, time_s, axis=0)
    speed[[0, -1]] = 0.0
    rate = np.gradient(speed, time_s, axis=0)
    fastest = np.minimum(bounds.speed_rad_s, 0.9 * np.array(model.qd_max))
    allowed = (
        (waves, bounds.angle_rad * size),
        (speed, fastest),
        (1.2 * rate, bounds.acceleration_rad_s2),  # the knots are joined by cubics, whose peaks lie between them
    )
    scale = np.min([most / np.abs(values).max(axis=0) for values, most in allowed], axis=0)
    return scale * waves, scale * speed


def _clear(links: ArmCapsules, way: Array, floor_m: float) -> bool:
    """Whether the arm keeps above the floor and off itself all along."""
    radii = np.array(links.radii)
    for q in way[::2].tolist():
        ends = np.array(links.axes(q))
        if (ends[1:, 1, 2] - radii[1:]).min() < floor_m:
            return False
        points = ends[:, None, 0] + _ALONG[None, :, None] * (ends[:, None, 1] - ends[:, None, 0])
        for a, b in _LINKS:
            apart = np.linalg.norm(points[a][:, None] - points[b][None], axis=-1).min()
            if apart < radii[a] + radii[b] + _MARGIN_M:
                return False
    return True
