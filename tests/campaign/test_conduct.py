"""Every run has exactly one result, even if processes die; existing results are reused; failing runs are reduced."""

import itertools
import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from campaign_rig import CAMPAIGN, InProcessWorkers, write

from emulator import script_cli as cli
from emulator.campaign.conduct import Conductor, first_failures, simplest
from emulator.campaign.journal import Journal, write_parquet
from emulator.campaign.plan import Plan, read_plan
from emulator.campaign.report import write_report
from emulator.campaign.work import Result, Status, installed_version
from emulator.campaign.workers import LocalWorkers
from emulator.config import ConfigError
from emulator.journal.replay import Replay

VERSION = installed_version()


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Executing runs in this process changes its current folder."""
    monkeypatch.chdir(tmp_path)


def conducted(
    plan: Plan, folder: Path, workers: object | None = None, on_results: Callable[[list[Result]], None] = lambda _: None
) -> list[Result]:
    """The contents of the journal after the campaign."""
    with Journal(folder, plan, VERSION) as journal:
        Conductor(plan, workers or InProcessWorkers(plan.folder), journal, VERSION, on_results).run()
        return list(journal.results())


def complete(plan: Plan, results: list[Result]) -> bool:
    return sorted(result.run for result in results) == list(range(len(plan)))


def test_rerunning_the_command_of_a_run_gives_the_same_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import pyarrow.parquet

    plan = read_plan(write(tmp_path))
    results = conducted(plan, tmp_path / "out")
    assert complete(plan, results)
    with Journal(tmp_path / "out", plan, VERSION) as journal:
        write_parquet(journal, plan, tmp_path / "results.parquet")
    rows = pyarrow.parquet.read_table(tmp_path / "results.parquet").to_pylist()
    assert {row["status"] for row in rows} == {"passed", "failed"}  # random, by the seed
    assert {row["status"] for row in rows if not row["fault"]} == {"passed"}
    for row in (next(row for row in rows if row["status"] == status) for status in ("passed", "failed")):
        _, _, *words = row["command"].split()
        assert cli.main(["run", *words]) == (row["status"] == "failed")
        printed = capsys.readouterr().out
        assert f"time    {row['robot_s']:.3f} s\nresult  {row['failure'] or 'finished'}\n" in printed


def test_an_interrupted_campaign_resumes(tmp_path: Path) -> None:
    plan = read_plan(write(tmp_path))

    def interrupt(results: list[Result]) -> None:
        if results:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        conducted(plan, tmp_path / "out", on_results=interrupt)
    journal = tmp_path / "out" / "journal.jsonl"
    done = journal.read_bytes().count(b"\n") - 1
    assert 0 < done < len(plan)
    journal.write_bytes(journal.read_bytes() + b'{"run":11,"status":"pas')  # an incomplete last line
    workers = InProcessWorkers(plan.folder)
    assert complete(plan, conducted(plan, tmp_path / "out", workers))
    assert sum(len(numbers) for _, numbers, *_ in workers.jobs) == len(plan) - done


def test_results_of_another_campaign_are_not_resumed(tmp_path: Path) -> None:
    conducted(read_plan(write(tmp_path, "script: work.script")), tmp_path / "out")
    with pytest.raises(ConfigError, match="has changed: add --fresh"):
        conducted(read_plan(write(tmp_path, "script: work.script", "sync()\n")), tmp_path / "out")
    (tmp_path / "out" / "journal.jsonl").write_text("what is this\n")
    with pytest.raises(ConfigError, match="is not a campaign journal"):
        conducted(read_plan(write(tmp_path)), tmp_path / "out")


def test_a_run_that_kills_its_process_is_the_only_one_lost(tmp_path: Path) -> None:
    plan = read_plan(write(tmp_path, "script: work.script\nmatrix: {seed: {count: 30}}", "sync()\n"))
    workers = InProcessWorkers(plan.folder, loses=lambda _plan, numbers, *_: 17 in numbers)
    results = conducted(plan, tmp_path / "out", workers)
    assert complete(plan, results)
    assert [result.run for result in results if result.status is not Status.PASSED] == [17]
    assert max(len(numbers) for _, numbers, *_ in workers.jobs) > 1  # it was part of a job with several runs


@pytest.mark.long
def test_a_killed_process_loses_and_duplicates_no_results(tmp_path: Path) -> None:
    plan = read_plan(write(tmp_path, "script: work.script\nmatrix: {seed: {count: 40}}", "sleep(10)\n"))
    workers = LocalWorkers(plan.folder, 2)
    killed: list[int] = []

    def kill(results: list[Result]) -> None:
        pids = [worker.process.pid for worker in workers._busy if worker.process.pid]
        if results and not killed and pids:
            killed.append(pids[0])
            os.kill(killed[0], signal.SIGKILL)

    try:
        results = conducted(plan, tmp_path / "out", workers, kill)
    finally:
        workers.close()
    assert killed
    assert complete(plan, results)
    assert {result.status for result in results} == {Status.PASSED}


def test_a_machine_with_another_version_is_refused(tmp_path: Path) -> None:
    plan = read_plan(write(tmp_path, "script: work.script"))
    with Journal(tmp_path / "out", plan, "9.9") as journal, pytest.raises(ConfigError):
        Conductor(plan, RaisingWorkers(plan.folder), journal, "9.9", lambda _: None).run()


class RaisingWorkers(InProcessWorkers):
    """Returns the exception of a function, like the other workers."""

    def submit(self, function: Callable[..., object], *arguments: object) -> int:
        def returning_errors(*given: object) -> object:
            try:
                return function(*given)
            except Exception as error:
                return error

        return super().submit(returning_errors, *arguments)


def test_one_failed_run_of_each_kind_is_reduced_to_a_minimum(tmp_path: Path) -> None:
    plan = read_plan(write(tmp_path, CAMPAIGN.replace("robot: [{model: ur3, ", "robot: [{model: ur10, ")))
    results = conducted(plan, tmp_path / "out")
    with Journal(tmp_path / "out", plan, VERSION) as journal:
        failed = first_failures(journal, 10)
        assert [result.failure for result in failed] == ["runtime exception: line 3: oh"]
        assert failed[0].run == min(result.run for result in results if result.status is Status.FAILED)
        simpler = simplest(plan, InProcessWorkers(plan.folder), VERSION, failed)
        command = plan.command(simpler[failed[0].run])
        assert command == [
            *("urscript", "run", "work.script", "--model", "ur10", "--polyscope", "3.15.8"),
            *("--fault", "runtime_exception,line=3,message=oh", "--seed", "5", "--timeout", "20"),
        ]
        write_report(tmp_path / "report.html", plan, journal, simpler)
    page = (tmp_path / "report.html").read_text()
    assert " ".join(command) in page
    for result in results:
        shown = f"<td class=n>{result.run}<td>" in page
        assert shown == (result.status is Status.FAILED)


def test_failed_runs_leave_journals_that_can_be_replayed(tmp_path: Path) -> None:
    text = CAMPAIGN.replace(
        "limit_s", "options: {input: [digital3=1@0.1, tool-analog1=2@0.1], register: [float3=2]}\nlimit_s"
    )
    plan = read_plan(write(tmp_path, text))
    results = conducted(plan, tmp_path / "out")
    with Journal(tmp_path / "out", plan, VERSION) as journal:
        write_report(tmp_path / "out" / "report.html", plan, journal, {})
    page = (tmp_path / "out" / "report.html").read_text()
    assert any(result.files for result in results)
    for result in results:
        assert list(result.files) == [f"failed_runs/{result.run}_run.journal"] * (result.status is Status.FAILED)
        for name in result.files:
            assert f"ur-emulator trace {name}" in page
            with Replay(tmp_path / "out" / name) as replay:
                replay.run()
                assert replay.difference is None
                assert replay.controller.time_s - 41.0 == pytest.approx(result.robot_s)


def test_a_report_escapes_any_text(tmp_path: Path) -> None:
    text = CAMPAIGN.replace("message=oh", "message=<b>&")
    plan = read_plan(write(tmp_path, text))
    conducted(plan, tmp_path / "out")
    with Journal(tmp_path / "out", plan, VERSION) as journal:
        write_report(tmp_path / "report.html", plan, journal, {})
    page = (tmp_path / "report.html").read_text()
    assert "&lt;b&gt;&amp;" in page
    assert "<b>" not in page


def test_the_speed_slider_and_faults_are_options_of_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path)

    def robot_s(*options: str) -> float:
        cli.main(["run", "work.script", *options])
        line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("time"))
        return float(line.split()[1])

    usual, slow = robot_s(), robot_s("--speed-slider", "0.5")
    assert slow > 1.5 * usual
    assert cli.main(["run", "work.script", "--fault", "joint_fault,joint=2,after=0.5"]) == 1
    assert "the arm was stopped: fault" in capsys.readouterr().out
    chances = [cli.main(["run", "work.script", *f"--seed {n} --fault runtime_exception,line=3,probability=0.5".split()])
               for n in range(8)]  # fmt: skip
    assert set(chances) == {0, 1}
    for wrong in ("--fault=nonsense", "--fault=stall,port=rtde"):
        assert cli.main(["run", "work.script", wrong]) == 2
    with pytest.raises(SystemExit):
        cli.main(["run", "work.script", "--speed-slider", "1.5"])


TESTS = """
def test_by_chance(ur_robot, ur_seed):
    ur_robot.step(125)
    assert ur_robot.describe()["model"] == "ur3e"
    assert ur_seed != 2, "seed two"
