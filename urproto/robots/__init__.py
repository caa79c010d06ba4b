"""The arms and their mathematics.

Importing this package is cheap; ``dynamics`` loads Pinocchio and is imported by name where
it is needed.
"""

from urproto.robots.kinematics import Kinematics
from urproto.robots.model import DH, MODELS, Joints, Link, RobotModel, UnknownModel, load_model

__all__ = ["DH", "MODELS", "Joints", "Kinematics", "Link", "RobotModel", "UnknownModel", "load_model"]
