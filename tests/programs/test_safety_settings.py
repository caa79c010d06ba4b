"""The safety configuration of an installation file, changed row by row, and in force on the emulated robot."""

import gzip
from dataclasses import replace
from functools import cache
from math import isfinite, pi, radians

import pytest

from emulator.machine import ControllerConfig
from emulator.safety.files import load_safety_file
from emulator.virtual import VirtualRobot
from tests.rows import each_row
from urproto.controlapi import BadArguments
from urproto.robots import MODELS, load_model
from urproto.versions import DEFAULT_VERSION
from urscript.polyscope.document import make, read_document, write_document
from urscript.polyscope.installation_sections import SettingError, new_element
from urscript.polyscope.installation_settings import change_setting, new_installation, read_section
from urscript.polyscope.safety_configuration import (
    BoundaryMode,
    Plane,
    SafetyInput,
    ToolOrientation,
    factory_configuration,
    simulator_configuration,
)
from urscript.polyscope.safety_section import read_safety_settings
from urscript.polyscope.safety_text import settings_text, value_of, with_value

UR5E = load_model("ur5e")


@cache
def _file(name):
    model = load_model(name)
    root = new_installation(DEFAULT_VERSION[model.series])
    new_element(root, "SafetySettings", {}).text = settings_text(factory_configuration(model), model)
    return write_document(root)


def saved(name="ur5e"):
    """An installation with the factory safety configuration."""
    return read_document(_file(name))


def safety(root):
    return read_safety_settings(read_document(write_document(root)).child("SafetySettings").text)


@each_row("name", MODELS)
def test_a_configuration_round_trips(name):
    model = load_model(name)
    full = replace(
        factory_configuration(model),
        planes=(Plane("table", (0.0, 0.0, 1.0), 0.25, BoundaryMode.BOTH),),
        tool_orientation=ToolOrientation((0.0, 0.0, -1.0), 0.5, BoundaryMode.NORMAL),
        inputs={SafetyInput.EMERGENCY_STOP: (2, 3)},
    )
    read = read_safety_settings(settings_text(full, model))
    assert replace(read, normal=full.normal, reduced=full.reduced, inputs=dict(read.inputs)) == full
    for mine, theirs in ((read.normal, full.normal), (read.reduced, full.reduced)):
        assert mine.tcp_speed == theirs.tcp_speed
        assert mine.joint_speed == theirs.joint_speed
        assert mine.joint_min == pytest.approx(theirs.joint_min)
        assert mine.joint_max == pytest.approx(theirs.joint_max)
    assert isfinite(read_safety_settings(settings_text(simulator_configuration(model), model)).normal.tcp_speed)


def test_one_value_changes_one_line_and_the_checksum():
    root, before = saved(), write_document(saved()).decode().splitlines()
    change_setting(root, "safety_limits", "TCP force [N]", {"reduced": 90.0})
    after = write_document(root).decode().splitlines()
    assert [line for line in after if line not in before] == ["crc = 0", "maxForce = 90.0"]
    assert len(after) == len(before)
    assert safety(root).reduced.force == 90.0
    assert safety(root).crc is None


@each_row(
    ("section", "name", "values", "found"),
    [
        ("safety_limits", "TCP speed [m/s]", {"normal": 0.5}, lambda s: s.normal.tcp_speed == 0.5),
        ("safety_limits", "Stopping time [s]", {"reduced": 0.25}, lambda s: s.reduced.stopping_time == 0.25),
        (
            *("safety_joints", "Elbow", {"normal_min": radians(-100), "normal_max": radians(20), "reduced_speed": 1.0}),
            lambda s: (
                (s.normal.joint_min[2], s.normal.joint_max[2], s.reduced.joint_speed[2])
                == pytest.approx((radians(-100), radians(20), 1.0))
            ),
        ),
        ("safety_joints", "Wrist 3", {"limited": False}, lambda s: not isfinite(s.normal.joint_max[5])),
        (
            *("safety_planes", "3", {"name": "table", "mode": "BOTH", "normal": [0, 0, 1], "distance": 0.1}),
            lambda s: s.planes == (Plane("table", (0.0, 0.0, 1.0), 0.1, BoundaryMode.BOTH, elbow=True),),
        ),
        (
            *("safety_tool_direction", "", {"mode": "REDUCED", "direction": [0, 0, -1], "deviation": 0.3}),
            lambda s: s.tool_orientation == ToolOrientation((0.0, 0.0, -1.0), 0.3, BoundaryMode.REDUCED),
        ),
        ("safety_io", "reducedModeInput", {"pins": "4, 5"}, lambda s: s.inputs[SafetyInput.REDUCED_MODE] == (4, 5)),
        ("safety_io", "safeguardStopResetInput", {"pins": ""}, lambda s: not s.inputs),
        (
            *("safety_home", "", {"defined": True, "q1": -pi / 2}),
            lambda s: s.safe_home == pytest.approx((0, 1.5 * pi, 0, 0, 0, 0)),
        ),
    ],
)
def test_each_setting_reads_back(section, name, values, found):
    root = saved()
    change_setting(root, section, name, values)
    assert found(safety(root))
    (row,) = [row for row in read_section(root, section) if not name or name in row.values()]
    for key, value in values.items():
        if key != "q1":
            assert row[key] == pytest.approx(value) if isinstance(value, float) else row[key] == value