"""


def test_tests_are_run_with_the_robots_and_seeds_of_the_campaign(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text(TESTS)
    text = "pytest: test_it.py\nmatrix: {model: [ur3e], seed: {from: 1, count: 2}}"
    plan = read_plan(write(tmp_path, text))
    results = sorted(conducted(plan, tmp_path / "out"), key=lambda result: result.run)
    assert complete(plan, results)
    assert [result.status for result in results] == ["passed", "failed"]
    assert results[0].robot_s == pytest.approx(125 * 0.002)
    assert results[1].failure == "test_by_chance: AssertionError: seed two"


@pytest.mark.long
def test_a_missing_test_is_refused(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text(TESTS)
    plan = read_plan(write(tmp_path, "pytest: [test_it.py::test_none, test_it.py]\nmatrix: {wheels: [4]}"))
    results = conducted(plan, tmp_path / "out")
    assert [result.status for result in results] == ["refused", "failed"]
    assert "test_none" in results[0].failure
    assert "no option 'wheels'" in results[1].failure


def test_job_sizes_shrink_towards_the_end(tmp_path: Path) -> None:
    plan = read_plan(write(tmp_path, "script: work.script\nmatrix: {seed: {count: 60}}", "sync()\n"))
    workers = InProcessWorkers(plan.folder)
    conducted(plan, tmp_path / "out", workers)
    sizes = [len(numbers) for _, numbers, *_ in workers.jobs]
    assert sizes[0] == 1
    assert max(sizes) > 5
    assert sizes[-1] == 1
    assert all(later <= earlier for earlier, later in itertools.pairwise(sizes[3:]))
