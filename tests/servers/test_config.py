from pathlib import Path
from typing import Any

import pytest
import yaml

from emulator.config import (
    ConfigError,
    EmulatorConfig,
    choose_model,
    controller_config,
    read_calibration,
    read_initial_positions,
    read_programs_dir,
)
from emulator.machine import ControllerConfig
from emulator.ports import PORTS
from tests.rows import each_row
from urproto.joints import JOINT_NAMES
from urproto.robots import MODELS, Calibration, calibration_hash, choose_version, load_model
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series

# ur_description's config/initial_positions.yaml
UR_DESCRIPTION = """shoulder_pan_joint: 0.0
shoulder_lift_joint: -1.57
elbow_joint: 0.0
wrist_1_joint: -1.57
wrist_2_joint: 0.0
wrist_3_joint: 0.0
"""


def test_models() -> None:
    assert choose_model("UR3").name == "ur3"
    assert choose_model(None).name == "ur3"
    assert choose_model(None, "5.11").name == "ur3e"
    with pytest.raises(ConfigError, match="is not a PolyScope version"):
        choose_model(None, "new")
    with pytest.raises(ConfigError, match="ur99") as caught:
        choose_model("ur99")
    assert all(name in str(caught.value) for name in MODELS)


def test_versions() -> None:
    ur3, ur5e = load_model("ur3"), load_model("ur5e")
    assert choose_version(None, ur3) == DEFAULT_VERSION[Series.CB3]
    assert choose_version(None, ur5e) == DEFAULT_VERSION[Series.E]
    assert choose_version("3.14.3", ur3) == PolyscopeVersion(3, 14, 3)
    assert choose_version("5.9", ur5e) == PolyscopeVersion(5, 9)


@each_row(("model", "text"), [("ur3", "5.22"), ("ur3", "3.16"), ("ur5e", "3.15.8")])
def test_versions_the_arm_never_ran(model: str, text: str) -> None:
    with pytest.raises(ConfigError, match="requires PolyScope"):
        controller_config(model, polyscope=text)


@each_row("text", ["", "new", "5", "5.x", "-5.1"])
def test_invalid_versions(text: str) -> None:
    with pytest.raises(ConfigError, match="is not a PolyScope version"):
        controller_config("ur5e", polyscope=text)


@each_row(
    ("model", "text", "problem"),
    [
        ("ur5e", "10.6", "emulated from 10.7 to 10.13"),
        ("ur5e", "10.14.0", "emulated from 10.7 to 10.13"),
        ("ur5e", "11.0", "emulated from 10.7 to 10.13"),
        ("ur15", "10.7.0", "UR15 requires PolyScope X 10.8 or later"),
        ("ur7e", "10.8", "UR7e requires PolyScope X 10.9 or later"),
        ("ur18", "10.10.0", "UR18 requires PolyScope X 10.11 or later"),
        ("ur8long", "10.9", "UR8 Long requires PolyScope X 10.11 or later"),
        ("ur5", "10.12", r"\(CB3\) requires PolyScope 3.0 to 3.15"),
    ],
)
def test_polyscope_x_by_model(model: str, text: str, problem: str) -> None:
    assert choose_version("10.12.0", load_model("ur7e")) == PolyscopeVersion(10, 12)
    assert choose_version("10.8.0", load_model("ur15")) == PolyscopeVersion(10, 8)
    with pytest.raises(ConfigError, match=problem):
        controller_config(model, polyscope=text)


def test_polyscope_x_has_the_robot_api_instead_of_the_dashboard() -> None:
    def wanted(version: PolyscopeVersion, **options: Any) -> dict[str, int]:
        controller = ControllerConfig(model=load_model("ur5e"), version=version)
        return EmulatorConfig(controller=controller, **options).wanted_ports

    with_x, before = wanted(PolyscopeVersion(10, 12)), wanted(PolyscopeVersion(5, 25))
    assert {**before, "robot api": 80}.keys() - {"dashboard"} == with_x.keys()
    assert with_x["robot api"] == 80
    assert wanted(PolyscopeVersion(10, 12), port_offset=100)["robot api"] == 180
    assert wanted(PolyscopeVersion(10, 12), port_offset=100, robot_api_port=8080)["robot api"] == 8080
    with pytest.raises(ConfigError, match="has no Robot API"):
        wanted(PolyscopeVersion(5, 25), robot_api_port=8080)
    with pytest.raises(ConfigError, match="0 to 65535"):
        wanted(PolyscopeVersion(10, 12), robot_api_port=70000)


