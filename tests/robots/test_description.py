"""URDF, read by Pinocchio's parser and by check_urdf, must agree with our model of the arm."""

import math
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import yaml

from urproto.joints import JOINT_NAMES
from urproto.robots import MODELS, Calibration, RobotModel, kinematics_of, load_model
from urproto.robots.description import MissingMeshesError, joint_frames, urdf
from urproto.robots.dynamics import Dynamics
from urproto.robots.pose import pose_trans, rotvec_to_matrix

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
Q = (0.3, -1.2, 1.4, -0.7, 2.0, -2.5)
QD = (0.5, -0.4, 0.3, 1.0, -0.8, 0.9)
QDD = (1.0, 0.2, -0.5, 2.0, 0.7, -1.0)
CHECK_URDF = shutil.which("check_urdf", path=str(Path(sys.executable).parent)) or shutil.which("check_urdf")
MESHES = ("base", "shoulder", "upperarm", "forearm", "wrist1", "wrist2", "wrist3")


def arm(name: str) -> RobotModel:
    """A nominal one, or "calibrated ur5e"."""
    model = load_model(name.split()[-1])
    if " " not in name:
        return model
    content = yaml.safe_load((GOLDEN / f"calibration_{model.name}.yaml").read_text())
    return replace(model, calibration=Calibration.from_mapping(content, "file").dh)


@pytest.fixture(params=[*MODELS, "calibrated ur5", "calibrated ur5e"])
def model(request: pytest.FixtureRequest) -> RobotModel:
    return arm(request.param)


def configuration(built: pin.Model) -> np.ndarray:
    """Q in Pinocchio's format: an unlimited joint is a point on the circle."""
    parts: list[float] = []
    for joint, angle in zip(built.joints[1:], Q, strict=True):
        parts += [angle] if joint.nq == 1 else [math.cos(angle), math.sin(angle)]
    return np.array(parts)


def test_forward_kinematics_and_dynamics(model: RobotModel) -> None:
    built = pin.buildModelFromXML(urdf(model))
    assert list(built.names)[1:] == list(JOINT_NAMES)
    data, q = built.createData(), configuration(built)
    built.gravity.linear = np.array((0.0, 0.0, -9.82))
    torques = pin.rnea(built, data, q, np.array(QD), np.array(QDD))
    assert torques == pytest.approx(Dynamics(model).inverse_dynamics(Q, QD, QDD), abs=1e-9)
    pin.framesForwardKinematics(built, data, q)
    place = data.oMf[built.getFrameId("base")].inverse() * data.oMf[built.getFrameId("tool0")]
    x, y, z, *turn = kinematics_of(model).forward(Q)
    # nominal data files have pi/2 with nine decimals, which the closed form treats as exact
    np.testing.assert_allclose(place.translation, (x, y, z), rtol=0, atol=1e-9)
    np.testing.assert_allclose(place.rotation, np.array(rotvec_to_matrix(*turn)).reshape(3, 3), rtol=0, atol=2e-9)


def test_frames_match_ur_description() -> None:
    built = pin.buildModelFromXML(urdf(load_model("ur3e")))
    data = built.createData()
    pin.framesForwardKinematics(built, data, pin.neutral(built))

    def place(frame: str) -> pin.SE3:
        assert built.existFrame(frame), frame
        return data.oMf[built.getFrameId(frame)]

    half_turn = place("base_link").inverse() * place("base")
    np.testing.assert_allclose(half_turn.rotation, np.diag((-1.0, -1.0, 1.0)), atol=1e-12)
    np.testing.assert_allclose((place("wrist_3_link").inverse() * place("tool0")).homogeneous, np.eye(4), atol=1e-12)
    x_of_flange = (place("tool0").inverse() * place("flange")).rotation[:, 0]
    np.testing.assert_allclose(x_of_flange, (0.0, 0.0, 1.0), atol=1e-12)  # points away from the arm
    assert built.existFrame("ft_frame")


def test_limits(model: RobotModel) -> None:
    built = pin.buildModelFromXML(urdf(model))
    assert tuple(built.velocityLimit) == pytest.approx(model.qd_max)
    assert tuple(built.effortLimit) == pytest.approx(model.torque_max)
    assert tuple(built.lowerPositionLimit)[:5] == pytest.approx(model.q_min[:5])
    kind = ElementTree.fromstring(urdf(model)).find("joint[@name='wrist_3_joint']").get("type")  # type: ignore[union-attr]
    assert kind == ("continuous" if model.wrist3_unlimited else "revolute")


def test_frames_match_the_description(model: RobotModel) -> None:
    built = pin.buildModelFromXML(urdf(model, prefix="left_"))
    data = built.createData()
    pin.framesForwardKinematics(built, data, configuration(built))
    angles = dict(zip((f"left_{joint}" for joint in JOINT_NAMES), Q, strict=True))
    for joint, parent, child, pose, moves in joint_frames(model, "left_"):
        turned = pose_trans(pose, (0.0, 0.0, 0.0, 0.0, 0.0, angles[joint] if moves else 0.0))
        place = data.oMf[built.getFrameId(parent)].inverse() * data.oMf[built.getFrameId(child)]
        assert place.translation == pytest.approx(np.array(turned[:3]), abs=1e-9)
        assert place.rotation.flatten() == pytest.approx(np.array(rotvec_to_matrix(*turned[3:])), abs=1e-9)


@pytest.mark.skipif(CHECK_URDF is None, reason="check_urdf is not installed")
def test_check_urdf_accepts_it(model: RobotModel, tmp_path: Path) -> None:
    file = tmp_path / "robot.urdf"
    file.write_text(urdf(model, prefix="left_"))
    assert CHECK_URDF is not None
    checked = subprocess.run([CHECK_URDF, str(file)], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stderr
    assert "root Link: left_base_link" in checked.stdout


def test_shapes_reach_from_joint_to_joint(model: RobotModel) -> None:
    """Upper arm and forearm have their lengths; every link has a visual and a collision shape."""
    built = pin.buildModelFromXML(urdf(model))
    for kind in (pin.GeometryType.COLLISION, pin.GeometryType.VISUAL):
        shapes = pin.buildGeomFromUrdfString(built, urdf(model), kind)
        assert len(shapes.geometryObjects) == 7 * 3
    lengths = [
        2 * shape.geometry.halfLength for shape in shapes.geometryObjects if hasattr(shape.geometry, "halfLength")
    ]
    assert lengths[2:4] == pytest.approx([abs(model.dh.a[1]), abs(model.dh.a[2])])


def test_meshes_from_a_folder(tmp_path: Path) -> None:
    for folder, ending in (("visual", "dae"), ("collision", "stl")):
        (tmp_path / folder).mkdir()
        for name in MESHES:
            (tmp_path / folder / f"{name}.{ending}").write_text("")
    root = ElementTree.fromstring(urdf(load_model("ur5e"), meshes=tmp_path))
    meshes = [str(mesh.get("filename")) for mesh in root.iter("mesh")]
    assert len(meshes) == 14
    assert (tmp_path / "visual" / "wrist1.dae").as_uri() in meshes
    (tmp_path / "visual" / "wrist1.dae").unlink()
    with pytest.raises(MissingMeshesError, match="visual/wrist1"):
        urdf(load_model("ur5e"), meshes=tmp_path)
    with pytest.raises(MissingMeshesError, match="UR15"):
        urdf(load_model("ur15"), meshes=tmp_path)
