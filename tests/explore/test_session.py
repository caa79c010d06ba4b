"""Explorations of a recorded session: its messages are sent again, and a few come otherwise."""

import pytest

from emulator.commands.requests import DashboardLine, RTDEInputs, ScriptUnit
from emulator.explore.answer import story, write_found
from emulator.explore.choices import Decision, PlanError
from emulator.explore.plan import plan_of
from emulator.explore.run import Run
from emulator.explore.search import Runner, explored
from emulator.journal.file import MemorySink
from emulator.journal.recorder import record
from emulator.journal.replay import Replay
from emulator.virtual import virtual_robot

# It takes a position once it is valid. A client writes both, 80 ms apart, and relies on it.
PROGRAM = """def take():
  while read_input_integer_register(0) == 0:
    sync()
  end
  set_standard_digital_out(read_input_integer_register(1), True)
end
"""
CLIENT = "10.0.0.7:40000"
PLAN = {
    "session": "run.journal",
    "choices": {"network": {"session": "moved", "by": "0..20", "kind": "RTDE inputs"}},
    "properties": {"right place": {"always": "output.0 == false"}},
}


@pytest.fixture
def recorded(tmp_path):
    """A robot after the session, whose journal is the file of the plan."""
    robot = virtual_robot("ur3", running=True)
    recorder = record(robot, MemorySink())
    for periods, command in (
        (20, ScriptUnit(PROGRAM, "block", f"a script from {CLIENT} on port 30002")),
        (10, RTDEInputs({"input_int_register_1": 2})),
        (20, RTDEInputs({"input_int_register_0": 1})),
        (0, DashboardLine("programState")),
        (10, DashboardLine("robotmode")),
    ):
        robot.controller.post(command, client=CLIENT)
        if periods:
            robot.step(periods)
    robot.set_digital_input(0, True)
    robot.step(20)
    (tmp_path / "run.journal").write_bytes(recorder.journal)
    return robot


def test_a_session_is_as_it_was_and_one_message_that_comes_later_breaks_its_program(recorded, tmp_path):
    plan = plan_of(PLAN, tmp_path)
    run = Run(plan)
    assert run.finish(()).broken == {}
    mine, its = (one.controller.snapshot.values() for one in (recorded, run.robot))
    assert {name for name in mine if mine[name] != its[name]} <= {"actual_execution_time", "messages"}
    told = []
    with Runner(plan, 1) as runner:
        found, _ = explored(plan, runner, 0, lambda: bool(told) or runner.runs > 100, told.append)
    (decision,) = found["right place"].trail.schedule
    by = dict(decision.values)["by"]
    assert decision.period == 20
    assert 10 <= by <= 20
    first, _ = story(plan, found["right place"].trail)
    assert f"network: {CLIENT}: RTDEInputs(values=" in first
    assert first.endswith(f"(sent at 0.160 s) comes {by * plan.period_s:.3g} s later")
    journal = write_found(tmp_path / "plan.yaml", plan, found["right place"], tmp_path)
    with Replay(journal) as replay:
        replay.run()
        assert replay.difference is None
        assert replay.controller.snapshot.actual_digital_output_bits & 1


@pytest.mark.parametrize(
    ("choice", "message", "outputs", "words"),
    [
        ({"session": "moved", "by": "-20..-11"}, 2, 0b001, "comes 0.096 s earlier"),
        ({"session": "dropped", "client": "port 30002"}, 0, 0, "is lost"),
        ({"session": "doubled", "kind": "RTDE inputs"}, 1, 0b100, "comes twice"),
        ({"session": "swapped"}, 3, 0b100, f"comes after {CLIENT}: robotmode"),
        ({"session": "dropped", "kind": "Control API"}, 5, 0b100, "set_digital_input(index=0, level=True) (sent at"),
    ],
)
def test_what_changes_of_messages_do(recorded, choice, message, outputs, words, tmp_path):
    plan = plan_of({**PLAN, "choices": {"it": choice}}, tmp_path)
    kind = plan.choices["it"].kind
    at = max(0, plan.session.messages[message].period - 20 * ("by" in choice))
    assert kind.settled(at) == at
    values = {"by": -12} if "by" in choice else {}
    run = Run(plan)
    trail = run.finish((Decision(at, "it", tuple(values.items())),))
    assert not trail.refused
    assert run.robot.controller.snapshot.actual_digital_output_bits & 0b111 == outputs
    assert words in story(plan, trail)[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"session": "none.journal"}, r"none\.journal: No such file"),
        ({"session": ""}, "needs a program or a session"),
        ({"model": "ur5e"}, "those of the session"),
        ({"choices": {"a": {"session": "later"}}}, "a: session: .*later"),
        ({"choices": {"a": {"session": "moved"}}}, "a: session: a message is moved by"),
        ({"choices": {"a": {"session": "dropped", "by": 3}}}, "a: session: a message is moved by"),
        ({"choices": {"a": {"session": "moved", "by": "0.5..2"}}}, "a: session: a message is moved by"),
        ({"choices": {"a": {"session": "dropped", "port": 30003}}}, "a: session: .*port"),
        ({"choices": {"a": {"session": "dropped", "client": "port 30003"}}}, "a: the session has no message"),
    ],
)
def test_wrong_plans(recorded, change, message, tmp_path):
    with pytest.raises(PlanError, match=message):
        plan_of({**PLAN, **change}, tmp_path)


def test_what_no_client_has_sent_cannot_be_explored(tmp_path):
    robot = virtual_robot("ur3", running=True)
    recorder = record(robot, MemorySink())
    robot.send_script('def ask():\n  socket_open("10.0.0.5", 5000)\nend\n')
    robot.step(5)
    (tmp_path / "run.journal").write_bytes(recorder.journal)
    with pytest.raises(PlanError, match="name who answers them in peers"):
        plan_of(PLAN, tmp_path)
