"""Work that clients and files cause is limited in every control period: counted, since time depends on the machine."""

import gzip
import tracemalloc
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest

from emulator.commands.dashboard import COMMANDS
from emulator.commands.requests import DashboardLine
from emulator.control.verbs import verbs_of
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from emulator.mailbox import Command
from emulator.programs.compiling import CompiledTexts
from emulator.programs.loading import load_steps
from emulator.robotapi.endpoints import OPERATIONS, Upload
from emulator.robotapi.server import RobotApiCall
from emulator.virtual import VirtualRobot
from emulator.workshare import WORK_PER_SECOND, Job, WorkShare
from tests.budget import examples
from tests.rows import each_row
from urproto.controlapi import BadArguments, NotPossible
from urproto.robots import load_model
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series
from urscript.polyscope.installation_file import InstallationFile, read_installation_steps

PERIOD_S = 0.002
SHARE = round(WORK_PER_SECOND * PERIOD_S)
MAX_STEP = 12_000  # units: a step may take some periods, which then have no share
TIMES = examples(10)
NOT_HERE = ("shutdown", "quit")
ARGUMENTS = {"load": "good.script", "load installation": "none.installation", "generate support file": "."}


def robot(folder: Path, version: str | None = None) -> Controller:
    wanted = PolyscopeVersion.parse(version) if version else None
    return Controller(
        ControllerConfig(model=load_model("ur5e"), version=wanted, programs_dir=folder, remote_control=True)
    )


def run(controller: Controller, command: Command, times: int) -> list[Any]:
    """The answers to a command that as many clients send at the same time; fails if a period does too much work."""
    answers: list[Any] = []
    for _ in range(times):
        controller.post(command, answers.append)
    spent, most = controller.work.used, 0
    for _ in range(40_000):
        controller.tick()
        most, spent = max(most, controller.work.used - spent), controller.work.used
        if len(answers) == times:
            break
    assert len(answers) == times, f"{len(answers)} of {times} were answered"
    assert most <= SHARE + MAX_STEP, f"{most} units in one period"
    return answers


@each_row("name", [name for name in COMMANDS if name not in NOT_HERE])
def test_every_dashboard_command_is_paid_for(name: str, tmp_path: Path) -> None:
    (tmp_path / "good.script").write_text("set_digital_out(0, True)\n")
    controller = robot(tmp_path)
    form = COMMANDS[name].form
    argument = ARGUMENTS.get(name, "x") if form.takes_argument else ""
    run(controller, DashboardLine(f"{form.words} {argument}".strip()), TIMES)
    assert controller.work.used >= 20 * TIMES
    assert len(list(tmp_path.iterdir())) < 50


@each_row("operation", OPERATIONS, ids=lambda each: f"{each.endpoint.method} {each.endpoint.path}")
def test_every_request_of_the_robot_api_is_paid_for(operation: Any, tmp_path: Path) -> None:
    controller = robot(tmp_path, "10.12")
    arguments: tuple[Any, ...] = ("x",) if operation.named else (Upload(b"x"),) if operation.upload else ()
    if operation.body is not None:
        (field, *_) = msgspec.structs.fields(operation.body)
        kind = {"action": {"StateChange": "POWER_ON", "ProgramStateChange": "stop"}.get(operation.body.__name__)}
        value = kind.get(field.name) or "x"
        arguments = (msgspec.convert({field.name: value}, operation.body),)
    run(controller, RobotApiCall(operation, arguments), TIMES)
    assert controller.work.used >= 20 * TIMES


def test_commands_beyond_the_share_wait_their_turn_and_jobs_continue() -> None:
    share = WorkShare(PERIOD_S)

    def endless() -> Iterator[int]:
        while True:
            yield 10

    jobs: list[Job[None]] = [Job(endless()) for _ in range(3)]  # type: ignore[arg-type]
    used, done = [0, 0, 0], 0
    for _ in range(1000):
        share.new_period()
        while share.take(20):
            done += 1
        for index, job in enumerate(jobs):
            before = share.used
            assert not share.work(job)
            used[index] += share.used - before
    assert share.used <= 1000 * SHARE + SHARE
    assert done * 20 == pytest.approx(500 * SHARE, rel=0.1)
    assert min(used) > 0.25 * sum(used)  # each of three gets a third


