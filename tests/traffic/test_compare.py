"""Comparison of two recordings: equal parts, and the place where they diverge."""

import csv
from pathlib import Path

import pytest
from traffic_rig import recorded_robot
from typer.testing import CliRunner

from client.cli import app
from client.errors import FileError
from client.traffic.alignment import Offset, find_offset
from client.traffic.compare import compare, compare_sources, read_source
from client.traffic.recording import TrafficRecording
from client.traffic.report import report
from client.traffic.tracks import Track, tracks_of
from urproto.errors import LocalProtocolError


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("recordings")


@pytest.fixture(scope="module")
def usual(folder) -> TrafficRecording:
    return recorded_robot(folder / "usual")


def test_the_same_program_at_another_time_is_equal(folder, usual):
    comparison = compare(usual, recorded_robot(folder / "later", idle_s=0.52))
    assert comparison.same, report(comparison)
    (pair,) = comparison.pairs
    assert pair.offset.seconds == pytest.approx(0.32, abs=0.002)
    assert pair.offset.by == ("target_q",)
    assert "## No differences" in report(comparison)


def test_a_changed_acceleration_is_found_at_its_start(folder, usual):
    comparison = compare(usual, recorded_robot(folder / "slower", acceleration=1.3))
    assert not comparison.same
    first = comparison.differences[0][1]
    assert first.column in ("target_q[2]", "actual_q[2]", "target_q[1]", "actual_q[1]")
    assert 0.2 < first.begins.time_s < 0.4  # the program begins after 0.2 s
    text = report(comparison)
    assert f"**They diverge {first.begins.time_s:.3f} s after the start of A, in `{first.column}`**" in text
    assert "dashboard: the same, 3 messages" in text
    assert "| rtde | target_q[2] | rad | 0.001 |" in text


def test_an_output_set_in_only_one_recording(folder, usual):
    other = recorded_robot(folder / "output", then="  set_digital_out(3, True)\n")
    (one,) = {difference.column for _, difference in compare(usual, other).differences}
    assert one == "actual_digital_output_bits"
    difference = compare(usual, other).differences[0][1]
    assert (difference.begins.first, difference.begins.second, difference.tolerance) == (0, 8, 0)


def test_tolerances_are_by_unit_and_field(folder, usual):
    slower = recorded_robot(folder / "a bit slower", acceleration=1.2)
    columns = {
        one.column.partition("[")[0] for _, one in compare(usual, slower, ["rad=1", "runtime_state=3"]).differences
    }
    assert columns == set()
    columns = {one.column.partition("[")[0] for _, one in compare(usual, slower, ["target_q=1"]).differences}
    assert "actual_q" in columns
    assert "target_q" not in columns
    with pytest.raises(LocalProtocolError, match="not a tolerance: give a field or unit and a number"):
        compare(usual, slower, ["much"])


def test_fields_and_tracks_in_only_one_recording(folder, usual):
    other = recorded_robot(folder / "fewer", names=("timestamp", "actual_q", "actual_qd"))
    (pair,) = compare(usual, other).pairs
    assert pair.only_first == ("actual_digital_output_bits", "runtime_state", "target_q")
    assert pair.only_second == ("actual_qd",)


def test_tables_of_watch(folder, usual, tmp_path):
    (track,) = tracks_of(usual)
    with (tmp_path / "watched.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["timestamp", *(f"actual_q_{index}" for index in range(6))])
        for number, time_s in enumerate(track.times_s):
            table.writerow([time_s, *(track.columns[f"actual_q[{index}]"][number] for index in range(6))])
    sources = read_source(usual.path), read_source(tmp_path / "watched.csv")
    comparison = compare_sources(*sources)
    assert comparison.same, report(comparison)
    assert comparison.pairs[0].columns == 6
    (tmp_path / "text.csv").write_text("a,b\n1,2\n")
    with pytest.raises(FileError, match="is not a table with a column `timestamp`"):
        read_source(tmp_path / "text.csv")


def test_the_exit_status_of_the_command(folder, usual):
    other = recorded_robot(folder / "other", acceleration=0.7)
    same = CliRunner().invoke(app, ["compare", str(usual.path), str(usual.path)])
    assert (same.exit_code, same.stdout.splitlines()[0]) == (0, "## No differences")
    different = CliRunner().invoke(app, ["compare", str(usual.path), str(other.path)])
    assert (different.exit_code, different.stdout.splitlines()[0]) == (1, "## The recordings differ")


def test_recordings_without_motion_are_aligned_at_their_first_states():
    tracks = []
    for began_s in (3.0, 10.0):
        track = Track("rtde", "rtde")
        for step in range(50):
            track.add(began_s + 0.008 * step, {"target_q[0]": 0.5})
        tracks.append(track)
    assert find_offset(*tracks) == Offset(7.0, ())
    assert find_offset(*reversed(tracks)) == Offset(-7.0, ())
