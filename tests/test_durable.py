"""Files are written completely or not at all: with a file system that fails at each call in turn."""

import errno
import json
import os
import zipfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from functools import cache, partial
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
import pytest
from typer.testing import CliRunner

from client.calibration import read_calibration, write_calibration
from client.cli import app
from client.decoding.packets import SocketAddress
from client.errors import ClientError
from client.identification.identify import write_arm
from client.lerobot import write_dataset
from client.pendant.saved import Poses, ProgramFile, SavedDraft
from client.recording import Recorder, convert, read
from client.recording.plots import draw_trajectory
from client.traffic.recording import TrafficRecorder, TrafficRecording
from emulator.campaign.journal import Journal, write_parquet
from emulator.campaign.plan import read_plan
from emulator.campaign.report import write_report
from emulator.campaign.work import Result, Status
from emulator.config import ConfigError
from emulator.ctl import _show as ctl_show
from emulator.machine import ControllerConfig
from emulator.reports import write_crash
from emulator.robotapi.stored import store_program
from emulator.serve import write_ports
from emulator.servers.http import HttpError
from emulator.virtual import VirtualRobot
from tests.robotapi.rig import empty_urpx
from urproto import durable
from urproto.controlapi import NotPossible
from urproto.robots import Calibration, load_model
from urscript.polyscope.document import read_document
from urscript.polyscope.urpx import read_urpx
from urscript.work import run_to_end

CHANGING: Final = ("open", "write", "fsync", "chmod", "replace", "rename", "close")
OLD: Final = b"{}"


class Killed(BaseException):
    """The process has ended: nothing after this call happens."""


