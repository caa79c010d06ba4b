"""ur_rtde's reaction to faults that are injected over the control API."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest
from rig import PATIENCE_S, START_Q, Rig, disconnecting
from rtde_control import RTDEControlInterface
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface

from urproto.controlapi import RemoteControl

TARGET_Q = [START_Q[0] + 0.3, *START_Q[1:]]
ATTEMPTS = 4  # ur_rtde 1.6.5: about one in ten ends with a signal
LOSES_ITS_CONNECTION = """
import sys, time
from rtde_control import RTDEControlInterface
control = RTDEControlInterface(sys.argv[1])
print("connected", flush=True)
while control.isConnected():
    time.sleep(0.01)
connected = False
while not connected:
    time.sleep(0.1)
    try:
        connected = control.reconnect()
    except RuntimeError:
        pass  # nobody listens yet
moved = control.moveJ([float(q) for q in sys.argv[2:]], 2.0, 8.0)
control.disconnect()
sys.exit(not moved)
"""


@pytest.fixture
def faults(rig: Rig) -> Iterator[RemoteControl]:
    with closing(RemoteControl(rig.host)) as control:
        yield control
        control.clear_faults()


def until(robot: RemoteControl, condition: Callable[[], object]) -> None:
    """Check again after some control periods; the rig's method needs RTDE."""
    for _ in range(200):
        if condition():
            return
        robot.run_until(f"timestamp > {robot.time()['time_s'] + 0.05}")
    raise AssertionError("it did not happen")


def test_a_dropped_connection_is_noticed_and_reestablished(
    rig: Rig, faults: RemoteControl, receive: RTDEReceiveInterface
) -> None:
    assert receive.isConnected()
    faults.inject_fault("drop_connection", port="rtde")
    rig.eventually(lambda: not receive.isConnected())
    assert receive.reconnect()
    assert receive.getActualQ() == pytest.approx(START_Q)


def test_a_program_survives_the_loss_of_its_client_connection(rig: Rig, faults: RemoteControl) -> None:
    """In a separate process: the thread in which ur_rtde reconnects sometimes terminates its process."""
    for _ in range(ATTEMPTS):
        command = [sys.executable, "-c", LOSES_ITS_CONNECTION, rig.host, *map(str, TARGET_Q)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
            assert child.stdout is not None
            assert child.stdout.readline() == "connected\n"
            faults.inject_fault("restart_port", port="rtde", outage_s=0.3)
            child_output, _ = child.communicate(timeout=PATIENCE_S)
        if child.returncode >= 0:
            break
    assert child.returncode == 0, child_output


def test_stale_data_has_a_running_time_stamp(rig: Rig, faults: RemoteControl, receive: RTDEReceiveInterface) -> None:
    fault = faults.inject_fault("stale_data")
    faults.set_digital_input(2, level=True)
    before = receive.getTimestamp()
    rig.eventually(lambda: receive.getTimestamp() > before + 0.5)
    assert receive.getActualDigitalInputBits() == 0
    faults.clear_fault(fault)
    rig.eventually(lambda: receive.getActualDigitalInputBits() == 4)
    faults.set_digital_input(2, level=False)


def test_a_pause_of_the_data_freezes_the_time_stamp(
    rig: Rig, faults: RemoteControl, receive: RTDEReceiveInterface
) -> None:
    fault = faults.inject_fault("pause_rtde")
    faults.run_until(f"timestamp > {receive.getTimestamp() + 0.2}")
    frozen = receive.getTimestamp()
    faults.run_until(f"timestamp > {frozen + 0.5}")
    assert receive.getTimestamp() == frozen
    faults.clear_fault(fault)
    rig.eventually(lambda: receive.getTimestamp() > frozen + 0.5)


def test_an_encoder_jump_stops_the_move(rig: Rig, faults: RemoteControl, control: RTDEControlInterface) -> None:
    receive = RTDEReceiveInterface(rig.host)
    with disconnecting(receive):
        jump = faults.inject_fault("encoder_jump", joint=0, by_rad=0.2, stop_above_rad=0.1)
        rig.eventually(receive.isProtectiveStopped)
        assert receive.getActualQ()[0] == pytest.approx(START_Q[0] + 0.2, abs=1e-6)
        faults.clear_fault(jump)
        faults.unlock_protective_stop()
        rig.eventually(lambda: not receive.isProtectiveStopped())
        assert receive.getActualQ()[0] == pytest.approx(START_Q[0], abs=1e-6)


def test_an_input_in_use_keeps_the_client_out(rig: Rig, faults: RemoteControl) -> None:
    fault = faults.inject_fault("rtde_input_in_use", field="speed_slider_mask")
    with pytest.raises(RuntimeError, match="in use"):
        RTDEIOInterface(rig.host).disconnect()
    faults.clear_fault(fault)
    RTDEIOInterface(rig.host).disconnect()


def test_a_refused_port(rig: Rig, faults: RemoteControl) -> None:
    fault = faults.inject_fault("refuse_connections", port="rtde")
    with pytest.raises(RuntimeError, match="Could not connect"):
        RTDEReceiveInterface(rig.host)
    faults.clear_fault(fault)

    def connects() -> bool:
        try:
            receive = RTDEReceiveInterface(rig.host)
        except RuntimeError:
            return False
        with disconnecting(receive):
            return bool(receive.isConnected())

    until(faults, connects)


def test_a_program_that_fails_at_a_line(rig: Rig, faults: RemoteControl) -> None:
    faults.inject_fault("runtime_exception", line=40, message="injected")
    with pytest.raises(RuntimeError):
        RTDEControlInterface(rig.host).disconnect()
    assert any("injected" in line for line in faults.log())
