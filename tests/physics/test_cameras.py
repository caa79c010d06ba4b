"""Pictures: positions, distances and segmentation of objects."""

import math

import numpy as np
import pytest

from emulator.physics import open_cameras
from emulator.physics.cameras import CameraError
from urproto.robots.pose import pose_inv, pose_trans

PART = "part: {box: [0.1, 0.1, 0.1], pose: [-0.6, 0.1, 0.55], mass: 1, colour: [1, 0, 0]}"
FLOOR = "floor: {plane: {}, pose: [0, 0, -0.5]}"
CAMERAS = """cameras:
  above: {pose: [-0.7, 0, 2.0, 3.14159265, 0, 0], size: [160, 120], fov: 0.9}
  wrist: {pose: [0.1, 0, 0], at: [0.1, 0, 0.3], frame: flange}
"""


@pytest.fixture
def scene(cell):
    here = cell(FLOOR, PART, more=CAMERAS)
    try:
        cameras = open_cameras(here.world)
    except CameraError as error:
        pytest.skip(str(error))
    with cameras:
        yield here, cameras


def test_an_object_is_seen_where_intrinsics_and_extrinsics_predict(scene):
    here, cameras = scene
    seen = cameras.segmentation("above")
    number = next(number for number, name in cameras.bodies.items() if name == "part")
    rows, columns = np.nonzero(seen == number)
    x, y, z = pose_trans(pose_inv(cameras.extrinsics("above")), here.world.pose("part"))[:3]
    top = z - 0.05  # the visible face
    u, v, _ = cameras.intrinsics("above") @ (x / top, y / top, 1.0)
    assert (columns.mean(), rows.mean()) == pytest.approx((u, v), abs=1.0)
    edge = cameras.intrinsics("above")[0, 0] * 0.1 / top
    assert len(rows) == pytest.approx(edge**2, rel=0.15)
    assert np.median(cameras.depth("above")[rows, columns]) == pytest.approx(top, abs=0.001)
    red, green, blue = cameras.rgb("above")[rows, columns].mean(axis=0)
    assert red > 2 * max(green, blue)
    assert cameras.depth("above")[0, 0] == pytest.approx(2.5, abs=0.01)


def test_a_camera_on_the_flange_moves_with_it(scene):
    here, cameras = scene
    before = cameras.extrinsics("wrist")
    here.program("movel(p[-0.3, -0.4, 0.3, 0, 3.14159, 0], v=0.5)")
    flange, camera = here.controller.arm.flange_pose, cameras.extrinsics("wrist")
    assert math.dist(camera[:3], flange[:3]) == pytest.approx(0.1, abs=1e-3)
    assert math.dist(camera[:3], before[:3]) > 0.1


def test_a_covered_camera_sees_nothing(scene):
    here, cameras = scene
    here.world.covered.add("above")
    assert not cameras.rgb("above").any()
    assert not cameras.depth("above").any()
    here.world.covered.clear()
    assert cameras.rgb("above").any()
    with pytest.raises(CameraError, match="there is no camera 'none'; there are: above, wrist"):
        cameras.rgb("none")