@dataclass
class FaultyDisk:
    """The module `os` on a file system whose call with this number fails.

    how: full, read-only, torn (half of a write arrives), short (the same, but the rest may be written), or killed.
    calls: their names.
    """

    at: int = -1
    how: str = ""
    calls: list[str] = field(default_factory=list)
    dead: bool = False
    opened: set[int] = field(default_factory=set)

    def __getattr__(self, name: str) -> Any:
        function = getattr(os, name)
        return partial(self._call, name, function) if name in (*CHANGING, "unlink", "ftruncate") else function

    def _call(self, name: str, function: Callable[..., Any], *arguments: Any) -> Any:
        if name == "close" and arguments[0] not in self.opened:  # a file of an earlier case, which is collected now
            return function(*arguments)
        if self.dead:
            raise Killed
        if name in CHANGING:
            self.calls.append(name)
        fails = name in CHANGING and len(self.calls) == self.at
        result = None
        if fails and name == "write" and self.how in ("torn", "short"):
            result = function(arguments[0], arguments[1][: max(1, len(arguments[1]) // 2)])
        elif not fails or name == "close" or self.how == "short":  # a descriptor is closed even if that fails
            result = function(*arguments)
        if not fails or self.how == "short":
            self.opened |= {result} if name == "open" else set()
            return result
        self.dead = self.how == "killed"
        if self.dead:
            raise Killed
        number = {"full": errno.ENOSPC, "read-only": errno.EROFS, "torn": errno.EIO}[self.how]
        raise OSError(number, os.strerror(number))


def run_cli(*words: str) -> None:
    """Run ``ur-client``; raises its error."""
    result = CliRunner().invoke(app, words)
    if result.exception is not None:
        raise result.exception


@cache
def virtual_robot() -> VirtualRobot:
    return VirtualRobot(ControllerConfig(model=load_model("ur5e"), running=True))


def robot(path: Path) -> VirtualRobot:
    """A robot whose programs folder is that of this file."""
    controller = virtual_robot().controller
    controller.config = replace(controller.config, programs_dir=path.parent)
    controller.installation.path = None
    return virtual_robot()


def reply(path: Path, line: str) -> None:
    """Carry out a dashboard command. Raises NotPossible with its answer if that is about a failure."""
    answer = robot(path).dashboard(line)
    if answer.startswith("Failed"):
        raise NotPossible(answer)


def record(path: Path) -> None:
    with Recorder(path, ["actual_q"]) as recorder:
        for number in range(3):
            recorder.write({"timestamp": 1.0 + 0.1 * number, "actual_q": (0.1 * number,) * 6})


def capture(path: Path) -> None:
    problems: list[str] = []
    recorder = TrafficRecorder(path, problem=problems.append)
    recorder.connection(SocketAddress("10.0.0.2", 45678), SocketAddress("10.0.0.1", 29999)).data(True, b"play\n")
    recorder.close()
    if problems:
        raise ClientError(*problems)


def campaign(path: Path, write: Callable[..., object]) -> None:
    folder = path.parent
    (folder / "work.script").write_text("sleep(0.1)")
    (folder / "trial.yaml").write_text("script: work.script\nmatrix: {seed: {from: 1, count: 2}}")
    plan = read_plan(folder / "trial.yaml")
    with Journal(folder, plan, "1") as journal:
        journal.add([Result(0, Status.PASSED), Result(1, Status.FAILED, "it failed")])
        write(journal, plan, path)


def dataset(folder: Path) -> None:
    write_dataset(folder, [source_of(folder)], ["push"], state=["actual_q"], action=["actual_q"])


def source_of(path: Path) -> Path:
    """A recording to read."""
    return path.parent.parent / "source.csv"


def states(path: Path) -> None:
    assert len(read(path)) == 3
    assert not read(path).info.keys() & {"cut_off", "left_out"}


def conversations(path: Path) -> None:
    recording = TrafficRecording.read(path)
    assert (len(recording.conversations), recording.problems) == (1, [])


def ends(end: bytes) -> Callable[[Path], None]:
    def check(path: Path) -> None:
        assert path.read_bytes().rstrip().endswith(end)

    return check


def ends_a_line(path: Path) -> None:
    assert path.read_bytes().endswith(b"\n")


def is_xml(path: Path) -> None:
    read_document(path.read_bytes())


def is_json(path: Path) -> None:
    json.loads(path.read_text())


def is_zip(path: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None


def two_rows(path: Path) -> None:
    assert pytest.importorskip("pyarrow.parquet").read_table(path).num_rows == 2


@dataclass(frozen=True)
class Kind:
    """A kind of file. name: of the file; a star stands for what is not known before.

    write: writes it. errors: what that raises. check: fails if the file is not complete. replaces: an earlier file.
    unfinished: what could be written stays under this name. quick: so that many calls can be tried.
    """

    name: str
    write: Callable[[Path], object]
    check: Callable[[Path], object]
    errors: tuple[type[Exception], ...] = (ClientError,)
    replaces: bool = True
    unfinished: str = ""
    quick: bool = True


OF_COMMANDS: Final = (OSError,)  # which the commands report in one line
OF_VERBS: Final = (NotPossible,)
ANGLES: Final = (0.1, -1.2, 1.3, 0.2, 0.3, 0.4)
TIMES: Final = np.linspace(0.0, 1.0, 5)
DRAFT: Final = SavedDraft("job.urp", True, b"content")
ARM: Final[Any] = SimpleNamespace(to_mapping=lambda: {"friction": [1.0, 2.5]})
KINDS: Final = (
    *(
        Kind(f"run{suffix}", record, states, unfinished=f"run.unfinished{suffix}")
        for suffix in (".mcap", ".npz", ".csv")
    ),
    Kind("converted.npz", lambda path: convert(source_of(path), path), states),
    Kind("traffic.pcapng", capture, conversations, unfinished="traffic.unfinished.pcapng"),
    Kind("dataset", dataset, lambda path: is_json(path / "meta/info.json"), replaces=False),
    Kind(
        "plot.svg",
        lambda path: draw_trajectory(TIMES, np.ones((5, 6)), np.ones((5, 6)), path),
        ends(b"</svg>"),
        quick=False,
    ),
    Kind("arm.yaml", lambda path: write_arm(path, ARM), ends(b"[1.0, 2.5]")),
    Kind(
        "calibration.yaml",
        lambda path: write_calibration(path, Calibration.of(load_model("ur5e").dh)),
        lambda path: read_calibration(path),
    ),
    Kind("arm.urdf", lambda path: run_cli("describe", "ur5e", "-o", str(path)), ends(b"</robot>")),
    Kind("job.urp", lambda path: run_cli("program", "new", str(path), "--force"), is_xml),
    Kind("a.installation", lambda path: run_cli("installation", "new", str(path), "--force"), is_xml),
    Kind("poses.json", lambda path: Poses(path)._replace("ur5e", {"here": ANGLES}), is_json),
    Kind("robot.json", lambda path: ProgramFile(path.parent, "robot").write(DRAFT), is_json),
    Kind("results.parquet", lambda path: campaign(path, write_parquet), two_rows, OF_COMMANDS),
    Kind(
        "report.html",
        lambda path: campaign(path, lambda journal, plan, to: write_report(to, plan, journal, {})),
        ends(b"</table>"),
        OF_COMMANDS,
    ),
    Kind("ports.json", lambda path: write_ports(path, {"rtde": 30004}), is_json, (ConfigError,)),
    Kind("state.json", lambda path: ctl_show({"time_s": 1.0}, path), is_json, OF_COMMANDS),
    Kind("a.script", lambda path: robot(path).save_program(path.name, "c2xlZXAoMSk="), ends(b"sleep(1)"), OF_VERBS),
    Kind(
        "default.installation",
        lambda path: robot(path).change_installation("external_control", {"host": "10.0.0.9"}),
        is_xml,
        OF_VERBS,
        replaces=False,
    ),
    Kind(
        "a.urpx",
        lambda path: run_to_end(store_program(robot(path).controller, empty_urpx("a"), new=True)),
        lambda path: read_urpx(path.read_bytes()),
        (HttpError,),
        replaces=False,
    ),
    Kind(
        "log_history.txt", lambda path: (reply(path, "addToLog hello"), reply(path, "saveLog")), ends_a_line, OF_VERBS
    ),
    Kind("flightreport_*", lambda path: reply(path, "generate flight report"), ends_a_line, OF_VERBS, replaces=False),
    Kind("ur_*.zip", lambda path: reply(path, "generate support file ."), is_zip, OF_VERBS, replaces=False),
    Kind(
        "crash_*.zip", lambda path: write_crash(robot(path).controller, "", "", ""), is_zip, OF_COMMANDS, replaces=False
    ),
)
HOW: Final = ("full", "read-only", "torn", "short", "killed")


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_file_is_complete_or_the_earlier_one_at_every_call_that_fails(
    kind: Kind, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(tmp_path / "source.csv")
    calls = written(kind, tmp_path / "whole", FaultyDisk(), monkeypatch)
    assert {"open", "write", "fsync"} < set(calls)
    assert set(calls) & {"replace", "rename"}
    count = len(calls)
    sample = {*range(1, 4), count // 2, *range(max(1, count - 4), count + 1)}
    ways = product(sample, HOW) if kind.quick else ((count // 2, "full"), (count, "read-only"), (count - 3, "killed"))
    for number, (at, how) in enumerate(ways):
        written(kind, tmp_path / str(number), FaultyDisk(at, how), monkeypatch)


def written(kind: Kind, folder: Path, disk: FaultyDisk, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Write a file on such a disk, check what is there afterwards, and return the calls."""
    folder.mkdir()
    path = folder / kind.name
    if kind.replaces:
        path.write_bytes(OLD)
    error, killed = "", False  # texts: an error would hold the file of a killed process open
    monkeypatch.setattr(durable, "os", disk)
    try:
        kind.write(path)
    except (Killed, *kind.errors) as raised:
        error, killed = str(raised) or repr(raised), isinstance(raised, Killed)
    finally:
        monkeypatch.undo()
    failed = f"{kind.name}, {disk.how} at call {disk.at} of {disk.calls}: {error}"
    fails = disk.at > 0 and disk.how != "short"
    assert killed == (disk.how == "killed"), failed
    assert bool(error) == fails, failed
    assert "\n" not in error, failed
    found = {place.name for place in folder.iterdir()}
    named = [folder / name for name in found if fnmatch(name, kind.name)]
    for place in named:
        if not kind.replaces or place.read_bytes() != OLD:
            kind.check(place)
    if kind.replaces or not fails:
        assert named, failed
    if disk.how != "killed":
        left = {name for name in found if name.startswith(".") or "unfinished" in name}
        assert left <= {kind.unfinished}, f"{failed}: {left}"
        assert all(name in error for name in left), failed
    return disk.calls


def test_a_link_stays_one_and_rights_stay_what_they_are(tmp_path: Path) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_text("old")
    target.chmod(0o640)
    link.symlink_to(target)
    durable.write_file(link, "new")
    assert link.is_symlink()
    assert (target.read_text(), target.stat().st_mode & 0o777) == ("new", 0o640)


@pytest.mark.skipif(not Path("/dev/null").exists(), reason="requires a device")
def test_a_device_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "out").symlink_to("/dev/null")
    durable.write_file(tmp_path / "out", "text")
    assert Path("/dev/null").is_char_device()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_an_unfinished_file_of_before_is_not_overwritten(tmp_path: Path) -> None:
    files = [durable.NewFile(tmp_path / "run.csv", unfinished=True) for _ in range(2)]
    assert [file.path.name for file in files] == ["run.unfinished.csv", "run.unfinished-2.csv"]
    for number, file in enumerate(files):
        file.write(b"%d" % number)
        file.publish()
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("run.csv", "1")]


def test_a_recording_that_ends_with_an_error_does_not_replace_an_earlier_one(tmp_path: Path, caplog: Any) -> None:
    """Without an earlier one, it gets its name: it is complete up to the error."""
    path = tmp_path / "run.csv"
    for name in ("run.csv", "run.unfinished.csv"):
        recorder = Recorder(path, ["actual_q"])
        with suppress(ConnectionError), recorder:
            recorder.write({"timestamp": 1.0, "actual_q": (0.1,) * 6})
            raise ConnectionError
        assert recorder.place == tmp_path / name
        assert len(read(recorder.place)) == 1
    assert "run.csv is still the earlier recording: what is new is in" in caplog.text
    record(path)
    assert len(read(path)) == 3
