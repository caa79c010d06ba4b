"""Replays of whole emulators, of random sessions, until a moment, and of runs that are not the same."""

import asyncio
import io
import json
import os
import time
import zipfile
from base64 import b64decode
from contextlib import suppress
from dataclasses import replace
from random import Random

import pytest
from journal_rig import Recorded

from emulator.app import Emulator
from emulator.commands.requests import DashboardLine, RTDEInputs, ScriptUnit
from emulator.control.conditions import parse_condition
from emulator.journal.file import MAGIC, JournalError, JournalWriter, MemorySink, read_journal
from emulator.journal.recorder import record
from emulator.journal.replay import Replay
from emulator.journal.ring import Ring
from emulator.journal.stops import StopJournals
from emulator.options import configure
from emulator.virtual import virtual_robot
from tests.rows import each_row
from tests.ticking import StepClock
from urproto.controlapi import BadArguments, NotPossible
from urproto.modes import RuntimeState

SESSIONS = int(os.environ.get("RANDOM_SESSIONS", "6"))
MOVE = "def go():\n  while True:\n    movej([0.2, -1.4, 1.5, -1.7, -1.5, 0.3 * random()])\n  end\nend\n"
SCRIPTS = (
    MOVE,
    """def speed():
  while True:
    speedl([0, 0, 0.05, 0, 0, 0.2], 0.5, 0.1)
    speedj([0.1, 0, 0, 0, 0, 0], 1, 0.1)
  end
end
""",
    """def force():
  force_mode(p[0, 0, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, -5, 0, 0, 0], 2, [0.1, 0.1, 0.1, 1, 1, 1])
  sleep(0.5)
  end_force_mode()
end
""",
    "sec out():\n  set_digital_out(3, True)\nend\n",
    "def wrong():\n  movej([0.1])\nend\n",
    """def waits():
  thread beside():
    while True:
      sync()
    end
  end
  run beside()
  popup("x", blocking=True)
end
""",
)
LINES = (
    "pause",
    "play",
    "stop",
    "power off",
    "power on",
    "brake release",
    "unlock protective stop",
    "close popup",
    "?",
)


def act(run, chance):
    robot = run.robot
    kind = chance.randrange(6)
    if kind == 0:
        run.post(ScriptUnit(chance.choice(SCRIPTS), "block"))
    elif kind == 1:
        run.post(DashboardLine(chance.choice(LINES)))
    elif kind == 2:
        run.post(RTDEInputs({"speed_slider_mask": 1, "speed_slider_fraction": chance.random()}))
    elif kind == 3:
        robot.set_digital_input(chance.randrange(8), chance.random() < 0.5)
    elif kind == 4 and robot.controller.snapshot.safety_mode == 1:
        robot.press_emergency_stop() if chance.random() < 0.3 else robot.push_tool(
            [0.0, 0.0, chance.uniform(-30, 30), 0.0, 0.0, 0.0]
        )
    elif kind == 5:
        robot.inject_fault(chance.choice(("lagging_joint", "frozen_feedback")), joint=chance.randrange(6), lasting=0.2)
    robot.step(chance.randrange(1, 120))


@each_row("seed", range(SESSIONS))
def test_random_sessions(seed):
    chance = Random(f"session {seed}")
    model, arm = chance.choice(("ur3", "ur5e", "ur10e")), chance.choice(("ideal", "dynamic"))
    run = Recorded(model, arm=arm, seed=seed)
    for _ in range(30):
        with suppress(NotPossible, BadArguments):
            act(run, chance)
    run.is_repeated()


async def test_an_emulator_with_faults_and_a_restart(tmp_path):
    journal = tmp_path / "run.journal"
    options = {"model": "ur5e", "running": True, "ephemeral_ports": True, "fault": ["joint_fault,joint=2,after=9"]}
    config = configure(**options, journal=journal)
    clock = StepClock()
    async with Emulator(config, clock) as emulator:
        emulator.control.send_script(MOVE)
        clock.step(100)
        emulator.control.inject_fault("drop_connection", port="rtde")
        emulator.control.inject_fault("frozen_feedback", joint=1, lasting=0.1)
        clock.step(200)
        emulator.control.inject_fault("restart_controller", boot_s=0.5, outage_s=0.2)
        before = emulator.controller
        for _ in range(400):
            clock.step(1)
            await asyncio.sleep(0)
            if emulator.controller is not before:
                break
        assert emulator.controller is not before
        clock.step(700)
        uptime_s = emulator.controller.time_s
    with Replay(journal) as replay:
        replay.run()
        assert replay.difference is None, str(replay.difference)
        assert replay.checked > 900
        assert replay.controller.time_s == uptime_s


