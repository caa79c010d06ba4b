"""Faults of arm, programs and controller on a robot without ports, and their effects on clients."""

import asyncio
import struct
from itertools import pairwise

import pytest
from fault_rig import Client, Robot

from emulator.app import Emulator
from emulator.clock import RealClock
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from emulator.virtual import VirtualRobot
from urproto.compat_asyncio import timeout
from urproto.controlapi import NotPossible
from urproto.robots import load_model
from urproto.robots.kinematics import Kinematics

MOVE = "def go():\n  movej([0, -1, 1, 0, 0, 0], t=2)\nend\n"
COUNT = "def count():\n  global n = 0\n  while True:\n    n = n + 1\n    sync()\n  end\nend\n"


@pytest.fixture(params=["ur3", "ur5e"])
def virtual(request: pytest.FixtureRequest) -> VirtualRobot:
    return VirtualRobot(ControllerConfig(model=load_model(request.param), running=True))


def joints(robot: VirtualRobot) -> list[float]:
    robot.step()
    return robot.state(["actual_q"])["actual_q"]


# arm


def test_a_joint_lags_behind(virtual: VirtualRobot) -> None:
    fault = virtual.inject_fault("lagging_joint", joint=1, delay_s=0.2)
    virtual.send_script(MOVE)
    virtual.run_until("actual_q[1] > -1.4")
    state = virtual.state(["actual_q", "target_q", "actual_TCP_pose"])
    assert state["target_q"][1] - state["actual_q"][1] > 0.05
    assert state["target_q"][2:] == state["actual_q"][2:]
    kinematics = Kinematics(virtual.controller.model.dh)
    assert state["actual_TCP_pose"] == pytest.approx(kinematics.forward(tuple(state["actual_q"])), abs=1e-9)
    virtual.run_until("runtime_state == STOPPED")
    virtual.step(200)
    assert joints(virtual)[1] == pytest.approx(-1.0)
    virtual.clear_fault(fault)


def test_a_lag_detected_by_the_controller_stops_the_arm(virtual: VirtualRobot) -> None:
    virtual.inject_fault("lagging_joint", joint=1, delay_s=0.5, stop_above_rad=0.1)
    virtual.send_script(MOVE)
    virtual.run_until("safety_mode == PROTECTIVE_STOP and runtime_state == PAUSED")
    assert any("C153A1" in line for line in virtual.log())


def test_feedback_freezes_and_thaws(virtual: VirtualRobot) -> None:
    before = joints(virtual)
    fault = virtual.inject_fault("frozen_feedback", joint=1)
    virtual.send_script(MOVE)
    virtual.run_until("runtime_state == PLAYING")
    virtual.run_until("runtime_state == STOPPED")
    frozen = joints(virtual)
    assert (frozen[1], frozen[2]) == (before[1], pytest.approx(1.0))
    virtual.clear_fault(fault)
    assert joints(virtual)[1] == pytest.approx(-1.0)


def test_an_encoder_jumps_once_and_keeps_the_offset(virtual: VirtualRobot) -> None:
    before = joints(virtual)
    fault = virtual.inject_fault("encoder_jump", joint=5, by_rad=0.3, after=0.1)
    assert joints(virtual) == before
    virtual.step(100)
    assert [joints(virtual) for _ in range(3)] == [[*before[:5], pytest.approx(before[5] + 0.3)]] * 3
    virtual.clear_fault(fault)
    assert joints(virtual) == before


@pytest.mark.parametrize("severity", ["fault", "violation"])
def test_a_broken_joint_fails_again_until_the_fault_is_cleared(virtual: VirtualRobot, severity: str) -> None:
    fault = virtual.inject_fault("joint_fault", joint=2, severity=severity)
    virtual.run_until(f"safety_mode == {severity.upper()} and robot_mode == POWER_OFF")
    modes = virtual.state(["joint_mode"])["joint_mode"]
    assert modes == ["POWER_OFF", "POWER_OFF", severity.upper(), "POWER_OFF", "POWER_OFF", "POWER_OFF"]
    virtual.restart_safety()
    virtual.power_on()
    virtual.run_until(f"safety_mode == {severity.upper()} and robot_mode == POWER_OFF")
    virtual.clear_fault(fault)
    virtual.restart_safety()
    virtual.release_brakes()
    virtual.run_until("robot_mode == RUNNING and safety_mode == NORMAL")
    assert virtual.state(["joint_mode"])["joint_mode"] == ["RUNNING"] * 6


