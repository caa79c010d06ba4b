"""Injected disturbances of a scene, requested by ``inject_fault``."""

from collections.abc import Collection
from typing import Any, Final

import mujoco
import numpy as np

from emulator.physics.wiring import Wires

_NOWHERE: Final = (0.0, 0.0, -10.0, 1.0, 0.0, 0.0, 0.0)  # position [m] and quaternion of a removed part


class SceneDisturbances:
    """`emulator.world.world` for one scene. covered: names of covered cameras, shared with the scene's world."""

    def __init__(
        self, model: Any, data: Any, names: Collection[str], wires: Wires, cameras: Collection[str], covered: set[str]
    ) -> None:
        self._model, self._data, self._wires, self._covered = model, data, wires, covered
        self.cameras = cameras
        self._free = {
            name: body
            for name in names
            for body in (model.body(name).id,)
            if model.body_jntnum[body] == 1 and model.jnt_type[model.body_jntadr[body]] == mujoco.mjtJoint.mjJNT_FREE
        }
        self._missing: dict[str, tuple[Any, Any]] = {}  # pose to return to, and contact bits
        self._frictions: dict[str, Any] = {}

    @property
    def parts(self) -> Collection[str]:
        return self._free.keys()

    @property
    def conveyors(self) -> Collection[str]:
        return self._wires.belts.keys()

    def take_away(self, part: str) -> None:
        model, body, geoms = self._model, self._free[part], self._geoms(part)
        place, speed = self._state_of(part)
        if part not in self._missing:
            self._missing[part] = self._first_place(part), (model.geom_contype[geoms], model.geom_conaffinity[geoms])
            model.geom_contype[geoms] = model.geom_conaffinity[geoms] = 0
        elif not _is_removed(place):
            self._missing[part] = place.copy(), self._missing[part][1]
        for cup in self._wires.cups.values():
            if cup.holds == body:
                cup.release(self._data)
        for changer in self._wires.changers:
            if changer.holds(self._data) == body:
                changer.release(self._data)
        place[:], speed[:] = _NOWHERE, 0.0

    def bring_back(self, part: str) -> None:
        model, geoms = self._model, self._geoms(part)
        place, speed = self._state_of(part)
        there, touching = self._missing.pop(part)
        model.geom_contype[geoms], model.geom_conaffinity[geoms] = touching
        if _is_removed(place):  # otherwise, it was placed elsewhere in this period
            place[:], speed[:] = there, 0.0

    def set_friction(self, part: str, friction: float | None) -> None:
        sliding = self._model.geom_friction[:, 0]
        geoms = self._geoms(part)
        own = self._frictions.setdefault(part, sliding[geoms])
        sliding[geoms] = own if friction is None else friction

    def jam(self, conveyor: str, *, jammed: bool) -> None:
        self._wires.belts[conveyor].jammed = jammed

    def cover(self, camera: str, *, covered: bool) -> None:
        (self._covered.add if covered else self._covered.discard)(camera)

    def _geoms(self, part: str) -> Any:
        model = self._model
        return np.flatnonzero(model.body_rootid[model.geom_bodyid] == self._free[part])

    def _first_place(self, part: str) -> Any:
        joint = int(self._model.jnt_qposadr[self._model.body_jntadr[self._free[part]]])
        return self._model.qpos0[joint : joint + 7].copy()

    def _state_of(self, part: str) -> tuple[Any, Any]:
        """Views of position with quaternion, and speed, for writing."""
        model, data = self._model, self._data
        joint = int(model.body_jntadr[self._free[part]])
        place, speed = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        return data.qpos[place : place + 7], data.qvel[speed : speed + 6]


def _is_removed(place: Any) -> bool:
    """Whether a part is removed, even after it has fallen for a period."""
    return bool(place[2] < 0.5 * _NOWHERE[2])
