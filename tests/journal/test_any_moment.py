"""Robots that return to earlier moments of their run, or go on from one twice."""

import asyncio
import json
import os
from base64 import b64decode

import pytest

from emulator import branches, virtual
from emulator.app import Emulator
from emulator.commands.requests import ScriptUnit
from emulator.journal.doors import plain_values
from emulator.journal.replay import Replay
from emulator.machine import ControllerConfig
from emulator.options import configure
from emulator.virtual import VirtualRobot, virtual_robot
from tests.networks import MemorySockets
from tests.rows import each_row
from tests.ticking import StepClock
from urproto.controlapi import BadArguments, NotPossible
from urproto.robots import load_model

AROUND = """def around():
  socket_open("10.0.0.1", 5000)
  thread other():
    while True:
      write_output_float_register(3, random())
      sync()
    end
  end
  run other()
  while True:
    movej([0.2, -1.4, 1.5, -1.7, -1.5, 0.3 * random()], a=3, v=2)
    write_output_integer_register(2, read_output_integer_register(2) + 1)
    movej([0.7, -1.4, 1.2, -1.7, -1.5, 0.3 * random()], a=3, v=2)
  end
end
"""
PERIODS = 1_000


@pytest.fixture(params=["fork", "again"])
def way(request, monkeypatch):
    """By copies of the process, or by executing the run again, as where there are none."""
    if request.param == "again":
        monkeypatch.setattr(virtual, "can_branch", lambda: False)
    elif not branches.can_branch():
        pytest.skip("the system cannot copy processes")
    return request.param


def robot(model="ur5e", **options):
    made = virtual_robot(model, running=True, **options)
    made.send_script(AROUND)
    made.step(300)
    return made


def state(one):
    """Everything that the robot shows, and its log."""
    return json.dumps(one.state()), one.log(20)


