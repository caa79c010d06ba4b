"""LeRobot's own commands with a UR: not part of the tests' environment, because it brings PyTorch.

pip install 'lerobot[core_scripts]' . integrations/lerobot_robot_ur pytest pytest-asyncio pytest-timeout
pytest tests/lerobot
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("lerobot", reason="PyTorch is large: see above")

import pandas
from lerobot.cameras import make_cameras_from_configs
from lerobot.robots import make_robot_from_config

from client.lerobot.devices import URConfig, UREmulatorCameraConfig
from urproto.errors import URError
from urproto.testing.process import EmulatorProcess

SCENE = Path(__file__).parents[2] / "emulator" / "learning" / "tasks" / "pick_and_place" / "scene.yaml"
LEAD = """def lead():
  while True:
    movej([0.2, -1.5, 1.5, -1.57, -1.57, 0.0], a=0.8, v=0.4)
    set_standard_digital_out(0, True)
    movej([-0.2, -1.4, 1.4, -1.57, -1.57, 0.3], a=0.8, v=0.4)
    set_standard_digital_out(0, False)
  end
end
"""
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
UR5 = ["--model", "ur5", "--running", "--no-pendant"]
FPS = 10
FRAMES = 40
CAMERA = "{overview: {type: ur_emulator, host: %s, name: overview, width: 320, height: 240, fps: 10}}"


def lerobot(command: str, tmp_path: Path, *options: str) -> None:
    """Run a command of LeRobot on a dataset in a folder."""
    words = [f"--dataset.repo_id=me/{command}", f"--dataset.root={tmp_path / 'dataset'}", "--play_sounds=false"]
    program = Path(sys.executable).with_name(f"lerobot-{command}")
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "hf")}
    done = subprocess.run(
        [str(program), *words, *options], env=environment, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr[-3000:]


@pytest.mark.timeout(900)
def test_a_dataset_is_recorded_and_replayed(tmp_path: Path) -> None:
    with (
        EmulatorProcess(UR5) as leader,
        EmulatorProcess([*UR5, "--physics", "--world", str(SCENE)]) as follower,
    ):
        leader.control.send_script(LEAD)
        robot = (f"--robot.host={follower.host}", "--robot.type=ur", "--robot.gripper=digital", f"--robot.fps={FPS}")
        lerobot(
            "record",
            tmp_path,
            *robot,
            f"--robot.cameras={CAMERA % follower.host}",
            "--teleop.type=ur_leader",
            f"--teleop.host={leader.host}",
            "--teleop.gripper_output=0",
            f"--dataset.fps={FPS}",
            "--dataset.num_episodes=1",
            f"--dataset.episode_time_s={FRAMES // FPS}",
            "--dataset.single_task=swing",
            "--dataset.push_to_hub=false",
        )
        info = json.loads((tmp_path / "dataset" / "meta" / "info.json").read_text())
        assert info["robot_type"] == "ur"
        assert info["features"]["action"]["names"] == [*(f"{name}_joint.pos" for name in JOINTS), "gripper.pos"]
        assert info["features"]["observation.images.overview"]["shape"] == [240, 320, 3]
        frames = pandas.read_parquet(tmp_path / "dataset" / "data")
        assert abs(len(frames) - FRAMES) <= 2
        actions, seen = frames["action"].to_list(), frames["observation.state"].to_list()
        pairs = zip(actions[25:], seen[26:], strict=False)  # once the follower has caught up
        assert max(abs(action[0] - state[0]) for action, state in pairs) < 0.1
        assert {action[6] for action in actions} == {0.0, 1.0}

        lerobot("replay", tmp_path, *robot, "--dataset.episode=0")
        assert follower.control.state(["actual_q"])["actual_q"] == pytest.approx(actions[-1][:6], abs=0.02)


def test_actions_that_are_unsafe_are_refused_before_the_arm_moves(tmp_path: Path) -> None:
    with EmulatorProcess(UR5) as emulated:
        robot = make_robot_from_config(URConfig(host=emulated.host, calibration_dir=tmp_path))
        robot.connect()
        try:
            held = {key: robot.get_observation()[key] for key in robot.action_features}
            assert robot.send_action(held) == held
            for change, problem in (
                ({"elbow_joint.pos": float("nan")}, "finite numbers"),
                ({"elbow_joint.pos": 9.0}, "outside its limits"),
            ):
                with pytest.raises(URError, match=problem):
                    robot.send_action(held | change)
            with pytest.raises(URError, match=r"it lacks wrist_3_joint.pos"):
                robot.send_action(dict(list(held.items())[:5]))
            assert emulated.control.state(["safety_mode"])["safety_mode"] == "NORMAL"
        finally:
            robot.disconnect()
        with pytest.raises(URError, match="not connected"):
            robot.get_observation()


def test_a_camera_of_another_size_is_refused() -> None:
    with EmulatorProcess([*UR5, "--physics", "--world", str(SCENE)]) as emulated:
        config = UREmulatorCameraConfig(host=emulated.host, name="overview", width=640, height=480, fps=10)
        (camera,) = make_cameras_from_configs({"overview": config}).values()
        with pytest.raises(ValueError, match="320 x 240 pixels: set width and height"):
            camera.connect()
