"""The fixtures in a user's tests."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from urproto.testing import launch
from urproto.testing.process import EmulatorProcess

ROBOTS = """
    import socket
    import pytest

    pytestmark = pytest.mark.ur_model("ur3", running=True)
    HOSTS = []

    @pytest.mark.ur_model("ur5e", polyscope="5.12", initial_q=[0.1, -1.2, 1.0, -1.4, -1.5, 0.2])
    def test_process(ur_emulator):
        HOSTS.append(ur_emulator.host)
        assert ur_emulator.describe()["model"] == "ur5e"
        assert ur_emulator.describe()["polyscope"].startswith("5.12")
        state = ur_emulator.state(["robot_mode", "actual_q"])
        assert state == {"robot_mode": "RUNNING", "actual_q": pytest.approx([0.1, -1.2, 1.0, -1.4, -1.5, 0.2])}
        with socket.create_connection((ur_emulator.host, ur_emulator.ports["dashboard"])) as dashboard:
            assert dashboard.recv(100).startswith(b"Connected: Universal Robots Dashboard Server")
        ur_emulator.press_emergency_stop()
        ur_emulator.run_until("safety_mode == ROBOT_EMERGENCY_STOP")
        ur_emulator.kill()
        assert not ur_emulator.start().state(["safety_mode"]) == {"safety_mode": "ROBOT_EMERGENCY_STOP"}

    def test_a_second_robot_of_the_same_model_is_a_separate_robot(ur_emulator, make_ur_emulator):
        other = make_ur_emulator(speed=5)
        assert len({*HOSTS, ur_emulator.host, other.host}) == 3
        assert ur_emulator.describe()["model"] == "ur3"
        assert other.describe()["model"] == "ur10e"
        assert other.time()["speed"] == 5

    @pytest.mark.ur_model(remote_control=True)
    def test_virtual_time(ur_robot):
        assert ur_robot.describe()["model"] == "ur3"
        ur_robot.run_until("robot_mode == RUNNING")
        began = ur_robot.time()["time_s"]
        ur_robot.step(125 * 60)
        assert ur_robot.time()["time_s"] == pytest.approx(began + 60)
        assert ur_robot.controller.remote_control
"""


def test_markers_and_options_select_the_robot(run_tests) -> None:
    run_tests(ROBOTS, "--ur-model", "ur10e", "--ur-polyscope", "5.9").assert_outcomes(passed=3)


WISHES = [
    ('"ur6"', "ur_emulator", "*unknown*ur6*"),
    ('"ur3", wheels=4', "ur_emulator", "*No such option*--wheels*"),
    ('"ur3", wheels=4', "ur_robot", "*no option 'wheels': choose from*running*"),
    ('"ur3", polyscope="5.12"', "ur_robot", "*UR3 (CB3) requires PolyScope*"),
    ('"ur3", "5.12"', "ur_robot", "*ur_model takes a model and named options*"),
]


def test_impossible_requests_are_explained(run_tests) -> None:
    result = run_tests(
        "import pytest\n"
        + "".join(
            f"@pytest.mark.ur_model({marker})\ndef test_{number}({fixture}): pass\n"
            for number, (marker, fixture, _) in enumerate(WISHES)
        )
    )
    result.assert_outcomes(errors=len(WISHES))
    result.stdout.fnmatch_lines([complaint for *_, complaint in WISHES])


def test_a_failure_shows_the_robots_log(run_tests) -> None:
    result = run_tests("""
        def test_it(ur_emulator):
            ur_emulator.send_script('sec hello():\\n  textmsg("I was here")\\nend\\n')
            ur_emulator.run_until("timestamp > 43")
            assert False
    """)
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*ur_emulator 127.*: output*", "*Ready*", "*ur_emulator 127.*: log*", "*I was here*"])
    result.stdout.fnmatch_lines(["*ur_emulator 127.*: see it again*", "ur-emulator replay *.journal"])


def test_a_crashed_emulator_is_reported(run_tests) -> None:
    result = run_tests("""
        import os, signal
        def test_it(ur_emulator):
            os.kill(ur_emulator._process.pid, signal.SIGABRT)
            ur_emulator._process.wait()
    """)
    result.assert_outcomes(passed=1, errors=1)
    result.stdout.fnmatch_lines(["*the emulator ended with status -6*"])


@pytest.mark.long
def test_four_workers_have_four_robots_at_the_same_time(run_tests, pytester: pytest.Pytester) -> None:
    result = run_tests(
        """
        import pathlib, time, pytest
        HERE = pathlib.Path(__file__).parent

        @pytest.mark.parametrize("number", range(4))
        def test_it(ur_emulator, number):
            (HERE / f"{ur_emulator.host}.robot").touch()
            deadline = time.monotonic() + 80
            while len(list(HERE.glob("*.robot"))) < 4:
                assert time.monotonic() < deadline, list(HERE.glob("*.robot"))
                time.sleep(0.05)
            assert ur_emulator.ports["rtde"] == 30004
            assert ur_emulator.state(["robot_mode"]) == {"robot_mode": "POWER_OFF"}
        """,
        "-n", "4", "--maxschedchunk", "1",
    )  # fmt: skip
    result.assert_outcomes(passed=4)


class TestNamesakes:
    """A user's project has modules named ``emulator`` and ``client``, too."""

    TESTS = """
        import emulator, client.things
        import pytest

        @pytest.mark.ur_model("ur3", running=True)
        def test_process(ur_emulator):
            assert ur_emulator.describe()["model"] == "ur3"
            assert emulator.OWNER == client.things.OWNER == "the user"

        @pytest.mark.ur_model("ur3", running=True)
        def test_virtual_time(ur_robot):
            raise AssertionError("it needs our emulator")
    """

    @pytest.fixture(autouse=True)
    def namesakes(self, pytester: pytest.Pytester) -> None:
        for package in ("emulator", "client"):
            pytester.mkpydir(package)
        for file in ("emulator/__init__.py", "client/things.py"):
            (pytester.path / file).write_text('OWNER = "the user"\n')

    def test_in_the_folder_of_the_tests(self, run_tests) -> None:
        result = run_tests(self.TESTS)
        result.assert_outcomes(passed=1, errors=1)
        result.stdout.fnmatch_lines(["*use EmulatorProcess (the fixture ur_emulator), or rename that package*"])

    def test_on_the_pythonpath(self, run_tests, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
        before = os.environ.get("PYTHONPATH", "")
        monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(pytester.path), *([before] if before else [])]))
        run_tests(self.TESTS, "--import-mode=importlib").assert_outcomes(passed=1, errors=1)


