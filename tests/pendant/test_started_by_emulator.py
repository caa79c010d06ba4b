"""``python -m emulator`` starts a pendant, and ends it."""

import asyncio
import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from client.rtde import BlockingRTDEClient
from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from emulator.pendant_process import Pendant
from tests.servers.test_cli import read_until
from urproto.addresses import is_backdoor
from urproto.compat import module_command
from urproto.compat_asyncio import timeout
from urproto.controlapi import RemoteControl
from urproto.ports import CONTROL_API_PORT
from urproto.robots import load_model
from urproto.testing.process import claim_address

DEADLINE_S = 40.0

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="requires a separate address")


@contextmanager
def emulator(*arguments: str) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    address = claim_address()
    command = [*module_command("emulator", "-u"), "--model", "ur3", "--host", address.host, *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        yield process, address.host
    finally:
        process.kill()
        process.communicate()
        address.release()


def responds(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=5) as page:
            return page.status == 200
    except OSError:
        return False


@pytest.mark.parametrize("number", [pytest.param(signal.SIGINT, marks=pytest.mark.long), signal.SIGKILL])
def test_pendant_starts_and_ends_with_emulator(number: signal.Signals) -> None:
    with emulator() as (process, host):
        url = f"http://{host}:6080"
        assert url in read_until(process, "Teach pendant of")
        assert responds(url)
        assert is_backdoor(host, 6080), "programs of robots must not reach it"
        process.send_signal(number)
        process.wait(DEADLINE_S)
        deadline = time.monotonic() + DEADLINE_S
        while responds(url):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        assert number == signal.SIGKILL or process.returncode == 0


def test_taken_port_is_reported_and_robot_keeps_running(tmp_path: Path) -> None:
    with emulator("--pendant-port", "29999") as (process, host):
        output = read_until(process, "No teach pendant:")
        assert f"ur-client: cannot listen on {host} port 29999: Address already in use; choose another --port" in output
        assert "Traceback" not in output
        assert process.poll() is None


@pytest.mark.long
def test_killed_pendant_is_restarted_and_reported() -> None:
    with emulator() as (process, host):
        read_until(process, "Teach pendant of")
        with closing(RemoteControl(host, CONTROL_API_PORT)) as control:
            first = control.pendant()
            assert (first["state"], first["starts"], first["port"], first["problem"]) == ("running", 1, 6080, "")
            with BlockingRTDEClient(host, ("timestamp",)) as robot:
                os.kill(first["pid"], signal.SIGKILL)
                messages = read_until(process, "(restarted: start 2)")
                assert robot.latest()["timestamp"] > 0.0
            again = control.pendant()
        assert "The teach pendant was killed (SIGKILL) after" in messages
        assert responds(f"http://{host}:6080")
        assert (again["state"], again["starts"]) == ("running", 2)
        assert again["pid"] != first["pid"]
        assert again["problem"].startswith("it was killed (SIGKILL)")


async def test_repeatedly_dying_pendant_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("emulator.pendant_process._BACKOFF_S", (0.0, 0.0))
    monkeypatch.setattr(Pendant, "_command", lambda _: ["sh", "-c", "kill -9 $$"])
    messages = list[str]()
    given_up = asyncio.Event()

    def report(line: str) -> None:
        messages.append(line)
        if "given up" in line:
            given_up.set()

    config = EmulatorConfig(controller=ControllerConfig(model=load_model("ur3")), ephemeral_ports=True)
    async with (
        Emulator(config) as robot,
        Pendant(robot.config, robot.ports, 6080, report) as pendant,
        timeout(DEADLINE_S),
    ):
        await given_up.wait()
    assert [line.partition(" after ")[0] for line in messages] == ["The teach pendant was killed (SIGKILL)"] * 3
    assert "it has failed 3 times and is given up" in messages[-1]
    assert "ur-client pendant --robot-ip 127.0.0.1" in messages[-1]
    assert pendant.report()["state"] == "given up"
    assert pendant.report()["starts"] == 3


def test_pendant_can_be_disabled() -> None:
    with emulator("--no-pendant") as (process, _):
        read_until(process, "Ready:")
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text()
        assert not children.split(), os.listdir(f"/proc/{process.pid}")
