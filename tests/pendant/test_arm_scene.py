"""The drawn arm: position of its TCP, closed shapes, meshes and frames."""

import math
import random
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
import pytest
import yaml
from nicegui import Client, ui
from nicegui.elements.scene import Object3D
from nicegui.elements.scene.objects import Gltf, Stl, Text
from nicegui.page import page as ui_page

from client.pendant.arm_scene import DrawnArm, Lathe
from urproto.primary.subpackages import KinematicsInfo
from urproto.robots import DH, MODELS, Calibration, RobotModel, kinematics_of, load_model
from urproto.robots.description import urdf
from urproto.robots.pose import rotvec_to_matrix
from urproto.robots.shapes import link_parts

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
TCP = (0.03, -0.05, 0.12, 0.4, -0.3, 0.9)


@pytest.fixture
def scene() -> Iterator[ui.scene]:
    client = Client(ui_page(""), request=None)
    with client:
        yield ui.scene()
    client.delete()


def kinematics_message(dh: DH) -> KinematicsInfo:
    """The message of a robot with these parameters."""
    return KinematicsInfo(checksum=(0,) * 6, dh_theta=dh.theta, dh_a=dh.a, dh_d=dh.d, dh_alpha=dh.alpha, status=0)


def scene_pose(obj: Object3D, q_rad: Sequence[float]) -> np.ndarray:
    """Pose of an object in the scene when the browser rotates the joints to these angles."""
    pose = np.eye(4)
    while isinstance(obj, Object3D):
        local = np.eye(4)
        local[:3, :3] = obj.R
        local[:3, 3] = (obj.x, obj.y, obj.z)
        if obj.name is not None and obj.name.startswith("joint "):
            angle = q_rad[int(obj.name[6:])]
            assert np.allclose(local, np.eye(4)), "a group that the browser rotates about z must have no other rotation"
            local[:2, :2] = ((math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle)))
        pose, obj = local @ pose, obj.parent
    return pose


