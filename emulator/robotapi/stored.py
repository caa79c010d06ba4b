"""The stored programs of PolyScope X: ``.urpx`` files of the programs folder, identified by the names in them."""

from collections.abc import Generator
from functools import lru_cache
from pathlib import Path
from typing import Final

from emulator.controller import Controller
from emulator.programs.loading import DEFAULT_URPX, MAX_PROGRAMS, ensure_programs_folder
from emulator.servers.http import BAD, INVALID, NOT_FOUND, HttpError
from urproto.durable import writing
from urproto.robotapi import DEFAULT_PROGRAM
from urscript.polyscope.folder import ProgramsFolder, read_file
from urscript.polyscope.urpx import SUFFIX, UrpxError, UrpxInformation, read_information, read_urpx

_Stored = tuple[Path, UrpxInformation]
_LONGEST_NAME: Final = 200  # letters; guess, and files cannot have much longer ones


def stored_programs(controller: Controller) -> Generator[None, None, list[_Stored]]:
    """The stored programs by name; yields once per control period, since each file must be read.

    Files that are not programs are omitted, with a note in the log.
    """
    found: dict[str, _Stored] = {}
    information: UrpxInformation | str
    for path in [DEFAULT_URPX, *_files(controller)]:
        try:
            status = path.stat()
            information = _information(path, status.st_mtime_ns, status.st_size)
        except OSError as error:
            information = str(error)
        if isinstance(information, str):
            controller.messages.note(f"{path.name} is omitted from the programs: {information}")
        else:
            found[information.name] = path, information
        yield
    return [found[name] for name in sorted(found)]


@lru_cache(maxsize=2 * MAX_PROGRAMS)
def _information(path: Path, modified_ns: int, size: int) -> UrpxInformation | str:
    """What a file says of its program, or why it is none. It is read once, since any client may ask for all of them.

    Raises OSError.
    """
    try:
        return read_information(read_file(path))
    except UrpxError as error:
        return str(error)


def _files(controller: Controller) -> list[Path]:
    root = controller.config.programs_dir
    if root is None:
        return []
    paths = sorted(path for path in root.glob(f"*{SUFFIX}") if path.is_file() and not path.name.startswith("."))
    return paths[:MAX_PROGRAMS]


def find_program(controller: Controller, name: str) -> Generator[None, None, Path]:
    """Find the file of a program, by the name of the program, otherwise of the file. Raises HttpError."""
    stored = yield from stored_programs(controller)
    for names in ({information.name: path for path, information in stored}, {path.stem: path for path, _ in stored}):
        if name in names:
            return names[name]
    raise HttpError(NOT_FOUND, f"there is no program {name!r}")


def store_program(controller: Controller, data: bytes, *, new: bool) -> Generator[None, None, str]:
    """Write a program, completely or not at all, and return its name. Raises HttpError.

    new: whether the program must not exist yet; otherwise it replaces an existing one.
    """
    try:
        name = read_urpx(data).name
    except UrpxError as error:
        raise HttpError(INVALID, f"the file is not a PolyScope X program: {error}") from error
    stored = {information.name: path for path, information in (yield from stored_programs(controller))}
    if new and name in stored:
        raise HttpError(BAD, f"the program {name!r} exists already")
    if not new and name not in stored:
        raise HttpError(NOT_FOUND, f"there is no program {name!r}")
    if name == DEFAULT_PROGRAM and stored[name] == DEFAULT_URPX:
        raise HttpError(INVALID, f"{name!r} is reserved for the robot: give the program another name")
    yield from _write(_place(controller, name) if new else stored[name], data)
    return name


def _place(controller: Controller, name: str) -> Path:
    if len(name) > _LONGEST_NAME or "/" in name or "\\" in name:
        raise HttpError(INVALID, f"{name[:40]!r} cannot be the name of a program: no / or \\, and at most 200 letters")
    place = ProgramsFolder(ensure_programs_folder(controller)).place(f"{name}{SUFFIX}")
    if place is None or place.exists():  # a file of this name that contains another program must not be overwritten
        raise HttpError(INVALID, f"{name!r} cannot be the name of a program: another program uses its file name")
    return place


def _write(place: Path, data: bytes) -> Generator[None, None, None]:
    try:
        yield from writing(place, data)
    except (OSError, ValueError) as error:
        raise HttpError(
            INVALID, f"{place.name} cannot be written: {getattr(error, 'strerror', None) or error}"
        ) from error
