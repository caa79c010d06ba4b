"""The arm models, and their kinematics and dynamics.

Importing this package is cheap; ``dynamics`` loads Pinocchio and must be imported explicitly where it is needed.
"""

from urproto.robots.calibrated import kinematics_of
from urproto.robots.calibration import Calibration, CalibrationError, calibration_hash
from urproto.robots.kinematics import Kinematics
from urproto.robots.model import (
    DH,
    MODELS,
    START_Q,
    Joints,
    Link,
    RobotModel,
    UnknownModelError,
    choose_version,
    default_model,
    load_model,
)

__all__ = [
    "DH",
    "MODELS",
    "START_Q",
    "Calibration",
    "CalibrationError",
    "Joints",
    "Kinematics",
    "Link",
    "RobotModel",
    "UnknownModelError",
    "calibration_hash",
    "choose_version",
    "default_model",
    "kinematics_of",
    "load_model",
]
