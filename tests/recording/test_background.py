"""A recorder in a separate process: the same file, and a proper end if any process dies."""

import logging
import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from recording_rig import INFO, controller_state

from client.errors import RecordingError
from client.recording import BackgroundRecorder, read

PATIENCE_S = 30.0


@pytest.mark.parametrize("suffix", [".mcap", ".csv", ".npz"])
def test_the_file_contains_all_states(states, tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"run{suffix}"
    with BackgroundRecorder(file, states[0], INFO) as recorder:
        for state in states:
            recorder.write({**state, "more": 1})
    assert recorder.count == len(states)
    found = read(file)
    assert list(found.states()) == states
    assert suffix == ".csv" or found.info["robot"] == INFO["robot"]


def test_controller_states_are_recorded_too(states, tmp_path: Path) -> None:
    with BackgroundRecorder(tmp_path / "run.mcap", states[0]) as recorder:
        for state in states[:50]:
            recorder.write(state)
            recorder.write_controller("mine", controller_state(state["timestamp"], 0.1, 0.2))
    found = read(tmp_path / "run.mcap").tracking()
    assert (found.source, len(found.time_s)) == ("mine", 50)
    assert found.desired_q == pytest.approx(0.2)


def test_an_unwritable_file_is_reported_immediately(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"cannot write .*: No such file or directory"):
        BackgroundRecorder(tmp_path / "nowhere" / "run.csv")
    with pytest.raises(RecordingError, match="not a format of recordings"):
        BackgroundRecorder(tmp_path / "run.txt")
    with pytest.raises(RecordingError, match="actual_q"):
        BackgroundRecorder(tmp_path / "run.csv", ["actual_qq"])


def test_later_errors_are_raised_only_at_the_end(states, tmp_path: Path, caplog) -> None:
    recorder = BackgroundRecorder(tmp_path / "run.mcap", states[0])
    recorder.write(states[0])
    os.kill(recorder._process.pid, signal.SIGKILL)
    recorder._process.wait(PATIENCE_S)
    with caplog.at_level(logging.CRITICAL):
        for _ in range(100):
            recorder.write(states[0])
        with pytest.raises(RecordingError, match="was killed"):
            recorder.close()
    recorder.close()  # a second time has no effect


def test_controllers_in_an_unsupported_format_are_an_error_at_the_end(states, tmp_path: Path) -> None:
    recorder = BackgroundRecorder(tmp_path / "run.csv", states[0])
    recorder.write_controller("mine", controller_state(1.0, 0.1, 0.2))
    with pytest.raises(RecordingError, match=r"only \.mcap files can contain states of controllers"):
        recorder.close()


def test_markers_are_recorded_and_invalid_ones_do_not_affect_the_rest(states, tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    recorder = BackgroundRecorder(file, states[0])
    for number, state in enumerate(states[:50]):
        recorder.write(state)
        marker = {"ns": "post", "type": "round" if number == 20 else 2}
        recorder.write_markers("/planning_scene", [marker], state["timestamp"])
    with pytest.raises(RecordingError, match="not fields of visualization_msgs/Marker"):
        recorder.close()
    found = read(file)
    assert "cut_off" not in found.info
    assert len(found) == 50
    with file.open("rb") as stream:
        messages = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(["/planning_scene"])
        drawn = [marker for *_, message in messages for marker in message.markers]
    assert [(marker.ns, marker.type) for marker in drawn] == [("post", 2)] * 49


PROGRAM = """
import os, sys, time
from client.recording import BackgroundRecorder
recorder = BackgroundRecorder(sys.argv[1], ["actual_q"])
for number in range(200):
    recorder.write({"timestamp": 0.002 * number, "actual_q": (0.1,) * 6})
while not recorder._queue.empty():
    time.sleep(0.01)
print(recorder._process.pid, flush=True)
os.kill(os.getpid(), 9)
"""


def wait_for_end(pid: int) -> None:
    """Wait for the end of a process that is not a child."""
    try:
        process = os.pidfd_open(pid)
    except ProcessLookupError:
        return
    try:
        assert select.select([process], [], [], PATIENCE_S)[0]
    finally:
        os.close(process)


@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="only Linux can wait for processes that are not children")
def test_the_file_is_complete_when_its_program_is_killed(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(file)], capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    wait_for_end(int(done.stdout))
    found = read(file)
    assert "cut_off" not in found.info
    assert len(found) > 100  # the last few may be lost with it
