"""Emulators for the tests with unmodified client libraries, and those libraries' interfaces to them."""

import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rtde_control
import rtde_io
import rtde_receive

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # the helpers beside this file; importlib mode does not add their folder

from emulator_process import EmulatorProcess  # noqa: E402 - found by the line above
from rig import JOINTS, START_Q, Rig  # noqa: E402

if sys.platform != "linux":  # many robots at once need the loopback addresses of Linux
    collect_ignore_glob = ["test_*"]

HANG_S = 60.0  # no test takes longer; a hanging client call ends when its program is stopped
ARGUMENTS = {
    "ur3": (["--model", "ur3"], (3, 15), 0.008),
    "ur3e": (["--model", "ur3e", "--polyscope", "5.22", "--remote-control"], (5, 22), 0.002),
}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Client calls block in C++ for minutes when something is missing: the hard limit has to be a thread."""
    for item in items:
        if HERE in item.path.parents:
            item.add_marker(pytest.mark.real_client)
            item.add_marker(pytest.mark.timeout(HANG_S + 30, method="thread"))


@pytest.fixture(scope="session")
def emulators(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str], Rig]]:
    """Start an emulator at its first use, end it with the session and check that it ends cleanly."""
    rigs: dict[str, Rig] = {}
    positions = tmp_path_factory.mktemp("positions") / "start.yaml"
    positions.write_text("".join(f"{name}: {q}\n" for name, q in zip(JOINTS, START_Q, strict=True)))

    def get(model: str) -> Rig:
        if model not in rigs:
            arguments, polyscope, period_s = ARGUMENTS[model]
            process = EmulatorProcess([*arguments, "--running", "--initial-positions", str(positions)])
            rigs[model] = Rig(process, model, polyscope, period_s)
        return rigs[model] if rigs[model].process.running else rigs[model].start()

    yield get
    statuses = {model: rig.process.stop() for model, rig in rigs.items() if rig.process.running}
    for rig in rigs.values():
        rig.process.dispose()
    assert not any(statuses.values()), f"exit statuses: {statuses}"


@pytest.fixture
def rig(request: pytest.FixtureRequest, emulators: Callable[[str], Rig]) -> Iterator[Rig]:
    """A robot at rest in START_Q; a UR3 unless the test is parametrised with another model."""
    rig = emulators(getattr(request, "param", "ur3"))
    rig.reset()
    guard = threading.Timer(HANG_S, rig.process.dashboard, ["stop"])
    guard.start()
    yield rig
    guard.cancel()
    guard.join()
    assert rig.process.running, f"the emulator died:\n{rig.process.log}"


@pytest.fixture
def control(rig: Rig) -> Iterator[rtde_control.RTDEControlInterface]:
    control = rtde_control.RTDEControlInterface(rig.host)
    yield control
    control.disconnect()


@pytest.fixture
def receive(rig: Rig) -> Iterator[rtde_receive.RTDEReceiveInterface]:
    receive = rtde_receive.RTDEReceiveInterface(rig.host)
    yield receive
    receive.disconnect()


@pytest.fixture
def io(rig: Rig) -> Iterator[rtde_io.RTDEIOInterface]:
    io = rtde_io.RTDEIOInterface(rig.host)
    yield io
    io.disconnect()
