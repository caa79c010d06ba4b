"""One suite for every robot: behaviour documented in the manuals, tested through the client library only.

    pytest tests/conformance                                             emulators, started here
    pytest tests/conformance --robot-ip 192.168.1.10                     a robot: reads only
    pytest tests/conformance --robot-ip 192.168.1.10 --i-know-it-moves   a robot: everything

Cases marked ``moves`` change something: they switch the arm on, turn the last joint by at
most 0.1 rad about where it is, at 0.2 rad/s or less, stop programs, write outputs and
registers, show popups. They never run on a robot without the flag. Put the arm where 0.1 rad in each joint is safe, and
on e-Series switch to Remote Control.
"""

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest

from client import BlockingDashboardClient, BlockingPrimaryClient, BlockingRealtimeClient, BlockingRTDEClient, dashboard
from client.primary import BRAKE_RELEASE, POWER_ON, STOP_PROGRAM, UNLOCK_PROTECTIVE_STOP
from urproto.errors import RobotRefused
from urproto.modes import RobotMode, SafetyMode
from urproto.versions import PolyscopeVersion

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "real_clients")]  # waiting; an emulator in a separate process

from emulator_process import EmulatorProcess  # noqa: E402 - found by the line above

if sys.platform != "linux":  # several emulators at once need the loopback addresses of Linux
    collect_ignore_glob = ["test_*"]

PATIENCE_S = 60.0
EMULATED = {  # faster than real time, as most of these cases wait for brakes and for stops to be unlocked
    "ur3": ["--model", "ur3", "--speed", "4"],
    "ur5e": ["--model", "ur5e", "--polyscope", "5.22", "--remote-control", "--speed", "2"],
}
PROGRAM = "conformance.urp"
PROGRAM_SCRIPT = "def conformance():\n  while True:\n    sync()\n  end\nend\n"


@dataclass(frozen=True)
class Robot:
    """Address and properties of the robot. program: a file it can load and play."""

    host: str
    version: PolyscopeVersion
    program: str | None

    @property
    def period_s(self) -> float:
        return self.version.series.period_s

    def dashboard(self) -> BlockingDashboardClient:
        return BlockingDashboardClient(self.host)

    def primary(self) -> BlockingPrimaryClient:
        return BlockingPrimaryClient(self.host)

    def realtime(self) -> BlockingRealtimeClient:
        return BlockingRealtimeClient(self.host)

    def rtde(self, outputs=(), inputs=(), **options) -> BlockingRTDEClient:
        return BlockingRTDEClient(self.host, outputs, inputs, **options)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "robot" in metafunc.fixturenames:
        names = [metafunc.config.getoption("--robot-ip") or list(EMULATED)]
        names = names[0] if isinstance(names[0], list) else names
        metafunc.parametrize("robot", names, indirect=True, scope="package")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("--robot-ip") or config.getoption("--i-know-it-moves"):
        return
    skip = pytest.mark.skip(reason="may move the robot: use --i-know-it-moves to allow that")
    for item in items:
        if HERE in item.path.parents and item.get_closest_marker("moves"):
            item.add_marker(skip)


@pytest.fixture(scope="package")
def robot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    """The robot under test; an emulator runs as long as its tests."""
    with ExitStack() as ending:
        if request.config.getoption("--robot-ip"):
            host, program = request.param, request.config.getoption("--robot-program")
        else:
            host, program = _start_emulator(request.param, tmp_path_factory.mktemp("programs"), ending), PROGRAM
        with BlockingDashboardClient(host) as client:
            version = client.request(dashboard.POLYSCOPE_VERSION)
        yield Robot(host, version, program)


def _start_emulator(name: str, programs: Path, ending: ExitStack) -> str:
    (programs / PROGRAM).write_bytes(b"")
    (programs / PROGRAM).with_suffix(".script").write_text(PROGRAM_SCRIPT)
    process = EmulatorProcess([*EMULATED[name], "--programs", str(programs)])
    ending.callback(process.dispose)
    process.start()
    ending.callback(process.stop)
    return process.host


@pytest.fixture
def running(robot: Robot, request: pytest.FixtureRequest) -> Robot:
    """The robot with its brakes released, no stop, no program. Only for tests marked ``moves``."""
    assert request.node.get_closest_marker("moves"), "this case moves the robot: mark it"
    with robot.primary() as primary:
        primary.run(primary.core.robot_state())
        state = primary.core.state
        if state.masterboard.safety_mode == SafetyMode.PROTECTIVE_STOP:
            primary.run(primary.core.command(UNLOCK_PROTECTIVE_STOP))
        if state.mode.robot_mode < RobotMode.IDLE:
            primary.run(primary.core.command(POWER_ON))
        if state.mode.robot_mode != RobotMode.RUNNING:
            primary.run(primary.core.command(BRAKE_RELEASE))
        primary.run(primary.core.command(STOP_PROGRAM))
    return robot


@pytest.fixture
def has(robot: Robot):
    """Skip a test of a feature that the robot's version lacks."""

    def check(operation: dashboard.Operation) -> dashboard.Operation:
        try:
            operation.check(robot.version)
        except RobotRefused as refused:
            pytest.skip(str(refused))
        return operation

    return check
