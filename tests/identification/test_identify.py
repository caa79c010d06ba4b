"""Identification of an arm with known drives; parameters that a motion does not excite are kept."""

from dataclasses import fields

import pytest
import yaml
from typer.testing import CliRunner

from client.cli import app
from client.errors import RecordingError
from client.identification.fidelity import Payload, fidelity
from client.identification.identify import identify
from client.recording import Recording
from emulator.config import ConfigError, controller_config
from tests.identification.conftest import ARM, DRIVES, MODEL, recorded, saved, without
from tests.rows import each_row
from urproto.robots.drivetrain import Drivetrain, DrivetrainError
from urproto.robots.measured import drivetrain_of

EXACT = ("torque_constants_Nm_A", "rotor_kg_m2", "known_coulomb_Nm", "known_viscous_Nm_s", "known_fast_viscous_Nm_s")
COLUMNS = ("timestamp", "actual_q", "actual_qd", "actual_current", "target_current", "target_moment")


@pytest.fixture(scope="module")
def found(motion):
    return identify(Recording(motion), MODEL)


def test_parameters_used_by_the_controller_are_identified_exactly(found):
    assert found.kept == ()
    for name in EXACT:
        assert getattr(found.drives, name) == pytest.approx(getattr(DRIVES, name), rel=1e-6), name


@pytest.mark.parametrize("name", ["coulomb_Nm", "viscous_Nm_s"])
def test_friction_is_identified_within_its_confidence(found, name):
    for value, error, true in zip(getattr(found.drives, name), found.errors[name], getattr(DRIVES, name), strict=True):
        assert value == pytest.approx(true, rel=0.15)
        assert abs(value - true) < max(5.0 * error, 0.05 * true)


def test_noise_is_identified(found):
    assert found.drives.rest_noise_A == pytest.approx(DRIVES.rest_noise_A, rel=0.35)  # the arm rests for a short time
    assert found.drives.motion_noise_A == pytest.approx(DRIVES.motion_noise_A, rel=0.25)


def test_measured_angles_alone_are_enough(motion):
    drives = identify(without(motion, "target_q"), MODEL).drives
    assert drives.rotor_kg_m2 == pytest.approx(DRIVES.rotor_kg_m2, rel=0.05)
    assert drives.known_coulomb_Nm == pytest.approx(DRIVES.known_coulomb_Nm, rel=0.1)
    assert drives.torque_constants_Nm_A == pytest.approx(DRIVES.torque_constants_Nm_A, rel=0.1)


def test_identified_parameters_predict_another_motion_better_than_the_model(found):
    other = Recording(
        recorded("def other():\n  movej([-1.5, -0.8, 1.9, -1.5, -1.3, 1.6], a=2, v=0.4)\n  sleep(1)\nend\n")
    )
    before, after = fidelity(other, MODEL), fidelity(other, found.arm)
    for field in ("target_moment", "target_current", "actual_current"):
        assert after.worst(field)[0] < 0.5 * before.worst(field)[0]


def test_an_unannounced_load_is_identified(motion):
    """Its weight, added to the recorded motor currents, as the arm itself would sag."""
    loaded = fidelity(Recording(motion), ARM, mounted=Payload(3.0, (0.02, 0.0, 0.08))).predicted["actual_current"]
    more = loaded - fidelity(Recording(motion), ARM).predicted["actual_current"]
    found = identify(Recording(motion | {"actual_current": motion["actual_current"] + more}), MODEL)
    assert found.payload.mass_kg == pytest.approx(3.0, abs=0.1)
    assert found.payload.cog_m == pytest.approx((0.02, 0.0, 0.08), abs=0.02)
    assert found.drives.coulomb_Nm == pytest.approx(DRIVES.coulomb_Nm, rel=0.15)
    assert identify(Recording(motion), MODEL).payload is None


def test_joints_at_rest_keep_the_parameters_of_the_model():
    still = recorded(
        "def one():\n  sleep(0.6)\n  movej([1.5, -1.4, 1.0, 0, 0.3, 0.1], a=1, v=0.8)\n"
        "  movej([0, -1.4, 1.0, 0, 0.3, 0.1], a=2, v=0.4)\n  sleep(0.6)\nend\n"
    )
    found, model = identify(Recording(still), MODEL), drivetrain_of(MODEL)
    assert found.drives.rotor_kg_m2[0] == pytest.approx(DRIVES.rotor_kg_m2[0], rel=1e-6)
    assert found.drives.rotor_kg_m2[1:] == model.rotor_kg_m2[1:]
    assert found.errors["rotor_kg_m2"][1:] == (None,) * 5
    assert "elbow: hardly moves; its rotor is kept" in found.kept


