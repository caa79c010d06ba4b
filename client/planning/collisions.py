"""Collision checking with Pinocchio and coal.

A motion between two configurations is verified over its whole length, not at samples: at each configuration checked,
the distance of a pair of bodies says how far the arm can move on before that pair must be checked again. An obstacle is
never missed, however thin it is, and a distant one needs only one check.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import dist
from typing import Any, Final

import numpy as np

from client.errors import PlanningError
from client.planning.collision_model import CollisionModel
from client.planning.parameterisation import Array, Trajectory
from client.planning.scene import PlanningScene
from client.quantities import checked
from urproto.joints import JOINT_LABELS
from urproto.vectors import ZERO3, Vector3

_RESOLUTION_M: Final = 0.001
_MIN_STEP_M: Final = 1e-9
_NEAR_M: Final = 0.03  # nearer than this beyond the padding, a link is checked by its cylinders (guess)
_SPEED_SHARES: Final = (1.0, 0.5, 0.25, 0.1)  # of a speed that are tried; guess


@dataclass(frozen=True, slots=True)
class PairDistance:
    """Two links or objects and the distance between them [m]; if negative, the penetration depth.

    point: the midpoint between their nearest points [m], in the base frame. normal: from ``one`` towards ``other``.
    """

    one: str
    other: str
    distance_m: float
    point: Vector3 = ZERO3
    normal: Vector3 = ZERO3

    def __str__(self) -> str:
        if self.distance_m < 0.0:
            return f"{self.one} is {-1000 * self.distance_m:.1f} mm deep in {self.other}"
        return f"{self.one} is {1000 * self.distance_m:.1f} mm from {self.other}"


@partial(checked, error=PlanningError)
class CollisionChecker:
    """Checks configurations and motions against a scene, each time as the scene is at the call."""

    def __init__(self, scene: PlanningScene) -> None:
        self.scene = scene
        self._low, self._high = (np.array(limits) for limits in scene.model.position_limits)
        self._revision = scene.revision
        self._model = CollisionModel(scene)

    def is_free(self, q_rad: Sequence[float] | Array) -> bool:
        """Whether a configuration is within the joint limits and nothing is nearer than the padding."""
        model = self._current_model()
        q = np.asarray(q_rad, dtype=float)
        if (q < self._low).any() or (q > self._high).any():
            return False
        near = model.coarse.colliding_pairs(q)
        if near:
            model.fine.move(q)
        return not any(model.fine.in_collision(pair) for pair in model.fine_pairs(near))

    def clearance(self, q_rad: Sequence[float] | Array) -> float:
        """The smallest distance [m] of all pairs that may not touch; infinite if there are none."""
        results = self._current_model().fine.distances(np.asarray(q_rad, dtype=float))
        return min((float(result.min_distance) for result in results), default=float("inf"))

    def distances(self, q_rad: Sequence[float]) -> list[PairDistance]:
        """The distances of all pairs that may not touch, nearest first."""
        fine = self._current_model().fine
        found: dict[tuple[str, str], Any] = {}
        for names, result in zip(fine.names, fine.distances(np.asarray(q_rad, dtype=float)), strict=True):
            if names not in found or result.min_distance < found[names].min_distance:
                found[names] = result
        pairs = [_pair_distance(names, result) for names, result in found.items()]
        return sorted(pairs, key=lambda pair: pair.distance_m)

    def collisions(self, q_rad: Sequence[float]) -> list[PairDistance]:
        """The pairs that are nearer than the padding, deepest first."""
        return [pair for pair in self.distances(q_rad) if pair.distance_m < self.scene.padding_m]

    def violation(self, q_rad: Sequence[float]) -> str:
        """Why a configuration is not valid: the joint limit or the pairs in collision; "" if it is valid."""
        q = np.asarray(q_rad, dtype=float)
        for name, low, angle, high in zip(JOINT_LABELS, self._low, q, self._high, strict=True):
            if not low <= angle <= high:
                return f"{name} is at {angle:.4f} rad, outside its limits of {low:.4f} to {high:.4f} rad"
        pairs = self.collisions(q_rad)
        required = f"; the required clearance is {1000 * self.scene.padding_m:g} mm"
        return "; ".join(map(str, pairs[:3])) + required if pairs else ""

    def path_is_free(self, start_rad: Sequence[float] | Array, end_rad: Sequence[float] | Array) -> bool:
        """Whether the straight joint-space path from one configuration to another is free."""
        start, end = np.asarray(start_rad, dtype=float), np.asarray(end_rad, dtype=float)
        delta = end - start
        return self.is_free(end) and self.blocked_at(lambda share: start + share * delta, abs(delta)) is None

    def blocked_at(self, path: Callable[[float], Array], travel_rad: Array) -> float | None:
        """Where a path is in collision or nearer than the padding, as a share of it from 0 to 1; None if it is free.

        It is one such place, not necessarily the first. travel_rad: upper bound of each joint's travel (6,), its
        highest speed kept up for the whole path.
        """
        model, padding = self._current_model(), self.scene.padding_m
        lengths = [np.maximum(layer.levers @ travel_rad, _MIN_STEP_M).tolist() for layer in (model.coarse, model.fine)]
        coarse_m, fine_m = lengths  # upper bounds of how far the bodies of each pair move towards each other
        finest = _RESOLUTION_M / max(coarse_m, default=_RESOLUTION_M)
        parts = [(0.0, 1.0, list(range(len(coarse_m))), list[int]())]
        while parts:
            low, high, far, near = parts.pop()
            middle, half = 0.5 * (low + high), 0.5 * (high - low)
            q = path(middle)
            known, still_far, still_near = (
                half,
                list[int](),
                list[int](),
            )  # known: how far the path is free to both sides
            if far:
                model.coarse.move(q)
            for pair in far:
                free = model.coarse.distance(pair) - padding
                if free >= coarse_m[pair] * half:
                    continue
                if free > _NEAR_M:
                    known = min(known, free / coarse_m[pair])
                    still_far.append(pair)
                else:
                    near = near + model.parts[pair]
            if near:
                model.fine.move(q)
            for pair in near:
                free = model.fine.distance(pair) - padding
                if free < 0.0:
                    return middle
                if (share := max(free / fine_m[pair], finest)) < half:
                    known = min(known, share)
                    still_near.append(pair)
            if still_far or still_near:
                parts += ((middle + known, high, still_far, still_near), (low, middle - known, still_far, still_near))
        return None

    def _current_model(self) -> CollisionModel:
        """The collision model of the scene as it is now."""
        if self._revision != self.scene.revision:
            self._model = CollisionModel(self.scene)
            self._revision = self.scene.revision
        return self._model


def _pair_distance(names: tuple[str, str], result: Any) -> PairDistance:
    x, y, z = 0.5 * (result.getNearestPoint1() + result.getNearestPoint2())
    u, v, w = result.normal
    return PairDistance(
        *names, float(result.min_distance), (float(x), float(y), float(z)), (float(u), float(v), float(w))
    )


def blocking_reason(checker: CollisionChecker, trajectory: Trajectory, q_rad: Sequence[float]) -> str:
    """What blocks the rest of a trajectory; "" if nothing does.

    q_rad: the arm's configuration (6,). The check covers the motion from there to the nearest point of the trajectory,
    and from that point to the end.
    """
    configurations = trajectory.q.tolist()
    before = list(q_rad)
    nearest = min(range(len(configurations)), key=lambda i: dist(configurations[i], before))
    for q in configurations[nearest:]:
        if not checker.path_is_free(before, q):
            near = checker.collisions(q)
            return f"the scene has changed, and the path is blocked{f': {near[0]}' if near else ''}"
        before = q
    return ""


def free_share(checker: CollisionChecker, q_rad: Sequence[float], qd_rad_s: Sequence[float], ahead_s: float) -> float:
    """The share of the joint speeds (6,) at which an arm meets nothing for the next ``ahead_s``, from 0 to 1.

    An arm that is in collision already may move slowly if that takes it out.
    """
    q = np.asarray(q_rad, dtype=float)
    way = ahead_s * np.asarray(qd_rad_s, dtype=float)
    for share in _SPEED_SHARES:
        if checker.path_is_free(q, q + share * way):
            return share
    leaves = not checker.is_free(q) and checker.clearance(q + _SPEED_SHARES[-1] * way) > checker.clearance(q)
    return _SPEED_SHARES[-1] if leaves else 0.0
