"""The GitHub Action's steps, run as on a runner: bash, with the inputs in the environment.

The first step, which fetches packages, finds an existing environment.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import yaml

from urproto.testing.process import claim_address

ROOT = Path(__file__).resolve().parents[2]
ACTION = yaml.safe_load((ROOT / "action.yml").read_text())
SCRIPTS = Path(sys.executable).parent
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the action runs bash")


class Runner:
    """Runs the action's steps with some inputs. outputs: set by the last step. printed: output of all steps."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.printed = ""
        self.outputs = dict[str, str]()
        (folder / "ur-emulator").mkdir()
        (folder / "ur-emulator" / "bin").symlink_to(SCRIPTS)

    def run(self, **given: str) -> int:
        """The exit status of the first step that fails, or 0."""
        defaults = {name: str(value["default"]) for name, value in ACTION["inputs"].items()}
        assert given.keys() <= defaults.keys()
        inputs = {**defaults, **given}
        context = {f"inputs.{name}": value for name, value in inputs.items()} | {"github.action_path": str(ROOT)}
        path, output = self._folder / "path", self._folder / "output"
        path.touch()
        output.write_text("")
        for step in ACTION["runs"]["steps"]:
            assert step["shell"] == "bash"
            variables = {name: context[value.strip("${} ")] for name, value in step["env"].items()}
            assert "${{" not in step["run"]  # a user's input is a value, and never part of the script
            added = ":".join(path.read_text().split())
            done = subprocess.run(
                ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]],
                env={
                    **{name: value for name, value in os.environ.items() if not name.startswith(("UR_", "PYTEST_"))},
                    "PATH": f"{added}:/usr/bin:/bin",
                    "RUNNER_TEMP": str(self._folder),
                    "GITHUB_PATH": str(path),
                    "GITHUB_OUTPUT": str(output),
                    **variables,
                },
                cwd=self._folder,
                capture_output=True,
                text=True,
                timeout=100,
                check=False,
            )
            self.printed += done.stdout + done.stderr
            if done.returncode:
                return done.returncode
        self.outputs = dict(line.split("=", 1) for line in output.read_text().splitlines())
        return 0

    def end_robots(self) -> None:
        """End all started processes, as a runner does at the end of a job."""
        deadline = time.monotonic() + 30.0
        while begun := [place for place in Path("/proc").glob("[0-9]*") if self._began(place)]:
            assert time.monotonic() < deadline, f"{begun} do not end"
            for place in begun:
                with suppress(ProcessLookupError):
                    os.kill(int(place.name), signal.SIGTERM)
            time.sleep(0.1)

    def _began(self, place: Path) -> bool:
        try:
            return f"RUNNER_TEMP={self._folder}".encode() in (place / "environ").read_bytes().split(b"\0")
        except OSError:  # ended, or of another user
            return False


@pytest.fixture
def host() -> Iterator[str]:
    address = claim_address()
    yield address.host
    address.release()


@pytest.fixture
def runner(tmp_path: Path) -> Iterator[Runner]:
    if not Path("/proc/self/environ").exists():
        pytest.skip("processes are found in /proc")
    runner = Runner(tmp_path)
    yield runner
    runner.end_robots()


def test_a_robot_is_running_after_the_action(runner: Runner, host: str) -> None:
    assert runner.run(model="ur5e", polyscope="5.12", host=host) == 0, runner.printed
    seen = subprocess.run(
        [SCRIPTS / "ur-client", "state", "--robot-ip", host, "--json"], capture_output=True, text=True, timeout=60
    )
    assert seen.returncode == 0, seen.stderr
    assert "Ready:" in Path(runner.outputs["log"]).read_text()


def test_invalid_options_are_shown_immediately(runner: Runner, host: str) -> None:
    assert runner.run(model="ur99", host=host, wait="600") == 1
    assert "::error title=ur-emulator::" in runner.printed
    assert "ur99" in runner.printed


@pytest.mark.skipif(sys.platform != "linux", reason="the shared clock is a library for Linux")
def test_a_command_runs_with_the_robot_in_time_of_their_own(runner: Runner, host: str) -> None:
    command = f"sleep 60; ur-client state --robot-ip {host} --json"
    assert runner.run(host=host, run=command) == 0, runner.printed
    assert '"robot_mode": "RUNNING"' in runner.printed
    assert Path(runner.outputs["journal"]).exists()
    assert runner.run(host=host, run="exit 7 | true") == 7
