"""Explorations: plans, choices, properties, and a search that finds what is planted and nothing else."""

import runpy
from random import Random

import pytest
import yaml

from emulator import branches
from emulator.config import ConfigError
from emulator.control.conditions import parse_condition
from emulator.explore import search
from emulator.explore.answer import broken_by, explanation, junit, story, write_found
from emulator.explore.choices import Decision, PlanError, domain_of
from emulator.explore.disturbances import PeerDisturbance
from emulator.explore.plan import plan_of, read_plan
from emulator.explore.properties import parse_property
from emulator.explore.run import Run
from emulator.explore.search import Runner, explored
from emulator.journal.replay import Replay
from emulator.snapshot import Snapshot
from tests.networks import MemorySockets
from tests.rows import each_row
from urproto.modes import SafetyMode

# It grips whatever passes: the edge is lost if it falls into the time of the movement.
PROGRAM = """def cell():
  while True:
    while get_standard_digital_in(0) == False:
      sync()
    end
    set_standard_digital_out(0, True)
    sleep(0.4)
    if get_standard_digital_in(1):
      while get_standard_digital_in(1):
        sync()
      end
    end
    set_standard_digital_out(0, False)
    sleep(0.1)
  end
end
"""
PLAN = {
    "program": "cell.script",
    "model": "ur3",
    "lasts": 4,
    "choices": {
        "part": {
            "verb": "set_digital_input",
            "index": 0,
            "level": True,
            "at": "0..3",
            "then": {"verb": "set_digital_input", "index": 0, "level": False, "after": "0.01..0.5"},
        },
        "door": {"verb": "set_digital_input", "index": 1, "level": [True, False]},
        "slider": {"verb": "set_speed_slider", "fraction": "0.1..1.0"},
    },
    "properties": {
        "released": {"after": "output.0 == true", "eventually": "output.0 == false", "within": 1},
        "no_unexpected_stop": True,
    },
}


@pytest.fixture
def plan_file(tmp_path):
    (tmp_path / "cell.script").write_text(PROGRAM)
    file = tmp_path / "plan.yaml"
    file.write_text(yaml.safe_dump(PLAN, sort_keys=False))
    return file


def found_with(plan_file, workers, seed=3, runs=150):
    """What is found first, with the plan, the features seen, and the number of runs."""
    plan, told = read_plan(plan_file), []
    with Runner(plan, workers) as runner:
        found, seen = explored(plan, runner, seed, lambda: bool(told) or runner.runs >= runs, told.append)
        return plan, found, seen.features, runner.runs


def test_what_is_found_is_simple_replays_and_is_a_test(plan_file, tmp_path):
    plan, found, _, runs = found_with(plan_file, 2)
    assert list(found) == ["released"]
    trail = found["released"].trail
    assert sorted(decision.choice for decision in trail.schedule) == ["door", "part"]
    told = story(plan, trail)
    assert any("door: set_digital_input(index=1, level=True)" in line for line in told)
    assert told[-1].startswith("released: not output.0 == false within 1 s of ")
    journal = write_found(plan_file, plan, found["released"], tmp_path / "found")
    with Replay(journal) as replay:
        replay.run()
        assert replay.difference is None
        assert replay.checked == replay.periods == trail.periods
        assert replay.controller.snapshot.actual_digital_output_bits & 1
    kept = runpy.run_path(str(tmp_path / "found" / "test_released.py"))
    with pytest.raises(AssertionError):
        kept["test_released"]()
    (tmp_path / "cell.script").write_text(PROGRAM.replace("if get_standard_digital_in(1):", "if False:"))
    kept["test_released"]()
    xml = junit(plan, found, runs).decode()
    assert 'failures="1"' in xml
    assert "no_unexpected_stop" in xml


def test_the_same_seed_finds_the_same_with_any_number_of_processes_and_without_copies(plan_file, monkeypatch):
    one = found_with(plan_file, 1, runs=16)
    two = found_with(plan_file, 3, runs=16)
    assert one[1:] == two[1:]
    monkeypatch.setattr(search, "can_branch", lambda: False)
    assert found_with(plan_file, 1, runs=16)[1:] == one[1:]
    assert found_with(plan_file, 2, seed=0, runs=16)[1:] != one[1:]


@pytest.mark.skipif(not branches.can_branch(), reason="the system cannot copy processes")
def test_runs_from_a_kept_moment_are_those_from_the_beginning(plan_file):
    plan = read_plan(plan_file)
    chance = Random(5)
    with Runner(plan, 2) as runner:
        (base,) = runner.carry_out([()])
        runner.keep(base)
        schedules = [
            tuple(
                sorted(
                    Decision(chance.randrange(50, 480), name, tuple(plan.choices[name].draw(chance).items()))
                    for name in plan.choices
                )
            )
            for _ in range(4)
        ]
        for entry, schedule in zip(runner.carry_out(schedules), schedules, strict=True):
            entry.close()
            assert entry.trail == Run(plan).finish(schedule)


