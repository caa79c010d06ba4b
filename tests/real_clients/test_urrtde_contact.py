"""ur_rtde against something solid: an emulator with a table 30 mm below the tool (--world)."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from emulators import Emulators
from rig import JOINTS, START_Q, Rig
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

from tests.budget import subset
from urproto.robots import load_model
from urproto.robots.kinematics import Kinematics

pytestmark = pytest.mark.robot_speed(3)

BASE = [0.0] * 6
ALONG_Z = [0, 0, 1, 0, 0, 0]
DOWN = [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]
LIMITS = [0.05, 0.05, 0.05, 0.2, 0.2, 0.2]
BELOW_M = 0.03
STIFFNESS = 10_000.0
CONTACT_N = 20.0  # the emulator's contact threshold
both_series = pytest.mark.parametrize("rig", subset(["ur3", "ur3e"], now=["ur3"]), indirect=True)
e_series = pytest.mark.parametrize("rig", ["ur3e"], indirect=True)  # ur_rtde's script leaves these out on CB3


def height(model: str) -> float:
    """Height of the tool at START_Q."""
    return Kinematics(load_model(model).dh).forward(START_Q)[2]


@pytest.fixture(scope="module")
def emulators(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Emulators]:
    folder = tmp_path_factory.mktemp("world")
    positions = folder / "start.yaml"
    positions.write_text("".join(f"{name}: {q}\n" for name, q in zip(JOINTS, START_Q, strict=True)))
    emulators = WithTable(positions, folder)
    yield emulators
    emulators.close()


class WithTable(Emulators):
    """Emulators with a table."""

    def __init__(self, positions: Path, folder: Path) -> None:
        super().__init__(positions)
        self._folder = folder

    def arguments(self, model: str) -> list[str]:
        table = self._folder / f"{model}.yaml"
        pose = [0.0, 0.0, height(model) - BELOW_M]
        table.write_text(f"objects: {{table: {{plane: {{}}, pose: {pose}, stiffness: {STIFFNESS}}}}}\n")
        return [*super().arguments(model), "--world", str(table)]


@pytest.fixture
def control(control: RTDEControlInterface) -> RTDEControlInterface:
    """With the sensor zeroed in free space, since the reset sets the payload, which zeroes it where the last test
    ended."""
    assert control.zeroFtSensor()
    return control


@both_series
def test_force_mode_presses_on_the_table_with_10_N(
    rig: Rig, control: RTDEControlInterface, receive: RTDEReceiveInterface
) -> None:
    table = height(rig.model) - BELOW_M
    assert control.forceModeSetDamping(0.05)
    with rig.watch("actual_TCP_force") as state:
        assert control.forceMode(BASE, ALONG_Z, [0, 0, -10, 0, 0, 0], 2, LIMITS)
        state.wait_until(lambda sample: sample["actual_TCP_force"][2] > 5.0)
        pressed = state.wait_for(3.0)
        assert pressed["actual_TCP_force"][:3] == pytest.approx([0, 0, 10], abs=0.1)
        assert pressed["actual_TCP_pose"][2] == pytest.approx(table - 10 / STIFFNESS, abs=2e-5)
        assert receive.getActualTCPForce()[2] == pytest.approx(10, abs=0.1)
        assert control.forceModeStop()
        state.wait_until_still(timeout_s=2)


@e_series
def test_move_until_contact_returns_to_the_table_surface(rig: Rig, control: RTDEControlInterface) -> None:
    table = height(rig.model) - BELOW_M
    with rig.watch("actual_TCP_force") as state:
        assert control.moveUntilContact([0, 0, -0.05, 0, 0, 0])
        end = state.wait_until_still()
        track = state.track
    assert end["actual_TCP_pose"][2] == pytest.approx(table, abs=5e-4)
    assert table - 0.01 < track.pose[:, 2].min() < table - 0.5 * CONTACT_N / STIFFNESS  # includes damping


@e_series
def test_contact_from_another_direction_is_ignored(rig: Rig, control: RTDEControlInterface) -> None:
    """Down onto the table, while only upward contact is detected: the arm keeps pressing."""
    with rig.watch("actual_TCP_force") as state:
        assert control.startContactDetection([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        start = list(state.newest()["actual_TCP_pose"])
        goal = [*start[:2], height(rig.model) - BELOW_M - 0.004, *start[3:]]
        assert control.moveL(goal, 0.05, 0.5)
        pressed = state.wait_until_still()["actual_TCP_force"][2]
        assert not control.stopContactDetection()
        assert pressed == pytest.approx(0.004 * STIFFNESS, abs=1.0)


@e_series
def test_contact_detection_ends_a_move(rig: Rig, control: RTDEControlInterface) -> None:
    """ur_rtde's script stops, and returns to where the contact began."""
    table = height(rig.model) - BELOW_M
    with rig.watch() as state:
        start = list(state.next()["actual_TCP_pose"])
        assert control.startContactDetection()  # in the direction of motion
        assert control.moveL([start[0], start[1], start[2] - 0.1, *start[3:]], 0.05, 0.5, True)
        state.wait_until_moving()
        state.wait_until_still()
        still = state.wait_for(0.5)
        assert control.readContactDetection()
        assert control.stopContactDetection()
    assert still["actual_TCP_pose"][2] == pytest.approx(table, abs=5e-4)


@e_series
def test_tool_contact_reports_the_direction(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        start = list(state.next()["actual_TCP_pose"])
        control.toolContact(DOWN)
        state.wait_for(0.1)
        assert control.toolContact(DOWN) == 0
        deep = [*start[:2], height(rig.model) - BELOW_M - 0.004, *start[3:]]
        assert control.moveL(deep, 0.05, 0.5)
        state.wait_until(lambda _: control.toolContact(DOWN) > 0)  # the first answers are older
        state.wait_until(lambda _: control.toolContact([0, 0, 1.0, 0, 0, 0]) == 0)
        state.wait_until(lambda _: control.toolContact(BASE) > 0)
