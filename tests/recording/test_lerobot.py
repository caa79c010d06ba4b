"""Datasets for LeRobot, read by independent libraries: Parquet and JSON in the format of `lerobot` 0.4.4."""

import io
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image
from recording_rig import BEGAN_NS, INFO, array, record
from typer.testing import CliRunner

from client.cameras import Shot
from client.cli import app
from client.errors import MissingExtraError, RecordingError
from client.lerobot import Episode, stats, write_dataset, write_episodes
from client.recording import Recorder
from tests.served_cameras import OVERVIEW, POSE, WRIST
from urproto.joints import JOINT_NAMES

FPS = 10
NAMED = [f"{joint}.pos" for joint in JOINT_NAMES]


def jpeg(red: int, size: tuple[int, int] = (8, 6)) -> bytes:
    written = io.BytesIO()
    Image.new("RGB", size, (red, 40, 80)).save(written, "JPEG", quality=95)
    return written.getvalue()


def filmed(path: Path, states, reds, *, period_s: float = 0.1, size=(8, 6), cameras=(OVERVIEW,)) -> Path:
    """A recording with pictures in these shades of red, the first one 10 ms after the first state."""
    begin_s = states[0]["timestamp"]
    with Recorder(path, states[0], INFO, now_ns=lambda: BEGAN_NS) as recorder:
        for i, state in enumerate(states):
            recorder.write(state)
            if i == 0:
                for camera in cameras:
                    for number, red in enumerate(reds):
                        taken_s = begin_s + 0.01 + number * period_s
                        recorder.write_shot(Shot(camera, "rgb.jpg", jpeg(red, size), taken_s, POSE))
    return path


def loaded(folder: Path) -> SimpleNamespace:
    """A dataset's tables and documents."""
    return SimpleNamespace(
        info=json.loads((folder / "meta/info.json").read_text()),
        stats=json.loads((folder / "meta/stats.json").read_text()),
        tasks=pq.read_table(folder / "meta/tasks.parquet"),
        episodes=pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist(),
        frames=pq.read_table(folder / "data/chunk-000/file-000.parquet").to_pydict(),
    )


def test_frames_are_evenly_timed_states_with_the_next_target_as_action(states, tmp_path: Path) -> None:
    write_dataset(tmp_path / "set", [record(tmp_path / "run.npz", states)], ["turn"], fps=FPS)
    found = loaded(tmp_path / "set")
    step = round(1.0 / FPS / 0.002)
    frames = (len(states) - 1) // step
    assert np.array(found.frames["observation.state"]) == pytest.approx(
        array(states, "actual_q")[: frames * step : step], abs=1e-6
    )
    assert np.array(found.frames["action"]) == pytest.approx(
        array(states, "target_q")[step : (frames + 1) * step : step], abs=1e-6
    )
    assert found.frames["timestamp"] == pytest.approx(np.arange(frames) / FPS)
    assert found.frames["frame_index"] == found.frames["index"] == list(range(frames))
    assert found.info["features"]["observation.state"] == {"dtype": "float32", "shape": [6], "names": NAMED}
    assert (found.info["fps"], found.info["total_frames"], found.info["codebase_version"]) == (FPS, frames, "v3.0")
    assert found.info["data_path"].format(chunk_index=0, file_index=0) == "data/chunk-000/file-000.parquet"