def test_loading_the_plugin_imports_next_to_nothing() -> None:
    code = (
        "import sys, pytest\nbefore = set(sys.modules)\nimport urproto.testing.pytest_plugin\n"
        "print(sorted(set(sys.modules) - before))"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert loaded.strip() in (
        "['urproto.testing', 'urproto.testing.pytest_plugin']",
        "['urproto.testing.pytest_plugin']",
        "['urproto', 'urproto.testing', 'urproto.testing.pytest_plugin']",
    )


def test_an_emulator_does_not_outlive_the_process_that_started_it(tmp_path: Path) -> None:
    code = (
        "import os, signal\nfrom urproto.testing import EmulatorProcess\nrobot = EmulatorProcess().start()\n"
        "print(robot._process.pid, flush=True)\nos.kill(os.getpid(), signal.SIGKILL)"
    )
    command = [sys.executable, "-c", code]
    killed = subprocess.run(
        command, capture_output=True, text=True, check=False, env=os.environ | {"TMPDIR": str(tmp_path)}
    )
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    deadline = time.monotonic() + 20
    while Path("/proc", killed.stdout.strip(), "exe").exists():
        assert time.monotonic() < deadline, "it lives on"
        time.sleep(0.02)


def test_a_process_exits_cleanly_and_can_be_restarted() -> None:
    with EmulatorProcess(["--model", "ur3"]) as robot:
        first = robot.host
        assert robot.stop() == 0
        assert not robot.running
        assert not robot.crashed
        robot.start()
        assert robot.host == first
        assert robot.describe()["model"] == "ur3"
        pid = robot._process.pid
    assert not Path("/proc", str(pid)).exists()


def test_with_a_single_loopback_address_robots_use_free_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    from urproto.testing import process

    monkeypatch.setattr(process, "_FIRST", 0xC6336400)  # 198.51.100.0, for documentation: no machine has it
    with EmulatorProcess(["--model", "ur3"]) as robot, EmulatorProcess(["--model", "ur3"]) as other:
        assert robot.host == other.host == "127.0.0.1"
        assert not set(robot.ports.values()) & set(other.ports.values())
        assert other.describe()["model"] == "ur3"


def test_the_launched_emulator_is_this_installation() -> None:
    assert Path(__file__).parents[2] == launch.ROOT
