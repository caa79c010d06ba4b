"""Camera pictures in MCAP files and for Foxglove, read by rosbags, mcap-ros2-support and Foxglove's protocol."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from typer.testing import CliRunner

from client.cameras import Shot
from client.cli import app
from client.errors import RecordingError
from client.recording import Recorder
from client.recording.pictures import Pictures
from client.recording.timestamps import Stamps
from tests.rows import each_row
from tests.served_cameras import BELT, DEPTH, JPEG, MATRIX, OVERVIEW, POSE, WRIST, served_cameras

BEGAN_NS = 1_700_000_000_123_456_789


def depth(camera, time_s: float) -> Shot:
    with served_cameras() as served:
        _, _, data = served.answer("/depth.npy")
    return Shot(camera, "depth.npy", data, time_s, POSE)


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """Two states, pictures between them, and a picture from before the start of the recording."""
    path = tmp_path / "pictures.mcap"
    with Recorder(path, ("timestamp", "actual_q"), now_ns=lambda: BEGAN_NS) as recorder:
        recorder.write_shot(Shot(OVERVIEW, "rgb.jpg", b"too early", 9.0, POSE))
        recorder.write({"timestamp": 10.0, "actual_q": (0.0,) * 6})
        recorder.write({"timestamp": 10.5, "actual_q": (0.1,) * 6})
        recorder.write_shot(Shot(OVERVIEW, "rgb.jpg", JPEG, 10.25, POSE))
        recorder.write_shot(depth(WRIST, 10.25))
        recorder.write_shot(Shot(BELT, "rgb.jpg", JPEG, 10.25, POSE))
        recorder.write({"timestamp": 11.0, "actual_q": (0.2,) * 6})
    return path


def test_rosbags_reads_pictures_cameras_and_camera_poses(recorded: Path) -> None:
    with AnyReader([recorded]) as bag:
        found = {
            connection.topic: (time_ns, bag.deserialize(data, connection.msgtype))
            for connection, time_ns, data in bag.messages()
        }
    time_ns, picture = found["/over_all/image_raw/compressed"]
    assert time_ns == BEGAN_NS + 250_000_000
    assert bytes(picture.data) == JPEG
    assert picture.format.startswith("rgb8; jpeg")
    assert picture.header.frame_id == "over_all_optical_frame"
    assert picture.header.stamp.nanosec == (BEGAN_NS + 250_000_000) % 10**9
    _, metres = found["/wrist/depth/image_raw"]
    assert (metres.encoding, metres.height, metres.width, metres.is_bigendian) == ("32FC1", 6, 8, 0)
    assert np.array_equal(np.frombuffer(bytes(metres.data), "<f4").reshape(6, 8), DEPTH)
    _, info = found["/wrist/depth/camera_info"]
    assert tuple(info.k) == MATRIX
    assert (info.width, info.distortion_model, len(info.p)) == (8, "plumb_bob", 12)
    (moving,) = found["/tf"][1].transforms
    assert (moving.header.frame_id, moving.child_frame_id) == ("base", "belt_link")
    assert "/tf_static" in found


def test_frames_are_repeated_for_late_subscribers() -> None:
    pictures = Pictures()

    def has_static_transforms(seconds: float) -> bool:
        shot = Shot(OVERVIEW, "rgb.jpg", JPEG, 0.0, POSE)
        return "/tf_static" in [message.topic for message in pictures.encoded(shot, BEGAN_NS + round(1e9 * seconds))]

    assert [has_static_transforms(seconds) for seconds in (0.0, 0.5, 1.0, 1.5, 0.0)] == [True, False, True, False, True]


def test_a_late_picture_does_not_set_the_clock() -> None:
    stamps = Stamps(lambda: BEGAN_NS)
    assert stamps.at(10.0) is None
    assert stamps.of(20.0) == BEGAN_NS
    assert stamps.at(17.0) == BEGAN_NS - 3 * 10**9
    assert stamps.of(20.5) == BEGAN_NS + 5 * 10**8
    assert stamps.at(1e9) is None


def test_only_mcap_files_contain_pictures(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.csv", ("timestamp",)) as recorder:
        recorder.write({"timestamp": 1.0})
        with pytest.raises(RecordingError, match=r"a\.csv: only \.mcap files can contain camera images$"):
            recorder.write_shot(Shot(OVERVIEW, "rgb.jpg", JPEG, 1.0, POSE))


@each_row(
    ("options", "error"),
    [
        (["record", "a.csv", "--camera", "all"], "only .mcap files can contain camera images"),
        (
            ["record", "a.mcap", "--camera", "all", "--camera-rate", "0"],
            "--camera-rate must be above 0 and at most 30, not 0",
        ),
        (["record", "a.mcap", "--depth"], "--depth needs a camera"),
        (["stream", "--plotjuggler", "udp://127.0.0.1", "--camera", "all"], "PlotJuggler shows no images"),
    ],
)
def test_invalid_options_are_reported(options: list[str], error: str) -> None:
    result = CliRunner().invoke(app, options)
    assert result.exit_code != 0
    assert error in " ".join((result.output + str(result.exception)).replace("│", " ").split())
