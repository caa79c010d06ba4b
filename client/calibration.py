"""Calibration files in the format of ur_description, and the geometry that a robot reports.

calibration = read_calibration(Path("my_robot_calibration.yaml"))
with Robot("192.168.1.10", calibration=calibration) as robot:     # refuses another arm
    robot.tcp_pose_at([0.2, -1.4, 1.5, -1.7, -1.5, 0.1])
"""

from dataclasses import replace
from pathlib import Path
from typing import Final

import yaml

from client.errors import FileError, PlanningError
from urproto.durable import write_file
from urproto.modes import KinematicsStatus
from urproto.primary.subpackages import ConfigurationData, KinematicsInfo
from urproto.robots import DH, MODELS, Calibration, CalibrationError, Kinematics, RobotModel, load_model
from urproto.robots.calibrated import CalibratedKinematics
from urproto.structures import InvalidYamlError, load_yaml

_LENGTH_TOLERANCE_M: Final = 0.01  # configuration data and data files have the same lengths, except for old hardware


def read_calibration(path: Path) -> Calibration:
    """Read ur_description's ``my_robot_calibration.yaml``, or a file with lists of Denavit-Hartenberg parameters.

    Raises FileError if the file cannot be read or is not a calibration.
    """
    try:
        with FileError.accessing(path):
            return Calibration.from_mapping(load_yaml(path.read_bytes()), str(path))
    except InvalidYamlError as error:
        raise FileError(path, f"it is not YAML: {error}") from error
    except CalibrationError as error:
        raise FileError(path, str(error).removeprefix(f"{path}: ")) from error


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration file in the format of ur_calibration. Raises FileError if it cannot be written."""
    with FileError.accessing(path):
        write_file(path, yaml.safe_dump(calibration.to_mapping(), sort_keys=False))


def parameters(kinematics: KinematicsInfo) -> DH:
    """The Denavit-Hartenberg parameters that a robot reports."""
    return DH(a=kinematics.dh_a, d=kinematics.dh_d, alpha=kinematics.dh_alpha, theta=kinematics.dh_theta)


def calibration_of(kinematics: KinematicsInfo) -> Calibration:
    """Return the calibration that a robot reports. Raises CalibrationError if the robot is not calibrated."""
    if kinematics.status == KinematicsStatus.NOT_LINEARISED:
        raise CalibrationError(
            f"the robot's calibration status is {kinematics.status}: calibrate it or restore its calibration"
        )
    return Calibration.of(parameters(kinematics))


def is_nominal(calibration: Calibration, arm: ConfigurationData) -> bool:
    """True if the calibration does not deviate from the nominal geometry, as on a simulated arm."""
    return calibration.dh == _nominal(arm)


def geometry_of(arm: ConfigurationData, kinematics: KinematicsInfo | None) -> Kinematics | None:
    """Kinematics of the arm as it describes itself, including its calibration; None for an unknown geometry."""
    try:
        nominal = _nominal(arm)
        if kinematics is None or parameters(kinematics) == nominal:
            return Kinematics(nominal)
        return CalibratedKinematics(nominal, parameters(kinematics))
    except ValueError:  # CalibrationError is one
        return None


def model_of(arm: ConfigurationData) -> RobotModel | None:
    """The model with these type numbers and lengths; None if it is unknown."""

    def difference(model: RobotModel) -> float:
        lengths = zip((*model.dh.a, *model.dh.d), (*arm.dh_a, *arm.dh_d), strict=True)
        return max(abs(own - its) for own, its in lengths)

    models = map(load_model, MODELS)
    same_type = [model for model in models if (model.robot_type, model.sub_type) == (arm.robot_type, arm.sub_type)]
    best = min(same_type, key=difference, default=None)
    return best if best is not None and difference(best) < _LENGTH_TOLERANCE_M else None


def calibrated_model(arm: ConfigurationData, calibration: Calibration) -> RobotModel | None:
    """The model, with the arm's calibration if it deviates from the nominal one; None if the model is unknown."""
    model = model_of(arm)
    if model is None or calibration.dh == model.dh:
        return model
    return replace(model, calibration=calibration.dh)


def require_model(arm: ConfigurationData | None, kinematics: KinematicsInfo) -> RobotModel:
    """Like `calibrated_model`, for callers that need the arm's shape. Raises PlanningError if the model is unknown."""
    model = calibrated_model(arm, calibration_of(kinematics)) if arm else None
    if model is None:
        raise PlanningError("this arm is not a known model, so its shape is unknown")
    return model


def _nominal(arm: ConfigurationData) -> DH:
    return DH(arm.dh_a, arm.dh_d, arm.dh_alpha, arm.dh_theta)
