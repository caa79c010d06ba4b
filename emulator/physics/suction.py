"""A suction cup: an object at its lip sticks to it while the vacuum is on, unless the pull exceeds its force.

There is a weld between each cup and each body that moves, which can be activated and released at any time.
"""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

from emulator.physics.arm_bodies import PREFIX, add_fitting
from emulator.physics.welds import add_weld, weld_name

if TYPE_CHECKING:
    from emulator.physics.plan import Cup

_LENGTH_M: Final = 0.03  # of the cup and its stem
_LIP_M: Final = 0.002  # distance from the lip within which a surface is caught (guess)
_ACROSS: Final = 0.5  # friction of the lip: fraction of the force that holds sideways (guess)
_SOFT: Final = (0.01, 1.0)  # time constant [s] and damping ratio of rubber (guess)
_FRICTION: Final = 0.6  # of its sides and face


def add_suction(spec: Any, flange: Any, name: str, cup: "Cup", movable: Iterable[str]) -> None:
    """Add a stem whose end is the lip, at the cup's pose; it acts along z. ``movable``: bodies it can hold."""
    body = add_fitting(flange, name, cup.pose, cup.suction.radius, _LENGTH_M, _FRICTION)
    body.add_site(name=PREFIX + name)
    for other in movable:
        add_weld(spec, name, other, _SOFT)


class SuctionCup:
    """The cup of a compiled scene. ``holds``: the held body, 0 for none."""

    def __init__(self, name: str, cup: "Cup", model: Any) -> None:
        self.suction = cup.suction
        self._name, self._model = name, model
        self._site = model.site(PREFIX + name).id
        self._body = model.body(PREFIX + name).id
        self._welded = 0
        self.holds = 0

    def act(self, data: Any, *, sucking: bool) -> None:
        """After each step: catch an object at the lip; release it if it is pulled off or the vacuum is off."""
        if self.holds and (not sucking or self._is_torn_off(data)):
            data.eq_active[self._welded] = False
            self.holds = 0
        elif sucking and not self.holds:
            self._grasp(data)

    def release(self, data: Any) -> None:
        self.act(data, sucking=False)

    def save(self) -> list[float]:
        """The held body and its weld, for `restore`; whether the weld is active is part of the scene's state."""
        return [self.holds, self._welded, *self._weld_parameters.ravel().tolist()]

    def restore(self, values: Sequence[float]) -> None:
        """Restore a state from `save`. Raises ValueError."""
        holds, welded, *how = values
        if not (0 <= holds < self._model.nbody and 0 <= welded < max(1, self._model.neq)):
            raise ValueError(f"a cup cannot hold body {holds:g} by weld {welded:g}: they do not exist")
        self.holds, self._welded = int(holds), int(welded)
        self._weld_parameters[:] = how

    @property
    def _weld_parameters(self) -> Any:
        """Parameters of the weld; empty if there are no bodies to hold."""
        return self._model.eq_data[self._welded : self._welded + 1]

    def _is_torn_off(self, data: Any) -> bool:
        rows = np.flatnonzero(
            (data.efc_type[: data.nefc] == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
            & (data.efc_id[: data.nefc] == self._welded)
        )
        if len(rows) < 3:
            return False
        force = data.efc_force[rows[:3]]  # on the cup, in the axes of the base
        way = data.site_xmat[self._site].reshape(3, 3)[:, 2]
        pull = float(force @ way)
        across = float(np.linalg.norm(force - pull * way))
        return pull > self.suction.force or across > _ACROSS * self.suction.force

    def _grasp(self, data: Any) -> None:
        model = self._model
        lip, way = data.site_xpos[self._site], data.site_xmat[self._site].reshape(3, 3)[:, 2].copy()
        hit = np.array([-1], np.int32)
        distance = mujoco.mj_ray(model, data, lip - _LIP_M * way, way, None, True, self._body, hit)
        if not 0.0 <= distance <= 2.0 * _LIP_M:
            return
        body = int(model.body_weldid[model.geom_bodyid[hit[0]]])
        if not body:
            return
        self._welded = model.equality(weld_name(self._name, model.body(body).name)).id
        frame = data.xmat[body].reshape(3, 3)
        inverse, turned = np.zeros(4), np.zeros(4)
        mujoco.mju_negQuat(inverse, data.xquat[self._body])
        mujoco.mju_mulQuat(turned, inverse, data.xquat[body])
        values = model.eq_data[self._welded]
        values[:3] = frame.T @ (lip - data.xpos[body])
        values[3:6] = 0.0  # the lip is the cup's origin
        values[6:10] = turned
        data.eq_active[self._welded] = True
        self.holds = body
