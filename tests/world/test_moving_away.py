"""After a collision, the arm can be moved away once its stop is released; moving it further in stops it again."""

from pathlib import Path

import pytest

from emulator.commands.requests import DashboardLine
from emulator.safety.signals import SafetyDevice
from emulator.world.file import read_world
from tests.commands import SetSafetyDevice
from tests.rows import each_row
from urproto.modes import RobotMode, RuntimeState, SafetyMode
from urproto.primary.messages import ErrorCodeMessage

TABLE = Path(__file__).parents[2] / "examples" / "table.yaml"
AWAY = {"up": (0.0, 0.0, 0.02), "up and aside": (0.012, 0.008, 0.012), "barely up": (0.02, 0.0, 0.002)}


def codes(rig):
    return [message.code for message in rig.messages if isinstance(message, ErrorCodeMessage)]


def ask(rig, line):
    """The dashboard server's answer."""
    return rig.post(DashboardLine(line))


def move(rig, by, speed):
    """Run a straight move of the TCP, until it is over or the arm has been stopped."""
    goal = [place + change for place, change in zip(rig.pose, (*by, 0.0, 0.0, 0.0), strict=True)]
    rig.program(f"movel(p{goal}, a=1.2, v={speed})")
    rig.until(lambda: rig.now.runtime_state is RuntimeState.PLAYING, 1.0)
    rig.until(lambda: rig.controller.safety.stopped or rig.now.runtime_state is RuntimeState.STOPPED, 60.0)


def crashed(make, speed, **config):
    """An arm that has driven the tip into the table of the example and was stopped by that."""
    rig = make("ur5e", world=read_world(TABLE), **config)
    above = rig.pose[2] - 0.055
    move(rig, (0.0, 0.0, -above - 0.06), speed)
    assert codes(rig) == [157]
    rig.until(lambda: rig.controller.arm.standing, 1.0)
    rig.seconds(0.5)
    rig.messages.clear()
    return rig


def unlocked(make, speed=0.05, **config):
    """As after recover() of the client library: unlocked, the program ended."""
    rig = crashed(make, speed, **config)
    rig.seconds(5.0)
    assert ask(rig, "unlock protective stop") == "Protective stop releasing"
    rig.controller.programs.stop("recovery")
    rig.until(lambda: rig.now.runtime_state is RuntimeState.STOPPED, 1.0)
    assert rig.now.safety_mode is SafetyMode.NORMAL
    return rig


@each_row("direction", AWAY)
@each_row("speed", [0.005, 0.25])
@each_row("impact", [0.05, 0.25])
def test_the_arm_can_be_moved_away_in_any_direction_at_any_speed(make, impact, speed, direction):
    rig = unlocked(make, impact)
    before, wanted = rig.pose, AWAY[direction]
    assert rig.force[2] > 80.0
    move(rig, wanted, speed)
    assert codes(rig) == []
    assert [now - then for now, then in zip(rig.pose, before, strict=False)][:3] == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize("speed", [0.005, 0.25])
def test_an_arm_with_servo_loops_and_noise_can_be_moved_away(make, speed):
    rig = unlocked(make, dynamic=True, seed=3)
    move(rig, AWAY["up"], speed)
    assert codes(rig) == []
    assert rig.force[2] == pytest.approx(0.0, abs=3.0)


@each_row("speed", [0.005, 0.05])
@each_row("impact", [0.05, 0.25])
def test_moving_further_in_stops_the_arm_again(make, impact, speed):
    rig = unlocked(make, impact)
    height = rig.pose[2]
    move(rig, (0.0, 0.0, -0.02), speed)
    assert codes(rig) == [157]
    rig.seconds(0.5)
    assert 0.0005 < height - rig.pose[2] < 0.003


def test_what_is_granted_decreases_as_the_arm_is_relieved(make):
    """Half out, the arm is stopped at less than the first impact; wholly out, it is granted nothing."""
    rig = unlocked(make, 0.25)
    ordinary = make("ur5e").now.actual_current_window
    depth = 0.05 - (rig.pose[2] - 0.005)
    windows = [rig.now.actual_current_window]
    for _ in range(2):
        move(rig, (0.0, 0.0, depth / 2), 0.02)
        windows.append(rig.now.actual_current_window)
    assert windows[0][1] > windows[1][1] > windows[2][1]
    move(rig, (0.0, 0.0, 0.01), 0.02)
    assert rig.now.actual_current_window == ordinary
    move(rig, (0.0, 0.0, -0.03), 0.05)
    assert codes(rig) == [157]
    assert rig.force[2] < 110.0  # as at the first impact at this speed


def test_a_push_the_other_way_is_a_collision_at_the_ordinary_window(make):
    rig = unlocked(make)
    move(rig, AWAY["up"], 0.05)
    rig.controller.external_wrench = (0.0, 0.0, -100.0, 0.0, 0.0, 0.0)
    rig.until(lambda: rig.controller.safety.stopped, 0.2)
    assert codes(rig) == [157]


def test_a_resumed_program_that_presses_on_is_stopped_again(make):
    rig = crashed(make, 0.05)
    rig.seconds(5.0)
    assert ask(rig, "unlock protective stop") == "Protective stop releasing"
    rig.tick()
    rig.controller.programs.resume()
    rig.until(lambda: rig.controller.safety.stopped, 10.0)
    assert codes(rig) == [157]


def test_an_arm_that_was_powered_off_in_contact_can_be_moved_away(make):
    """Also from a force beyond the tool's limit, which would be a violation a quarter of a second later."""
    rig = crashed(make, 0.25)
    assert rig.force[2] > 176.0
    rig.post(SetSafetyDevice(SafetyDevice.EMERGENCY_STOP, True))
    rig.until(lambda: rig.now.robot_mode is RobotMode.POWER_OFF, 5.0)
    rig.post(SetSafetyDevice(SafetyDevice.EMERGENCY_STOP, False))
    rig.controller.programs.stop()  # it is paused, and another one would only end it
    ask(rig, "brake release")
    rig.until(lambda: rig.now.robot_mode is RobotMode.RUNNING, 60.0)
    rig.seconds(1.0)
    rig.messages.clear()
    move(rig, AWAY["up"], 0.005)
    assert codes(rig) == []
    assert rig.now.safety_mode is SafetyMode.NORMAL


def test_the_force_is_still_shown_after_a_script_has_been_started(make):
    """Nobody has zeroed the sensor: the tip still presses."""
    rig = unlocked(make)
    pressing = rig.force[2]
    rig.program("sleep(0.5)")
    rig.until(lambda: rig.now.runtime_state is RuntimeState.PLAYING, 1.0)
    assert rig.now.actual_TCP_force[2] == pytest.approx(pressing)
    assert pressing > 80.0
