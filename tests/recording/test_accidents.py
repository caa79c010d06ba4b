"""Recordings after accidents: a full disk, a killed recorder, damaged files, a robot without a time."""

import math
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from random import Random

import numpy as np
import pytest
from mcap.reader import make_reader
from recording_rig import record
from typer.testing import CliRunner

from client.cli import app
from client.errors import RecordingError
from client.recording import Recorder, convert, read
from tests.rows import each_row

FORMATS = (".mcap", ".csv", ".npz")
PATIENCE_S = 30.0

FULL = """
import json, resource, sys
from client.errors import RecordingError
from client.recording import Recorder
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, resource.RLIM_INFINITY))
recorder = Recorder(sys.argv[1], ["actual_q"])
try:
    for number in range(20_000):
        recorder.write({"timestamp": 0.002 * number, "actual_q": (0.1 * number, 1.0 / (number + 1)) * 3})
except RecordingError as error:
    count, error_text = recorder.count, str(error)
recorder.write({"timestamp": 100.0, "actual_q": (0.0,) * 6})
try:
    recorder.close()
except RecordingError as error:
    assert str(error) != error_text
print(count, error_text)
"""


def run(program: str, *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], capture_output=True, text=True, timeout=PATIENCE_S, check=True
    )
    assert not done.stderr
    return done.stdout


