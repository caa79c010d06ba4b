"""The pendant's switch between Simulation and Real Robot: in simulation, programs move only the simulated arm."""

import pytest

from emulator.machine import ControllerConfig
from emulator.servers.primary_state import robot_state
from emulator.virtual import VirtualRobot
from emulator.world.file import WorldPlan
from emulator.world.shapes import Box, WorldObject
from tests.controller.test_safety_limits import SERVO, STRETCHED, safe
from tests.rows import each_row
from urproto.controlapi import NotPossible
from urproto.modes import RuntimeState, SafetyMode
from urproto.robots import START_Q, load_model

TARGET = (0.3, -1.2, 0.8, -1.4, 0.2, 0.1)
MOVE = f"def far():\n  movej({list(TARGET)}, a=3, v=2)\nend\n"


def enabled(rig):
    return robot_state(rig.now, rig.controller.model).mode.real_robot_enabled


def play(rig, text=MOVE):
    rig.script(text)
    rig.until(lambda s: s.runtime_state is RuntimeState.PLAYING)
    return rig.until(lambda s: s.runtime_state is RuntimeState.STOPPED)


@each_row("model", ["ur3", "ur5e"])
@each_row("dynamic", [False, True])
def test_a_program_moves_the_simulated_arm_and_not_the_real_one(make, model, dynamic):
    rig = make(model, running=True, dynamic=dynamic)
    before = rig.tick(3).actual_q
    assert enabled(rig)
    rig.script("set sim")
    rig.tick()
    assert not enabled(rig)
    shown = play(rig).actual_q
    assert shown == pytest.approx(TARGET, abs=1e-9)  # a simulated arm is exactly at its target
    assert rig.controller.simulation.real.q == pytest.approx(before, abs=1e-4)
    rig.script("set real")
    assert rig.tick(2).actual_q == pytest.approx(before, abs=1e-4)
    assert rig.now.target_q == pytest.approx(before, abs=1e-4)
    assert enabled(rig)
    assert play(rig).actual_q == pytest.approx(TARGET, abs=1e-2)
    assert rig.controller.simulation.real.measured_q == rig.now.actual_q
    assert rig.now.safety_mode is SafetyMode.NORMAL


@pytest.mark.parametrize(("line", "first"), [("set sim", None), ("set real", "set sim")])
def test_simulation_cannot_be_switched_while_a_program_runs(ready, line, first):
    if first:
        ready.script(first)
        ready.tick()
    before = ready.controller.simulation.on
    ready.script(MOVE)
    ready.until(lambda s: any(s.actual_qd))
    ready.script(line)
    ready.tick(2)
    assert ready.controller.simulation.on is before
    assert ready.now.runtime_state is RuntimeState.PLAYING


def test_the_simulated_arm_touches_no_objects(make):
    touched = {}
    for mode in ("set real", "set sim"):
        rig = make("ur5e", running=True, world=WorldPlan())
        place = rig.tick().actual_TCP_pose
        rig.controller.world.add("wall", WorldObject(Box((0.4, 0.4, 0.4)), (*place[:2], place[2] + 0.25, 0, 0, 0)))
        rig.script(mode)
        rig.tick()
        rig.script(f"def into():\n  movel(p{[*place[:2], place[2] + 0.1, *place[3:]]}, v=0.2)\nend\n")
        rig.seconds(1.5)
        touched[mode] = rig.now.safety_mode, rig.now.actual_TCP_pose[2] - place[2] > 0.09
    assert touched["set sim"] == (SafetyMode.NORMAL, True)
    assert touched["set real"] == (SafetyMode.PROTECTIVE_STOP, False)


def test_safety_limits_apply_in_simulation(make):
    rig = make("ur5e", running=True, initial_q=STRETCHED, safety=safe("ur5e"))
    rig.script("set sim")
    rig.tick()
    rig.script(SERVO)
    rig.until(lambda s: s.safety_mode is SafetyMode.VIOLATION)
    assert rig.controller.simulation.real.q == STRETCHED


def test_simulation_verbs():
    robot = VirtualRobot(ControllerConfig(model=load_model("ur3"), running=True))
    robot.set_simulation(True)
    robot.set_joints(TARGET)
    robot.step()
    assert robot.state(["actual_q"]) == {"actual_q": pytest.approx(TARGET)}
    assert robot.simulation() == {"on": True, "real_q_rad": pytest.approx(START_Q)}
    with pytest.raises(NotPossible, match="simulation"):
        robot.save()
    robot.send_script(MOVE.replace("0.3", "0.9"))
    robot.step(20)
    with pytest.raises(NotPossible, match="stop it before"):
        robot.set_simulation(False)
    robot.run_until("runtime_state == STOPPED")
    robot.set_simulation(False)
    robot.step()
    assert robot.state(["target_q"]) == {"target_q": pytest.approx(START_Q)}
