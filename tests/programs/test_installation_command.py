"""``ur-client installation``: creates installations for the emulator, and shows, sets and checks values of files."""

import json

import pytest
from typer.testing import CliRunner

from client.commands.installation import installation_app
from client.errors import URError
from emulator.machine import ControllerConfig
from emulator.virtual import VirtualRobot
from urproto.robots import load_model
from urscript.polyscope.document import unpacked
from urscript.polyscope.installation_file import load_installation_file
from urscript.polyscope.installation_settings import SECTIONS
from urscript.polyscope.safety_configuration import factory_configuration


def run(*arguments: object, status: int = 0) -> str:
    """What the command prints. Raises its error."""
    done = CliRunner().invoke(installation_app, [str(argument) for argument in arguments])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == status, done.output
    return done.output


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "default.installation"
    run("new", path, "--model", "ur5e", "--host", "10.1.2.3")
    return path


@pytest.mark.parametrize("model", ["ur3", "ur5e"])
def test_the_emulator_uses_an_installation_created_with_new(tmp_path, model):
    path = tmp_path / "default.installation"
    assert "for UR" in run("new", path, "--model", model, "--host", "10.1.2.3", "--port", 50010)
    assert run("check", path).endswith("no problems found\n")
    arm = load_model(model)
    robot = VirtualRobot(ControllerConfig(model=arm, programs_dir=tmp_path))
    assert robot.external_control() == {"host": "10.1.2.3", "port": 50010}
    assert load_installation_file(path).safety.checksum == factory_configuration(arm).checksum


def test_values_are_set_and_shown_in_user_units(path):
    before = unpacked(path.read_bytes()).splitlines()
    run("set", path, "tcps", "pose=[0,0,0.15,0,0,1.5]", "--row", "TCP")
    run("set", path, "safety_joints", "normal_max=1.5707963267948966", "--row", "Elbow")
    shown = run("show", path)
    assert "Name: TCP, Position and rotation: [0, 0, 150, 0, 0, 1.5] mm, Active: yes" in shown
    assert "Joint: Elbow, Positions are limited: yes, Normal mode, lowest: -363 °, Normal mode, highest: 90 °" in shown
    changed = [line for line in unpacked(path.read_bytes()).splitlines() if line not in before]
    assert [line.split(b" ")[0] for line in changed if not line.startswith(b"  ")] == [
        *(b"crc", b"maxJointPosition", b"maxJointRevolutions")
    ]
    output_text = json.loads(run("show", path, "--section", "external_control", "--json"))
    assert output_text == {"external_control": [{"host": "10.1.2.3", "port": 50002}]}


@pytest.mark.parametrize(
    ("before", "after", "output_text"),
    [
        ('activePose="TCP"', 'activePose="gripper"', "TCP: the active one is 'gripper', which does not exist"),
        ('DigitalInputNames value=", ', 'DigitalInputNames value="a, a', "I/O: 4 signals are called 'a'"),
        ('autoLoad="false"', 'autoLoad="true" fileName="no.urp"', "Default program: there is no no.urp"),
        ("maxForce = 150.0", "maxForce = much", "Safety: [SafetyLimits Normal Values] maxForce = much"),
        ("reducedModeInputA = 255\nreducedModeInputB = 255", "reducedModeInputA = 0\nreducedModeInputB = 1", "0, 1"),
        ("minJointRevolutions = [-2", "minJointRevolutions = [3", "a minimum position is not below the maximum"),
    ],
)
def test_invalid_values_are_found(path, before, after, output_text):
    text = unpacked(path.read_bytes()).decode()
    assert before in text
    path.write_text(text.replace(before, after))
    assert output_text in run("check", path, status=1)


def test_errors_are_one_line_and_change_nothing(tmp_path, path):
    before = path.read_bytes()
    for arguments, output_text in (
        (("new", path), "exists: pass --force"),
        (("new", tmp_path / "x.urp"), "must end in .installation"),
        (("show", tmp_path / "none.installation"), "No such file"),
        (("show", path, "--section", "colours"), "unknown section 'colours'"),
        (("set", path, "colours", "a=1"), "no section 'colours'"),
        (("set", path, "tcps", "pose", "--row", "TCP"), "is not FIELD=VALUE"),
        (("set", path, "tcps", "pose=[1]", "--row", "TCP"), "6 numbers"),
        (("set", path, "tcps", "pose=[0,0,0,0,0,0]", "--row", "hand"), "there is no 'hand'"),
    ):
        with pytest.raises(URError, match=output_text) as error:
            run(*arguments)
        assert "\n" not in str(error.value)
    (tmp_path / "p.installation").write_text("<URProgram/>")
    with pytest.raises(URError, match="is not an installation"):
        run("check", tmp_path / "p.installation")
    assert path.read_bytes() == before
    assert sorted(SECTIONS) == sorted(json.loads(run("show", path, "--json")))
