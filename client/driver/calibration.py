"""Which arm this is: the kinematics it was calibrated with."""

import hashlib
import struct
from collections.abc import Iterable

from urproto.modes import KinematicsStatus
from urproto.primary.state import KinematicsInfo

__all__ = ["calibration_hash", "calibration_problem"]


def calibration_hash(kinematics: KinematicsInfo) -> str:
    """A name for these Denavit-Hartenberg parameters: equal parameters give equal names, on every machine."""
    blocks: Iterable[tuple[float, ...]] = (
        kinematics.dh_theta,
        kinematics.dh_a,
        kinematics.dh_d,
        kinematics.dh_alpha,
    )
    numbers = [value for block in blocks for value in block]
    return "calib_" + hashlib.sha256(struct.pack(f">{len(numbers)}d", *numbers)).hexdigest()[:16]


def calibration_problem(kinematics: KinematicsInfo, expected: str | None) -> str | None:
    """What is wrong with the calibration, and what to do; None when nothing is."""
    if kinematics.status != KinematicsStatus.OK:
        return f"its calibration status is {kinematics.status}: calibrate the robot or restore its calibration"
    found = calibration_hash(kinematics)
    if expected is not None and found != expected:
        return f"its calibration is {found}, not {expected}: this is another arm, or it was calibrated again"
    return None