def test_a_manually_moved_plane_no_longer_follows_its_feature():
    root = saved()
    settings = root.child("SafetySettings")
    section = "SafetyLimits BoundaryPlane0"
    settings.text = with_value(settings.text, section, "sourceFeatureId", "e52b")
    change_setting(root, "safety_planes", "0", {"mode": "NORMAL", "normal": [0, 0, 2 / 3]})
    text = root.child("SafetySettings").text
    assert value_of(text, section, "sourceFeatureId") is None
    assert value_of(text, section, "planeNormal") == "[0.0, 0.0, 1.0]"


@each_row(
    ("section", "name", "values", "complaint"),
    [
        ("safety_limits", "Power [W]", {"normal": 1001.0}, "more than 0 and at most 1000, not 1001"),
        ("safety_limits", "Power [W]", {"normal": 0.0}, "more than 0"),
        ("safety_joints", "Base", {"normal_min": 1.0, "normal_max": 1.0}, "must be below the maximum"),
        ("safety_joints", "Base", {"reduced_speed": 0.0}, "more than 0"),
        ("safety_planes", "0", {"mode": "BOTH"}, "no normal"),
        ("safety_planes", "9", {"mode": "BOTH"}, "there is no '9'"),
        ("safety_tool_direction", "", {"direction": [0, 0, 0]}, "zero vector"),
        ("safety_tool_direction", "", {"mode": "BOTH"}, "less than 180°"),
        ("safety_io", "reducedModeInput", {"pins": "0, 1"}, "already have the function safeguardStopResetInput"),
        ("safety_io", "reducedModeInput", {"pins": "0, 2"}, "must be one of"),
    ],
)
def test_invalid_configurations_are_refused_and_change_nothing(section, name, values, complaint):
    root = saved()
    with pytest.raises(SettingError, match=complaint):
        change_setting(root, section, name, values)
    assert write_document(root) == write_document(saved())


def test_text_without_a_configuration_is_refused():
    root = new_installation(DEFAULT_VERSION[UR5E.series])
    root.children.append(make("SafetySettings", text="[SafetyLimits Normal Values]\nmaxForce = none\n"))
    assert read_section(root, "safety_limits") == []
    with pytest.raises(SettingError, match="cannot be read"):
        change_setting(root, "safety_limits", "TCP force [N]", {"normal": 100.0})


@pytest.mark.parametrize("model", ["ur5", "ur5e"])
def test_a_change_applies_immediately_with_the_arm_off_or_after_a_restart(tmp_path, model):
    def started(**config):
        return VirtualRobot(ControllerConfig(model=load_model(model), running=True, programs_dir=tmp_path, **config))

    robot = started()
    checksum = robot.controller.snapshot.safety_checksum
    assert robot.installation("safety_joints")["sections"]["safety_joints"][0]["joint"] == "Base"
    robot.change_installation("mounting", {"tilt": 0.1})
    path = tmp_path / "default.installation"
    assert b"SafetySettings" not in gzip.decompress(path.read_bytes())
    robot.change_installation("safety_joints", {"normal_max": -1.0}, "Shoulder")
    robot.step(2)
    assert robot.state(["robot_mode"]) == {"robot_mode": "POWER_OFF"}
    assert robot.controller.snapshot.safety_checksum != checksum
    robot.release_brakes()
    robot.run_until("robot_mode == RUNNING")
    robot.send_script("def far():\n  movej([-1.6, 0.5, -2.2, -0.8, 1.6, 0])\nend\n")
    robot.run_until("safety_mode == PROTECTIVE_STOP", 20.0)
    assert robot.state(["actual_q"])["actual_q"][1] < -1.0
    with pytest.raises(BadArguments, match="must be below the maximum"):
        robot.change_installation("safety_joints", {"normal_min": 3.0}, "Shoulder")
    configuration = load_safety_file(path, load_model(model))
    assert configuration == robot.controller.safety_board.configuration
    again = started(safety=configuration)
    again.step()
    assert again.controller.snapshot.safety_checksum == robot.controller.snapshot.safety_checksum
