"""What the links of an arm look like, roughly: one capsule each, out of the model's own numbers.

Good for pictures and for coarse collision checks. The radii are guesses.
"""

from dataclasses import dataclass
from typing import Final

from urproto.robots.model import RobotModel
from urproto.vectors import ZERO3, Vector3

_TUBE: Final = (0.025, 0.035)  # m, and per m of reach: radius of upper arm and forearm (guess)
_WRIST: Final = (0.025, 0.015)  # of the wrists (guess)
_SHORTEST_M: Final = 0.01


@dataclass(frozen=True, slots=True)
class Capsule:
    """Ends of the axis in the frame that turns with the link [m]."""

    start: Vector3
    end: Vector3
    radius: float


def tube_radius(model: RobotModel) -> float:
    """Of upper arm and forearm [m]."""
    return _TUBE[0] + _TUBE[1] * model.reach_m


def wrist_radius(model: RobotModel) -> float:
    """Of the wrists [m]."""
    return _WRIST[0] + _WRIST[1] * model.reach_m


def capsules(model: RobotModel) -> tuple[Capsule, ...]:
    """Of base, shoulder, upper arm, forearm, wrist 1, 2 and 3, in the frames of ur_description's links."""
    tube, wrist = tube_radius(model), wrist_radius(model)
    d1, _, _, d4, d5, d6 = model.dh.d
    upper, fore = model.links[1].com_m[2], model.links[2].com_m[2]  # of the tubes, from the arm's plane
    return (
        Capsule(ZERO3, (0.0, 0.0, d1 / 2), tube),
        Capsule((0.0, 0.0, -d1 / 2), ZERO3, tube),
        Capsule((0.0, 0.0, upper), (model.dh.a[1], 0.0, upper), tube),
        Capsule((0.0, 0.0, fore), (model.dh.a[2], 0.0, fore), tube),
        Capsule((0.0, 0.0, fore - d4), ZERO3, wrist),
        Capsule((0.0, 0.0, -d5), ZERO3, wrist),
        Capsule((0.0, 0.0, min(-wrist, _SHORTEST_M - d6)), (0.0, 0.0, -wrist), wrist),
    )