@each_row("suffix", FORMATS)
def test_a_file_that_cannot_grow_reports_how_much_it_contains(tmp_path: Path, suffix: str) -> None:
    count, _, error_text = run(FULL, str(tmp_path / f"run{suffix}")).partition(" ")
    path = tmp_path / f"run.unfinished{suffix}"
    found = read(path)
    reported = re.fullmatch(
        rf"{path} can no longer be written: File too large; (\d+) states are certainly in the file, the last (\d+) "
        "may be lost: free some space and record again",
        error_text.strip(),
    )
    assert reported
    saved, lost = map(int, reported.groups())
    assert saved + lost == int(count)
    assert 100 < saved <= len(found) <= int(count)
    assert saved == len(found) or suffix == ".mcap"  # its last chunk may be complete, but its index not
    assert found.info["cut_off"]
    assert path.stat().st_size <= 100_000


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="only Linux has a device that is always full")
@pytest.mark.parametrize("suffix", FORMATS)
def test_a_full_disk(states, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    path.symlink_to("/dev/full")
    with pytest.raises(RecordingError, match=r"(can no longer be written|cannot finish .*): No space left on device"):
        record(path, states)


KILLED = """
import sys, time
from client.recording import Recorder
recorders = [Recorder(path, ["actual_q"]) for path in sys.argv[1:]]
began, number = time.monotonic(), 0
while True:
    for recorder in recorders:
        recorder.write({"timestamp": 10.0 + time.monotonic() - began, "actual_q": (0.1 * number,) * 6})
    print(10.0 + time.monotonic() - began, flush=True)
    number += 1
    time.sleep(0.05)
"""


def test_a_killed_recorder_loses_at_most_one_second(tmp_path: Path) -> None:
    """Even with few and small states, which do not fill a chunk or buffer for minutes."""
    paths = [tmp_path / f"run.unfinished{suffix}" for suffix in FORMATS]
    named = [str(tmp_path / f"run{suffix}") for suffix in FORMATS]
    with subprocess.Popen([sys.executable, "-c", KILLED, *named], stdout=subprocess.PIPE, text=True) as killed:
        assert killed.stdout
        last = 0.0
        while last < 12.0:
            last = float(killed.stdout.readline())
        killed.send_signal(signal.SIGKILL)
        rest = killed.stdout.read().split()
    last = float(rest[-1]) if rest else last
    for path in paths:
        found = read(path)
        assert last - found["timestamp"][-1] < 1.0, path
        assert found["timestamp"][0] < 11.0
        again = convert(path, tmp_path / f"again_{path.suffix[1:]}.npz")
        assert len(read(tmp_path / f"again_{path.suffix[1:]}.npz")) == len(again) == len(found)


@pytest.mark.parametrize("suffix", FORMATS)
def test_states_without_a_time_are_counted_and_left_out(states, tmp_path: Path, suffix: str) -> None:
    bad = [states[5] | {"timestamp": stamp} for stamp in (math.nan, math.inf, -1e300, 1e18)]
    with Recorder(tmp_path / f"run{suffix}", states[0]) as recorder:
        for state in (*bad, *states[:20], *bad, *states[20:30]):
            recorder.write(state)
    assert (recorder.count, recorder.left_out) == (30, 8)
    assert list(read(tmp_path / f"run{suffix}").states()) == states[:30]


@pytest.mark.parametrize("name", ["robot_mode", "safety_mode", "runtime_state"])
def test_modes_unknown_to_ros_are_recorded(states, tmp_path: Path, name: str) -> None:
    absurd = [state | {name: 2**31 - 1, "actual_TCP_pose": (math.inf,) * 6} for state in states[:5]]
    assert list(read(record(tmp_path / "run.mcap", absurd)).states()) == absurd


def test_a_table_with_damaged_lines_keeps_the_others(states, tmp_path: Path) -> None:
    path = record(tmp_path / "run.csv", states[:40])
    lines = path.read_bytes().splitlines(keepends=True)
    lines[10] = b'1.0,"2.0,3.0\r\n'
    lines[20] = b"\0" * 50 + b"\xff\r\n"
    lines[30] = lines[30].replace(b".", b"x", 1)
    lines[35] = lines[35].replace(lines[35].split(b",")[0], b"nan", 1)
    path.write_bytes(b"".join(lines)[:-20])
    result = CliRunner().invoke(app, ["convert", str(path), str(tmp_path / "run.npz")])
    assert result.exit_code == 0
    assert "35 states of 25 variables" in result.stdout
    (note,) = result.stderr.splitlines()
    assert "3 of 40 lines are damaged and left out (first: line 11: 3 columns" in note
    assert "1 of 36 states have no valid timestamp" in note
    assert "line 41" in note
    found = read(tmp_path / "run.npz")
    assert len(found) == 35
    assert "left_out" not in found.info


def test_a_damaged_chunk_loses_only_that_chunk(states, tmp_path: Path) -> None:
    many = [state | {"timestamp": 100.0 + 0.002 * number} for number, state in enumerate(states * 4)]
    path = record(tmp_path / "run.mcap", many)
    whole = path.read_bytes()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunks = summary.chunk_indexes
    assert len(chunks) > 2
    random = Random(1)
    for chunk in (chunks[0], chunks[len(chunks) // 2]):  # the first has the channels and schemas of all
        damaged = bytearray(whole)
        middle = chunk.chunk_start_offset + chunk.chunk_length // 2
        damaged[middle : middle + 50] = random.randbytes(50)
        path.write_bytes(bytes(damaged))
        found = read(path)
        assert len(many) // 2 < len(found) < len(many)
        assert "1 damaged parts of the file" in found.info["left_out"]
        assert "cut_off" not in found.info
    path.write_bytes(whole[: len(whole) // 2])
    found = read(path)
    assert " bytes cannot be read" in found.info["cut_off"]
    assert len(found) > len(many) // 4


def test_a_damaged_array_loses_only_that_variable(states, tmp_path: Path) -> None:
    path = record(tmp_path / "run.npz", states)
    content = bytearray(path.read_bytes())
    place = content.index(b"actual_qd.npy") + 200
    content[place : place + 20] = bytes(20)
    path.write_bytes(bytes(content))
    found = read(path)
    assert "actual_qd is damaged and left out" in found.info["left_out"]
    assert "actual_qd" not in found
    assert np.array_equal(found["actual_q"], [state["actual_q"] for state in states])


def test_a_clock_jump_does_not_make_a_recording_a_year_long(states, tmp_path: Path) -> None:
    jump = [state | {"timestamp": state["timestamp"] + 9e8} for state in states[5:10]]
    with Recorder(tmp_path / "run.mcap", states[0]) as recorder:
        for state in (*states[:5], *jump):
            recorder.write(state)
    found = read(tmp_path / "run.mcap")
    assert len(found) == 10
    assert found.time_s[-1] < 1.0
    assert found.times_ns[-1] < time.time_ns() + 10**9