def test_a_large_step_is_paid_back() -> None:
    share = WorkShare(PERIOD_S)
    job: Job[None] = Job(iter([10 * SHARE, 1]))  # type: ignore[arg-type]
    periods = 0
    with suppress(RuntimeError):
        while not share.work(job):
            share.new_period()
            periods += 1
    assert periods >= 10


# files


def program(nodes: str, attributes: str = "") -> bytes:
    return (
        f'<URProgram name="x" installation="none"{attributes}><children><MainProgram><children>{nodes}</children>'
        "</MainProgram></children></URProgram>"
    ).encode()


FILES: dict[str, tuple[bytes, str]] = {
    "elements.urp": (gzip.compress(program("<Wait/>" * 1_000_000)), "more than 60000 elements"),
    "attributes.urp": (
        gzip.compress(program("", "".join(f' a{number}="1"' for number in range(500_000)))),
        "more than 1000 attributes",
    ),
    "tag.urp": (gzip.compress(program("", f' a="{"x" * 2_000_000}"')), "a tag or comment of more than 1 MiB"),
    "unpacked.urp": (gzip.compress(b"<URProgram>" + b" " * 50_000_000), "more than 8 MiB of XML"),
    "depth.urp": (gzip.compress(program("<a>" * 1000)), "nested more than 200 deep"),
    "bytes.urp": (b"x" * 5_000_000, "5,000,000 bytes, and a file of the programs folder may have 4,194,304"),
    "bytes.script": (b"x = 1\n" * 1_000_000, "6,000,000 bytes"),
    "bytes.installation": (b"x" * 5_000_000, "5,000,000 bytes"),
    "elements.installation": (gzip.compress(b"<Installation>" + b"<a/>" * 50_000), "more than 20000 elements"),
    "bytes.urpx": (b" " * 2_000_000, "2,000,000 bytes, and a program may have 1,048,576"),
    "late.urp": (gzip.compress(program("<Wait/>" * 100_000, f' a="{"x" * 900_000}"')), "more than 60000 elements"),
    "references.urp": (
        gzip.compress(program("<Wait/>" * 20_000 + '<Wait reference="../Wait[20000]"/>' * 20_000)),
        "node <Wait>|unknown|Wait",
    ),
}


def steps_of(path: Path) -> Any:
    if path.suffix == ".installation":
        return read_installation_steps(path)
    version = PolyscopeVersion.parse("10.12") if path.suffix == ".urpx" else DEFAULT_VERSION[Series.E]
    return load_steps(path, path.parent, InstallationFile(), version, CompiledTexts())


@each_row("name", FILES)
def test_files_beyond_a_limit_are_refused_by_name_and_in_small_steps(name: str, tmp_path: Path) -> None:
    content, problem = FILES[name]
    path = tmp_path / name
    path.write_bytes(content)
    work: list[int] = []
    with pytest.raises((ValueError, OSError), match=problem):
        work.extend(steps_of(path))
    limit = MAX_STEP if path.suffix != ".urpx" else 2 * len(content)
    assert max(work, default=0) <= limit


@each_row("suffix", [".urp", ".script", ".installation", ".urpx"])
def test_a_sparse_file_costs_no_memory(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"sparse{suffix}"
    with path.open("wb") as file:
        file.truncate(8 << 30)
    tracemalloc.start()
    try:
        with pytest.raises((ValueError, OSError), match=r"8,589,934,592 bytes, and a file"):
            list(steps_of(path))
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


def test_verbs_that_wait_do_so_in_steps(tmp_path: Path) -> None:
    """In virtual time, every verb that needs no particular state is carried out ten times without an error of ours."""
    control = VirtualRobot(ControllerConfig(model=load_model("ur5e"), programs_dir=tmp_path))
    for name, verb in verbs_of(VirtualRobot.SUBJECTS).items():
        required = [field for field in msgspec.structs.fields(verb.parameters) if field.required]
        if required or name in ("step", "inject_fault"):
            continue
        before = control.controller.work.used
        for _ in range(TIMES):
            with suppress(NotPossible, BadArguments):
                verb.call(control, {})
        assert control.controller.work.used - before < 100 * SHARE * TIMES, name
