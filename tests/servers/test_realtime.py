"""An emulator that is punctual without disturbing the system: real-time settings that it requests and releases."""

import asyncio
import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest

from emulator import realtime
from emulator.logs import BackgroundStream
from emulator.realtime import Overload
from tests.rows import each_row
from urproto.compat_asyncio import timeout
from urproto.testing.process import EmulatorProcess

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the emulator requests priorities on Linux only")
FIFO_ALLOWED = sys.platform == "linux" and os.geteuid() == 0
DEADLINE_S = 60.0


def test_overload_lowers_the_priority_immediately_and_recovers_slowly() -> None:
    overload = Overload()
    assert not overload.see(0.5, 0.5)
    assert overload.see(0.9, 0.5)
    assert overload.over
    assert not any(overload.see(share, 0.5) for share in (0.9, 0.6, *[0.1] * 19))
    assert overload.see(0.1, 0.5)
    assert not overload.over


def test_the_descriptor_table_is_grown_before_clients_connect() -> None:
    """Otherwise the kernel stops the process for some 20 ms at the 256th, the 512th and the 1024th client."""
    code = """
import resource
from emulator.realtime import RealTime, claim_real_time
hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
resource.setrlimit(resource.RLIMIT_NOFILE, (600, hard))
claim_real_time(RealTime.OFF)
print(*(line.split()[1] for line in open("/proc/self/status") if line.startswith("FDSize:")))
"""
    printed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=DEADLINE_S
    )
    assert int(printed.stdout) >= 600


def test_library_pages_used_only_while_loading_are_returned() -> None:
    code = """
import emulator.serve
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from emulator.realtime import RealTime, claim_real_time
from urproto.robots import load_model

def of_files():
    with open("/proc/self/status") as lines:
        return next(int(line.split()[1]) for line in lines if line.startswith("RssFile:"))

Controller(ControllerConfig(model=load_model("ur3")))
before = of_files()
claim_real_time(RealTime.OFF)
after = of_files()
controller = Controller(ControllerConfig(model=load_model("ur3"), running=True))
controller.tick()
q = controller.snapshot.actual_q
print(before, after, of_files(), len(q))
"""
    printed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=DEADLINE_S
    )
    before, after, later, joints = map(int, printed.stdout.split())
    assert before > 40_000, "kB: Pinocchio and NumPy are loaded"
    assert after < 0.2 * before
    assert later < 0.5 * before
    assert joints == 6, "what is still used has been mapped again"


