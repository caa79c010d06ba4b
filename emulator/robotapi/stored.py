"""The programs of PolyScope X that are stored: ``.urpx`` files of the programs folder, known by the names in them."""

import os
from collections.abc import Generator
from contextlib import suppress
from pathlib import Path
from typing import Final

from emulator.controller import Controller
from emulator.programs.loading import DEFAULT_URPX, MOST_PROGRAMS
from emulator.programs.own_folder import ensure_programs_folder
from emulator.servers.http import BAD, INVALID, NOT_FOUND, Refused
from urproto.robotapi import DEFAULT_PROGRAM
from urscript.polyscope.folder import ProgramsFolder
from urscript.polyscope.urpx import SUFFIX, UrpxError, UrpxInformation, read_information, read_urpx

_Stored = tuple[Path, UrpxInformation]
_LONGEST_NAME: Final = 200  # letters; guess, and files cannot have much longer ones


def stored_programs(controller: Controller) -> Generator[None, None, list[_Stored]]:
    """Files and what they say of themselves, by name; yields once a control period, for each file is read.

    Files that are not programs are left out, and the log says why.
    """
    found: dict[str, _Stored] = {}
    for path in [DEFAULT_URPX, *_files(controller)]:
        try:
            information = read_information(path.read_bytes())
        except (OSError, UrpxError) as error:
            controller.messages.note(f"{path.name} is left out of the programs: {error}")
        else:
            found[information.name] = path, information
        yield
    return [found[name] for name in sorted(found)]


def _files(controller: Controller) -> list[Path]:
    root = controller.config.programs_dir
    if root is None:
        return []
    paths = sorted(path for path in root.glob(f"*{SUFFIX}") if path.is_file() and not path.name.startswith("."))
    return paths[:MOST_PROGRAMS]


def find_program(controller: Controller, name: str) -> Generator[None, None, Path]:
    """The file of a program, by its name, else by that of the file. Raises Refused."""
    stored = yield from stored_programs(controller)
    for names in ({information.name: path for path, information in stored}, {path.stem: path for path, _ in stored}):
        if name in names:
            return names[name]
    raise Refused(NOT_FOUND, f"there is no program {name!r}")


def store_program(controller: Controller, data: bytes, *, new: bool) -> Generator[None, None, str]:
    """Write a program, whole or not at all; returns its name. Raises Refused.

    new: it must not be there yet; otherwise it replaces the one that is.
    """
    try:
        name = read_urpx(data).name
    except UrpxError as error:
        raise Refused(INVALID, f"the file is not a program of PolyScope X: {error}") from error
    stored = {information.name: path for path, information in (yield from stored_programs(controller))}
    if new and name in stored:
        raise Refused(BAD, f"there is a program {name!r} already")
    if not new and name not in stored:
        raise Refused(NOT_FOUND, f"there is no program {name!r}")
    if name == DEFAULT_PROGRAM and stored[name] == DEFAULT_URPX:
        raise Refused(INVALID, f"{name!r} belongs to the robot: give the program another name")
    _write(_place(controller, name) if new else stored[name], data)
    return name


def _place(controller: Controller, name: str) -> Path:
    if len(name) > _LONGEST_NAME or "/" in name or "\\" in name:
        raise Refused(INVALID, f"{name[:40]!r} cannot be the name of a program: no / or \\, and at most 200 letters")
    place = ProgramsFolder(ensure_programs_folder(controller)).place(f"{name}{SUFFIX}")
    if place is None or place.exists():  # a file of this name with another program in it is nobody's to overwrite
        raise Refused(INVALID, f"{name!r} cannot be the name of a program: a file of it has no place in the folder")
    return place


def _write(place: Path, data: bytes) -> None:
    draft = place.with_name(f".{place.name}.new")
    try:
        draft.write_bytes(data)
        os.replace(draft, place)
    except (OSError, ValueError) as error:
        with suppress(OSError):
            draft.unlink()
        raise Refused(
            INVALID, f"{place.name} cannot be written: {getattr(error, 'strerror', None) or error}"
        ) from error