@pytest.mark.parametrize("periods", [PERIODS, pytest.param(10_000, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    "options", [{}, pytest.param({"arm": "dynamic", "seed": 4}, marks=pytest.mark.long)], ids=["ideal", "dynamic"]
)
def test_branches_and_the_undisturbed_robot_stay_the_same(way, options, periods):
    one = robot(**options)
    one.inject_fault("lagging_joint", joint=2, delay_s=0.004)
    with one.branch() as other, other.branch() as third:
        for each in (one, other, third):
            each.step(periods)
        assert state(one) == state(other) == state(third)
        third.set_speed_slider(0.5)
        third.step(50)
        other.step(50)
        assert state(other) != state(third)


@pytest.mark.parametrize("model", ["ur3", "ur5e"])
def test_a_robot_returns_to_a_checkpoint_in_motion(model):
    one = robot(model)
    checkpoint = json.loads(json.dumps(one.checkpoint()))
    moment = state(one)
    one.step(PERIODS)
    later = state(one)
    one.protective_stop()
    one.step(20)
    one.restore(checkpoint)
    assert state(one) == moment
    one.step(PERIODS)
    assert state(one) == later


def test_saving_in_a_program_is_a_checkpoint_and_fits_another_robot_of_the_model():
    one = robot()
    saved = one.save()
    other = virtual_robot("ur5e")
    other.restore(saved)
    assert state(other) == state(one)
    with pytest.raises(BadArguments, match="model is 'ur5e', that of this robot 'ur3'"):
        virtual_robot("ur3").restore(saved)


def test_stepping_back():
    one = robot()
    moments = []
    for _ in range(40):
        one.step(1)
        moments.append(state(one))
    one.set_speed_slider(0.4)
    one.step(5)
    one.step_back(5)
    one.step_back(10)
    assert state(one) == moments[-11]
    one.step(10)
    assert state(one) == moments[-1]  # without the slider, which came later
    assert one.step_back() == one.time()["time_s"]
    with pytest.raises(BadArguments, match="342 periods old: it cannot go 400 back"):
        one.step_back(400)


def test_a_moment_within_a_verb_that_waits():
    one = virtual_robot("ur3")
    one.power_on()
    one.run_until("robot_mode == IDLE")
    one.release_brakes()
    one.run_until("robot_mode == RUNNING")
    one.step_back(60)
    assert one.state(["robot_mode"]) == {"robot_mode": "IDLE"}
    one.run_until("robot_mode == RUNNING")


def test_a_restart_is_in_the_run():
    one = virtual_robot("ur5e", running=True)
    one.step(10)
    one.inject_fault("restart_controller", outage_s=0.2, boot_s=0.1)
    one.step(50)
    with pytest.raises(NotPossible, match="switched off"):
        one.checkpoint()
    one.step(100)
    moment, checkpoint = state(one), one.checkpoint()
    one.step(10)
    one.restore(checkpoint)
    assert state(one) == moment
    with pytest.raises(NotPossible, match="switched off at that moment"):
        one.step_back(80)
    assert state(one) == moment


def test_faults_go_on_and_can_be_cleared():
    one = robot()
    number = one.inject_fault("lagging_joint", joint=2, delay_s=0.004)
    one.step(10)
    one.restore(one.checkpoint())
    assert [fault["state"] for fault in one.faults()] == ["in force"]
    one.clear_fault(number)
    one.step(10)
    assert [fault["state"] for fault in one.faults()] == ["over"]


def test_programs_files_are_those_of_the_run(tmp_path):
    (tmp_path / "first.script").write_text("def first():\n  sleep(1)\nend\n")
    one = virtual_robot("ur5e", running=True, programs=tmp_path)
    one.step(10)
    checkpoint = one.checkpoint()
    (tmp_path / "first.script").unlink()
    one.restore(checkpoint)
    assert one.read_program("first.script")
    one.save_program("second.script", "")
    assert not list(tmp_path.iterdir())


def test_what_changes_a_robot_by_other_ways_is_noticed():
    one = robot()
    one.controller.registers.output.set_double(7, 1.5)
    one.step(1)
    moment, checkpoint = state(one), one.checkpoint()
    with pytest.raises(NotPossible, match=r"cannot be repeated: .*is \[0.0, .*0.0\], recorded \["):
        one.restore(checkpoint)
    assert state(one) == moment
    with one.branch() as other:
        assert state(other) == moment


def test_robots_without_a_run():
    one = VirtualRobot(ControllerConfig(model=load_model("ur3")))
    with pytest.raises(NotPossible, match=r"make it with virtual_robot\(\)"):
        one.checkpoint()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system cannot copy processes")
def test_sockets_of_a_branch_have_their_own_peers():
    one = virtual_robot("ur5e", running=True)
    one.controller.programs.socket_backend = MemorySockets(("10.0.0.1", 5000))
    one.send_script(AROUND)
    one.step(100)
    with one.branch() as other:
        for each in (one, other):
            each.step(500)
        assert state(one) == state(other)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system cannot copy processes")
def test_errors_and_the_end_of_a_branch():
    one = robot()
    other = one.branch()
    with pytest.raises(BadArguments, match="at least 1, not -1"):
        other.step(-1)
    with pytest.raises(AttributeError):
        other.no_such_verb()
    assert plain_values(one.controller.snapshot)["timestamp"] == other.time()["time_s"]
    other.close()
    other.close()
    with pytest.raises(NotPossible, match="closed"):
        other.step()


@each_row(
    ("change", "message"),
    [
        (lambda document: document | {"journal": "?"}, "journal is damaged"),
        (lambda document: document | {"journal": "aGVsbG8="}, "not a journal"),
        (lambda document: document | {"journal": 5}, "journal is damaged"),
        (lambda document: document | {"journal": document["journal"][:400]}, "no beginning"),
    ],
)
def test_damaged_documents_change_nothing(change, message):
    one = robot()
    checkpoint, moment = one.checkpoint(), state(one)
    with pytest.raises(BadArguments, match=message):
        one.restore(change(checkpoint))
    assert state(one) == moment


async def test_an_emulator_is_saved_in_a_program_and_restored():
    clock = StepClock()
    async with Emulator(configure(model="ur3", ephemeral_ports=True), clock) as emulator:
        control = emulator.control
        control.release_brakes()
        clock.step(300)
        control.send_script(AROUND)
        clock.step(300)
        saved, moment = control.save(), plain_values(emulator.controller.snapshot)
        clock.step(500)
        for _ in control.restore(saved):
            clock.step(1)
            await asyncio.sleep(0)
        assert control.state()["runtime_state"] == "PLAYING"
        clock.step(200)
        with Replay(b64decode(control.journal())) as replay:
            replay.run()
            assert replay.difference is None
            assert replay.controller.snapshot.target_q == emulator.controller.snapshot.target_q
        assert control.state(["timestamp"])["timestamp"] < moment["timestamp"] + 500 * 0.008
        assert control.ports()["rtde"]


async def test_a_restored_emulator_whose_time_was_paused_is_paused_again():
    async with Emulator(configure(model="ur3", running=True, ephemeral_ports=True)) as emulator:
        control = emulator.control
        emulator.controller.post(ScriptUnit(AROUND, "block"))
        while control.state(["runtime_state"])["runtime_state"] != "PLAYING":
            await asyncio.sleep(0.01)
        saved = control.save()
        control.pause_time()
        for _ in control.restore(saved):
            assert not control.pace.paused
            await asyncio.sleep(0.01)
        assert control.pace.paused
        assert control.state(["runtime_state"])["runtime_state"] == "PLAYING"
