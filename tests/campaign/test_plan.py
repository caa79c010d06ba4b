"""The runs of a campaign file, and errors in it."""

from pathlib import Path

import pytest
from campaign_rig import write

from emulator.campaign.plan import read_plan
from emulator.config import ConfigError
from tests.rows import each_row


def test_runs_are_all_combinations_with_the_last_axis_varying_fastest(tmp_path: Path) -> None:
    plan = read_plan(write(tmp_path))
    assert len(plan) == 2 * 2 * 3
    commands = [" ".join(plan.command(plan.run(number))) for number in range(len(plan))]
    assert len(set(commands)) == len(plan)
    assert commands[0] == "urscript run work.script --model ur3 --polyscope 3.15.8 --seed 5 --timeout 20"
    assert commands[1].endswith("--seed 6 --timeout 20")
    assert commands[11] == (
        "urscript run work.script --model ur5e --fault encoder_jump,joint=1,by_rad=0.3,after=9 "
        "--fault runtime_exception,line=3,probability=0.4,message=oh --seed 7 --timeout 20"
    )


def test_options_of_tests_are_passed_through_the_plugin(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text("")
    text = """
pytest: test_it.py::test_one
options: {polyscope: "5.12"}
matrix: {model: [ur5e], seed: {count: 2}, fault: [["joint_fault,joint=1", "stall,port=rtde"]]}
"""
    plan = read_plan(write(tmp_path, text))
    assert plan.command(plan.run(1)) == [
        *("pytest", "test_it.py::test_one", "--ur-polyscope", "5.12", "--ur-model", "ur5e", "--ur-option", "seed=1"),
        *("--ur-option", "fault=joint_fault,joint=1", "--ur-option", "fault=stall,port=rtde"),
    ]


def test_joint_angles_become_six_arguments(tmp_path: Path) -> None:
    plan = read_plan(write(tmp_path, "script: work.script\nmatrix: {joints: [[0, -1.2, 1, -1.4, -1.5, 0]]}"))
    assert "--joints 0 -1.2 1 -1.4 -1.5 0" in " ".join(plan.command(plan.run(0)))


def test_a_million_runs_need_little_memory(tmp_path: Path) -> None:
    plan = read_plan(write(tmp_path, "script: work.script\nmatrix: {model: [ur3, ur5], seed: {count: 500000}}"))
    assert len(plan) == 1_000_000
    assert plan.command(plan.run(999_999))[3:7] == ["--model", "ur5", "--seed", "499999"]


@each_row(
    ("text", "complaint"),
    [
        ("matrix: {}", "give either 'script' or 'pytest'"),
        ("{script: work.script, pytest: a.py}", "give either 'script' or 'pytest'"),
        ("{script: work.script, matrix: {model: [ur3, ur4]}}", "unknown robot model 'ur4'"),
        ("{script: work.script, matrix: {model: []}}", "model has no values"),
        ("{script: work.script, matrix: {seed: {from: 1}}}", "seed: write a list"),
        ("{script: work.script, matrix: {colour: [red]}}", "unrecognized arguments: --colour red"),
        ("{script: work.script, matrix: {fault: ['joint_fault,joint=9']}}", "joint_fault: Expected `int` <= 5"),
        ("{script: work.script, matrix: {fault: ['stall,port=rtde']}}", "this robot has no ports"),
        ("{script: work.script, matrix: {polyscope: [5.10]}}", "write it in quotes"),
        ("{script: work.script, matrix: {speed: [2]}}", "speed is not an option of a campaign"),
        ("{script: work.script, options: {seed: 1}, matrix: {seed: [2]}}", "seed is in options and in seed"),
        ("{script: work.script, matrix: {r: [{model: ur3}, ur5]}}", "either all of its values must be mappings"),
        ("{script: nowhere.script}", "nowhere.script"),
        ("{pytest: nowhere.py}", "nowhere.py is not there"),
        ("{script: work.script, limit_s: 0}", "limit_s"),
        ("{script: work.script, matrices: {}}", "matrices"),
        ("{script: work.script, matrix: {seed: {count: 2000000000}}}", "2,000,000,000 runs"),
    ],
)
def test_invalid_plans_are_refused_in_one_line_before_anything_runs(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=r"trial\.yaml") as raised:
        read_plan(write(tmp_path, text))
    assert complaint in str(raised.value)
    assert "\n" not in str(raised.value)


def test_another_program_is_another_campaign(tmp_path: Path) -> None:
    before = read_plan(write(tmp_path)).fingerprint
    assert read_plan(write(tmp_path)).fingerprint == before
    assert read_plan(write(tmp_path, program="textmsg(1)\n")).fingerprint != before
