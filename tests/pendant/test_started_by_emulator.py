"""``python -m emulator`` brings a pendant along, and takes it away again."""

import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.servers.test_cli import read_until
from urproto.testing.addresses import claim_address

DEADLINE_S = 40.0

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="wants an address of its own")


@contextmanager
def emulator(*arguments: str) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    address = claim_address()
    command = [sys.executable, "-P", "-u", "-m", "emulator", "--model", "ur3", "--host", address.host, *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        yield process, address.host
    finally:
        process.kill()
        process.communicate()
        address.release()


def answers(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=5) as page:
            return page.status == 200
    except OSError:
        return False


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_pendant_comes_and_goes_with_the_emulator(number: signal.Signals) -> None:
    with emulator() as (process, host):
        url = f"http://{host}:6080"
        assert url in read_until(process, "Teach pendant of")
        assert answers(url)
        process.send_signal(number)
        process.wait(DEADLINE_S)
        deadline = time.monotonic() + DEADLINE_S
        while answers(url):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        assert number == signal.SIGKILL or process.returncode == 0


def test_a_taken_port_is_told_and_the_robot_stays(tmp_path: Path) -> None:
    with emulator("--pendant-port", "29999") as (process, host):
        seen = read_until(process, "No pendant:")
        assert f"ur-client: cannot listen on {host} port 29999: Address already in use; choose another --port" in seen
        assert "Traceback" not in seen
        assert process.poll() is None


def test_none_is_wanted() -> None:
    with emulator("--no-pendant") as (process, _):
        read_until(process, "Ready:")
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text()
        assert not children.split(), os.listdir(f"/proc/{process.pid}")
