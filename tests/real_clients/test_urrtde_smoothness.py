"""ur_rtde's stream through the recording proxy, and what is found in it."""

import math
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from rig import START_Q, Rig, disconnecting
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

from client.traffic.recording import TrafficRecording
from client.traffic.smoothness import examine

PROXY = "127.0.77.1"
PERIOD_S = 0.008  # of a CB3
NEW_HZ = 10


@contextmanager
def recorded(host: str, path: Path) -> Iterator[None]:
    """Everything that passes through `PROXY`, a process of its own: ur_rtde keeps Python's lock while it connects."""
    command = [sys.executable, "-u", "-m", "client", "proxy", "--robot-ip", host, "--listen", PROXY, "--record", path]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as proxy:
        assert any(line.startswith("Recording to") for line in proxy.stdout)
        try:
            yield
        finally:
            proxy.send_signal(signal.SIGINT)
            proxy.stdout.read()


@pytest.mark.parametrize("rig", ["ur3"], indirect=True)
def test_a_slow_policy_is_found_in_what_ur_rtde_sends(rig: Rig, tmp_path: Path) -> None:
    with recorded(rig.host, tmp_path / "robot.pcapng"):
        control, receive = RTDEControlInterface(PROXY), RTDEReceiveInterface(PROXY)
        with disconnecting(control, receive):
            for step in range(round(3.0 / PERIOD_S)):
                began = control.initPeriod()
                computed = math.floor(step * PERIOD_S * NEW_HZ) / NEW_HZ
                control.servoJ([START_Q[0] + 0.1 * (1 - math.cos(computed)), *START_Q[1:]], 0, 0, PERIOD_S, 0.1, 300)
                control.waitPeriod(began)
            control.servoStop()
            control.stopScript()
    found = examine(TrafficRecording.read(tmp_path / "robot.pcapng"))
    (stream,) = found.streams
    assert stream.source == "ur_rtde, servoJ"
    assert stream.timing.distinct_hz == pytest.approx(NEW_HZ, rel=0.3)
    assert [form.name for form in stream.forms][2:] == ["robot's target", "arm"]
    assert any("a staircase" in finding.text for finding in found.findings), found.findings