def transform(pose: Sequence[float]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(rotvec_to_matrix(*pose[3:])).reshape(3, 3)
    matrix[:3, 3] = pose[:3]
    return matrix


def objects_named(scene: ui.scene, name: str) -> list[Object3D]:
    return [obj for obj in scene.objects.values() if obj.name == name]


def check(scene: ui.scene, model: RobotModel) -> None:
    source = random.Random(model.name)
    (tcp,) = objects_named(scene, "tcp")
    for _ in range(5):
        q = tuple(source.uniform(-3, 3) for _ in range(6))
        expected = transform(kinematics_of(model).forward(q, TCP))
        np.testing.assert_allclose(scene_pose(tcp, q), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_drawn_tcp_matches_kinematics(scene: ui.scene, name: str) -> None:
    model = load_model(name)
    arm = DrawnArm(scene)
    arm.set_tcp(TCP)
    arm.set_model(model, kinematics_message(model.dh))
    check(scene, model)


@pytest.mark.parametrize("name", ["ur5", "ur5e"])
def test_drawn_tcp_matches_calibration_after_model_change(scene: ui.scene, name: str) -> None:
    content = yaml.safe_load((GOLDEN / f"calibration_{name}.yaml").read_text())
    measured = Calibration.from_mapping(content, "file").dh
    arm = DrawnArm(scene)
    with scene:
        other_object = scene.box()
    arm.set_model(load_model("ur3"), None)
    arm.set_model(load_model(name), kinematics_message(measured))
    arm.set_tcp(TCP)
    check(scene, replace(load_model(name), calibration=measured))
    assert other_object.id in scene.objects
    arm.set_model(None, None)
    assert list(scene.objects) == [other_object.id]


@pytest.mark.parametrize("name", MODELS)
def test_links_are_closed_solids(scene: ui.scene, name: str) -> None:
    """The profiles of all parts are closed, and the lengths of tubes and flange match the model."""
    model = load_model(name)
    links = link_parts(model)
    assert len(links) == 7
    for parts in links:
        for part in parts:
            radii, heights = zip(*part.profile, strict=True)
            assert radii[0] == radii[-1] == 0.0
            assert min(radii) >= 0.0
            assert heights[0] < heights[-1]
            assert math.isclose(math.hypot(*part.axis), 1.0)
    tubes = [max(height for _, height in part.profile) for part in links[2] + links[3]]
    assert abs(model.dh.a[1]) in tubes
    assert abs(model.dh.a[2]) in tubes
    assert max(height for part in links[6] if part.axis[2] for _, height in part.profile) == 0.0  # the flange


def test_missing_meshes_are_reported_and_shapes_drawn_instead(scene: ui.scene, tmp_path: Path) -> None:
    errors = list[str]()
    arm = DrawnArm(scene, tmp_path, errors.append)
    arm.set_model(load_model("ur5e"), None)
    assert "base" in errors[0]
    assert [obj for obj in scene.objects.values() if isinstance(obj, Lathe)]


@pytest.mark.parametrize("layout", ["{mesh}.stl", "collision/{mesh}.stl", "ur5e/visual/{mesh}.glb"])
def test_meshes_are_found_in_all_folder_layouts(scene: ui.scene, tmp_path: Path, layout: str) -> None:
    for mesh in ("base", "shoulder", "upperarm", "forearm", "wrist1", "wrist2", "wrist3"):
        file = tmp_path / layout.format(mesh=mesh)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"")
    errors = list[str]()
    DrawnArm(scene, tmp_path, errors.append).set_model(load_model("ur5e"), None)
    meshes = [obj for obj in scene.objects.values() if isinstance(obj, Stl | Gltf)]
    assert not errors
    assert [obj.args[0].rsplit("/", 1)[1].split(".")[0] for obj in meshes][:3] == ["base", "shoulder", "upperarm"]
    assert [obj.z for obj in meshes] == pytest.approx([0, 0, 0.138, 0.007, -0.127, -0.0997, -0.0989])


@pytest.mark.parametrize("name", ["ur5", "ur10e"])
def test_drawn_frames_match_urdf(scene: ui.scene, name: str) -> None:
    model = load_model(name)
    arm = DrawnArm(scene)
    arm.set_model(model, None)
    arm.set_tcp(TCP)
    arm.show_frames(True)
    labels = {label.args[0]: label for label in scene.objects.values() if isinstance(label, Text)}
    robot = pinocchio.buildModelFromXML(urdf(model))
    links = {frame.name for frame in robot.frames if frame.type == pinocchio.FrameType.BODY}
    assert {part for label in labels for part in label.split(", ")} == links | {"tcp"}
    data = robot.createData()
    q = tuple(random.Random(name).uniform(-3, 3) for _ in range(6))
    pinocchio.framesForwardKinematics(robot, data, np.array(q))
    base = data.oMf[robot.getFrameId("base")].inverse()
    for label, shown in labels.items():
        frame = "base" if label.startswith("base") else label.split(", ")[0]
        if frame != "tcp":
            expected = (base * data.oMf[robot.getFrameId(frame)]).homogeneous
            np.testing.assert_allclose(scene_pose(shown.parent, q), expected, rtol=0, atol=1e-6)
    flange = np.array((base * data.oMf[robot.getFrameId("flange")]).homogeneous)
    drawn = [scene_pose(group, q) for group in scene.objects.values() if group.parent is labels[_last(labels)].parent]
    assert any(np.allclose(pose, flange, rtol=0, atol=1e-6) for pose in drawn)
    assert all(label.parent.visible_ for label in labels.values())
    arm.show_frames(False)
    arm.set_tcp((0.0,) * 6)
    assert not any(label.parent.visible_ for label in scene.objects.values() if isinstance(label, Text))


def _last(labels: dict[str, Any]) -> str:
    return next(label for label in labels if label.startswith("wrist_3_link"))


def test_ghost_is_hidden_and_separate_from_arm(scene: ui.scene) -> None:
    DrawnArm(scene, ghost=True).set_model(load_model("ur5e"), None)
    (ghost,) = objects_named(scene, "ghost")
    assert not ghost.visible_
    assert [len(objects_named(scene, f"ghost joint {joint}")) for joint in range(6)] == [1] * 6
    assert not objects_named(scene, "tcp")