def test_until_a_moment_and_on_from_there():
    run = Recorded()
    run.robot.send_script(MOVE)
    run.robot.step(900)
    with run.replay() as again:
        again.run(parse_condition("runtime_state == PLAYING"))
        assert again.controller.snapshot.runtime_state is RuntimeState.PLAYING
        early = again.periods
        assert early < 900
        controller = again.leave(run)
        before = controller.snapshot.target_q
        for _ in range(300):
            controller.tick()
        assert controller.snapshot.target_q != before


def altered(journal, change):
    """The journal with another list of records."""
    sink = io.BytesIO()
    writer = JournalWriter(sink)
    for one in change(list(read_journal(journal))):
        writer.add(one)
    writer.flush()
    return sink.getvalue()


def test_the_first_period_that_differs_is_named_with_what_differs():
    run = Recorded()
    run.robot.step(600)
    run.post(RTDEInputs({"speed_slider_mask": 1, "speed_slider_fraction": 0.5}))
    run.robot.send_script(MOVE)
    run.robot.step(1000)

    def without_the_slider(records):
        return [one for one in records if not (one[1] == "post" and "RTDEInputs" in json.dumps(one))]

    with Replay(altered(run.journal, without_the_slider)) as replay:
        replay.run()
        assert replay.difference is not None
        assert 600 < replay.difference.period <= 1000
        assert "target_speed_fraction is 1.0, recorded 0.5" in str(replay.difference)
        assert "report it with the journal" in replay.advice
        replay.header["product"] = "0.0.1"
        assert "change of behaviour" in replay.advice


def test_a_journal_that_was_cut_ends_earlier_and_one_that_is_damaged_says_so():
    run = Recorded()
    run.robot.send_script(MOVE)
    run.robot.step(1500)
    journal = run.journal
    whole = len(list(read_journal(journal)))
    assert len(list(read_journal(journal[:-3]))) < whole
    chance = Random(1)
    for _ in range(200):
        damaged = bytearray(journal)
        damaged[chance.randrange(len(damaged))] ^= 1 << chance.randrange(8)
        records = read_journal(bytes(damaged))
        with suppress(JournalError):
            assert len(list(records)) <= whole


def begun(**changes):
    """A change of the first record."""
    return lambda records: [[0, "run", {**records[0][2], **changes}], *records[1:]]


def with_record(*content):
    return lambda records: [records[0], [0, *content]]


@each_row(
    ("change", "message"),
    [
        (lambda records: records[1:], "no beginning"),
        (begun(format=1, product="0.1"), "format 1, .* reads 2: replay it with the version that wrote it, 0.1"),
        (begun(problem="it was not made from options"), "cannot be replayed: it was not made from options"),
        (begun(options={"polyscope": "99.0"}), "cannot make the robot"),
        (begun(files={"programs": {"../../x": ""}}), "outside of its folder"),
        (begun(files={"../../x": {"y": ""}}), "outside of its folder"),
        (begun(options={"world": {"folder": "world", "file": "../../x"}}), "outside of its folder"),
        (begun(files=1), "the beginning of the journal is damaged"),
        (with_record("telepathy", 1), "unknown kind, 'telepathy'"),
        (with_record("verb", "__init__", {"@m": []}), "damaged record of the kind verb"),
        (lambda records: [records[0], [10**15, "left", 1]], "has nothing between period 0 and"),
        (with_record("post", {"@": "Popen", "args": "x"}), "unknown value"),
    ],
)
def test_journals_that_cannot_be_replayed(change, message):
    run = Recorded()
    run.robot.step(1)
    with pytest.raises(JournalError, match=message), Replay(altered(run.journal, change)) as replay:
        replay.run()


def test_a_foreign_file():
    with pytest.raises(JournalError, match="not a journal"):
        list(read_journal(b"PK" + MAGIC))


@pytest.mark.emulator_fails
def test_a_crash_report_has_the_journal_up_to_the_failure(tmp_path):
    run = Recorded(programs=tmp_path)
    run.robot.send_script(MOVE)
    run.robot.step(400)
    run.robot.controller.on_tick.append(lambda: 1 / 0)
    run.robot.step(1)
    (report,) = tmp_path.glob("crash_*.zip")
    with zipfile.ZipFile(report) as archive, Replay(archive.read("run.journal")) as replay:
        replay.run()
        assert replay.difference is None
        assert replay.controller.step_count == run.robot.controller.step_count
        assert replay.controller.programs.state is RuntimeState.PLAYING


