"""Life cycle, switching and conflicts; what happens when controllers or hardware fail."""

import asyncio
import time
from types import SimpleNamespace

import pytest
from controllers_rig import JOINTS, Bench, point, started, trajectory

from client.controllers.broadcasters import ForceTorqueParameters, ForceTorqueSensorBroadcaster
from client.controllers.controller import LIFE_CYCLE, Interfaces, LifecycleState
from client.controllers.goals import ErrorCode
from client.controllers.loop import ControlLoop
from client.controllers.parameters import Reading, read_parameters
from client.errors import ControllerError
from client.rtde import ReceivedState
from tests.rows import each_row
from urproto.rtde.recipes import RecipeValues

TRANSITIONS = sorted({transition for _, transition in LIFE_CYCLE})


def state_of(bench, name):
    return next(info.state for info in bench.manager.list_controllers() if info.name == name)


def test_the_life_cycle():
    bench = Bench()
    manager = bench.manager
    manager.load("jtc")
    assert state_of(bench, "jtc") is LifecycleState.UNCONFIGURED
    manager.configure("jtc")
    assert state_of(bench, "jtc") is LifecycleState.INACTIVE
    manager.activate("jtc")
    assert manager.list_controllers()[0].claimed == ("shoulder_joint/position", "elbow_joint/position")
    manager.deactivate("jtc")
    assert manager.list_controllers()[0].claimed == ()
    manager.cleanup("jtc")
    assert state_of(bench, "jtc") is LifecycleState.UNCONFIGURED
    manager.unload("jtc")
    assert manager.list_controllers() == []


@each_row("state", [LifecycleState.UNCONFIGURED, LifecycleState.INACTIVE, LifecycleState.ACTIVE])
@each_row("transition", TRANSITIONS)
def test_every_transition_in_every_state(state, transition):
    bench = Bench()
    manager = bench.manager
    manager.load("jtc")
    if state is not LifecycleState.UNCONFIGURED:
        manager.configure("jtc")
    if state is LifecycleState.ACTIVE:
        manager.activate("jtc")
    calls = {
        "configure": lambda: manager.configure("jtc"),
        "activate": lambda: manager.switch(activate=["jtc"]),
        "deactivate": lambda: manager.deactivate("jtc"),
        "cleanup": lambda: manager.cleanup("jtc"),
        "shutdown": lambda: manager.unload("jtc"),
    }
    if (state, transition) in LIFE_CYCLE:
        calls[transition]()
        if transition != "shutdown":
            assert state_of(bench, "jtc") is LIFE_CYCLE[state, transition]
    else:
        with pytest.raises(ControllerError, match=f"it is {state}"):
            calls[transition]()
        assert state_of(bench, "jtc") is state


def test_two_controllers_cannot_have_one_interface():
    bench, jtc = started()
    bench.manager.load("forward")
    bench.manager.configure("forward")
    handle = jtc.send_goal(trajectory(point(1.0, 1.0, 1.0)))
    with pytest.raises(ControllerError, match="forward: jtc has claimed shoulder_joint/position"):
        bench.manager.activate("forward")
    assert state_of(bench, "forward") is LifecycleState.INACTIVE
    assert bench.until(handle).error_code is ErrorCode.SUCCESSFUL
    bench.manager.deactivate("jtc")
    with pytest.raises(ControllerError, match="has claimed shoulder_joint/position"):
        bench.manager.switch(activate=["jtc", "forward"])
    assert not bench.manager.active()


def test_a_switch_hands_interfaces_over_in_one_go():
    bench, _ = started()
    bench.manager.load("forward")
    bench.manager.configure("forward")
    bench.manager.switch(activate=["forward"], deactivate=["jtc"])
    names = tuple(f"{joint}/position" for joint in JOINTS)
    assert bench.joints.switches[-1] == (names, names)
    bench.manager.controller("forward").command([0.5, -0.5])
    bench.cycle(2)
    assert bench.q == (0.5, -0.5)
    claimed = {info.name: info.claimed_by for info in bench.manager.list_interfaces() if info.kind == "command"}
    assert claimed["elbow_joint/position"] == "forward"
    assert claimed["elbow_joint/velocity"] == ""


def test_best_effort_leaves_out_what_cannot_be():
    bench, _ = started()
    bench.manager.load("states")
    bench.manager.configure("states")
    bench.manager.switch(activate=["states", "forward"], deactivate=["jtc", "speeds"], best_effort=True)
    assert [controller.name for controller in bench.manager.active()] == ["states"]


def test_what_the_hardware_does_not_do_changes_nothing():
    bench, _ = started()
    bench.joints.refuses = "position and velocity cannot be commanded at the same time"
    with pytest.raises(ControllerError, match="at the same time"):
        bench.manager.activate("speeds")
    assert [controller.name for controller in bench.manager.active()] == ["jtc"]


def test_an_interface_that_is_not_there():
    bench = Bench(joints=["wrist_joint"], allow_partial_joints_goal=True)
    with pytest.raises(ControllerError, match="no command interface wrist_joint/position"):
        bench.manager.activate("jtc")
    bench.manager.load("other", "joint_state_broadcaster/JointStateBroadcaster", {"joints": ["wrist_joint"]})
    with pytest.raises(ControllerError, match="no state interface wrist_joint/position"):
        bench.manager.activate("other")


