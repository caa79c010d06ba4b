"""The cable is pulled, and somebody else reads too slowly."""

import socket
import time

import pytest
from cable import Cable
from cell import FAR, HOME, Cell
from waiting import wait_until

from urtesting import EmulatorProcess


def test_a_pulled_cable_is_noticed_and_forgiven(far_cell: Cell, cable: Cable) -> None:
    assert far_cell.is_online()
    cable.pull()
    wait_until(lambda: not far_cell.is_online())
    cable.plug()
    wait_until(far_cell.is_online)
    far_cell.move(FAR, speed=3.0)


def test_the_robot_stops_by_itself_without_the_cable(
    far_cell: Cell, cable: Cable, ur_emulator: EmulatorProcess
) -> None:
    far_cell.guard()
    assert far_cell.control.moveJ(list(FAR), 0.1, 1.0, True)  # 12 s
    for _ in range(20):
        far_cell.kick()
        time.sleep(0.05)
    assert ur_emulator.state(["runtime_state"]) == {"runtime_state": "PLAYING"}
    cable.pull()
    ur_emulator.run_until("runtime_state == STOPPED", timeout_s=5)
    ur_emulator.run_until("target_qd[0] == 0")
    assert HOME[0] < ur_emulator.state(["actual_q"])["actual_q"][0] < FAR[0] - 0.3


def test_a_slow_client_of_the_robot_does_not_slow_the_cell(cell: Cell, ur_emulator: EmulatorProcess) -> None:
    sleepers = [socket.create_connection((ur_emulator.host, port)) for port in (30001, 30003) for _ in range(3)]
    for sleeper in sleepers:
        sleeper.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    ur_emulator.set_speed(10)
    later = ur_emulator.time()["time_s"] + 60
    ur_emulator.run_until(f"timestamp >= {later}", timeout_s=120)  # 9 MB that nobody reads
    ur_emulator.set_speed(1)
    now = ur_emulator.state(["timestamp"])["timestamp"]
    wait_until(lambda: cell.receive.getTimestamp() >= now)
    cell.move(FAR, speed=3.0)
    assert cell.receive.getActualQ() == pytest.approx(FAR, abs=0.01)
    for sleeper in sleepers:
        sleeper.close()
