"""The files of a program: a new one, and what PolyScope puts beside it when it saves.

A program ``x`` is three files: ``x.urp`` is the program, ``x.script`` the URScript it is run as, ``x.txt`` its tree for
people. Only the first is read again.
"""

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

from urproto.robots import RobotModel
from urproto.text import to_bytes
from urproto.versions import PolyscopeVersion, Series
from urscript.polyscope.document import Element, make, packed
from urscript.polyscope.editing import ProgramEditor
from urscript.polyscope.nodes.urcaps import new_external_control
from urscript.polyscope.nodes.waypoints import kinematics_element
from urscript.polyscope.registry import empty_children
from urscript.polyscope.tree import TreeError

_SERIAL_NUMBERS: Final = {Series.CB3: "2018359999", Series.E: "20195599999"}  # what simulators say
_PROGRAM_VERSIONS: Final = PolyscopeVersion(5, 13)  # first version that says which kind of file it writes (seen)
_PROGRAM_VERSION: Final = "2"
_INDENT: Final = "  "


def new_program(
    name: str,
    version: PolyscopeVersion,
    model: RobotModel,
    *,
    installation: str = "default",
    directory: str = "/programs",
    external_control: bool = False,
) -> Element:
    """An empty program as PolyScope makes it, or one with an External Control node.

    name and installation: without extension; the installation's may be a path relative to the program. directory:
    where the controller keeps it. PolyScope also saves ``crcValue``, whose rule is not known; many files lack it.
    """
    shown = str(version) if version < _PROGRAM_VERSIONS else version.short
    attributes = {
        "name": name,
        "installation": PurePosixPath(installation).name,
        "installationRelativePath": installation,
        "directory": directory,
        "createdIn": shown,
        "lastSavedIn": shown,
        "robotSerialNumber": _SERIAL_NUMBERS[model.series],
    }
    if version >= _PROGRAM_VERSIONS:
        attributes["createdInPolyscopeProgramVersion"] = _PROGRAM_VERSION
        attributes["lastSavedInPolycopeProgramVersion"] = _PROGRAM_VERSION  # PolyScope spells it so
    nodes = make("children", new_external_control()) if external_control else empty_children()
    main = make("MainProgram", nodes, runOnlyOnce="true" if external_control else "false", InitVariablesNode="true")
    return make(
        "URProgram",
        kinematics_element("kinematics", model),
        make("children", make("InitVariablesNode"), main),
        **attributes,
    )


@dataclass(frozen=True, slots=True)
class Saved:
    """What was written. script: whether the URScript could be; why not else."""

    paths: tuple[Path, ...]
    script_problem: str = ""


def outline_text(editor: ProgramEditor) -> str:
    """The tree as PolyScope writes it into the ``.txt``: a line a node, and how deep it lies.

    A suppressed node stands between apostrophes, without what lies in it.
    """
    lines = [" Program"]
    hidden = set[str]()
    for row in editor.rows():
        if row.suppressed:
            hidden.add(row.id)
        if row.parent in hidden:
            continue
        title = f"'{row.title}'" if row.suppressed_itself else row.title
        lines.append(f" {_INDENT * (row.depth + 1)}{title}")
    return "".join(f"{line}\n" for line in lines)


def save_program(editor: ProgramEditor, path: Path) -> Saved:
    """Write ``.urp``, ``.script`` and ``.txt``, each whole or not at all. Raises OSError or DocumentError.

    The program is saved also when it cannot be run yet; then there is no ``.script``, and an older one goes, since it
    would be that of another program.
    """
    _write(path, packed(editor.document()))
    script, text = path.with_suffix(".script"), path.with_suffix(".txt")
    written, problem = [path], ""
    try:
        _write(script, to_bytes(editor.written().text()))
        written.append(script)
    except TreeError as error:
        problem = str(error)
        script.unlink(missing_ok=True)
    _write(text, to_bytes(outline_text(editor)))
    editor.saved()
    return Saved((*written, text), problem)


def _write(path: Path, content: bytes) -> None:
    """A file that is there whole or not at all."""
    handle, draft = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        Path(draft).chmod(0o644)
        Path(draft).replace(path)
    except BaseException:
        Path(draft).unlink(missing_ok=True)
        raise
