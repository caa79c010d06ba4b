"""ur-client calibration, describe and doctor, and the driver's check, against a calibrated robot."""

import asyncio
import threading
from collections.abc import Iterator
from pathlib import Path

import pinocchio as pin
import pytest
import yaml
from typer.testing import CliRunner

from client import Robot, read_calibration
from client.calibration import calibration_of
from client.cli import app
from client.driver.config import calibration_problem
from client.errors import FileError
from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.config import read_calibration as calibrated
from emulator.machine import ControllerConfig
from tests.rows import each_row
from urproto.errors import RobotRefused
from urproto.modes import KinematicsStatus
from urproto.primary.subpackages import KinematicsInfo
from urproto.robots import Calibration, CalibrationError, load_model
from urproto.testing.process import claim_address

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
UR5E, UR5 = GOLDEN / "calibration_ur5e.yaml", GOLDEN / "calibration_ur5.yaml"
HOME = (0.2, -1.4, 1.5, -1.7, -1.5, 0.1)
PATIENCE_S = 20.0


@pytest.fixture(scope="module")
def host() -> Iterator[str]:
    """The address of a calibrated UR5e."""
    address = claim_address()
    if address.shared:
        pytest.skip("the commands want the usual ports, and there is no own address")
    model = calibrated(UR5E, load_model("ur5e"))
    config = EmulatorConfig(
        controller=ControllerConfig(model=model, initial_q=HOME, running=True), host=address.host, control=False
    )
    loop, robot = asyncio.new_event_loop(), Emulator(config)
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    try:
        asyncio.run_coroutine_threadsafe(robot.__aenter__(), loop).result(PATIENCE_S)
        yield address.host
        asyncio.run_coroutine_threadsafe(robot.__aexit__(None, None, None), loop).result(PATIENCE_S)
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()
        address.release()


def run(*arguments: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


def test_the_file_of_a_robot_is_the_one_it_was_made_of(host: str, tmp_path: Path) -> None:
    file = tmp_path / "arm.yaml"
    status, text = run("calibration", "--robot-ip", host, "-o", file)
    assert status == 0
    assert text.strip() == f"{file}: calib_14698139022496758595"
    assert list(yaml.safe_load(file.read_text())["kinematics"]) == [
        *("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3", "hash")
    ]
    assert read_calibration(file).is_whole


def test_only_the_right_arm_is_driven(host: str) -> None:
    calibration = read_calibration(UR5E)
    with Robot(host, calibration=calibration) as robot:
        assert robot.tcp_pose_at(robot.q) == pytest.approx(robot.tcp_pose, abs=1e-9)
    with pytest.raises(RobotRefused, match="calib_14698139022496758595, not calib_15200003067234149431"):
        Robot(host, calibration=read_calibration(UR5)).__enter__()


def test_description_of_a_robot(host: str, tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    status, text = run("describe", "--robot-ip", host, "-o", file)
    assert (status, text.strip()) == (0, f"{file}: UR5e, calibrated")
    from_file = tmp_path / "from_file.urdf"
    assert run("describe", "ur5e", "--calibration", UR5E, "-o", from_file)[0] == 0
    one, other = pin.buildModelFromUrdf(str(file)), pin.buildModelFromUrdf(str(from_file))
    for mine, its in zip(one.jointPlacements, other.jointPlacements, strict=True):
        assert mine.isApprox(its, 1e-9)


def test_doctor_of_a_robot(host: str) -> None:
    status, text = run("doctor", host, "--calibration", UR5E)
    assert status == 0, text
    for subject in ("port 30004", "round trip", "PolyScope: 5.", "RTDE stream", "jitter", "matches this robot"):
        assert subject in text
    status, text = run("doctor", host, "--calibration", UR5)
    assert status == 1
    assert f"ur-client calibration --robot-ip {host} -o {UR5}" in text


def test_doctor_without_a_robot() -> None:
    status, text = run("doctor", "127.0.0.1", "--port-offset", "-29000")
    assert status == 1
    assert "primary is closed" in text
    assert "-> ping 127.0.0.1" in text
    status, text = run("doctor")
    assert status == 0
    assert "kernel: " in text
    assert "Python 3." in text


@each_row(
    ("arguments", "problem"),
    [
        (("describe",), "either a model or --robot-ip"),
        (("describe", "ur99"), "unknown robot model"),
        (("describe", "ur5e", "--meshes", "/nonexistent"), "has no visual/base"),
    ],
)
def test_wrong_use(arguments: tuple[str, ...], problem: str) -> None:
    status, text = run(*arguments)
    assert status == 2
    assert problem in " ".join(text.replace("\u2502", " ").split())


def test_files_that_cannot_be_used(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.yaml"
    with pytest.raises(FileError, match="No such file"):
        read_calibration(wrong)
    wrong.write_text("a: [")
    with pytest.raises(FileError, match="not YAML"):
        read_calibration(wrong)
    wrong.write_text("kinematics: {shoulder: 1}")
    with pytest.raises(FileError, match="shoulder is missing"):
        read_calibration(wrong)
    with pytest.raises(FileError):
        run("describe", "ur5e", "-o", tmp_path / "missing" / "arm.urdf")
    assert Calibration.of(load_model("ur5e").dh).is_whole


@pytest.mark.parametrize("status", [KinematicsStatus.NOT_INITIALISED, KinematicsStatus.LINEARISED])
def test_a_simulator_and_a_calibrated_arm_have_no_problem(status: KinematicsStatus) -> None:
    assert calibration_problem(kinematics(status), None) is None
    assert calibration_of(kinematics(status)).dh == load_model("ur5e").dh


def test_an_arm_without_linearisation() -> None:
    assert "status is 1" in str(calibration_problem(kinematics(KinematicsStatus.NOT_LINEARISED), None))
    with pytest.raises(CalibrationError, match="status is 1"):
        calibration_of(kinematics(KinematicsStatus.NOT_LINEARISED))


def kinematics(status: KinematicsStatus) -> KinematicsInfo:
    dh = load_model("ur5e").dh
    return KinematicsInfo(dh_theta=dh.theta, dh_a=dh.a, dh_d=dh.d, dh_alpha=dh.alpha, status=status)
