"""pyRobotiqUR: a client of the gripper's port."""

import pytest
from pyrobotiqur import RobotiqGripper
from pyrobotiqur.enums import GripperStatus, ObjectStatus
from rig import Rig

pytestmark = pytest.mark.parametrize("rig", ["ur3 3.4"], indirect=True)


def test_activate_move_and_reset(rig: Rig) -> None:
    with RobotiqGripper(rig.host) as gripper:
        gripper.reset()
        assert gripper.get_status() is GripperStatus.RESET
        gripper.activate()
        assert gripper.get_status() is GripperStatus.ACTIVE
        closed, found = gripper.close(speed=255)
        assert closed > 200
        assert found is ObjectStatus.AT_DEST
        opened, _ = gripper.open(speed=255)
        assert opened < 20
        halfway, _ = gripper.move_percent(50, speed=255)
        assert halfway == pytest.approx(128, abs=2)
        assert gripper.get_fault() == 0


def test_reconnecting_preserves_the_state_of_the_gripper(rig: Rig) -> None:
    with RobotiqGripper(rig.host) as gripper:
        gripper.activate()
        position, _ = gripper.move(100, speed=255)
    with RobotiqGripper(rig.host) as gripper:
        assert gripper.get_status() is GripperStatus.ACTIVE
        assert gripper.get_position() == position
