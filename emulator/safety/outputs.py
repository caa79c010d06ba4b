"""What the safety outputs tell."""

from math import remainder, tau
from typing import TYPE_CHECKING, Final

from emulator.safety.configuration import SafetyOutput
from emulator.snapshot import Vector6
from urproto.modes import SafetyMode

if TYPE_CHECKING:
    from emulator.controller import Controller

__all__ = ["output_levels"]

_MOVING_RAD_S: Final = 0.1  # user manual: output "robot moving"
_HOME_RAD: Final = 0.0297  # 1.7 degrees: e-Series manual, safe home


def output_levels(controller: "Controller", home: Vector6 | None) -> dict[SafetyOutput, bool]:
    """User manual, safety outputs: low is the safe level, and after a violation or fault all are low.

    home: the joint angles of the safe home position [rad].
    """
    safety = controller.safety
    if safety.mode in (SafetyMode.VIOLATION, SafetyMode.FAULT):
        return dict.fromkeys(SafetyOutput, False)
    reduced = safety.mode is SafetyMode.REDUCED
    return {
        SafetyOutput.SYSTEM_EMERGENCY_STOP: safety.mode is not SafetyMode.ROBOT_EMERGENCY_STOP,
        SafetyOutput.ROBOT_MOVING: max(map(abs, controller.arm.qd)) <= _MOVING_RAD_S,
        SafetyOutput.ROBOT_NOT_STOPPING: safety.stopped,
        SafetyOutput.REDUCED_MODE: not reduced,
        SafetyOutput.NOT_REDUCED_MODE: reduced,
        SafetyOutput.SAFE_HOME: home is not None and controller.power.report.powered and _is_at(controller.arm.q, home),
    }


def _is_at(q: Vector6, home: Vector6) -> bool:
    return all(abs(remainder(a - b, tau)) <= _HOME_RAD for a, b in zip(q, home, strict=True))
