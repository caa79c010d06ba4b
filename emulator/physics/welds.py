"""Welds between what is on the flange and what it can hold: made for every pair, switched on while it holds one."""

from collections.abc import Sequence
from typing import Any, Final

import mujoco

from emulator.physics.arm_bodies import PREFIX

_MEASURED: Final = (*[0.0] * 10, 1.0, 0.0)  # MuJoCo's: as things stand when it is made, with turning


def add_weld(spec: Any, holder: str, body: str, solref: Sequence[float], data: Sequence[float] = _MEASURED) -> None:
    """holder: the name of what is mounted; body: of what it may hold. data: MuJoCo's numbers of a weld."""
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
    """Of the weld between them."""
    return f"{PREFIX}{holder}:{body}"
