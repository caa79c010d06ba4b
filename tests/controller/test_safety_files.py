"""Safety configurations from files: YAML, and the text that PolyScope stores in installations."""

import gzip
import math
from dataclasses import replace
from pathlib import Path

import pytest

from emulator.config import ConfigError, read_safety
from tests.rows import each_row
from urproto.robots import MODELS, load_model
from urproto.versions import Series
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.safety_configuration import (
    BoundaryMode,
    Plane,
    SafetyInput,
    SafetyOutput,
    ToolSphere,
    factory_configuration,
)

# in the form of PolyScope 5.8, shortened to one plane
SETTINGS = """
[SafetyLimits Normal Values]
maxTcpSpeed = 1.2
maxForce = 140.0
maxElbowSpeed = 1.1
maxElbowForce = 130.0
maxStoppingDistance = 0.5
maxStoppingTime = 0.4
maxPower = 290.0
maxMomentum = 24.0

[SafetyLimits Normal Joints]
maxJointSpeed = [3.3, 3.3, 3.3, 3.3, 3.3, 3.3]
minJointPosition = [6.230825429179586, 1.0, 1.0, 1.0, 1.0, 1.0]
maxJointPosition = [0.05235987799999986, 2.0, 2.0, 2.0, 2.0, 2.0]
minJointRevolutions = [-2, -1, -1, -1, -1, -1]
maxJointRevolutions = [1, 0, 0, 0, 0, 0]

[SafetyLimits Reduced Values]
maxTcpSpeed = 0.75
maxForce = 120.0
maxElbowSpeed = 0.75
maxElbowForce = 120.0
maxStoppingDistance = 0.3
maxStoppingTime = 0.3
maxPower = 200.0
maxMomentum = 10.0

[SafetyLimits Reduced Joints]
maxJointSpeed = [2.0, 2.0, 2.0, 2.0, 2.0, 2.0]
minJointPosition = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
maxJointPosition = [1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
minJointRevolutions = [0, 0, 0, 0, 0, 0]
maxJointRevolutions = [0, 0, 0, 0, 0, 0]

[SafetySetup]
withPositionLimits = [true, true, true, true, true, false]
verified = true

[Safety Checksum]
version = 5.8
crc = 924418886

[SafetyLimits BoundaryPlane0]
name = Tabletop
displacement = 0.014
mode = NORMAL
planeNormal = [-0.0, -0.0, 2.0]
distanceToOrigin = 0.014
elbowRestricted = true

[SafetyLimits ToolOrientation]
tcpOrientationVector = [0.0, 0.0, 1.0]
maximumTcpOrientationDeviation = 3.159045946109736
mode = DISABLED

[SafetyIOConfiguration Inputs]
emergencyStopInputA = 0
emergencyStopInputB = 1
reducedModeInputA = 255
reducedModeInputB = 255

[SafetyIOConfiguration Outputs]
robotMovingOutputA = 2
robotMovingOutputB = 3

[WorkpieceConfiguration]
toolSpheres = [[0.0, 0.0, 0.0, 0.0, 2], [0.0, 0.0, 0.1, 0.05, 1], [0.0, 0.0, 0.3, 0.1, 0]]
"""