async def test_a_flooded_loop_gives_up_its_priority(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    requested: list[int] = []
    used_s = time.monotonic  # as if this process had a dedicated core
    monkeypatch.setattr(time, "thread_time", lambda: used_s())
    monkeypatch.setattr(realtime, "_CHECK_EVERY_S", 0.05)
    monkeypatch.setattr(realtime, "_CALM_FOR_S", 0.1)
    monkeypatch.setattr(os, "sched_setscheduler", lambda pid, policy, parameters: requested.append(policy))
    monkeypatch.setattr(realtime, "_is_real_time", lambda thread: False)
    monkeypatch.setattr(realtime, "real_time_clients", lambda: clients)
    clients: list[str] = []
    watching = asyncio.create_task(realtime.yield_under_overload(realtime.RealTime.AUTO))
    deadline = time.monotonic() + DEADLINE_S
    while not requested and time.monotonic() < deadline:  # nothing but work
        await asyncio.sleep(0)
    assert requested == [os.SCHED_OTHER]
    assert "it gives up real-time priority" in caplog.text
    clients.append("a controller (process 1)")  # a flood continues, but this one would starve the emulator
    while len(requested) < 2 and time.monotonic() < deadline:
        await asyncio.sleep(0)
    assert requested[1:] == [os.SCHED_FIFO | os.SCHED_RESET_ON_FORK]
    clients.clear()
    while len(requested) < 3 and time.monotonic() < deadline:
        await asyncio.sleep(0)
    used_s = lambda: 0.0  # noqa: E731
    while len(requested) < 4 and time.monotonic() < deadline:
        await asyncio.sleep(0.02)
    assert requested[2:] == [os.SCHED_OTHER, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK]
    watching.cancel()


async def test_a_priority_that_was_insisted_on_is_kept() -> None:
    async with timeout(DEADLINE_S):
        await realtime.yield_under_overload(realtime.RealTime.ON)  # has nothing to do


@pytest.mark.skipif(not FIFO_ALLOWED, reason="only administrators may give a client real-time priority here")
def test_real_time_clients_are_found() -> None:
    client = """
import os, socket, sys, threading
port, policy = map(int, sys.argv[1:])
peer = socket.create_connection(("127.0.0.1", port))
def work():
    os.sched_setscheduler(0, policy, os.sched_param(5 if policy else 0))
    peer.send(b"!")
    peer.recv(1)
threading.Thread(target=work).start()
"""
    with socket.create_server(("127.0.0.1", 0)) as server:
        for policy, expected in ((os.SCHED_OTHER, False), (os.SCHED_FIFO, True), (os.SCHED_RR, True)):
            command = [sys.executable, "-c", client, str(server.getsockname()[1]), str(policy)]
            with subprocess.Popen(command) as process:
                connection, _ = server.accept()
                connection.settimeout(DEADLINE_S)
                assert connection.recv(1) == b"!"
                found = realtime.real_time_clients()
                assert any(f"(process {process.pid})" in one for one in found) is expected, (policy, found)
                connection.close()  # the client ends
        assert not any(f"(process {process.pid})" in one for one in realtime.real_time_clients())


@each_row("mode", ["auto", "on", "off"])
def test_granted_realtime_settings_are_reported_and_effective(mode: str) -> None:
    if mode == "on" and not FIFO_ALLOWED:
        pytest.skip("only administrators may require it here")
    with EmulatorProcess(["--realtime", mode]) as robot:
        until_s = time.monotonic() + DEADLINE_S
        while not (ready := "".join(re.findall(r"^Ready:.*\n", robot.output, re.MULTILINE))):
            assert time.monotonic() < until_s, robot.output
            time.sleep(0.01)  # its ports answer before it reports to be ready
        assert robot._process is not None
        announced = os.SCHED_FIFO if "SCHED_FIFO" in ready else os.SCHED_OTHER
        while (policy := os.sched_getscheduler(robot._process.pid) & ~os.SCHED_RESET_ON_FORK) != announced:
            assert time.monotonic() < until_s, f"the policy is {policy}, and the emulator says: {ready}"
            time.sleep(0.1)  # under load, the work of its start made it give up its priority for ten seconds
        status = Path(f"/proc/{robot._process.pid}/status").read_text()
        locked_kb = int(status.split("VmLck:")[1].split()[0])
    assert ("memory locked" in ready) == (locked_kb > 0)
    if mode == "off":
        assert "without real-time priority" in ready
    if mode == "on":
        assert "SCHED_FIFO" in ready
        assert "memory locked" in ready


def test_required_but_denied_realtime_settings_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(*arguments: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", denied)
    monkeypatch.setattr(realtime, "_lock_memory", lambda *, everything: True)
    monkeypatch.setattr(realtime, "_set_timer_slack", lambda: None)
    monkeypatch.setattr(realtime.gc, "freeze", lambda: None)
    assert realtime.claim_real_time(realtime.RealTime.AUTO) == ["memory locked"]
    with pytest.raises(realtime.RealTimeRefused, match="does not grant SCHED_FIFO: permit it to the user"):
        realtime.claim_real_time(realtime.RealTime.ON)


def test_slow_log_readers_do_not_delay_the_robot(tmp_path: Path) -> None:
    """Standard error is a full pipe, as with `| less`: the control loop continues, and the emulator ends in time."""
    address = EmulatorProcess()  # its address only
    command = [sys.executable, "-m", "emulator", "--host", address.host, "--no-pendant", "--log-level", "debug"]
    with subprocess.Popen(
        command, cwd=Path(__file__).parents[2], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        while not (line := process.stdout.readline()).startswith("Ready:"):
            assert line
        with closing(socket.create_connection((address.host, 29999), timeout=DEADLINE_S)) as connection:
            lines = connection.makefile("rw")
            assert "Dashboard" in lines.readline()
            for number in range(40):  # 400 kB, and a pipe holds 64
                lines.write(f"addToLog {number}{'x' * 10_000}\n")
                lines.flush()
                assert lines.readline() == "Added log message\n"
            lines.write("running\n")
            lines.flush()
            assert lines.readline() == "Program running: false\n"
        assert process.stderr is not None
        assert select.select([process.stderr], [], [], 0.0)[0], "the log holds nothing: this proves nothing"
        process.send_signal(signal.SIGINT)
        assert process.wait(DEADLINE_S) == 0  # before anything is read
    address.dispose()


def test_log_output_is_complete_and_in_order(capsys: pytest.CaptureFixture[str]) -> None:
    stream = BackgroundStream("stdout")
    with stream.in_background():
        for number in range(1000):
            stream.write(f"{number}\n")
    stream.write("after\n")
    assert capsys.readouterr().out.split() == [*map(str, range(1000)), "after"]