def test_an_ideal_arm_cannot_sag(virtual: VirtualRobot) -> None:
    with pytest.raises(NotPossible, match="ideal"):
        virtual.inject_fault("lost_brake", joint=1)


# programs


def test_a_program_never_starts(virtual: VirtualRobot) -> None:
    fault = virtual.inject_fault("program_never_starts")
    assert virtual.send_script(MOVE)
    virtual.step(1000)
    assert virtual.state(["runtime_state"]) == {"runtime_state": "STOPPED"}
    virtual.clear_fault(fault)
    virtual.run_until("runtime_state == PLAYING")
    virtual.inject_fault("program_never_starts")
    virtual.dashboard("stop")
    virtual.clear_faults()
    virtual.run_until("runtime_state == STOPPED")


def test_a_program_hangs_and_continues(virtual: VirtualRobot) -> None:
    virtual.send_script(COUNT)
    virtual.step(20)
    fault = virtual.inject_fault("program_stuck")
    virtual.step()
    before = virtual.variables()
    virtual.step(50)
    assert virtual.variables() == before
    assert virtual.state(["runtime_state"]) == {"runtime_state": "PLAYING"}
    virtual.clear_fault(fault)
    virtual.step(10)
    assert int(virtual.variables()["n"]) == int(before["n"]) + 10


def test_a_runtime_exception_at_a_line(virtual: VirtualRobot) -> None:
    virtual.inject_fault("runtime_exception", line=4, message="the gripper is gone")
    virtual.send_script(COUNT)
    virtual.step(50)
    assert virtual.state(["runtime_state"]) == {"runtime_state": "STOPPED"}
    assert any("the gripper is gone" in line and "4" in line for line in virtual.log())
    assert virtual.variables() == {}
    assert virtual.faults()[0]["state"] == "over"
    virtual.send_script(COUNT)
    virtual.step(20)
    assert virtual.state(["runtime_state"]) == {"runtime_state": "PLAYING"}


async def test_clients_receive_the_exception(ur3: Robot) -> None:
    client = await ur3.connect("primary")
    ur3.control.inject_fault("runtime_exception", line=2, message="injected here")
    client.send(MOVE.encode())
    await asyncio.sleep(0)
    await ur3.step(60)
    assert b"injected here" in client.read()


# the clock


def test_clock_faults_are_refused_for_stepped_time(virtual: VirtualRobot) -> None:
    for kind in ("late_ticks", "clock_drift"):
        with pytest.raises(NotPossible, match="step by step"):
            virtual.inject_fault(kind)


async def ticks(clock: RealClock, count: int) -> list[float]:
    """When the ticks of a clock began [s]."""
    loop = asyncio.get_running_loop()
    began: list[float] = []
    done = loop.create_future()

    def tick() -> None:
        began.append(loop.time())
        if len(began) == count:
            clock.close()
            done.set_result(None)
        elif len(began) == 3:
            clock.delay_next(0.2, made_up=False)

    clock.start(tick)
    await asyncio.wait_for(done, 20)
    return began


async def test_a_period_starts_late() -> None:
    began = await ticks(RealClock(0.002), 10)
    assert began[3] - began[2] >= 0.19


async def test_faults_reach_the_clock() -> None:
    config = EmulatorConfig(controller=ControllerConfig(model=load_model("ur3")), ephemeral_ports=True)
    async with Emulator(config) as emulator:
        clock = emulator.clock
        assert isinstance(clock, RealClock)
        usual = clock._period_ns
        fault = emulator.control.inject_fault("clock_drift", share=0.001)
        assert clock._period_ns == pytest.approx(usual / 1.001, rel=1e-6)
        emulator.control.clear_fault(fault)
        assert clock._period_ns == usual
        emulator.control.inject_fault("late_ticks", by_s=0.1, once=True, probability=1.0)
        loop = asyncio.get_running_loop()
        times: list[float] = []
        emulator.controller.subscribe(lambda snapshot: times.append(loop.time()))
        async with timeout(20):
            while not any(later - earlier > 0.09 for earlier, later in pairwise(times)):
                await asyncio.sleep(0.01)