@pytest.fixture
def write(tmp_path):
    def write(text, name="safety.yaml"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


@each_row("name", MODELS)
def test_every_arm_has_the_factory_limits_of_its_series(name):
    model = load_model(name)
    found = factory_configuration(model)
    assert (found.normal.tcp_speed, found.normal.force, found.normal.power, found.normal.momentum) == (
        1.5,
        150,
        300,
        25,
    )
    assert (found.reduced.tcp_speed, found.reduced.force, found.reduced.power) == (0.75, 120, 200)
    assert math.isinf(found.normal.elbow_speed) is (model.series is Series.CB3)
    assert found.checksum > 0
    assert found.normal.joint_max[0] == pytest.approx(math.radians(363.0))


def test_an_installation(tmp_path):
    path = tmp_path / "default.installation"
    xml = f'<Installation fileName="default"><SafetySettings>{SETTINGS}</SafetySettings></Installation>'
    path.write_bytes(gzip.compress(xml.encode()))
    found = read_safety(path, load_model("ur5e"))
    assert found.normal.tcp_speed == 1.2
    assert found.normal.elbow_force == 130.0
    assert (found.normal.joint_min[0], found.normal.joint_max[0]) == pytest.approx(
        (-math.radians(363.0), math.radians(363.0)), abs=1e-6
    )
    assert found.normal.joint_min[1] == pytest.approx(1.0 - math.tau)
    assert found.normal.joint_max[5] == math.inf
    assert found.reduced.joint_speed == (2.0,) * 6
    assert found.checksum == 924418886
    assert found.planes == (Plane("Tabletop", (0.0, 0.0, 1.0), 0.014, BoundaryMode.NORMAL, elbow=True),)
    assert found.tool_orientation is None
    assert found.tool_spheres == (ToolSphere((0.0, 0.0, 0.1), 0.05),)
    assert found.inputs == {SafetyInput.EMERGENCY_STOP: (0, 1)}
    assert found.outputs == {SafetyOutput.ROBOT_MOVING: (2, 3)}
    assert found.safe_home is None


def test_yaml_changes_only_the_named_settings(write):
    path = write(
        """
        preset: restricted
        normal: {tcp_speed: 1.0, joint_max: [1, 1, 1, 1, 1, 1]}
        planes: [{name: table, normal: [0, 0, 5], distance: 0.1, mode: trigger, elbow: true}]
        tool_orientation: {direction: [0, 0, -1], deviation: 0.5, mode: normal}
        inputs: {reduced_mode: [4, 5]}
        outputs: {safe_home: [0, 1]}
        safe_home: [0, -1.57, 0, -1.57, 0, 0]
        """
    )
    found = read_safety(path, load_model("ur5e"))
    assert (found.normal.tcp_speed, found.normal.force, found.reduced.force) == (1.0, 120.0, 100.0)
    assert found.normal.joint_max == (1.0,) * 6
    assert found.planes[0].depth((0.0, 0.0, -0.3)) == pytest.approx(-0.2)
    assert found.tool_orientation.deviation == 0.5
    assert found.inputs == {SafetyInput.REDUCED_MODE: (4, 5)}
    assert found.safe_home[1] == -1.57


def test_an_empty_file_is_the_factory_configuration_except_for_the_checksum(write):
    model = load_model("ur5")
    found, factory = read_safety(write(""), model), factory_configuration(model)
    assert (found.normal, found.reduced, found.inputs) == (factory.normal, factory.reduced, factory.inputs)


def test_the_checksum_follows_every_change(write):
    model = load_model("ur5e")
    texts = [
        "",
        "normal: {force: 149}",
        "reduced: {force: 119}",
        "outputs: {robot_moving: [0, 1]}",
        "safe_home: [0,0,0,0,0,0]",
    ]
    sums = {read_safety(write(text), model).checksum for text in texts}
    assert len(sums) == len(texts)
    assert all(0 < number < 2**32 for number in sums)


@each_row(
    ("text", "message"),
    [
        ("speed: 1", "unknown 'speed'; allowed are preset, normal"),
        ("normal: {tcp_speed: fast}", "normal.tcp_speed must be a number, not text"),
        ("normal: {tcp_speed: -1}", "normal.tcp_speed must be a number > 0.0"),
        ("normal: {tcp_speed: .nan}", "normal.tcp_speed must be a number > 0.0"),
        ("normal: {joint_max: [1, 2]}", "normal.joint_max must be a list of length 6, not 2"),
        ("normal: {joint_min: [7, 7, 7, 7, 7, 7]}", "joint_min must be below joint_max"),
        ("normal: {joint_speed: [0, 1, 1, 1, 1, 1]}", "joint_speed must be positive"),
        ("normal: {elbow_speed: 1}", "UR5 has no limit elbow_speed"),
        ("preset: soft", "preset: unknown 'soft'; allowed are default, least"),
        ("planes: [{normal: [0, 0, 0]}]", "normal must not be zero"),
        (
            "planes: [{normal: [0, 0, 1], mode: sometimes}]",
            "mode: unknown 'sometimes'; allowed are both, disabled,",
        ),
        ("planes: 3", "planes must be a list, not a whole number"),
        (
            "tool_orientation: {direction: [0, 0, 1], deviation: 4}",
            "deviation must be a number < 3.14",
        ),
        ("inputs: {emergency_stop: [0, 8]}", "inputs: emergency_stop[1] must be a whole number <= 7"),
        ("inputs: {emergency_stop: [0, 1], reduced_mode: [1, 2]}", "share pin 1"),
        ("outputs: {bell: [0, 1]}", "outputs: unknown function 'bell': choose one of system_emergency_stop"),
        ("manual_high_speed: 1", "manual_high_speed must be true or false"),
        ("- 1", ": it must be a mapping"),
        ("normal: [", "not YAML"),
    ],
)
def test_errors_name_the_setting(write, text, message):
    with pytest.raises(ConfigError, match=message.replace("[", r"\[")) as error:
        read_safety(write(text), load_model("ur5"))
    assert "safety.yaml" in str(error.value)


@each_row(
    ("settings", "message"),
    [
        ("nothing", "is missing"),
        (SETTINGS.replace("maxForce = 140.0", ""), "has no maxForce"),
        (SETTINGS.replace("mode = NORMAL", "mode = ODD"), "mode = ODD"),
        (SETTINGS.replace("[3.3, 3.3, ", "["), "6 numbers"),
        (SETTINGS.replace("[-0.0, -0.0, 2.0]", "[0.0, 0.0, 0.0]"), "no direction"),
    ],
)
def test_errors_in_an_installation_name_the_setting(tmp_path, settings, message):
    path = tmp_path / "x.installation"
    path.write_text(f"<Installation><SafetySettings>{settings}</SafetySettings></Installation>")
    with pytest.raises(ConfigError, match=message):
        read_safety(path, load_model("ur5e"))


def test_files_without_safety_settings(tmp_path):
    with pytest.raises(ConfigError, match="cannot read"):
        read_safety(tmp_path / "missing.yaml", load_model("ur5"))
    path = tmp_path / "x.installation"
    path.write_bytes(b"\\x00\\x01")
    with pytest.raises(ConfigError, match="not an installation"):
        read_safety(path, load_model("ur5"))
    path.write_text("<Installation></Installation>")
    with pytest.raises(ConfigError, match="no safety settings"):
        read_safety(path, load_model("ur5"))


def test_an_installation_with_another_safety_configuration_is_noted(make):
    own = factory_configuration(load_model("ur5e"))
    other = replace(own, normal=replace(own.normal, force=own.normal.force + 1.0), crc=None)
    rig = make("ur5e", running=True, safety=own)

    def noted(safety):
        before = len(rig.controller.messages.history)
        rig.controller.apply_installation(Path("cell.installation"), InstallationFile(safety=safety))
        return [line for line in list(rig.controller.messages.history)[before:] if "is not the active one" in line]

    assert noted(None) == []
    assert noted(own) == []
    (line,) = noted(other)
    assert f"of cell.installation (checksum {other.checksum})" in line
    assert f"({own.checksum})" in line
    assert rig.controller.safety_board.configuration is own
