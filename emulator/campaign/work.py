"""Executes runs of a campaign in the current process, for local processes and clusters."""

import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import msgspec
from msgspec.structs import replace

from emulator.campaign.minimise import minimised
from emulator.campaign.plan import Kind, Plan, Run
from emulator.config import ConfigError
from emulator.script_options import parsed
from emulator.script_run import execute
from urproto.compat import StrEnum
from urproto.entry import SUCCESS
from urproto.text import readable

_LONGEST: Final = 400  # characters of a failure; the replay command shows the rest
_PYTEST_FAILED: Final = 1
_NOT_COLLECTED: Final = 5
_EVIDENCE: Final = ("*.journal", "crash_*.zip")


class Status(StrEnum):
    """How a run ended."""

    PASSED = "passed"
    FAILED = "failed"
    REFUSED = "refused"  # an invalid combination of options
    LOST = "lost"  # its process died in every attempt


class Result(msgspec.Struct, frozen=True):
    """The result of a run. robot_s: robot time; cpu_s: processor time; wall_s: elapsed time; node: the machine.

    files: of a failed run, journals and crash reports by name; their contents are left out where results are stored.
    """

    run: int
    status: Status
    failure: str = ""
    robot_s: float | None = None
    cpu_s: float = 0.0
    wall_s: float = 0.0
    node: str = ""
    files: dict[str, bytes] = {}


def installed_version() -> str:
    return version("ur-emulator")


def carry_out(plan: Plan, numbers: Sequence[int], wanted_version: str, folder: str) -> list[Result]:
    """Execute some runs, one after the other. folder: the folder here to which the plan's paths are relative.

    Raises ConfigError if this machine has another version of the project.
    """
    _enter(wanted_version, folder)
    return [_timed(plan, plan.run(number)) for number in numbers]


def simplify(plan: Plan, number: int, failure: str, wanted_version: str, folder: str) -> Run:
    """The simplest run found that fails like this one. Raises ConfigError like `carry_out`."""
    _enter(wanted_version, folder)
    return minimised(plan, number, failure, lambda run: _timed(plan, run).failure)


def _enter(wanted_version: str, folder: str) -> None:
    if installed_version() != wanted_version:
        raise ConfigError(
            f"{platform.node()} has ur-emulator {installed_version()}, this machine {wanted_version}: install the same"
        )
    os.chdir(folder)


def _timed(plan: Plan, run: Run) -> Result:
    began, used = time.perf_counter(), _processor_s()
    try:
        result = _pytest(plan, run) if plan.kind is Kind.PYTEST else _script(plan, run)
    except Exception as error:  # an error in the emulator: the campaign reports it and continues
        result = Result(run.number, Status.FAILED, f"the emulator failed: {type(error).__name__}: {error}")
    return replace(
        result,
        failure=readable(result.failure)[:_LONGEST],
        cpu_s=_processor_s() - used,
        wall_s=time.perf_counter() - began,
        node=platform.node(),
    )


def _processor_s() -> float:
    """Processor time of this process, and of children that it has waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _script(plan: Plan, run: Run) -> Result:
    try:
        options = parsed(plan.command(run)[2:])
        outcome = execute(options, lambda _: None)
        if outcome.status == SUCCESS:
            return Result(run.number, Status.PASSED, outcome.failure, outcome.robot_s)
        journal = b"" if options.answer else execute(options, lambda _: None, record=True).journal  # the same run again
    except ValueError as error:
        return Result(run.number, Status.REFUSED, str(error))
    files = {"run.journal": journal} if journal else {}
    return Result(run.number, Status.FAILED, outcome.failure, outcome.robot_s, files=files)


# pytest: one process per run, because tests may leave anything behind in their process


def _pytest(plan: Plan, run: Run) -> Result:
    with tempfile.TemporaryDirectory(prefix="ur-campaign-") as folder:
        report = Path(folder, "report.xml")
        own = [f"--junitxml={report}", f"--basetemp={Path(folder, 'tests')}"]
        words = [*plan.command(run)[1:], "-p", "no:cacheprovider", *own]
        command = [sys.executable, "-m", "pytest", *words]
        try:
            ended = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                timeout=plan.limit_s,
                env={**os.environ, "TMPDIR": folder},  # for crash reports
            )
        except subprocess.TimeoutExpired:
            failure = f"not finished within {plan.limit_s:g} s"
            return Result(run.number, Status.FAILED, failure, files=_evidence(Path(folder)))
        result = _judged(run, ended.returncode, report, ended.stdout.decode(errors="replace"))
        return replace(result, files=_evidence(Path(folder))) if result.status is Status.FAILED else result


def _evidence(folder: Path) -> dict[str, bytes]:
    """The journals and crash reports in a folder, by name."""
    return {file.name: file.read_bytes() for kind in _EVIDENCE for file in folder.rglob(kind)}


def _judged(run: Run, status: int, report: Path, output: str) -> Result:
    if status == 0 or (status == _PYTEST_FAILED and report.exists()):
        tests = ElementTree.parse(report)
        return Result(run.number, Status.FAILED if status else Status.PASSED, _first_failure(tests), _robot_s(tests))
    if status == _NOT_COLLECTED:
        return Result(run.number, Status.REFUSED, f"pytest finds no test in {run.target}")
    lines = [line for line in output.splitlines() if line.startswith(("ERROR", "E  ", "INTERNALERROR"))]
    why = (lines or output.splitlines() or [""])[-1].strip()
    return Result(run.number, Status.REFUSED, f"pytest exited with status {status}: {why}")


def _first_failure(tests: "ElementTree.ElementTree[ElementTree.Element]") -> str:
    for case in tests.iter("testcase"):
        for problem in (*case.iter("failure"), *case.iter("error")):
            return f"{case.get('name')}: {(problem.get('message') or '').splitlines()[0]}"
    return ""


def _robot_s(tests: "ElementTree.ElementTree[ElementTree.Element]") -> float | None:
    """Robot time of the robots in virtual time, as reported by their fixture; None without any."""
    spent = [float(one.get("value", 0)) for one in tests.iter("property") if one.get("name") == "ur_robot_s"]
    return sum(spent) if spent else None