# outages


def test_a_robot_without_ports_restarts(virtual: VirtualRobot) -> None:
    virtual.send_script(MOVE)
    virtual.run_until("actual_q[1] > -1.4")
    virtual.inject_fault("restart_controller", outage_s=0.5, boot_s=1.0)
    virtual.run_until("robot_mode == NO_CONTROLLER")
    q = virtual.state(["actual_q"])
    virtual.step(round(0.6 / virtual.controller.period_s))
    assert virtual.state(["robot_mode", "runtime_state"]) == {"robot_mode": "BOOTING", "runtime_state": "STOPPED"}
    assert virtual.time()["time_s"] < 0.2
    assert virtual.state(["actual_q"]) == q
    virtual.run_until("robot_mode == POWER_OFF")
    virtual.release_brakes()
    virtual.run_until("robot_mode == RUNNING")
    assert virtual.faults()[0]["state"] == "over"


def test_power_returns_when_the_fault_ends(virtual: VirtualRobot) -> None:
    fault = virtual.inject_fault("power_loss", boot_s=0.1)
    virtual.step(2000)
    assert virtual.state(["robot_mode"]) == {"robot_mode": "NO_CONTROLLER"}
    virtual.clear_fault(fault)
    virtual.run_until("robot_mode == POWER_OFF")


async def test_a_restarted_controller_closes_connections_and_loses_its_state(robot: Robot) -> None:
    stream, dashboard = await robot.stream(), await robot.dashboard()
    ports = robot.emulator.ports
    robot.control.inject_fault("restart_controller", outage_s=0.4, boot_s=0.2)
    lasting = robot.control.inject_fault("rtde_field_not_found", field="actual_q")
    await robot.step(3)
    stream.read(), dashboard.read()
    assert (stream.ended, dashboard.ended) == ("end", "end")
    for port in ("rtde", "dashboard", "primary"):
        with pytest.raises(ConnectionRefusedError):
            Client(ports[port])
    await robot.step(round(0.4 / robot.period_s))
    assert robot.emulator.ports == ports
    await robot.until(lambda: all(server.listening for server in robot.emulator.servers.values()))
    assert robot.emulator.ports == ports
    dashboard = await robot.dashboard()
    assert b"BOOTING" in await robot.request(dashboard, b"robotmode\n")
    await robot.step(round(0.3 / robot.period_s))
    assert b"POWER_OFF" in await robot.request(dashboard, b"robotmode\n")
    with pytest.raises(AssertionError, match="did not happen"):  # an external fault continues with the new controller
        await robot.stream(("actual_q",))
    robot.control.clear_fault(lasting)
    again = await robot.stream(("timestamp", "actual_q"))
    await robot.step()
    assert struct.unpack(">d", again.data()[0][1:9])[0] == robot.emulator.controller.time_s < 2.0


async def test_without_power_connections_fall_silent(robot: Robot) -> None:
    stream, dashboard = await robot.stream(), await robot.dashboard()
    robot.control.inject_fault("power_loss", lasting=0.8, boot_s=0.0)
    await robot.step(5)
    stream.read()
    dashboard.send(b"robotmode\n")
    await robot.step(round(0.5 / robot.period_s))
    assert (stream.read(), stream.ended, dashboard.read(), dashboard.ended) == (b"", "", b"", "")
    with pytest.raises(ConnectionRefusedError):
        Client(robot.emulator.ports["dashboard"])
    await robot.step(round(0.5 / robot.period_s))
    await robot.until(lambda: robot.emulator.servers["rtde"].listening)
    stream.read(), dashboard.read()
    assert (stream.ended, dashboard.ended) == ("reset", "reset")
    assert b"POWER_OFF" in await robot.request(await robot.dashboard(), b"robotmode\n", periods=5)


async def test_an_emulator_can_be_ended_in_an_outage() -> None:
    for kind in ("power_loss", "restart_controller"):
        async with Robot("ur3") as robot:
            stream = await robot.stream()
            robot.control.inject_fault(kind)
            await robot.step(5)
            assert robot.control.state(["robot_mode"]) == {"robot_mode": "NO_CONTROLLER"}
        stream.close()
