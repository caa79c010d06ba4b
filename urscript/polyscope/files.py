"""The files of a program: creating a new one, and saving it with its companion files.

A program ``x`` has three files: ``x.urp`` is the program, ``x.script`` the URScript that is executed, and ``x.txt`` its
tree for people. Only the first one is read again.
"""

from pathlib import Path, PurePosixPath
from typing import Final

from urproto.durable import write_file
from urproto.facts import Situation, find
from urproto.robots import RobotModel
from urproto.text import to_bytes
from urproto.versions import PolyscopeVersion
from urscript.polyscope.document import Element, make, packed
from urscript.polyscope.editing import ProgramEditor
from urscript.polyscope.nodes.urcaps import new_external_control
from urscript.polyscope.nodes.waypoints import kinematics_element
from urscript.polyscope.registry import empty_children
from urscript.polyscope.tree import TreeError

_PROGRAM_VERSIONS: Final = PolyscopeVersion(5, 13)  # first version that writes the version of the file format (seen)
_PROGRAM_VERSION: Final = "2"
INDENT: Final = "  "
PROGRAM_SUFFIX: Final = ".urp"
SCRIPT_SUFFIX: Final = ".script"
TEXT_SUFFIX: Final = ".txt"


def new_program(
    name: str,
    version: PolyscopeVersion,
    model: RobotModel,
    *,
    installation: str = "default",
    directory: str = "/programs",
    external_control: bool = False,
) -> Element:
    """Create an empty program as PolyScope does, or one with an External Control node.

    name, installation: without extension; the installation may be a path relative to the program. directory: where the
    controller stores the program. PolyScope also saves ``crcValue``, whose rule is not known; many files lack it.
    """
    shown = str(version) if version < _PROGRAM_VERSIONS else version.short
    attributes = {
        "name": name,
        "installation": PurePosixPath(installation).name,
        "installationRelativePath": installation,
        "directory": directory,
        "createdIn": shown,
        "lastSavedIn": shown,
        "robotSerialNumber": find("serial_number", Situation(version, model.name)).value,
    }
    if version >= _PROGRAM_VERSIONS:
        attributes["createdInPolyscopeProgramVersion"] = _PROGRAM_VERSION
        attributes["lastSavedInPolycopeProgramVersion"] = _PROGRAM_VERSION  # PolyScope's spelling
    nodes = make("children", new_external_control()) if external_control else empty_children()
    main = make("MainProgram", nodes, runOnlyOnce="true" if external_control else "false", InitVariablesNode="true")
    return make(
        "URProgram",
        kinematics_element("kinematics", model),
        make("children", make("InitVariablesNode"), main),
        **attributes,
    )


def outline_text(editor: ProgramEditor) -> str:
    """The tree as PolyScope writes it into the ``.txt``: one line per node, indented by its depth.

    A suppressed node is between apostrophes, without its child nodes.
    """
    lines = [" Program"]
    hidden = set[str]()
    for row in editor.rows():
        if row.suppressed:
            hidden.add(row.id)
        if row.parent in hidden:
            continue
        title = f"'{row.title}'" if row.suppressed_itself else row.title
        lines.append(f" {INDENT * (row.depth + 1)}{title}")
    return "".join(f"{line}\n" for line in lines)


def export(editor: ProgramEditor, path: Path) -> None:
    """Write the ``.script`` or the ``.txt`` of a program, depending on the extension of the path.

    Raises TreeError when it cannot be run, ValueError for another extension, OSError.
    """
    if path.suffix not in (SCRIPT_SUFFIX, TEXT_SUFFIX):
        raise ValueError(f"a program can only be exported to {SCRIPT_SUFFIX} or {TEXT_SUFFIX}")
    text = editor.written().text() if path.suffix == SCRIPT_SUFFIX else outline_text(editor)
    write_file(path, to_bytes(text))


def save_program(editor: ProgramEditor, path: Path) -> str:
    """Write ``.urp``, ``.script`` and ``.txt``, each atomically. Raises OSError or DocumentError.

    A program that cannot be run yet is saved as well, but without a ``.script``: an older one is deleted, because it
    would belong to a different program, and the reason is returned as text. The same applies to a program with External
    Control nodes, whose code the driver provides when the program is played. A program with nodes of other URCaps keeps
    its old ``.script``, which contains the only copy of their code.
    """
    write_file(path, packed(editor.document()))
    script, problem = path.with_suffix(SCRIPT_SUFFIX), ""
    try:
        if editor.tree.needs_external_control:
            raise TreeError("the driver provides the code of its External Control nodes whenever it is played")
        export(editor, script)
    except TreeError as error:
        problem = str(error)
        if not editor.saved_script.blocks:
            script.unlink(missing_ok=True)
    export(editor, path.with_suffix(TEXT_SUFFIX))
    editor.saved()
    return problem