@pytest.mark.long
def test_a_program_without_a_fault_stays_clean(plan_file, tmp_path):
    (tmp_path / "cell.script").write_text(PROGRAM.replace("while get_standard_digital_in(1):", "while False:"))
    _, found, features, runs = found_with(plan_file, 2, runs=30)
    assert found == {}
    assert runs >= 30
    assert len(features) > 10


def test_the_fixture(plan_file, pytester, tmp_path):
    pytester.makepyfile(
        f"""
        def test_cell(ur_explore):
            ur_explore({str(plan_file)!r}, runs=17, seed=3)
        """
    )
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*released is broken:*", "*door: set_digital_input(index=1, level=True)*"])


PEERS = {"sockets": {"h:1": {"answers": {"ask": "1\n"}, "delay": 0.1}}}
ASKING = """def cell():
  socket_open("h", 1)
  socket_send_line("ask")
  set_standard_digital_out(0, socket_read_line("socket_0", 0) == "1")
end
"""


@each_row(
    ("choice", "values", "answer"),
    [
        ({"peer": "h:1", "late": 1}, {"late": 1}, True),
        ({"peer": "h:1", "silent": True}, {"silent": True}, False),
        ({"fault": "power_loss", "lasting": 0.5}, {"lasting": 0.5, "kind": "power_loss"}, False),
        ({"verb": "push_tool", "wrench": [[0, 0, 9, 0, 0, 0]]}, {"wrench": (0, 0, 9, 0, 0, 0)}, True),
    ],
)
def test_what_choices_do(choice, values, answer, tmp_path):
    (tmp_path / "cell.script").write_text(ASKING)
    (tmp_path / "peers.yaml").write_text(yaml.safe_dump(PEERS))
    answers = {"answers": {"eventually": "output.0 == true", "within": 2}}
    plan = plan_of({**PLAN, "peers": "peers.yaml", "choices": {"it": choice}, "properties": answers}, tmp_path)
    trail = Run(plan).finish((Decision(2, "it", tuple(values.items())),))
    assert not trail.refused
    assert (trail.broken == {}) is answer


def test_an_explanation_is_empty_if_nothing_is_broken(plan_file, tmp_path):
    (tmp_path / "cell.script").write_text("def cell():\n  sleep(1)\nend\n")
    assert explanation(plan_file, 10, 0) == ""
    assert broken_by(plan_file, [(3, "slider", {"fraction": 0.5})]) == {}


# the parts of a plan


@each_row(
    ("change", "message"),
    [
        ({"lasts": 0}, "lasts is a time"),
        ({"at_most": 0}, "at_most is at least 1"),
        ({"choices": {}}, "needs choices"),
        ({"wrong": 1}, "unknown 'wrong'"),
        ({"choices": {"a": {"verb": "set_digital_inputs"}}}, "a: .*set_digital_inputs.*set_digital_input"),
        (
            {"choices": {"a": {"verb": "set_speed_slider", "fraction": "x"}}},
            "fraction must be a number, not text",
        ),
        ({"choices": {"a": {"verb": "set_speed_slider"}}}, "a: set_speed_slider: .*fraction"),
        ({"choices": {"a": {"verb": "protective_stop", "at": "3..9"}}}, "a: at is a time or a range .* 0 to 4"),
        ({"choices": {"a": {"verb": "protective_stop", "at": "3..1"}}}, "a: '3..1': a range is LOW..HIGH"),
        ({"choices": {"a": {"peer": "there", "late": 1}}}, "a: 'there' is not HOST:PORT"),
        ({"choices": {"a": {"peer": "h:1"}}}, "a: peer: say whether"),
        ({"choices": {"a": {"peer": "h:1", "lat": 1}}}, "a: peer: .*lat"),
        ({"choices": {"a": 5}}, "a: write what happens"),
        ({"choices": {"a": {"what": 5}}}, "a: a choice has one of the keys"),
        ({"choices": {"a": {"verb": "set_digital_input", "index": [], "level": True}}}, "a: an empty list"),
        ({"properties": {"a": True}}, "a: write .*no_unexpected_stop: true"),
        ({"properties": {"a": {"always": "x"}}}, "a: 'x' is not a condition"),
        ({"properties": {"a": {"always": "no.such > 1"}}}, "a: there is no no.such here"),
        ({"properties": {"a": {"ever": "timestamp > 1"}}}, "a: .*ever"),
        ({"properties": {"a": {"eventually": "timestamp > 1"}}}, "a: write always"),
    ],
)
def test_wrong_plans(change, message, tmp_path):
    (tmp_path / "cell.script").write_text(PROGRAM)
    with pytest.raises(PlanError, match=message):
        Run(plan_of({**PLAN, **change}, tmp_path))


