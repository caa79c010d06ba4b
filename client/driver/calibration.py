"""Which arm this is: the kinematics it was calibrated with."""

from client.calibration import parameters
from urproto import robots
from urproto.modes import KinematicsStatus
from urproto.primary.state import KinematicsInfo
from urproto.robots import Calibration

__all__ = ["calibration_hash", "calibration_problem"]


def calibration_hash(kinematics: KinematicsInfo) -> str:
    """The name of these parameters, the same as in ur_description's files and in the vendor's driver."""
    return robots.calibration_hash(parameters(kinematics))


def calibration_problem(kinematics: KinematicsInfo, expected: Calibration | str | None) -> str | None:
    """What is wrong with the calibration, and what to do; None when nothing is."""
    if kinematics.status != KinematicsStatus.OK:
        return f"its calibration status is {kinematics.status}: calibrate the robot or restore its calibration"
    found = calibration_hash(kinematics)
    wanted = expected.hash if isinstance(expected, Calibration) else expected
    if wanted is not None and found != wanted:
        return (
            f"its calibration is {found}, not {wanted}: this is another arm, or it was calibrated again. If it is the "
            "right one, read its calibration with `ur-client calibration`"
        )
    return None
