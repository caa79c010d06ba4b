"""Plays the edited program: it is sent to an emulator as a file, to a robot and to PolyScope X as a script."""

import base64
from collections.abc import Iterable
from pathlib import PurePosixPath
from typing import Final

from client import dashboard
from client.errors import ClientError
from client.pendant.program_draft import ProgramDraft
from client.pendant.station import Station
from urproto.compat_asyncio import timeout
from urproto.errors import URError
from urproto.modes import RuntimeState
from urscript.polyscope.document import DocumentError
from urscript.polyscope.installation_file import InstallationFile, read_installation
from urscript.polyscope.numbers import identifier
from urscript.polyscope.program import script_steps
from urscript.polyscope.tree import TreeError
from urscript.work import run_to_end

EXTENSION: Final = ".urp"
_SCRIPTS_ONLY: Final = (
    "PolyScope X does not load .urp programs: they are played as scripts, without steps and breakpoints"
)
_STOP_TIMEOUT_S: Final = 5.0  # guess: braking the arm takes less
_PAUSED: Final = (RuntimeState.PAUSED, RuntimeState.PAUSING)


class PlayError(ClientError):
    """The program cannot be played in its present state, or not on this robot."""


def can_save_files(station: Station) -> bool:
    """Whether files can be saved in the robot's programs folder: an emulator's control API does that."""
    return station.emulator.available and "save_program" in station.emulator.verbs


def can_play_files(station: Station) -> bool:
    """Whether the robot can load saved files: PolyScope X only loads its own type of programs (.urpx)."""
    return can_save_files(station) and not _has_polyscope_x(station)


def _has_polyscope_x(station: Station) -> bool:
    return station.version is not None and station.version.is_polyscope_x


def stepping_refusal(station: Station) -> str:
    """Why there are no steps and breakpoints; empty if there are."""
    if can_play_files(station):
        return ""
    return _SCRIPTS_ONLY if _has_polyscope_x(station) else "On a robot, only its own teach pendant can do this"


def play_hint(station: Station) -> str:
    """A hint for the user before playing, empty if none is needed."""
    return _SCRIPTS_ONLY if _has_polyscope_x(station) else ""


async def save(station: Station, path: str) -> None:
    """Write the program and its accompanying files to an emulator's programs folder. Raises URError."""
    draft = station.program_draft
    path = with_extension(path)
    revision = draft.version
    for name, data in draft.files(PurePosixPath(path).stem).items():
        target = str(PurePosixPath(path).with_name(name))
        if data is None:
            await station.emulator.call("delete_program", path=target)
        else:
            saved = await station.emulator.call("save_program", path=target, data=base64.b64encode(data).decode())
            path = saved if name.endswith(EXTENSION) else path
    draft.mark_saved(path, revision)


async def open_file(station: Station, path: str) -> None:
    """Open a program of an emulator's programs folder. Raises URError, ValueError."""
    data = base64.b64decode(await station.emulator.call("read_program", path=path))
    station.program_draft.open(data, path)


async def load_installation(station: Station) -> None:
    """Let the program refer to the contents of an emulator's installation file. Raises URError.

    A robot does not publish its own; programs for it can only refer to what every installation has.
    """
    emulator = station.emulator
    if not can_save_files(station) or "installation" not in emulator.verbs:
        return
    file = (await emulator.call("installation", section="external_control"))["file"]
    try:
        data = base64.b64decode(await emulator.call("read_program", path=file))
        installation = read_installation(data, PurePosixPath(file).stem)
    except (URError, DocumentError):  # there is none yet
        installation = InstallationFile()
    if installation != station.program_draft.editor.installation:
        station.program_draft.use_installation(installation)


def with_extension(path: str) -> str:
    """Complete a name like PolyScope. Raises ValueError if it is empty."""
    path = path.strip()
    if not path.removesuffix(EXTENSION):
        raise ValueError("give the program a name")
    return path if path.endswith(EXTENSION) else path + EXTENSION


def is_on_robot(station: Station) -> bool:
    """Whether the robot plays the program as it is in the editor, so that the reported node numbers apply to it."""
    draft, programs = station.program_draft, station.programs
    if draft.played_version != draft.version:
        return False
    if not can_play_files(station):
        return programs.running == identifier(draft.editor.name)
    return bool(draft.path) and (programs.loaded or "").endswith(draft.path)


def is_paused(station: Station) -> bool:
    return station.runtime_state in _PAUSED and is_on_robot(station)


async def play(station: Station, *, at: str | None = None) -> None:
    """Play from the start, or from the node with an id; without a node, a paused program resumes.

    Raises URError.
    """
    if at is None and is_paused(station):
        await station.request(dashboard.PLAY)
        return
    number = None if at is None else station.program_draft.view.number(at)
    if not can_play_files(station):
        await _play_as_script(station, number or 0)
        return
    await _load(station)
    if number is None:
        await station.request(dashboard.PLAY)
    elif not await station.emulator.call("play_from", node=number):
        raise PlayError(f"the program does not start at node {number}: see Log")


async def step(station: Station) -> None:
    """Step to the next node, from where the program is paused or from its start. Raises URError."""
    if not is_paused(station):
        await _load(station)
    if not await station.emulator.call("step_program"):
        raise PlayError("the program does not start: see Log")


async def send_breakpoints(station: Station) -> None:
    """Send the breakpoints to the robot, if it has loaded this program."""
    if can_play_files(station) and is_on_robot(station):
        await station.emulator.call("set_breakpoints", nodes=_breakpoint_numbers(station.program_draft))


def _breakpoint_numbers(draft: ProgramDraft) -> list[int]:
    return sorted(row.number for row in draft.view.rows() if row.id in draft.view.breakpoints)


async def _load(station: Station) -> None:
    draft = station.program_draft
    _require_complete(draft.view.problems())
    if not draft.path:
        raise PlayError("the program has no name yet: save it first")
    if draft.changed or draft.path not in await station.programs.files(station):
        await save(station, draft.path)
    await station.mover.release_control()
    await station.request(dashboard.load(draft.path))
    try:
        async with timeout(_STOP_TIMEOUT_S):  # the paused program ends
            while station.runtime_state is not RuntimeState.STOPPED:
                await station.next_frame()
    except TimeoutError as error:
        raise PlayError("the previous program is still running: stop it first") from error
    draft.played_version = draft.version
    station.programs.refresh()
    await station.emulator.call("set_breakpoints", nodes=_breakpoint_numbers(draft))


def _require_complete(problems: Iterable[str]) -> None:
    for problem in problems:
        raise PlayError(f"{problem}: complete the program, or suppress the node")


async def _play_as_script(station: Station, start_at: int) -> None:
    draft = station.program_draft
    _require_complete(draft.view.problems())
    await station.mover.release_control()
    await station.send_script(script(station, start_at))
    draft.played_version = draft.version


def script(station: Station, start_at: int = 0) -> str:
    """The URScript of the program, with an installation that leaves tool and mounting as they are. Raises PlayError."""
    tree = station.program_draft.tree()
    if tree.needs_external_control:
        raise PlayError(
            "a program with External Control nodes gets their code when the robot itself plays it: download it, copy "
            "it to the robot, and play it at the robot's own pendant"
        )
    steps = script_steps(tree, InstallationFile(), version=station.program_draft.editor.version, start_at=start_at)
    try:
        return run_to_end(steps)
    except TreeError as error:
        raise PlayError(str(error)) from error