def test_a_motion_without_speed_is_refused(motion):
    standing = {name: array[:110] for name, array in motion.items()}
    with pytest.raises(RecordingError, match="nothing can be identified"):
        identify(Recording(standing), MODEL)


def test_parameters_not_excited_by_the_motion_are_kept_and_named():
    """Slower than the bend of the friction curve, so the part beyond it is unknown."""
    moves = ("[1.2, -0.6, 1.8, 1.0, -0.6, -0.8]", "[0.2, -1.4, 1.0, 0, 0.3, 0.1]")
    slow = "".join(f"  movej({q}, a=2, v=0.4)\n" for q in moves)
    found = identify(Recording(recorded(f"def slow():\n  sleep(0.6)\n{slow}end\n")), MODEL)
    assert found.drives.known_coulomb_Nm[0] == pytest.approx(DRIVES.known_coulomb_Nm[0], rel=1e-6)
    assert found.drives.known_fast_viscous_Nm_s == drivetrain_of(MODEL).known_fast_viscous_Nm_s
    assert any("does not determine known_fast_viscous_Nm_s" in reason for reason in found.kept)


def test_without_target_currents_only_friction_and_noise_are_identified(motion):
    found = identify(without(motion, "target_moment", "target_current"), ARM)
    assert found.errors["rotor_kg_m2"] == (None,) * 6
    assert found.drives.coulomb_Nm == pytest.approx(DRIVES.coulomb_Nm, rel=0.15)
    assert any("target_moment was not recorded" in reason for reason in found.kept)


def test_the_emulator_uses_the_written_arm_file(motion, tmp_path):
    recording = saved(tmp_path / "run.csv", motion, COLUMNS)
    file = tmp_path / "arm.yaml"
    arguments = ["identify", str(recording), "--model", "ur10", "--columns", ",".join(COLUMNS), "-o", str(file)]
    outcome = CliRunner().invoke(app, arguments)
    assert outcome.exit_code == 0, outcome.output
    assert "rotor_kg_m2" in outcome.stdout
    config = controller_config(arm=str(file))
    assert config.dynamic
    assert config.model.name == "ur10"
    written = Drivetrain.from_mapping(yaml.safe_load(file.read_text()))
    assert config.model.drivetrain == written
    assert written.rotor_kg_m2 == pytest.approx(DRIVES.rotor_kg_m2, rel=0.05)
    assert "--overwrite" in str(CliRunner().invoke(app, arguments).exception)


def arm_file(path, **changes):
    path.write_text(yaml.safe_dump({"model": "ur10", **DRIVES.to_mapping(), **changes}))
    return str(path)


def test_an_arm_file_applies_to_one_model(tmp_path):
    file = arm_file(tmp_path / "arm.yaml")
    assert controller_config("ur10", arm=file).model.drivetrain == DRIVES
    with pytest.raises(ConfigError, match="describes a ur10, not a ur5e: leave out --model"):
        controller_config("ur5e", arm=file)


@each_row(
    ("changes", "message"),
    [
        ({"rotor_kg_m2": [1, 2, 3]}, "rotor_kg_m2 must be a list of length 6, not 3"),
        ({"rotor_kg_m2": [0.0] * 6}, "rotor_kg_m2 must be six numbers above 0"),
        ({"coulomb_Nm": [-1.0] * 6}, "coulomb_Nm must be six numbers, none of them negative"),
        ({"model": 3}, "is not an arm file"),
        ({"model": "ur99"}, "unknown robot model"),
    ],
)
def test_an_invalid_arm_file_is_a_one_line_error(tmp_path, changes, message):
    with pytest.raises(ConfigError, match=message):
        controller_config(arm=arm_file(tmp_path / "arm.yaml", **changes))


def test_an_unknown_kind_of_arm_is_reported():
    with pytest.raises(ConfigError, match="neither ideal nor dynamic nor an existing file"):
        controller_config(arm="dynamik")
    with pytest.raises(ConfigError, match="cannot read"):
        controller_config(arm="missing.yaml")


def test_every_drivetrain_parameter_is_required():
    for field in fields(Drivetrain):
        values = DRIVES.to_mapping()
        del values[field.name]
        with pytest.raises(DrivetrainError, match=field.name):
            Drivetrain.from_mapping(values)
