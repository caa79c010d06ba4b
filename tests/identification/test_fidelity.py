"""A recording against the model: results for a known arm, and errors for unusable recordings."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from client.cli import app
from client.errors import RecordingError
from client.identification.fidelity import Payload, fidelity
from client.identification.samples import samples_of
from client.recording import Recording
from tests.identification.conftest import ARM, MODEL, MOVES, recorded, saved, without
from urproto.robots import load_model

COLUMNS = ("timestamp", "actual_q", "actual_qd", "actual_current", "target_current", "target_moment")


def worst(result, field):
    found = result.worst(field)
    assert found is not None
    return found[0]


def test_targets_of_the_same_arm_are_predicted_exactly(motion):
    result = fidelity(Recording(motion), ARM)
    assert worst(result, "target_moment") < 1e-9
    assert worst(result, "target_current") < 1e-9
    assert worst(result, "actual_current") < 0.03, "noise, and errors of the servo loops"
    assert max(row.rest for row in result.errors if row.field == "target_moment") < 1e-9


def test_measured_angles_do_nearly_as_well_as_targets(motion):
    result = fidelity(without(motion, "target_q"), ARM)
    assert worst(result, "target_moment") < 0.02
    assert worst(result, "target_current") < 0.02
    assert any("differentiated" in note for note in result.samples.notes)


def test_different_drives_show_in_each_field(motion):
    result = fidelity(Recording(motion), MODEL)
    shares = {(row.field, row.joint): row.share for row in result.errors}
    assert shares["target_moment", "base"] > 0.01, "rotors"
    assert shares["target_current", "wrist 3"] > 0.05, "constants and friction"


def test_a_row_shows_range_rms_and_share(motion):
    """For a current that is constantly 1 A too high."""
    values = motion | {"target_current": motion["target_current"] + 1.0}
    row = next(row for row in fidelity(Recording(values), ARM).errors if row.field == "target_current")
    moving = np.abs(motion["target_qd"][:, 0]) > 0.02
    assert row.rms == pytest.approx(1.0)
    assert row.p99 == pytest.approx(1.0)
    assert row.range == pytest.approx(np.ptp(values["target_current"][moving, 0]))
    assert row.share == pytest.approx(1.0 / row.range)
    assert row.rest == pytest.approx(1.0)


def test_joints_at_rest_have_no_error_in_motion():
    values = recorded("def one():\n  movej([1.5, -1.4, 1.0, 0, 0.3, 0.1], v=0.4)\n  sleep(0.5)\nend\n")
    shares = [row.share for row in fidelity(Recording(values), ARM).errors if row.field == "target_moment"]
    assert shares[0] is not None
    assert shares[1:] == [None] * 5


def test_the_payload_is_as_recorded_or_given():
    few = "".join(MOVES.splitlines(keepends=True)[:4]) + "end\n"
    values = recorded(few, "set_payload(4.0, [0.0, 0.05, 0.1])")
    values = {name: array[10:] for name, array in values.items()}
    assert worst(fidelity(Recording(values), ARM), "target_moment") < 1e-9
    bare = without(values, "payload")
    with_payload = fidelity(bare, ARM, Payload(4.0, (0.0, 0.05, 0.1)))
    assert worst(with_payload, "target_moment") < 1e-9
    with pytest.raises(RecordingError, match=r"Nm \(rms\) from that of a UR10 with 0 kg.*--payload"):
        fidelity(bare, ARM)


def test_the_real_payload_affects_only_actual_currents(motion):
    bare, loaded = (fidelity(Recording(motion), ARM, mounted=mounted) for mounted in (None, Payload(5.0)))
    assert worst(loaded, "target_moment") == worst(bare, "target_moment")
    assert worst(loaded, "actual_current") > worst(bare, "actual_current") + 0.01


def changed(motion, **how):
    return Recording({name: how.get(name, lambda array: array)(array) for name, array in motion.items()})


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"target_q": np.degrees, "actual_q": np.degrees}, r"joint angles reach .*degrees"),
        ({"target_qd": np.degrees}, r"joint speeds are 57\.\d times"),
        ({"timestamp": lambda array: 1e3 * array}, r"rises by 8 per state: .*milliseconds"),
        ({"timestamp": lambda array: 0.0 * array}, "never rises"),
        ({"actual_current": lambda array: 1e3 * array}, "milliamperes"),
        ({"target_moment": lambda array: 2.0 * array}, "from that of a UR10"),
    ],
)
def test_other_units_are_a_one_line_error(motion, how, message):
    with pytest.raises(RecordingError, match=message) as error:
        fidelity(changed(motion, **how), ARM)
    assert "\n" not in str(error.value)


def test_measured_angles_that_are_too_far_apart_are_refused(motion):
    seldom = {name: array[::8] for name, array in motion.items()}
    assert worst(fidelity(Recording(seldom), ARM), "target_moment") < 1e-9
    with pytest.raises(RecordingError, match=r"one state per 0.064 s is too few"):
        fidelity(without(seldom, "target_q"), ARM)


def test_missing_columns_are_named(motion):
    with pytest.raises(RecordingError, match="none of target_moment, target_current, actual_current"):
        samples_of(without(motion, "target_moment", "target_current", "actual_current"))
    with pytest.raises(RecordingError, match=r"no motion was recorded: .* or else actual_q"):
        samples_of(without(motion, "target_q", "actual_q"))


def test_a_different_model_is_named(motion):
    with pytest.raises(RecordingError, match="UR5 with 0 kg; it fits a UR10"):
        fidelity(Recording(motion), load_model("ur5"))


def test_gaps_are_left_out_and_noted(motion):
    kept = np.ones(len(motion["timestamp"]), bool)
    kept[400:450] = kept[700:760] = False
    values = {name: array[kept] for name, array in motion.items()}
    result = fidelity(without(values, "target_q"), ARM)
    assert worst(result, "target_moment") < 0.025
    assert any("2 gaps" in note for note in result.samples.notes)
    every_20th = {name: array[np.arange(len(array)) % 20 < 3] for name, array in motion.items()}
    with pytest.raises(RecordingError, match="without a gap"):
        samples_of(Recording(every_20th))


def test_damaged_states_are_left_out_and_noted(motion):
    values = {name: array.copy() for name, array in motion.items()}
    values["actual_current"][300, 2] = np.nan
    values["actual_q"][301, 0] = 1e250
    result = fidelity(Recording(values), ARM)
    assert np.isfinite([row.rms for row in result.errors]).all()
    assert any("1 states are left out" in note for note in result.samples.notes), "actual_q is not looked at"


def test_the_command_reads_files_without_a_header_and_plots(motion, tmp_path):
    file = saved(tmp_path / "bare.csv", {name: array[:800] for name, array in motion.items()}, COLUMNS)
    arguments = ["fidelity", str(file), "--model", "ur10", "--columns", ",".join(COLUMNS)]
    outcome = CliRunner().invoke(app, [*arguments, "-o", str(tmp_path / "bare.png")])
    assert outcome.exit_code == 0, outcome.output
    assert (tmp_path / "bare.png").read_bytes().startswith(b"\x89PNG")
    assert [line.split()[0] for line in outcome.stdout.splitlines()[1:]] == [
        name for name in COLUMNS[:2:-1] for _ in range(6)
    ]
    as_json = CliRunner().invoke(app, [*arguments, "--json"])
    assert len(json.loads(as_json.stdout)["errors"]) == 18


def test_files_of_the_vendors_recorder_are_separated_by_blanks(motion, tmp_path):
    names = ("timestamp", "target_q", "target_qd", "target_qdd", "target_moment")
    head = ["timestamp", *(f"{name}_{joint}" for name in names[1:] for joint in range(6))]
    file = saved(tmp_path / "official.csv", motion, names, ",".join(head))
    file.write_text(file.read_text().replace(",", " "))
    outcome = CliRunner().invoke(app, ["fidelity", str(file), "--model", "ur10", "--json"])
    assert len(json.loads(outcome.stdout)["errors"]) == 6


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--columns", "timestamp,foo"], "foo"),
        (["--model", "ur99"], "unknown robot model"),
        (["--payload", "3"], "KG,X,Y,Z"),
        (["--payload", "nan,0,0,0"], "0 to 100 kg"),
    ],
)
def test_invalid_options_are_reported(motion, tmp_path, more, message):
    file = saved(tmp_path / "bare.csv", {name: array[:50] for name, array in motion.items()}, COLUMNS)
    outcome = CliRunner().invoke(app, ["fidelity", str(file), "--model", "ur10", "--columns", ",".join(COLUMNS), *more])
    assert outcome.exit_code != 0
    assert message in f"{outcome.output}{outcome.exception}"
