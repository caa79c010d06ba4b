"""Emulators for the tests with unmodified client libraries, and those libraries' interfaces to them."""

import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import rtde_control
import rtde_io
import rtde_receive

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # the helpers next to this file; importlib mode does not add their folder

from emulators import Emulators  # noqa: E402 - found by the line above
from rig import JOINTS, START_Q, Rig  # noqa: E402

if sys.platform != "linux":  # many robots at once need the loopback addresses of Linux
    collect_ignore_glob = ["test_*"]

HANG_S = 60.0  # no test takes longer; a hanging client call ends when its program is stopped
DEFAULT_MODEL = "ur3"
RESET_SPEED = 8.0


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark these tests, and sort them by robot so that few emulators run at the same time."""
    places = [index for index, item in enumerate(items) if HERE in item.path.parents]
    for index, item in zip(places, sorted((items[index] for index in places), key=model_of), strict=True):
        item.add_marker(pytest.mark.real_client)
        # Client calls block in C++ for minutes if something is missing, so the hard limit has to be a thread.
        item.add_marker(pytest.mark.timeout(HANG_S + 60, method="thread"))
        items[index] = item


def model_of(item: pytest.Item) -> str:
    callspec = getattr(item, "callspec", None)
    return str(callspec.params.get("rig", DEFAULT_MODEL)) if callspec else DEFAULT_MODEL


@pytest.fixture(scope="package")
def emulators(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Emulators]:
    positions = tmp_path_factory.mktemp("positions") / "start.yaml"
    positions.write_text("".join(f"{name}: {q}\n" for name, q in zip(JOINTS, START_Q, strict=True)))
    emulators = Emulators(positions)
    yield emulators
    emulators.close()


@pytest.fixture
def rig(request: pytest.FixtureRequest, emulators: Emulators) -> Iterator[Rig]:
    """A robot at rest in START_Q; a UR3 unless the test is parametrised with another model.

    It runs in real time, or faster by the factor of the marker ``robot_speed`` if a test mostly waits for the arm.
    """
    rig = emulators.get(getattr(request, "param", DEFAULT_MODEL))
    rig.process.set_speed(RESET_SPEED)
    rig.reset()
    marker = request.node.get_closest_marker("robot_speed")
    rig.process.set_speed(marker.args[0] if marker else 1.0)
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
def control_beside_sensor(rig: Rig) -> Iterator[rtde_control.RTDEControlInterface]:
    """A control interface that leaves the external force input to another client."""
    flags = rtde_control.RTDEControlInterface.FLAGS_DEFAULT | rtde_control.RTDEControlInterface.FLAG_NO_EXT_FT
    control = rtde_control.RTDEControlInterface(rig.host, -1.0, flags)
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
