"""A fleet from outside: processes, signals, and clients of its robots."""

import json
import os
import signal
import subprocess
import sys

import pytest
from fleet_rig import DEADLINE_S, alive, answers, dashboard, host, running, wait_for_end

from urproto.compat import module_command
from urproto.controlapi import RemoteControl

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux has many loopback addresses")
READY = "Ready: every port of 4 robots answers"


def test_four_robots_answer_independently(tmp_path) -> None:
    with running(tmp_path, "--count", "4", "--running", "--processes", "2", "--ports-file", "ports.json") as fleet:
        fleet.read_until(READY)
        hosts = [host(index) for index in range(4)]
        assert list(fleet.workers) == hosts
        assert len(set(fleet.workers.values())) == 2
        rows = json.loads((tmp_path / "ports.json").read_text())
        assert [row["host"] for row in rows] == hosts
        assert all(row["model"] == "ur3" and row["ports"]["rtde"] == 30004 for row in rows)
        robots = [RemoteControl(row["host"], row["ports"]["control"]) for row in rows]
        try:
            robots[2].set_digital_input(3, level=True)
            robots[2].run_until("actual_digital_input_bits == 8")
            robots[1].power_off()
            robots[1].run_until("robot_mode == POWER_OFF")
            inputs = [robot.state(["actual_digital_input_bits"])["actual_digital_input_bits"] for robot in robots]
        finally:
            for robot in robots:
                robot.close()
        assert inputs == [0, 0, 8, 0]
        assert [dashboard(address, "robotmode") for address in hosts] == [
            "Robotmode: RUNNING",
            "Robotmode: POWER_OFF",
            "Robotmode: RUNNING",
            "Robotmode: RUNNING",
        ]
        assert fleet.interrupt() == (0, "")
        for pid in set(fleet.workers.values()):
            assert not alive(pid)
        assert not any(answers(address) for address in hosts)


def test_the_ctl_command_reaches_each_robot(tmp_path) -> None:
    with running(tmp_path, "--count", "2", "--port-offset", "40") as fleet:
        fleet.read_until("Ready: every port of 2 robots answers")
        command = [*module_command("emulator"), "ctl", "--host", host(1), "--port", "30120", "describe"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["model"] == "ur3"


def test_shutting_down_one_robot_leaves_the_others_running(tmp_path) -> None:
    with running(tmp_path, "--count", "4", "--processes", "1") as fleet:
        fleet.read_until(READY)
        dashboard(host(1), "shutdown")
        fleet.read_until(f"{host(1)} was shut down by a client.")
        assert [answers(host(index)) for index in range(4)] == [True, False, True, True]
        for index in (0, 2, 3):
            dashboard(host(index), "shutdown")
        fleet.read_until("Stopped.")
        assert fleet.process.wait(DEADLINE_S) == 0


def test_a_dead_process_is_reported(tmp_path) -> None:
    with running(tmp_path, "--count", "4", "--processes", "2") as fleet:
        fleet.read_until(READY)
        victim = fleet.workers[host(0)]
        os.kill(victim, signal.SIGKILL)
        fleet.read_until(f"Process {victim} ended by SIGKILL: lost {host(0)}, {host(2)}.")
        assert [answers(host(index)) for index in range(4)] == [False, True, False, True]
        assert fleet.interrupt() == (1, "")


def test_a_dead_process_is_restarted(tmp_path) -> None:
    with running(tmp_path, "--count", "4", "--processes", "2", "--running", "--restart") as fleet:
        fleet.read_until(READY)
        dashboard(host(0), "power off")
        os.kill(fleet.workers[host(0)], signal.SIGKILL)
        fleet.read_until(f"Restarted, with new state: {host(0)}, {host(2)}.")
        assert all(answers(host(index)) for index in range(4))
        assert dashboard(host(0), "robotmode") == "Robotmode: RUNNING"
        assert fleet.interrupt() == (0, "")


def test_robots_do_not_outlive_their_supervisor(tmp_path) -> None:
    with running(tmp_path, "--count", "3", "--processes", "3") as fleet:
        fleet.read_until("Ready: every port of 3 robots answers")
        fleet.process.kill()
        for pid in fleet.workers.values():
            wait_for_end(pid)
        assert not any(answers(host(index)) for index in range(3))


def test_a_port_in_use_aborts_the_start_of_the_fleet(tmp_path) -> None:
    with running(tmp_path, "--count", "2") as first:
        first.read_until("Ready: every port of 2 robots answers")
        with running(tmp_path, "--count", "2", "--first-host", host(1)) as second:
            out, complaint = second.process.communicate(timeout=DEADLINE_S)
            assert second.process.returncode == 2
        error = complaint.decode()
        assert out == b""
        assert error.startswith(f"ur-emulator: not ready: {host(1)}: cannot listen on {host(1)} port ")
        assert error.count("\n") == 1
        assert answers(host(0))


def test_a_mixed_fleet_from_a_file(tmp_path) -> None:
    (tmp_path / "cell.yaml").write_text(
        f"""
robots:
  - {{model: ur3, count: 2}}
  - {{model: ur5e, polyscope: 5.12.2, running: true, gripper: robotiq-2f-85, host: {host(7)}}}
"""
    )
    with running(tmp_path, "--fleet", "cell.yaml", "--exit-when-ready", "--ports-file", "ports.json") as fleet:
        fleet.read_until("Stopped.")
        assert fleet.process.wait(DEADLINE_S) == 0
    rows = json.loads((tmp_path / "ports.json").read_text())
    assert [(row["host"], row["model"]) for row in rows] == [(host(0), "ur3"), (host(1), "ur3"), (host(7), "ur5e")]
    assert ["gripper" in row["ports"] for row in rows] == [False, False, True]
    assert "PolyScope" in fleet.seen
    assert "5.12.2" in fleet.seen