def test_a_plan_file_that_is_not_there_or_names_one_that_is_not(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.yaml"):
        read_plan(tmp_path / "none.yaml")
    with pytest.raises(PlanError, match=r"cell\.script: No such file"):
        Run(plan_of(PLAN, tmp_path))
    (tmp_path / "cell.script").write_text("def cell(:\n")
    with pytest.raises(PlanError, match="the program does not start"):
        Run(plan_of(PLAN, tmp_path))


def test_domains():
    chance = Random(1)
    assert {repr(domain_of("0..3").draw(chance)) for _ in range(50)} == {"0", "1", "2", "3"}
    assert domain_of([[1, 2]]).draw(chance) == (1, 2)
    assert 0.01 <= domain_of("0.01..2").draw(chance) <= 2
    assert domain_of("p[1..2]").draw(chance) == "p[1..2]"
    assert domain_of([3, 4]).draw(chance) in (3, 4)
    assert list(domain_of([3, 4, 5]).simpler(5)) == [3, 4]
    assert next(iter(domain_of("0.5..2").simpler(1.23456))) == 0.5
    assert list(domain_of("0.5..2").simpler(0.5)) == []


@each_row(
    ("entry", "values", "broken", "margin"),
    [
        ({"always": "timestamp < 3"}, [1, 2, 2.5], False, 0.5),
        ({"always": "timestamp < 3"}, [1, 3, 2], True, 0.0),
        ({"always": "timestamp < 3", "until": "timestamp >= 2"}, [1, 2, 5], False, 2.0),
        ({"always": "timestamp < 3", "until": "timestamp == 9"}, [1, 2], True, 1.0),
        ({"always": "timestamp < 3", "when": "timestamp != 4"}, [1, 4, 2], False, 1.0),
        ({"eventually": "timestamp > 3", "within": 2}, [1, 1, 4], False, 0.0),
        ({"eventually": "timestamp > 3", "within": 1}, [1, 1, 4], True, 0.0),
        ({"after": "timestamp == 1", "eventually": "timestamp == 2", "within": 2}, [0, 0, 0, 1, 0, 2], False, 0.0),
        ({"after": "timestamp == 1", "eventually": "timestamp == 2", "within": 2}, [0, 1, 0, 0, 0, 2], True, 0.0),
        ({"finally": "timestamp == 2"}, [1, 2], False, 1.0),
        ({"finally": "timestamp == 2"}, [2, 1], True, -1.0),
    ],
)
def test_properties_over_time(entry, values, broken, margin):
    """A value of `timestamp` for each second."""
    monitor = parse_property("it", entry).monitor(lambda name: None)
    for second, value in enumerate(values):
        monitor.look(Snapshot(timestamp=value), float(second))
    monitor.end(Snapshot(timestamp=values[-1]), float(len(values)))
    assert bool(monitor.broken) is broken
    assert monitor.margin == margin


def test_ready_made_properties():
    assert parse_property("tool_force", 50).entry == {"always": "tcp_force_scalar <= 50"}
    assert parse_property("every_wait_ends", 3).entry["within"] == 3
    with pytest.raises(PlanError):
        parse_property("tool_force", True)


def test_margins_of_conditions():
    condition = parse_condition("timestamp > 2 and safety_mode == NORMAL")
    assert condition.margin(Snapshot(timestamp=2.5, safety_mode=SafetyMode.NORMAL)) == 0.5
    assert condition.margin(Snapshot(timestamp=2.5, safety_mode=SafetyMode.REDUCED)) == -1.0


def test_peers_that_are_disturbed():
    now = 0.0
    memory = MemorySockets(("h", 1))
    peers = PeerDisturbance(memory, lambda: now)
    socket = peers.open("h", 1)
    (peer,) = memory.opened

    def arrived(data=b""):
        peer.feed(data)
        assert socket.state == "open"
        text, socket.inbox[:] = bytes(socket.inbox), b""
        return text

    assert arrived(b"a") == b"a"
    peers.begin(("h", 1), late=0.5, lasting=1.0)
    assert arrived(b"b") == b""
    now = 0.4
    assert arrived(b"c") == b""
    now = 0.5
    assert arrived() == b"b"
    now = 1.0
    assert arrived(b"d") == b"cd"
    peers.begin(("h", 1), silent=True, lasting=1.0)
    assert arrived(b"e") == b""
    now = 2.0
    peers.begin(("h", 1), garbled=True)
    assert arrived(b"f") == b"g"
    assert socket.send(b"x")
    assert peer.sent == b"x"
    peer.close()
    assert socket.state == "closed"