@pytest.mark.parametrize("sink", [pytest.param(MemorySink, marks=pytest.mark.long), Ring])
def test_a_journal_in_memory_is_given_up_when_it_is_too_long_and_a_ring_begins_anew_at_rest(sink, caplog):
    robot = virtual_robot("ur5e", running=True, recorded=False)
    recorder = record(robot, sink(limit=20_000))
    robot.send_script(MOVE)
    robot.step(500)
    assert recorder.journal
    robot.step(9000)
    assert recorder.journal == b""
    assert caplog.text.count("the journal ends here") == 1
    robot.dashboard("stop")
    robot.step(600)
    assert bool(recorder.journal) is (sink is Ring)
    if recorder.journal:
        with Replay(recorder.journal) as replay:
            replay.run()
            assert (replay.difference, replay.periods) == (None, recorder.periods)
    recorder.close()


def test_a_refused_fault_has_no_number_in_a_replay_either():
    robot = virtual_robot("ur3", running=True, checked=True)
    with pytest.raises(NotPossible, match="dynamic"):
        robot.inject_fault("lost_brake", joint=1)
    number = robot.inject_fault("lagging_joint", joint=2, delay_s=0.1)
    robot.send_script(MOVE)
    robot.step(100)
    robot.clear_fault(number)
    robot.step(100)
    with Replay(robot.journal) as replay:
        replay.run()
        assert (replay.difference, replay.periods) == (None, 200)


def test_a_ring_drops_what_is_older_once_another_process_has_proven_new_beginnings():
    robot = virtual_robot("ur5e", running=True, recorded=False)
    recorder = record(robot, Ring(segment_s=2.0))
    number = robot.inject_fault("lagging_joint", joint=2, lasting=0.1)
    while "begin" not in next(read_journal(recorder.journal))[2]:
        robot.set_digital_output(1, not robot.state(["actual_digital_output_bits"])["actual_digital_output_bits"] & 2)
        robot.step(500)
        time.sleep(0.3)  # for the other process
    robot.send_script(MOVE)
    assert robot.inject_fault("lagging_joint", joint=2, lasting=0.1) == number + 1
    robot.step(500)
    with Replay(recorder.journal) as replay:
        begun = replay.periods
        replay.run()
        assert (replay.difference, replay.periods) == (None, recorder.periods)
        assert 0 < replay.checked == recorder.periods - begun
    recorder.close()


async def test_the_journals_of_unexpected_stops_are_written_by_themselves(tmp_path, caplog):
    for number in range(6):
        (tmp_path / f"stop_{number}.journal").touch()
    clock = StepClock()
    async with Emulator(
        configure(model="ur3", programs=tmp_path, ephemeral_ports=True, running=True), clock
    ) as emulator:
        emulator.stop_journals = StopJournals()
        clock.step(100)
        emulator.control.protective_stop()
        clock.step(200)
        emulator.control.press_emergency_stop()  # soon after the other one
        clock.step(300)
    (journal,) = (file for file in tmp_path.glob("stop_*.journal") if file.stat().st_size)
    assert len(list(tmp_path.glob("stop_*.journal"))) == 5
    assert f"PROTECTIVE_STOP: ur-emulator trace {journal} shows it" in caplog.text
    with Replay(journal) as replay:
        replay.run(parse_condition("safety_mode == PROTECTIVE_STOP"))
        stopped = replay.periods
        replay.run()
        assert replay.difference is None
        assert stopped <= 102
        assert 124 <= replay.periods - stopped <= 126


async def test_the_control_api_hands_the_journal_out():
    clock = StepClock()
    async with Emulator(configure(model="ur3", ephemeral_ports=True), clock) as emulator:
        emulator.control.release_brakes()
        clock.step(200)
        journal = b64decode(emulator.control.journal())
        with Replay(journal) as replay:
            replay.run()
            assert (replay.difference, replay.periods) == (None, 200)


async def test_the_ports_open_where_a_replay_ends():
    run = Recorded()
    run.robot.send_script(MOVE)
    run.robot.step(1500)
    with Replay(run.journal, again=MemorySink()) as again:
        again.run(parse_condition("timestamp >= 43"))
        clock = StepClock()
        config = replace(configure(model="ur5e", ephemeral_ports=True), controller=again.config)
        async with Emulator(config, clock, again) as emulator:
            assert emulator.ports["rtde"]
            assert emulator.control.state()["runtime_state"] == "PLAYING"
            before = emulator.controller.snapshot.target_q
            clock.step(100)
            assert emulator.controller.snapshot.target_q != before
            journal = b64decode(emulator.control.journal())
        with Replay(journal) as further:
            further.run()
            assert (further.difference, further.periods) == (None, again.periods + 100)
