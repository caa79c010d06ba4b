"""Connecting, connection loss and reconnecting; user scripts; the dashboard client."""

import csv
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from dashboard_client import DashboardClient
from emulator_process import EmulatorProcess
from rig import PLAYING, START_Q, STOPPED, Rig, Watch, disconnecting
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface
from script_client import ScriptClient

from tests.budget import subset
from urproto.robots import START_Q as URSIM_START_Q

both_series = pytest.mark.parametrize("rig", subset(["ur3", "ur3e"], now=["ur3"]), indirect=True)

POWER_OFF, IDLE, RUNNING = 3, 5, 7  # robot modes
NEAR_Q = [START_Q[0] + 0.2, *START_Q[1:]]


@both_series
def test_the_constructor_starts_the_control_program(rig: Rig, control: RTDEControlInterface) -> None:
    assert control.isConnected()
    assert control.isProgramRunning()
    assert control.getRobotStatus() & 0b11 == 0b11  # power is on, a program runs
    with rig.watch() as state:
        assert state.next()["runtime_state"] == PLAYING
    assert rig.process.dashboard("running") == ["Program running: true"]


@both_series
def test_stop_script_and_reupload(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        control.stopScript()
        state.wait_until(lambda sample: sample["runtime_state"] == STOPPED)
        assert control.reuploadScript()
        rig.eventually(control.isProgramRunning)
        assert control.moveJ(NEAR_Q, 2.0, 8.0)
        assert state.settled()["actual_q"] == pytest.approx(NEAR_Q, abs=1e-5)


@both_series
def test_disconnect_and_reconnect(rig: Rig, control: RTDEControlInterface) -> None:
    control.disconnect()
    assert not control.isConnected()
    with rig.watch() as state:
        assert state.next()["runtime_state"] == PLAYING  # ur_rtde leaves its program behind
    assert control.reconnect()
    assert control.isConnected()
    assert control.moveJ(NEAR_Q, 2.0, 8.0)


def test_a_second_client_takes_over_the_program_left_behind(rig: Rig, control: RTDEControlInterface) -> None:
    control.disconnect()
    second = RTDEControlInterface(rig.host)
    with disconnecting(second):
        assert second.moveJ(NEAR_Q, 2.0, 8.0)


def test_many_consecutive_calls(rig: Rig, control: RTDEControlInterface) -> None:
    """The round trip of a call takes some control periods."""
    with rig.watch() as state:
        begin = state.newest()["timestamp"]
        for _ in range(50):
            control.isSteady()
        took = state.newest()["timestamp"] - begin
    assert took / 50 < 10 * rig.period_s


@both_series
def test_two_receivers_at_125_hz(rig: Rig, tmp_path: Path) -> None:
    receivers = [RTDEReceiveInterface(rig.host, 125.0) for _ in range(2)]
    files = [tmp_path / f"{number}.csv" for number in range(2)]
    with disconnecting(*receivers), rig.watch() as state:
        for receiver, file in zip(receivers, files, strict=True):
            assert receiver.startFileRecording(str(file), ["timestamp", "actual_q"])
        state.wait_for(2.0)
        for receiver in receivers:
            assert receiver.stopFileRecording()
    for file in files:
        with file.open() as table:
            rows = list(csv.DictReader(table))
        steps = np.diff([float(row["timestamp"]) for row in rows])
        assert np.median(steps) == pytest.approx(0.008, abs=1e-6)
        assert len(rows) > 0.7 * 2.0 / 0.008  # a late client takes only the newest received state
        assert [float(rows[-1][f"actual_q_{joint}"]) for joint in range(6)] == pytest.approx(START_Q, abs=1e-4)


@both_series
def test_receive_interface_at_rest(rig: Rig, receive: RTDEReceiveInterface) -> None:
    assert receive.isConnected()
    assert receive.getTimestamp() > 40.0
    assert receive.getRobotMode() == RUNNING
    assert receive.getSafetyMode() == 1
    assert receive.getJointMode() == [253] * 6
    assert receive.getActualQ() == pytest.approx(START_Q, abs=1e-5)
    assert receive.getTargetQ() == receive.getActualQ()
    assert receive.getActualQd() == receive.getTargetQd() == [0.0] * 6
    assert receive.getSpeedScaling() == 0.0  # no program plays
    assert receive.getSafetyStatusBits() & 1
    assert min(receive.getJointTemperatures()) > 20.0
    assert 40.0 < receive.getActualRobotVoltage() < 56.0
    if rig.model == "ur3e":
        assert len(receive.getFtRawWrench()) == 6


def test_custom_script_function_runs_before_the_control_program_returns(
    rig: Rig, control: RTDEControlInterface, receive: RTDEReceiveInterface
) -> None:
    body = f"    movej({NEAR_Q}, a=8, v=2)\n    write_output_integer_register(14, 4711)\n"
    assert control.sendCustomScriptFunction("go_near", body)
    rig.eventually(lambda: receive.getOutputIntRegister(14) == 4711)
    rig.eventually(lambda: receive.getActualQ() == pytest.approx(NEAR_Q, abs=1e-5))
    assert control.moveJ(list(START_Q), 2.0, 8.0)


def test_custom_script_file(
    rig: Rig, control: RTDEControlInterface, receive: RTDEReceiveInterface, tmp_path: Path
) -> None:
    script = tmp_path / "mine.script"
    script.write_text(
        "def mine():\n"
        "  write_output_integer_register(0, 1)\n"
        "  write_output_float_register(14, 2.5)\n"
        "  write_output_integer_register(0, 2)\n"
        "end\n"
    )
    assert control.sendCustomScriptFile(str(script))
    rig.eventually(lambda: receive.getOutputDoubleRegister(14) == 2.5)


def test_script_client(rig: Rig, tmp_path: Path) -> None:
    client = ScriptClient(rig.host, *rig.polyscope)
    client.connect()
    assert client.isConnected()
    with rig.watch() as state:
        assert client.sendScriptCommand(f"movej({NEAR_Q}, a=8, v=2)\n")
        state.wait_until(lambda sample: sample["actual_q"] == pytest.approx(NEAR_Q, abs=1e-5))
        assert client.sendScriptCommand("def note():\n  write_output_float_register(20, 1.5)\nend\n")
        state.wait_until(lambda sample: sample["output_double_register_20"] == 1.5)
        file = tmp_path / "note.script"
        file.write_text("def note():\n  write_output_float_register(20, 2.5)\nend\n")
        assert client.sendScript(str(file))
        state.wait_until(lambda sample: sample["output_double_register_20"] == 2.5)
    client.disconnect()


@pytest.fixture
def dashboard(rig: Rig) -> Iterator[DashboardClient]:
    client = DashboardClient(rig.host)
    client.connect()
    yield client
    client.disconnect()


@both_series
def test_dashboard_power_cycle(rig: Rig, dashboard: DashboardClient, receive: RTDEReceiveInterface) -> None:
    assert dashboard.robotmode() == "Robotmode: RUNNING"
    with rig.watch() as state:
        dashboard.powerOff()
        state.wait_until(lambda sample: sample["robot_mode"] == POWER_OFF)
        dashboard.powerOn()
        state.wait_until(lambda sample: sample["robot_mode"] == IDLE, timeout_s=15)
        assert receive.getActualQ() == pytest.approx(START_Q, abs=1e-5)
        dashboard.brakeRelease()
        state.wait_until(lambda sample: sample["robot_mode"] == RUNNING, timeout_s=15)
    assert dashboard.robotmode() == "Robotmode: RUNNING"


@both_series
def test_dashboard_answers(rig: Rig, dashboard: DashboardClient) -> None:
    major, minor = rig.polyscope
    assert dashboard.polyscopeVersion().startswith(f"{major}.{minor}.")
    assert dashboard.getRobotModel() == "UR3"
    if rig.model == "ur3e":  # ur_rtde itself refuses to ask an older controller
        assert dashboard.getSerialNumber().isdigit()
    assert dashboard.safetymode() == "Safetymode: NORMAL"
    assert not dashboard.running()
    assert dashboard.programState().startswith("STOPPED")
    assert dashboard.isInRemoteControl() is (rig.model == "ur3e")
    dashboard.popup("hello")
    dashboard.closePopup()
    dashboard.closeSafetyPopup()
    dashboard.addToLog("a line in the log")
    dashboard.stop()


def test_dashboard_errors_reach_the_caller(rig: Rig, dashboard: DashboardClient) -> None:
    with pytest.raises(RuntimeError, match="File not found"):
        dashboard.loadURP("nowhere.urp")
    with pytest.raises(RuntimeError, match="Failed to execute: play"):
        dashboard.play()
    with pytest.raises(RuntimeError, match="Failed to execute: pause"):
        dashboard.pause()


@pytest.fixture
def own_process() -> Iterator[Callable[..., EmulatorProcess]]:
    """Start a separate emulator, which may die; if it still runs at the end, it has to end cleanly."""
    processes: list[EmulatorProcess] = []

    def start(*arguments: str) -> EmulatorProcess:
        processes.append(EmulatorProcess(arguments).start())
        return processes[-1]

    yield start
    statuses = [process.stop() for process in processes if process.running]
    for process in processes:
        process.dispose()
    assert not any(statuses)


def test_a_first_session_from_power_on_to_a_move(own_process: Callable[..., EmulatorProcess]) -> None:
    """Started with only the model: power on, release the brakes, connect, move."""
    process = own_process("--model", "ur3")
    dashboard = DashboardClient(process.host)
    dashboard.connect()
    assert dashboard.robotmode() == "Robotmode: POWER_OFF"
    with Watch(process.host) as state, disconnecting(dashboard):
        dashboard.powerOn()
        state.wait_until(lambda sample: sample["robot_mode"] == IDLE, timeout_s=15)
        dashboard.brakeRelease()
        state.wait_until(lambda sample: sample["robot_mode"] == RUNNING, timeout_s=15)
        assert state.settled()["actual_q"] == pytest.approx(URSIM_START_Q, abs=1e-3)
        control = RTDEControlInterface(process.host)
        target = [0.3, -1.2, 1.0, -1.4, -1.57, 0.0]
        with disconnecting(control):
            assert control.moveJ(target, 2.0, 8.0)
            assert state.settled()["actual_q"] == pytest.approx(target, abs=1e-5)


@pytest.mark.long
def test_clients_survive_a_restart_of_the_controller(own_process: Callable[..., EmulatorProcess]) -> None:
    doomed = own_process("--model", "ur3", "--running")
    control, receive = RTDEControlInterface(doomed.host), RTDEReceiveInterface(doomed.host)
    with disconnecting(control, receive):
        doomed.kill()
        doomed.start()
        assert receive.reconnect()
        assert receive.isConnected()
        assert control.reconnect()
        assert control.isProgramRunning()
        q = receive.getActualQ()
        q[0] += 0.1
        assert control.moveJ(q, 2.0, 8.0)
        with Watch(doomed.host) as state:
            assert state.settled()["actual_q"] == pytest.approx(q, abs=1e-5)


def test_a_vanished_controller_is_noticed(own_process: Callable[..., EmulatorProcess]) -> None:
    doomed = own_process("--model", "ur3", "--running")
    control, receive = RTDEControlInterface(doomed.host), RTDEReceiveInterface(doomed.host)
    with disconnecting(control, receive):
        doomed.kill()
        for _ in range(5 * 125):
            began = receive.initPeriod()
            if not receive.isConnected() and not control.isConnected():
                break
            receive.waitPeriod(began)
        else:
            pytest.fail("a client still believes in the connection after 5 s")
