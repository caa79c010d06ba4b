"""A tool changer: one half is on the flange and takes a tool directly below it by the tool's other half.

There is a weld between each changer and each tool with a coupling; locking activates one of them. The tool remains a
body of the scene: its weight and its contacts act on the flange through the weld.
"""

from collections.abc import Mapping, Sequence
from math import pi
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

from emulator.physics.arm_bodies import PREFIX, add_fitting, quaternion
from emulator.physics.welds import add_weld, weld_name

if TYPE_CHECKING:
    from emulator.physics.plan import Plate

_RADIUS_M, _HEIGHT_M = 0.03, 0.02  # of the half on the flange
_NEAR_M: Final = 0.002  # largest distance and angle between the halves at which they can lock (guesses)
_NEAR_RAD: Final = 2.0 * pi / 180.0
_TAKEN_M: Final = 0.02  # no force separates them: a tool that is farther away was placed elsewhere
_STIFF: Final = (0.005, 1.0)  # time constant [s] and damping ratio: those of contacts
_FRICTION: Final = 0.3  # of its sides and face


def add_changer(spec: Any, flange: Any, name: str, plate: "Plate", tools: Mapping[str, Sequence[float]]) -> None:
    """Add the half on the flange, with its face at the changer's pose. tools: coupling poses in the tools' frames."""
    add_fitting(flange, name, plate.pose, _RADIUS_M, _HEIGHT_M, _FRICTION)
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
