"""The robot is stopped, and the cell brings it back."""

from concurrent.futures import Future, ThreadPoolExecutor

import pytest
from cell import FAR, HOME, Cell, CellError
from waiting import wait_until

from urtesting import EmulatorProcess

MOVING = "target_qd[0] > 0.5"


def begin_move(pool: ThreadPoolExecutor, cell: Cell, ur_emulator: EmulatorProcess) -> "Future[None]":
    moving = pool.submit(cell.move, FAR)
    ur_emulator.run_until(MOVING)
    return moving


def test_a_move_arrives(cell: Cell, ur_emulator: EmulatorProcess) -> None:
    cell.move(FAR, speed=3.0)
    ur_emulator.run_until("target_qd[0] == 0")
    assert ur_emulator.state(["actual_q"])["actual_q"] == pytest.approx(FAR, abs=1e-3)


def test_protective_stop_on_the_way(cell: Cell, ur_emulator: EmulatorProcess) -> None:
    with ThreadPoolExecutor() as pool:
        moving = begin_move(pool, cell, ur_emulator)
        ur_emulator.protective_stop()
        with pytest.raises(CellError, match="protective stop"):
            moving.result()
    assert ur_emulator.state(["actual_q"])["actual_q"][0] < FAR[0] - 0.1
    cell.recover()
    cell.move(HOME, speed=3.0)


@pytest.mark.ur_model("ur5e", polyscope="5.22")
def test_emergency_stop_and_back(cell: Cell, ur_emulator: EmulatorProcess) -> None:
    with ThreadPoolExecutor() as pool:
        moving = begin_move(pool, cell, ur_emulator)
        ur_emulator.press_emergency_stop()
        with pytest.raises(CellError, match="emergency stop"):
            moving.result()
    with pytest.raises(CellError, match="release it first"):
        cell.recover()
    ur_emulator.release_emergency_stop()
    wait_until(lambda: not cell.stop_reason())
    cell.recover()
    cell.move(FAR, speed=3.0)
