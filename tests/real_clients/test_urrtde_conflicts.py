"""Two clients that control one robot: ur_rtde's interfaces need the same RTDE inputs."""

import pytest
from rig import Rig, disconnecting
from rtde_control import RTDEControlInterface
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface

pytestmark = pytest.mark.robot_speed(4)

IN_USE = "input registers are already in use"


def test_a_second_control_interface_is_refused_without_side_effects(rig: Rig, control: RTDEControlInterface) -> None:
    with pytest.raises(RuntimeError, match=IN_USE):
        RTDEControlInterface(rig.host)
    assert control.isConnected()
    assert control.isProgramRunning()
    assert control.moveJ([0.3, -1.4, 1.5, -1.7, -1.5, 0.1], 2.0, 8.0)


@pytest.mark.long
def test_one_control_one_io_and_many_receive_interfaces(rig: Rig, control: RTDEControlInterface) -> None:
    io = RTDEIOInterface(rig.host)
    watchers = [RTDEReceiveInterface(rig.host) for _ in range(3)]
    with disconnecting(io, *watchers):
        assert io.setStandardDigitalOut(3, True)
        rig.eventually(lambda: all(watcher.getDigitalOutState(3) for watcher in watchers))
        assert control.isProgramRunning()
        assert io.setStandardDigitalOut(3, False)


def test_another_client_may_control_once_the_first_has_left(rig: Rig) -> None:
    for _ in range(3):
        control = RTDEControlInterface(rig.host)
        with disconnecting(control):
            assert control.isProgramRunning()
            control.stopScript()
