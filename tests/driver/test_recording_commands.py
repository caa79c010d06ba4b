"""ur-client record, stream, plot and replay, as a user calls them."""

import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from math import dist
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from emulator_process import EmulatorProcess
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from typer.testing import CliRunner, Result

from client import Robot
from client.cli import app
from client.commands import record
from client.errors import ClientError, MotionError, RecordingError
from client.recording import DEFAULT_FIELDS, Recorder, joint_path, read
from urproto.robots import kinematics_of, load_model

PATIENCE_S = 30.0
HOME = (0.2, -1.4, 1.5, -1.7, -1.5, 0.1)
GOAL = (0.35, -1.3, 1.4, -1.7, -1.4, 0.3)
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="emulators need the loopback addresses of Linux")


@pytest.fixture(scope="module")
def emulator(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatorProcess]:
    process = EmulatorProcess(["--model", "ur5e", "--running"])
    process.start()
    yield process
    process.stop()
    process.dispose()


def call(*arguments: str) -> Result:
    return CliRunner().invoke(app, arguments)


@contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A command in a process of its own; it has begun its work."""
    command = (sys.executable, "-c", "from client.cli import main; main()", *arguments)
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr
        assert "Ctrl-C ends it" in process.stderr.readline()
        yield process
    finally:
        process.kill()
        process.communicate(timeout=PATIENCE_S)


def move(emulator: EmulatorProcess) -> None:
    with Robot(emulator.host) as robot:
        robot.make_ready()
        for goal in (HOME, GOAL, HOME):
            robot.move_j(goal, speed_rad_s=1.0, acceleration_rad_s2=3.0)


@pytest.mark.parametrize(
    ("suffix", "number"),
    [
        (".mcap", signal.SIGTERM),
        *(pytest.param(suffix, signal.SIGINT, marks=pytest.mark.long) for suffix in (".mcap", ".csv", ".npz")),
    ],
)
def test_a_signal_finishes_the_file(emulator, tmp_path: Path, suffix: str, number: signal.Signals) -> None:
    file = tmp_path / f"run{suffix}"
    with running("record", str(file), "--robot-ip", emulator.host) as process:
        call("record", str(tmp_path / "while.csv"), "--duration", "0.2", "--robot-ip", emulator.host)
        process.send_signal(number)
        output, _ = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0
    recording = read(file)
    assert "cut_off" not in recording.info
    assert output == f"{file}: {len(recording)} states\n"
    assert len(recording) >= 10  # of 100 or more: a busy machine may lose some on the way
    steps = np.diff(recording["timestamp"])
    assert np.median(steps) == pytest.approx(0.002)
    assert np.all(steps > 0.0)


@pytest.mark.long
def test_ctrl_c_stops_the_arm_softly_and_finishes_the_recording(emulator, tmp_path: Path) -> None:
    file = tmp_path / "goal.mcap"
    with Robot(emulator.host) as robot:
        robot.make_ready()
        robot.move_j(HOME, speed_rad_s=1.0)
    # so slowly that the arm is not half way on a busy machine either
    positions = ("--positions", "1.6,-1.4,1.5,-1.7,-1.5,0.1", "--time", "20")
    command = (sys.executable, "-c", "from client.cli import main; main()", "goal", *positions)
    process = subprocess.Popen([*command, "--record", str(file), "--robot-ip", emulator.host], stderr=subprocess.PIPE)
    try:
        emulator.control.run_until("actual_qd[0] > 0.04", PATIENCE_S)
        process.send_signal(signal.SIGINT)
        _, output = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
        process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert b"stopped" in output
    found = read(file)
    assert "cut_off" not in found.info
    speeds = found["target_qd"][:, 0]
    assert 0.04 < max(speeds) < 0.12
    assert speeds[-1] == pytest.approx(0.0, abs=1e-6)  # it came to rest before the recording ended
    assert found["actual_q"][-1][0] < 1.5
    braking = -np.diff(speeds) / np.diff(found["timestamp"])
    assert max(braking) < 10.0  # rad/s2


def test_requested_fields_are_recorded(emulator, tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    fields = ("--fields", "actual_q,robot_mode", "--fields", "payload")
    result = call("record", str(file), *fields, "--frequency", "50", "--duration", "0.4", "--robot-ip", emulator.host)
    assert result.exit_code == 0, result.output
    recording = read(file)
    assert list(recording.values) == ["timestamp", "actual_q", "robot_mode", "payload"]
    assert len(recording) == 21
    assert isinstance(call("record", str(file), "--robot-ip", emulator.host).exception, RecordingError)  # it is there


def test_what_is_around_the_arm_is_drawn(emulator, tmp_path: Path) -> None:
    pytest.importorskip("ompl")
    world, file = tmp_path / "cell.yaml", tmp_path / "run.mcap"
    world.write_text("tool: {sphere: 0.01}\nobjects: {post: {box: [0.1, 0.1, 1.0], pose: [-0.5, 0, 0.5]}}\n")
    order = ("--scene", str(world), "--frequency", "20", "--robot-ip", emulator.host)
    result = call("record", str(file), *order, "--duration", "1.5")
    assert result.exit_code == 0, result.output
    scenes = _markers(file)["/planning_scene"]
    drawn = [[(marker.ns, marker.header.frame_id) for marker in markers] for markers in scenes]
    assert len(drawn) == len(read(file))
    assert [[name for name, _ in markers] for markers in drawn].count(["post", "tool"]) == 2  # once a second
    assert drawn[1] == [("tool", "base")]
    for wrong, words in (
        (("record", str(tmp_path / "run.csv"), *order), "--scene and --plan need an .mcap file"),
        (("stream", "--plotjuggler", "udp://127.0.0.1:9", *order), "--scene and --plan need --foxglove"),
    ):
        assert words in " ".join(call(*wrong).output.split())
    refused = call("record", str(tmp_path / "other.mcap"), *order, "--fields", "robot_mode").exception
    assert isinstance(refused, RecordingError)
    assert "actual_q" in str(refused)


@pytest.mark.long
def test_an_execution_is_recorded_with_its_scene_and_its_way(emulator, tmp_path: Path) -> None:
    """Read by libraries that are not ours; the way that is drawn is the one that the arm took."""
    pytest.importorskip("ompl")
    world, file, plan = tmp_path / "cell.yaml", tmp_path / "run.mcap", tmp_path / "plan.json"
    world.write_text("tool: {sphere: 0.01}\nobjects: {post: {box: [0.1, 0.1, 1.0], pose: [0.5, 0, 0.5]}}\n")
    robot = ("--robot-ip", emulator.host)
    quick = ("--velocity", "1", "--acceleration", "1")
    order = ("plan", ",".join(map(str, GOAL)), "--scene", str(world), "--json", *robot)
    result = call(*order, *quick, "--execute", "--make-ready", "--record", str(file))
    assert result.exit_code == 0, result.output
    plan.write_text(result.stdout)
    assert json.loads(result.stdout)["positions"][-1] == pytest.approx(GOAL)
    drawn = _markers(file)
    flange = kinematics_of(load_model("ur5e")).forward
    way = [(point.x, point.y, point.z) for point in drawn["/planned_path"][0][0].points]
    assert way[-1] == pytest.approx(flange(GOAL)[:3])
    recording = read(file)
    taken = [flange(q)[:3] for q in recording["actual_q"][::20]]
    assert max(_beside(np.array(place), np.array(way)) for place in taken) < 0.003
    assert dist(taken[0], way[0]) < 0.001 > dist(taken[-1], way[-1])
    first, *later = drawn["/planning_scene"]
    assert {marker.ns for marker in first} == {"post", "tool"}
    tools = [marker.pose.position for markers in later for marker in markers if marker.ns == "tool"]
    assert dist((tools[-1].x, tools[-1].y, tools[-1].z), way[-1]) < 0.02  # it went with the arm

    other = tmp_path / "other.mcap"
    result = call("record", str(other), "--plan", str(plan), "--frequency", "20", "--duration", "0.5", *robot)
    assert result.exit_code == 0, result.output
    ((again,),) = _markers(other)["/planned_path"]
    assert [(point.x, point.y, point.z) for point in again.points] == pytest.approx(way)
    for wrong, words in (
        (("record", str(tmp_path / "a.mcap"), "--plan", str(world), *robot), "create one with `ur-client plan"),
        ((*order, "--record", str(tmp_path / "b.mcap")), "add --execute"),
        ((*order, "--markers", str(tmp_path / "c.csv")), "--markers writes .mcap files"),
    ):
        refused = call(*wrong)
        assert words in " ".join(f"{refused.output} {refused.exception}".replace("│", "").split())


def _beside(place: Any, way: Any) -> float:
    """How far a place is from the pieces of a line (n, 3) [m]."""
    begin, along = way[:-1], np.diff(way, axis=0)
    share = np.clip(((place - begin) * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
    return float(np.linalg.norm(begin + share[:, None] * along - place, axis=1).min())


def _markers(file: Path) -> dict[str, list[list[Any]]]:
    """Of each topic that has some, message by message."""
    found: dict[str, list[list[Any]]] = {}
    topics = ["/planning_scene", "/planned_path"]
    with file.open("rb") as stream:
        messages = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(topics)
        for _, channel, _, message in messages:
            found.setdefault(channel.topic, []).append(message.markers)
    return found


# Records at the robot's rate in real time: a recorder that a busy machine holds up misses states, and a path with holes
# is refused for the accelerations that they would take.
@pytest.mark.flaky(reruns=2)
@pytest.mark.long
def test_the_arm_goes_along_a_recorded_path(emulator, tmp_path: Path) -> None:
    first, second = tmp_path / "first.mcap", tmp_path / "second.mcap"
    for file, what in ((first, lambda: move(emulator)), (second, lambda: _replayed(emulator, first))):
        with running("record", str(file), "--robot-ip", emulator.host) as process:
            what()
            process.send_signal(signal.SIGINT)
            process.wait(PATIENCE_S)
    path, again = joint_path(read(first)), read(second)
    recorded = path.at(np.arange(0.0, path.duration_s, 0.01))
    later = again["actual_q"][::5]
    nearest = [float(np.min(np.max(np.abs(later - q), axis=1))) for q in recorded]
    assert max(nearest) < 0.01  # it was everywhere, between two states too
    picture = tmp_path / "again.png"
    result = call("plot", str(second), "-o", str(picture))
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "largest position error: 0.0" in result.output


def _replayed(emulator: EmulatorProcess, file: Path) -> None:
    result = call("replay", str(file), "--robot-ip", emulator.host)
    assert result.exit_code == 0, result.output
    assert ": replayed " in result.output


@pytest.mark.long
def test_a_program_records_its_own_robot(emulator, tmp_path: Path) -> None:
    file = tmp_path / "own.mcap"
    with Recorder(file) as recorder, Robot(emulator.host, outputs=DEFAULT_FIELDS) as robot:
        robot.inner.driver.link.on_state.append(recorder.write)
        robot.make_ready()
        robot.move_j(HOME, speed_rad_s=1.0)
        robot.move_j(GOAL, speed_rad_s=1.0)
    recording = read(file)
    assert len(recording) == recorder.count > 100
    assert recording["actual_q"][-1] == pytest.approx(GOAL, abs=1e-3)


@pytest.mark.long
def test_too_fast_is_refused_before_anything_moves(emulator, tmp_path: Path) -> None:
    file = tmp_path / "run.npz"
    with running("record", str(file), "--robot-ip", emulator.host) as process:
        move(emulator)
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE_S)
    with Robot(emulator.host) as robot:
        before = robot.q
    result = call("replay", str(file), "--speed", "10", "--robot-ip", emulator.host)
    assert isinstance(result.exception, MotionError)
    assert "try --speed" in str(result.exception)
    with Robot(emulator.host) as robot:
        assert robot.q == pytest.approx(before, abs=1e-6)


def test_a_real_arm_does_not_move_unasked(emulator, tmp_path: Path, monkeypatch) -> None:
    file = tmp_path / "run.npz"
    call("record", str(file), "--duration", "0.2", "--robot-ip", emulator.host)
    monkeypatch.setattr(record, "is_loopback", lambda address: False)
    result = call("replay", str(file), "--robot-ip", emulator.host)
    assert isinstance(result.exception, ClientError)
    assert "Is the path clear? There is no terminal to answer from: pass --yes" in str(result.exception)
    assert call("replay", str(file), "--yes", "--make-ready", "--robot-ip", emulator.host).exit_code == 0


def test_plotjuggler_is_sent_what_the_robot_does(emulator) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(PATIENCE_S)
        to = f"udp://127.0.0.1:{receiver.getsockname()[1]}"
        with running("stream", "--plotjuggler", to, "--fields", "actual_q", "--robot-ip", emulator.host):
            first, second = (json.loads(receiver.recv(2048)) for _ in range(2))
    assert len(first["actual_q"]) == 6
    assert second["timestamp"] - first["timestamp"] == pytest.approx(0.02, abs=1e-4)
    assert second["robot_time"] - first["robot_time"] == pytest.approx(0.02, abs=1e-4)


def test_a_stream_has_to_go_somewhere() -> None:
    result = call("stream")
    assert result.exit_code == 2
    assert "nowhere to stream to" in result.output
