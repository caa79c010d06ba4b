"""Pictures as a client gets them, what it makes of bad answers, and what ROS 2 calls them."""

import json
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from client.cameras import CameraClient, CameraFollower, Shot
from client.cameras.messages import camera_info, fixed_frames, image, moving_frames, optical_frame, ros_name
from client.errors import CameraError
from tests.served_cameras import BELT, DEPTH, JPEG, MATRIX, OVERVIEW, POSE, RGB, WRIST, Served, served_cameras
from urproto.cameras import CameraDescription
from urproto.robots.pose import pose_trans

PATIENCE_S = 30.0
STILL = "/cameras/over%20all/rgb.jpg"


@pytest.fixture
def served() -> Iterator[Served]:
    with served_cameras() as server:
        yield server


@pytest.fixture
def client(served: Served) -> Iterator[CameraClient]:
    with CameraClient(port=served.port) as client:
        yield client


def test_cameras_and_pictures_come_as_they_are(client: CameraClient) -> None:
    assert client.cameras() == [OVERVIEW, WRIST, BELT]
    shot = client.shot(OVERVIEW, "rgbd.npz")
    assert (shot.time_s, shot.pose) == (10.0, POSE)
    assert np.array_equal(shot.arrays["rgb"], RGB)
    assert np.array_equal(shot.arrays["depth"], DEPTH)
    assert client.shot(OVERVIEW, "rgb.jpg").data == JPEG
    assert [camera.name for camera in client.chosen(["wrist"])] == ["wrist"]
    assert len(client.chosen(["all"])) == 3


def test_what_is_not_there_is_one_clear_line(served: Served, client: CameraClient) -> None:
    with pytest.raises(CameraError, match=r"^there is no camera 'left'; there are: over all, wrist, belt$"):
        client.chosen(["left"])
    served.answers[STILL] = (503, {}, b'{"error": "nothing here draws pictures"}')
    with pytest.raises(CameraError, match=r"^nothing here draws pictures$"):
        client.shot(OVERVIEW, "rgb.jpg")
    served.cameras = []
    with pytest.raises(CameraError, match=r"has no cameras: add some to its world file$"):
        client.chosen(["all"])
    with (
        CameraClient(port=1) as nobody,
        pytest.raises(CameraError, match=r"no cameras at http://127.0.0.1:1 .*--physics$"),
    ):
        nobody.cameras()


@pytest.mark.parametrize(
    "index",
    [
        b"",
        b"[]",
        b"\xff",
        b'{"cameras": 3}',
        b'{"cameras": [{"name": "a"}]}',
        json.dumps({"cameras": [{**OVERVIEW.as_json(), "matrix": [1.0]}]}).encode(),
        json.dumps({"cameras": [{**OVERVIEW.as_json(), "pose": [1.0]}]}).encode(),
        json.dumps({"cameras": [{**OVERVIEW.as_json(), "width": 0}]}).encode(),
    ],
)
def test_an_invalid_list_of_cameras_is_reported(served: Served, client: CameraClient, index: bytes) -> None:
    served.answers["/cameras"] = (200, {}, index)
    with pytest.raises(CameraError, match="is not a camera server"):
        client.cameras()


def test_invalid_images_are_reported(served: Served, client: CameraClient) -> None:
    served.answers[STILL] = (200, {}, JPEG)
    with pytest.raises(CameraError, match="does not report the time and pose of an image"):
        client.shot(OVERVIEW, "rgb.jpg")
    with pytest.raises(CameraError, match=r"its rgb.npy cannot be read"):
        _ = Shot(OVERVIEW, "rgb.npy", b"nothing", 0.0, POSE).arrays
    small = CameraDescription("over all", 2, 2, MATRIX, "base", POSE)
    with pytest.raises(CameraError, match=r"its rgb has the shape \(6, 8, 3\), unlike its images"):
        _ = client.shot(small, "rgb.npy").arrays
    with pytest.raises(CameraError, match=r"rgb.jpg is not an array: request rgb.npy"):
        _ = Shot(OVERVIEW, "rgb.jpg", JPEG, 0.0, POSE).arrays


def test_a_follower_reports_lost_images_once_and_continues(served: Served) -> None:
    taken, reported = threading.Semaphore(0), list[str]()
    again = threading.Event()

    def report(text: str) -> None:
        reported.append(text)
        if len(reported) == 1:
            served.answers.clear()
        else:
            again.set()

    def take(shot: Shot) -> None:
        taken.release()
        if not reported:
            served.answers[STILL] = (503, {}, b'{"error": "no light"}')

    client = CameraClient(port=served.port)
    with CameraFollower(client, lambda: [(OVERVIEW, "rgb.jpg")], 100.0, take, report):
        assert taken.acquire(timeout=PATIENCE_S)
        assert again.wait(PATIENCE_S)
    assert reported == ["no light", "the cameras deliver images again"]


def test_frames_are_those_of_rep_103() -> None:
    """In the link's frame x is ahead and z up; in the optical frame z is ahead, x to the right and y down."""
    to_link, to_optical = fixed_frames(WRIST, "left_")
    assert to_link[:2] == ("left_tool0", "left_wrist_link")
    assert to_optical[:2] == ("left_wrist_link", "left_wrist_optical_frame")
    ahead, left, up = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    for optical, link in (((0.0, 0.0, 1.0), ahead), ((-1.0, 0.0, 0.0), left), ((0.0, -1.0, 0.0), up)):
        assert pose_trans(to_optical.pose, (*optical, 0.0, 0.0, 0.0))[:3] == pytest.approx(link)
    assert pose_trans(to_link.pose, to_optical.pose) == pytest.approx(WRIST.pose, abs=1e-9)
    assert fixed_frames(OVERVIEW)[0].parent == "base"
    assert [frame.child for frame in fixed_frames(BELT)] == ["belt_optical_frame"]  # where it is changes
    (moving,) = moving_frames(Shot(BELT, "rgb.jpg", JPEG, 0.0, POSE))
    assert moving[:2] == ("base", "belt_link")
    assert pose_trans(moving.pose, fixed_frames(BELT)[0].pose) == pytest.approx(POSE, abs=1e-9)
    assert not moving_frames(Shot(WRIST, "rgb.jpg", JPEG, 0.0, POSE))


def test_names_and_fields_are_those_of_ros() -> None:
    assert optical_frame(OVERVIEW) == "over_all_optical_frame"
    odd = [CameraDescription(name, 1, 1, MATRIX, "base", POSE) for name in ("3d", "é/b", "")]
    assert [ros_name(camera) for camera in odd] == ["_3d", "__b", "_"]
    info = camera_info(OVERVIEW)
    assert (info["width"], info["height"], info["k"]) == (8, 6, list(MATRIX))
    assert info["p"] == [10.0, 0.0, 4.0, 0.0, 0.0, 10.0, 3.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    rgb, depth = image(RGB), image(DEPTH.astype(">f4"))
    assert (rgb["encoding"], rgb["step"], rgb["data"]) == ("rgb8", 24, RGB.tobytes())
    assert (depth["encoding"], depth["step"], depth["data"]) == ("32FC1", 32, DEPTH.astype("<f4").tobytes())