def test_unknown_names():
    manager = Bench().manager
    with pytest.raises(ControllerError, match="it is not loaded"):
        manager.configure("jtc")
    with pytest.raises(ControllerError, match="test has jtc, scaled"):
        manager.load("gripper")
    with pytest.raises(ControllerError, match="did you mean joint_trajectory_controller/JointTrajectoryController"):
        manager.load("x", "joint_trajectory_controller/TrajectoryController")
    manager.load("jtc")
    with pytest.raises(ControllerError, match="already loaded"):
        manager.load("jtc")


def test_a_controller_that_fails_is_deactivated_alone(caplog):
    bench, jtc = started()
    bench.manager.activate("states")
    jtc.update = None  # not callable
    bench.cycle()
    assert [controller.name for controller in bench.manager.active()] == ["states"]
    assert "jtc failed and is deactivated" in caplog.text
    assert bench.joints.switches[-1][1] == ("shoulder_joint/position", "elbow_joint/position")


def test_a_robot_that_cannot_move_ends_what_moves_it():
    bench, jtc = started()
    bench.manager.activate("states")
    handle = jtc.send_goal(trajectory(point(1.0, 1.0, 1.0)))
    bench.run(0.5)
    bench.joints.failure = "somebody pressed the button"
    bench.cycle()
    assert handle.result.error_string == "somebody pressed the button"
    assert [controller.name for controller in bench.manager.active()] == ["states"]
    assert bench.manager.controller("states").topic.latest.position == pytest.approx(bench.q)


def test_a_halt_by_something_else_lets_controllers_begin_anew():
    bench, jtc = started()
    handle = jtc.send_goal(trajectory(point(1.0, 1.0, 1.0)))
    bench.run(0.5)
    bench.joints.halt = "the tool touched something"
    bench.cycle()
    assert handle.result.error_string == "the tool touched something"
    place = bench.q
    bench.run(1.0)
    assert bench.q == pytest.approx(place, abs=1e-9)
    assert bench.until(jtc.send_goal(trajectory(point(1.0, 0.0, 0.0)))).error_code is ErrorCode.SUCCESSFUL


def test_forward_commands_are_checked_and_end_with_the_activity():
    bench, speeds = started("speeds")
    bench.cycle()
    speeds.command([0.1, -0.1])
    bench.run(1.0)
    assert bench.q == pytest.approx((0.1, -0.1), abs=0.01)
    with pytest.raises(ControllerError, match="3 commands for 2 joints"):
        speeds.command([0, 0, 0])
    with pytest.raises(ControllerError, match="not numbers"):
        speeds.command([0, float("inf")])
    bench.manager.deactivate("speeds")
    place = bench.q
    bench.run(1.0)
    assert bench.q == place


DRIVER = SimpleNamespace(link=SimpleNamespace(feed=SimpleNamespace(max_age_s=60.0)))


def received(timestamp: float) -> ReceivedState:
    return ReceivedState(RecipeValues((timestamp,), {"timestamp": 0}), time.monotonic())


async def test_two_states_that_come_together_are_one_cycle_with_the_later_one():
    """As after a hold-up of this machine: a cycle for each would command the arm twice within a period."""
    cycles = []
    loop = ControlLoop(DRIVER)  # type: ignore[arg-type]
    loop._manager = SimpleNamespace(cycle=lambda state, time_s, period_s: cycles.append((time_s, period_s)) or True)
    for timestamps in ((1.0,), (1.002, 1.004), (1.006,)):
        for timestamp in timestamps:
            loop._on_state(received(timestamp))
        await asyncio.sleep(0)
    assert cycles == [(1.0, 0.0), (1.004, pytest.approx(0.004)), (1.006, pytest.approx(0.002))]


async def test_after_a_state_without_a_time_the_period_is_counted_from_the_last_that_had_one():
    cycles = []

    def cycle(state, time_s, period_s):
        cycles.append((time_s, period_s))
        return time_s == time_s

    loop = ControlLoop(DRIVER)  # type: ignore[arg-type]
    loop._manager = SimpleNamespace(cycle=cycle)
    for timestamp in (1.0, float("nan"), 1.004):
        loop._on_state(received(timestamp))
        await asyncio.sleep(0)
    assert cycles[-1] == (1.004, pytest.approx(0.004))


def test_when_one_does_not_begin_none_of_those_with_it_does(monkeypatch):
    bench, _ = started("states")
    manager = bench.manager
    manager.load("jtc")
    manager.configure("jtc")
    manager.load("speeds")
    manager.configure("speeds")
    second = manager.controller("speeds")

    def fail(time_s):
        raise second.error("not today")

    monkeypatch.setattr(second, "on_activate", fail)
    with pytest.raises(ControllerError, match="speeds: not today"):
        manager.switch(activate=["jtc", "speeds"], deactivate=["states"])
    assert {state_of(bench, name) for name in ("jtc", "speeds", "states")} == {LifecycleState.INACTIVE}
    assert bench.joints.switches[-1][1] == (*manager.controller("jtc").command_interfaces, *second.command_interfaces)
    bench.cycle()
    manager.activate("jtc", "states")


def test_a_wrench_has_its_offset_added_and_is_multiplied_then():
    numbers = {"force": {"x": 2.0, "z": -1.0}, "torque": {"y": 0.5}}
    parameters = {"sensor_name": "fts", "offset": numbers, "multiplier": numbers}
    sensor = ForceTorqueSensorBroadcaster(
        "sensor", read_parameters(ForceTorqueParameters, parameters, "", Reading()), 500
    )
    sensor.states = Interfaces(sensor.state_interfaces)
    sensor.states.put([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    sensor.update(0.0, 0.002)
    assert (sensor.topic.latest.force, sensor.topic.latest.torque) == ((6.0, 2.0, -2.0), (4.0, 2.75, 6.0))
