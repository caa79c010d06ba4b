"""Setpoints reach the arm through the driver's own control program."""

import pytest
from driver_rig import CALM_S, HOME, swing

from client.errors import ProgramNotRunningError
from urproto.errors import LocalProtocolError, RobotRefused


async def test_servoing_follows_joint_angles_and_comes_to_rest(pair):
    await pair.setpoints(1.0, lambda t: pair.driver.servoj(swing(t), CALM_S))
    assert pair.distance(swing(1.0)) < 0.02
    await pair.setpoints(1.2, lambda t: pair.driver.servoj(swing(min(1.0 + t, 2.0)), CALM_S))
    assert pair.distance() < 0.002
    pair.driver.idle()
    await pair.until(lambda: pair.at_rest)
    assert pair.driver.program_running
