"""Suction cups and tool changers: what holds a body of the scene by a weld that is active while it does.

There is a weld between each holder and each body that it can hold. An object at the lip of a cup sticks to it while the
vacuum is on, unless the pull exceeds its force. One half of a tool changer is on the flange and takes a tool directly
below it by the tool's other half; locking activates a weld. The tool remains a body of the scene: its weight and its
contacts act on the flange through the weld.
"""

from collections.abc import Iterable, Mapping, Sequence
from math import pi
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

from emulator.physics.arm_bodies import PREFIX, add_fitting, quaternion

if TYPE_CHECKING:
    from emulator.physics.plan import Cup, Plate

_MEASURED: Final = (*[0.0] * 10, 1.0, 0.0)  # MuJoCo's: relative pose at compilation, with rotation
_CUP_M, _CUP_FRICTION = 0.03, 0.6  # length of the cup and its stem, friction of its sides and face
_LIP_M: Final = 0.002  # distance from the lip within which a surface is caught (guess)
_ACROSS: Final = 0.5  # friction of the lip: fraction of the force that holds sideways (guess)
_SOFT: Final = (0.01, 1.0)  # time constant [s] and damping ratio of rubber (guess)
_PLATE_RADIUS_M, _PLATE_M, _PLATE_FRICTION = 0.03, 0.02, 0.3  # of the half on the flange
_NEAR_M: Final = 0.002  # largest distance and angle between the halves at which they can lock (guesses)
_NEAR_RAD: Final = 2.0 * pi / 180.0
_TAKEN_M: Final = 0.02  # no force separates them: a tool that is farther away was placed elsewhere
_STIFF: Final = (0.005, 1.0)  # time constant [s] and damping ratio: those of contacts


def add_weld(spec: Any, holder: str, body: str, solref: Sequence[float], data: Sequence[float] = _MEASURED) -> None:
    """Add a weld. holder: name of the mounted part; body: name of the body it can hold. data: MuJoCo's parameters."""
    spec.add_equality(
        name=weld_name(holder, body),
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1=PREFIX + holder,
        name2=body,
        active=False,
        data=list(data),
        solref=list(solref),
    )


def weld_name(holder: str, body: str) -> str:
    return f"{PREFIX}{holder}:{body}"


def add_suction(spec: Any, flange: Any, name: str, cup: "Cup", movable: Iterable[str]) -> None:
    """Add a stem whose end is the lip, at the cup's pose; it acts along z. ``movable``: bodies it can hold."""
    body = add_fitting(flange, name, cup.pose, cup.suction.radius, _CUP_M, _CUP_FRICTION)
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


def add_changer(spec: Any, flange: Any, name: str, plate: "Plate", tools: Mapping[str, Sequence[float]]) -> None:
    """Add the half on the flange, with its face at the changer's pose. tools: coupling poses in the tools' frames."""
    add_fitting(flange, name, plate.pose, _PLATE_RADIUS_M, _PLATE_M, _PLATE_FRICTION)
    for tool, coupling in tools.items():
        place = (*coupling, 0.0, 0.0, 0.0)[:6]
        w, *axis = quaternion(place[3:])
        turned_back = [w, *(-part for part in axis)]
        # a point of the tool, where it is on the changer, how the tool is turned there, and that this counts too
        add_weld(spec, name, tool, _STIFF, [*place[:3], 0.0, 0.0, 0.0, *turned_back, 1.0, 0.0])


class ToolChanger:
    """The changer of a compiled scene."""

    def __init__(self, name: str, plate: "Plate", tools: Mapping[str, Sequence[float]], model: Any) -> None:
        self.changer = plate.changer
        self._model = model
        self._body = model.body(PREFIX + name).id
        self._tools = {model.body(tool).id: model.equality(weld_name(name, tool)).id for tool in tools}
        self._locking = False

    def holds(self, data: Any) -> int:
        """Body of the tool that is locked, 0 for none."""
        return next((body for body, weld in self._tools.items() if data.eq_active[weld]), 0)

    def act(self, data: Any, *, locking: bool) -> None:
        """Advance one period. A tool is taken at the moment of locking only."""
        held = self.holds(data)
        if held and (not locking or self._distance(data, held)[0] > _TAKEN_M):
            self.release(data)
        elif locking and not self._locking:
            for body, weld in self._tools.items():
                away_m, away_rad = self._distance(data, body)
                if away_m < _NEAR_M and away_rad < _NEAR_RAD:
                    data.eq_active[weld] = True
                    break
        self._locking = locking

    def release(self, data: Any) -> None:
        for weld in self._tools.values():
            data.eq_active[weld] = False

    def save(self) -> list[float]:
        """State in addition to the scene's own, for `restore`."""
        return [float(self._locking)]

    def restore(self, values: Sequence[float]) -> None:
        self._locking = bool(values[0])

    def _distance(self, data: Any, tool: int) -> tuple[float, float]:
        """Distance of a tool from its locked pose [m, rad]."""
        weld = self._model.eq_data[self._tools[tool]]
        point = data.xpos[tool] + data.xmat[tool].reshape(3, 3) @ weld[:3]
        wanted, back, between = np.zeros(4), np.zeros(4), np.zeros(4)
        mujoco.mju_mulQuat(wanted, data.xquat[self._body], weld[6:10])
        mujoco.mju_negQuat(back, wanted)
        mujoco.mju_mulQuat(between, back, data.xquat[tool])
        turned = 2.0 * np.arccos(min(1.0, abs(float(between[0]))))
        return float(np.linalg.norm(point - data.xpos[self._body])), float(turned)
