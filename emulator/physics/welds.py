"""Welds between holders on the flange and the bodies they can hold: one for every pair, active while it holds."""

from collections.abc import Sequence
from typing import Any, Final

import mujoco

from emulator.physics.arm_bodies import PREFIX

_MEASURED: Final = (*[0.0] * 10, 1.0, 0.0)  # MuJoCo's: relative pose at compilation, with rotation


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