def test_initial_positions(tmp_path: Path) -> None:
    path = tmp_path / "initial_positions.yaml"
    path.write_text(UR_DESCRIPTION)
    assert read_initial_positions(path, load_model("ur3")) == (0.0, -1.57, 0.0, -1.57, 0.0, 0.0)


@each_row(
    ("text", "problem"),
    [
        ("", "must give radians for each of"),
        ("[1, 2, 3]", "must give radians for each of"),
        (UR_DESCRIPTION.replace("elbow_joint", "elbow"), "must give radians for each of"),
        (UR_DESCRIPTION + "gripper: 1\n", "must give radians for each of"),
        (UR_DESCRIPTION.replace("-1.57", "low", 1), "shoulder_lift_joint must be a number"),
        (UR_DESCRIPTION.replace("-1.57", "true", 1), "shoulder_lift_joint must be a number"),
        (UR_DESCRIPTION.replace("-1.57", ".nan", 1), "shoulder_lift_joint must be a finite number"),
        (UR_DESCRIPTION.replace("-1.57", "-90", 1), "shoulder_lift_joint is -90 rad"),
        ("a: b: c", "is not YAML"),
        ("!degrees 90", "is not YAML"),
    ],
)
def test_broken_initial_positions(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "positions.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=problem) as caught:
        read_initial_positions(path, load_model("ur3"))
    assert "\n" not in str(caught.value)
    assert "positions.yaml" in str(caught.value)


def test_unreadable_initial_positions(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot read"):
        read_initial_positions(tmp_path / "missing.yaml", load_model("ur3"))
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="is not YAML"):
        read_initial_positions(tmp_path / "binary.yaml", load_model("ur3"))


def test_programs_folder(tmp_path: Path) -> None:
    assert read_programs_dir(None) is None
    assert read_programs_dir(tmp_path) == tmp_path.resolve()
    with pytest.raises(ConfigError, match="not a folder"):
        read_programs_dir(tmp_path / "missing")


def test_ports() -> None:
    controller = ControllerConfig(model=load_model("ur3"))
    wanted = EmulatorConfig(controller=controller).wanted_ports
    assert {
        name: PORTS[name] for name in PORTS if name not in ("gripper", "tool line", "robot api", "cameras")
    } == wanted
    offset = EmulatorConfig(controller=controller, port_offset=100)
    assert offset.wanted_ports["dashboard"] == 30099
    assert set(EmulatorConfig(controller=controller, ephemeral_ports=True).wanted_ports.values()) == {0}
    for wrong in (-1, 40_000):
        with pytest.raises(ConfigError, match="port offset"):
            EmulatorConfig(controller=controller, port_offset=wrong)
    with pytest.raises(ConfigError, match="speed"):
        EmulatorConfig(controller=controller, speed=0.0)


def test_positions_need_six_joints() -> None:
    assert len(JOINT_NAMES) == 6


CALIBRATION = Path(__file__).resolve().parents[1] / "golden" / "calibration_ur5e.yaml"


def test_calibration_files(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    nominal = load_model("ur5e")
    assert read_calibration(None, nominal) is nominal
    model = read_calibration(CALIBRATION, nominal)
    assert model.calibration is not None
    assert calibration_hash(model.calibration) == "calib_14698139022496758595"
    assert not caplog.records
    changed = tmp_path / "changed.yaml"
    changed.write_text(CALIBRATION.read_text().replace("14698139022496758595", "1"))
    read_calibration(changed, nominal)
    assert "its hash is calib_1, but that of its parameters is calib_" in caplog.text


@each_row(
    ("text", "problem"),
    [("kinematics: {shoulder: [", "is not YAML"), ("a: 1", "neither"), ("kinematics: {}", "shoulder is missing")],
)
def test_invalid_calibration_files(tmp_path: Path, text: str, problem: str) -> None:
    file = tmp_path / "arm.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=problem) as caught:
        read_calibration(file, load_model("ur5e"))
    assert str(caught.value).count(str(file)) == 1
    with pytest.raises(ConfigError, match="not a calibration of UR3"):
        read_calibration(CALIBRATION, load_model("ur3"))
    with pytest.raises(ConfigError, match="cannot read"):
        read_calibration(tmp_path / "missing.yaml", load_model("ur5e"))


def test_a_nominal_calibration_has_no_effect(tmp_path: Path) -> None:
    file = tmp_path / "default_kinematics.yaml"
    for name in MODELS:
        model = load_model(name)
        file.write_text(yaml.safe_dump(Calibration.of(model.dh).to_mapping()))
        assert read_calibration(file, model) is model