def test_recordings_become_consecutive_episodes(states, tmp_path: Path) -> None:
    files = [record(tmp_path / "a.csv", states[:300]), record(tmp_path / "b.npz", states[300:])]
    made = write_dataset(tmp_path / "set", [*files, files[0]], ["go", "come back", "go"], fps=20, robot_type="ur5e")
    found = loaded(tmp_path / "set")
    lengths = [episode["length"] for episode in found.episodes]
    assert made.frames == sum(lengths) == len(found.frames["index"]) == found.info["total_frames"]
    assert [episode["tasks"] for episode in found.episodes] == [["go"], ["come back"], ["go"]]
    assert found.frames["index"] == list(range(made.frames))
    assert found.frames["task_index"] == [0] * lengths[0] + [1] * lengths[1] + [0] * lengths[2]
    assert found.tasks.to_pydict() == {"task_index": [0, 1], "task": ["go", "come back"]}
    assert json.loads(found.tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    for number, episode in enumerate(found.episodes):
        rows = slice(episode["dataset_from_index"], episode["dataset_to_index"])
        assert set(found.frames["episode_index"][rows]) == {number}
        assert found.frames["frame_index"][rows] == list(range(episode["length"]))
        assert np.mean(found.frames["action"][rows], axis=0) == pytest.approx(episode["stats/action/mean"], abs=1e-6)
    assert found.info["splits"] == {"train": "0:3"}
    assert found.info["robot_type"] == "ur5e"


def test_overall_statistics_cover_every_frame(states, tmp_path: Path) -> None:
    files = [record(tmp_path / "a.npz", states[:300]), record(tmp_path / "b.npz", states[300:])]
    write_dataset(tmp_path / "set", files, ["go"], fps=50)
    found = loaded(tmp_path / "set")
    every = np.array(found.frames["observation.state"])
    stats = found.stats["observation.state"]
    for name, value in (("min", every.min(0)), ("max", every.max(0)), ("mean", every.mean(0)), ("std", every.std(0))):
        assert stats[name] == pytest.approx(value, abs=1e-6), name
    assert stats["count"] == [len(every)]
    assert set(found.stats) == {*found.info["features"]}


def test_vector_elements_and_bits_can_be_selected(states, tmp_path: Path) -> None:
    changed = [
        state | {"actual_digital_output_bits": 0b100 if i > 500 else 0b011, "speed_scaling": 0.5}
        for i, state in enumerate(states)
    ]
    write_dataset(
        tmp_path / "set",
        [record(tmp_path / "run.npz", changed)],
        ["grip"],
        fps=FPS,
        state=["actual_TCP_pose[2]", "speed_scaling"],
        action=["actual_digital_output_bits[2]"],
    )
    found = loaded(tmp_path / "set")
    assert found.info["features"]["observation.state"]["names"] == ["actual_TCP_pose[2]", "speed_scaling"]
    assert found.info["features"]["action"] == {
        "dtype": "float32",
        "shape": [1],
        "names": ["actual_digital_output_bits[2]"],
    }
    assert found.frames["observation.state"][3] == pytest.approx([states[150]["actual_TCP_pose"][2], 0.5])
    assert found.frames["action"] == [0.0] * 10 + [1.0] * (len(found.frames["action"]) - 10)  # one number is not a list


def test_pictures_match_the_recording(states, tmp_path: Path) -> None:
    states = states[::5]
    reds = list(range(0, 200, 10))
    filmed(tmp_path / "run.mcap", states, reds, cameras=(OVERVIEW, WRIST))
    made = write_dataset(tmp_path / "set", [tmp_path / "run.mcap"], ["look"])
    found = loaded(tmp_path / "set")
    assert made.fps == 10  # the rate of the pictures
    assert made.cameras == ("over_all", "wrist")
    assert made.late_s < 1e-6  # a frame when a picture was taken
    pictures = found.frames["observation.images.over_all"]
    assert [picture["bytes"] for picture in pictures] == [jpeg(red) for red in reds[: len(pictures)]]
    assert found.info["features"]["observation.images.wrist"] == {
        "dtype": "image",
        "shape": [6, 8, 3],
        "names": ["height", "width", "channels"],
    }
    stats = found.stats["observation.images.wrist"]
    assert np.shape(stats["mean"]) == np.shape(stats["q99"]) == (3, 1, 1)
    used = np.array(reds[: len(pictures)])
    assert np.ravel(stats["mean"]) * 255 == pytest.approx([used.mean(), 40, 80], abs=2.0)
    assert stats["max"][0][0][0] * 255 == pytest.approx(used.max(), abs=3.0)
    # half the rate of the pictures, from the beginning of one camera
    write_dataset(tmp_path / "slow", [tmp_path / "run.mcap"], ["look"], fps=5)
    slow = loaded(tmp_path / "slow").frames["observation.images.wrist"]
    assert [picture["bytes"] for picture in slow] == [jpeg(red) for red in reds[: 2 * len(slow) : 2]]


def test_picture_statistics_match_their_pixels() -> None:
    shades = np.random.default_rng(1).integers(0, 256, (5, 6, 8, 3), np.uint8)
    pictures = []
    for picture in shades:
        written = io.BytesIO()
        Image.fromarray(picture).save(written, "JPEG")
        pictures.append(written.getvalue())
    pixels = np.concatenate([stats.decoded(picture).reshape(-1, 3) for picture in pictures]) / 255
    found = {name: np.ravel(values) for name, values in stats.picture_statistics(pictures).items()}
    for name, value in (
        ("min", pixels.min(0)),
        ("max", pixels.max(0)),
        ("mean", pixels.mean(0)),
        ("std", pixels.std(0)),
    ):
        assert found[name] == pytest.approx(value, abs=1e-12), name
    for name, share in (("q01", 0.01), ("q50", 0.5), ("q99", 0.99)):
        assert found[name] == pytest.approx(np.quantile(pixels, share, axis=0, method="inverted_cdf")), name
    with pytest.raises(RecordingError, match="the images of one camera have 2 different sizes"):
        stats.picture_statistics([jpeg(1), jpeg(1, (16, 6))])


def test_a_dataset_is_split_into_files_of_limited_size(states, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("client.lerobot.dataset._DATA_MB", 1e-3)
    monkeypatch.setattr("client.lerobot.dataset._IN_CHUNK", 2)
    files = [record(tmp_path / "a.npz", states[:400])] * 3
    write_dataset(tmp_path / "set", files, ["go"], fps=50)
    places = ["chunk-000/file-000", "chunk-000/file-001", "chunk-001/file-000"]
    assert sorted(path.relative_to(tmp_path / "set/data") for path in (tmp_path / "set/data").rglob("*.parquet")) == [
        Path(f"{place}.parquet") for place in places
    ]
    episodes = loaded(tmp_path / "set").episodes
    assert [(e["data/chunk_index"], e["data/file_index"]) for e in episodes] == [(0, 0), (0, 1), (1, 0)]


def nan_in(states):
    return [state | {"actual_q": (float("nan"),) * 6} if i == 500 else state for i, state in enumerate(states)]


@pytest.mark.parametrize(
    ("change", "options", "error"),
    [
        (lambda s: s, {"state": ["actual_p"]}, "actual_p"),
        (lambda s: s, {"state": ["actual_q[6]"]}, r"actual_q\[6\]: actual_q has 6 numbers, 0 to 5"),
        (lambda s: s, {"state": ["speed_scaling[0]"]}, r"speed_scaling is a single number: leave out \[0\]"),
        (lambda s: s, {"action": ["a b"]}, "'a b' is neither an RTDE variable"),
        (lambda s: s, {"action": ["payload"]}, "payload was not recorded"),
        (lambda s: s, {"action": []}, "at least one number"),
        (lambda s: s, {"fps": 0}, "at least 1 frame per second, not 0"),
        (lambda s: s, {"tasks": ["a", "b"]}, "2 tasks for 1 recordings"),
        (lambda s: s, {"tasks": [" "]}, "give one for all"),
        (lambda s: s[::100], {}, "it has 5 states per second, fewer than the 10 frames: give a lower --fps"),
        (lambda s: s[:30], {}, "it is too short for a frame at 10 frames per second"),
        (lambda s: s[:300] + s[500:], {}, r"states are missing for 0\.\d\d s before 0\.\d\d s"),
        (lambda s: s[400:] + s[:400], {}, "the robot rebooted during the recording"),
        (nan_in, {}, r"shoulder_pan_joint.pos is not a number 1.00 s after the start"),
    ],
)
def test_invalid_input_is_a_one_line_error_and_leaves_no_files(states, tmp_path, change, options, error) -> None:
    file = record(tmp_path / "run.npz", change(states))
    with pytest.raises(RecordingError, match=error) as refused:
        write_dataset(**({"path": tmp_path / "set", "recordings": [file], "tasks": ["go"]} | options))
    assert "\n" not in str(refused.value)
    assert [path.name for path in tmp_path.iterdir()] == ["run.npz"]


def test_all_recordings_must_have_the_same_cameras(states, tmp_path: Path) -> None:
    states = states[::5]
    one = filmed(tmp_path / "one.mcap", states, range(0, 200, 10))
    other = filmed(tmp_path / "other.mcap", states, range(0, 200, 10), size=(16, 6))
    with pytest.raises(
        RecordingError,
        match=r"other\.mcap: it has images of over_all \(16x6\), but earlier recordings of over_all \(8x6\)",
    ):
        write_dataset(tmp_path / "set", [one, other], ["go"])
    with pytest.raises(RecordingError, match=r"plain\.mcap: it has images of no camera, but earlier recordings"):
        write_dataset(tmp_path / "set", [one, record(tmp_path / "plain.mcap", states)], ["go"])
    gone = filmed(tmp_path / "gone.mcap", states, [10, 20], period_s=1.6)
    with pytest.raises(RecordingError, match=r"over_all has no image within 0.5 s of 0\.8\d s"):
        write_dataset(tmp_path / "set", [gone], ["go"], fps=10)
    with Recorder(bad := tmp_path / "bad.mcap", states[0], now_ns=lambda: BEGAN_NS) as recorder:
        for i, state in enumerate(states):
            recorder.write(state)
            if not i % 20:
                recorder.write_shot(Shot(OVERVIEW, "rgb.jpg", b"\xff\xd8 cut", state["timestamp"], POSE))
    with pytest.raises(RecordingError, match=r"bad\.mcap: an image in it is not a readable JPEG"):
        write_dataset(tmp_path / "set", [bad], ["go"])
    assert not (tmp_path / "set").exists()


def test_the_command(states, tmp_path: Path) -> None:
    states = states[::5]
    file = str(filmed(tmp_path / "run.mcap", states, range(0, 200, 10)))
    options = ["--task", "look", "--state", "actual_q,actual_TCP_force", "--action", "target_q"]
    result = CliRunner().invoke(app, ["dataset", str(tmp_path / "set"), file, file, *options])
    assert result.exit_code == 0, result.output
    assert "2 episodes, 38 frames at 10 fps, cameras: over_all" in result.output
    assert loaded(tmp_path / "set").info["features"]["observation.state"]["shape"] == [12]
    again = CliRunner().invoke(app, ["dataset", str(tmp_path / "set"), file, *options])
    assert "exists: choose another name" in str(again.exception)


def of_frames(count: int, **changes) -> Episode:
    numbers = np.arange(2.0 * count, dtype=np.float32).reshape(count, 2)
    return Episode(
        **{"task": "turn", "state": numbers, "action": numbers + 1, "environment": numbers[:, :1], **changes}
    )


def test_episodes_in_memory_become_a_dataset(tmp_path: Path) -> None:
    named = {"state": ["a", "b"], "action": ["c", "d"], "environment": ["e"]}
    made = write_episodes(tmp_path / "set", map(of_frames, (2, 3)), fps=25, robot_type="ur3", **named)
    assert (made.episodes, made.frames) == (2, 5)
    found = loaded(tmp_path / "set")
    assert found.info["features"]["observation.environment_state"] == {"dtype": "float32", "shape": [1], "names": ["e"]}
    assert found.frames["timestamp"] == pytest.approx([0.0, 0.04, 0.0, 0.04, 0.08])
    assert found.frames["observation.environment_state"] == [0.0, 2.0, 0.0, 2.0, 4.0]
    assert found.stats["observation.environment_state"]["max"] == [4.0]
    short = of_frames(2).action[:1]
    for episodes, problem in (
        ([], "no episodes"),
        ([of_frames(0)], "episode 0: observation.state has the shape"),
        (
            [of_frames(2), of_frames(2, action=short)],
            r"episode 1: action has the shape \(1, 2\): it needs",
        ),
        ([of_frames(2, environment=np.full((2, 1), np.nan))], "environment_state has numbers that are not finite"),
    ):
        with pytest.raises(RecordingError, match=problem):
            write_episodes(tmp_path / "none", episodes, fps=25, **named)
        assert not (tmp_path / "none").exists()
    with pytest.raises(RecordingError, match="choose another name"):
        write_episodes(tmp_path / "set", [of_frames(2)], fps=25, **named)


def test_a_missing_extra_is_reported(states, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(MissingExtraError, match=r"a dataset for LeRobot needs .* pip install .*\[lerobot\]'"):
        write_dataset(tmp_path / "set", [record(tmp_path / "run.npz", states)], ["go"])
