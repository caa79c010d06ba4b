"""``ur-client program``: create, show, compare, check and export PolyScope programs in the shell."""

from pathlib import Path
from typing import Annotated

import typer

from client.errors import ClientError, FileError
from client.programs import (
    all_problems,
    compare_files,
    controller,
    conversions,
    find_installation,
    open_lines,
    open_program,
    report_of,
    set_driver,
    stale_problems,
)
from urproto.commandline import AsJson, application, print_json
from urscript.polyscope.comparing import change_lines
from urscript.polyscope.document import DocumentError
from urscript.polyscope.editing import ProgramEditor
from urscript.polyscope.files import INDENT, PROGRAM_SUFFIX, export, new_program, save_program
from urscript.polyscope.folder import ProgramsFolder
from urscript.polyscope.tree import TreeError

_POLYSCOPE_X = "10.12"  # whose program files are known (urscript.polyscope.urpx)
DRIVER_PORT = 50002  # the URCap's default

program_app = application(
    "Create, show, compare, check and export PolyScope programs, without PolyScope.",
    completion=False,
    no_args_is_help=True,
)

_File = Annotated[
    Path, typer.Argument(help="A .urp, .installation, .variables or .urpx file; the contents decide.", metavar="FILE")
]
_Program = Annotated[Path, typer.Argument(help="The program, a .urp file.", metavar="NAME.urp")]
Model = Annotated[str | None, typer.Option(help="The arm, for example ur3 or ur5e.")]
Polyscope = Annotated[str | None, typer.Option(help="The PolyScope version to write it for, for example 3.15.")]
DriverHost = Annotated[str | None, typer.Option(help="Address of the driver's machine, as the robot sees it.")]
DriverPort = Annotated[int, typer.Option(help="Port on which the driver serves its program.", min=1, max=65535)]


def check_new(path: Path, kind: str, suffix: str, force: bool) -> None:
    """Raise FileError if no file of this kind can be created at the path. force: an existing one may be overwritten."""
    if path.suffix != suffix:
        raise FileError(path, f"the name of {kind} must end in {suffix}")
    if path.exists() and not force:
        raise FileError(path, "exists: pass --force to overwrite it")


@program_app.command("new")
def new_command(
    path: _Program,
    host: DriverHost = None,
    port: DriverPort = DRIVER_PORT,
    model: Model = None,
    polyscope: Polyscope = None,
    installation: Annotated[
        str, typer.Option(help="The program's installation: a path relative to the program, without .installation.")
    ] = "default",
    empty: Annotated[bool, typer.Option("--empty", help="Create it without the External Control node.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the program if it exists.")] = False,
) -> None:
    """Create a program with an External Control node.

    The address of the driver belongs to the installation, where the URCap keeps it. --host sets it in the installation
    next to the program and changes nothing else there. If there is none, a small one is created, which is enough for
    the emulator. On a robot, set the address on the URCap's page of the installation.
    """
    check_new(path, "a program", PROGRAM_SUFFIX, force)
    if empty and host is not None:
        raise ClientError(
            "--host sets the driver of an External Control node, which --empty leaves out: drop one of them"
        )
    arm, version = controller(model, polyscope)
    root = new_program(path.stem, version, arm, installation=installation, external_control=not empty)
    folder, notes = ProgramsFolder(path.absolute().parent), []
    if host is not None:
        settings = path.parent / f"{installation}.installation"
        made = set_driver(settings, host, port, version)
        notes.append(f"{settings}: {'created; ' if made else ''}the driver is at {host}:{port}")
    _save(ProgramEditor(root, path.stem, find_installation(root, folder), version, arm, folder=folder), path)
    typer.echo(f"{path}: for {arm.title}, PolyScope {version}")
    for note in notes:
        typer.echo(note)


@program_app.command("show")
def show_command(
    path: _File,
    numbers: Annotated[bool, typer.Option("--numbers", help="Also print PolyScope's line numbers.")] = False,
    as_json: AsJson = False,
) -> None:
    """Print a line for each node or setting, the same for the same contents, so that versions can be compared.

    Lengths are in mm, angles in degrees, rotation vectors in rad. `check` prints what keeps a program from running.
    """
    rows = list(open_lines(path).walk())
    if as_json:
        print_json(
            [
                {"depth": depth, "kind": line.kind, "name": line.name, "title": line.title, "values": line.values}
                for depth, line in rows
            ]
        )
        return
    width = len(str(len(rows)))
    for number, (depth, line) in enumerate(rows):
        typer.echo(f"{f'{number or str():>{width}} ' if numbers else ''}{INDENT * depth}{line.text}")


@program_app.command("diff")
def diff_command(
    before: _File,
    after: _File,
    as_json: AsJson = False,
    page: Annotated[
        Path | None,
        typer.Option(
            "--html", help="Write a page for browsers instead, to this file; of programs, with the path of the tool."
        ),
    ] = None,
    model: Annotated[
        str | None, typer.Option(help="The arm of that path, for example ur3 (default: recognised by its waypoints).")
    ] = None,
) -> None:
    """Print which nodes or settings were added, removed, moved and changed between two files of the same kind.

    If both files are programs, the installations next to them are compared as well, for what the programs use of them.
    For a page, they are run in virtual time, without a network: one cycle, of a minute at most.
    """
    changes = compare_files(before, after)
    if as_json:
        print_json([change.as_dict() for change in changes])
        return
    if page is not None:
        from client.difference_page import write_difference_page  # here, because it loads numpy

        write_difference_page(page, before, after, changes, model)
        return
    for line in change_lines(changes):
        typer.echo(line)


@program_app.command("check")
def check_command(
    path: _Program,
    model: Model = None,
    polyscope: Polyscope = None,
    form: Annotated[
        str, typer.Option("--format", help="How problems are reported: text, json, sarif or github (annotations).")
    ] = "text",
) -> None:
    """Report what keeps a program from running, and whether the script next to it is from another state of it.

    Other formats than text are those of `urscript check`, with its rules. Exit status 1 for any problem.
    """
    if form != "text":
        status, report = report_of(path, form, model, polyscope)
        typer.echo(report, nl=False)
        raise typer.Exit(status)
    editor = open_program(path, model, polyscope)
    problems = all_problems(editor) or stale_problems(editor, path)
    lines = {row.id: row for row in editor.rows()}
    for problem in problems:
        row = lines.get(problem.node)
        typer.echo(f"{path}{f':{row.number}: {row.title}' if row else ''}: {problem.message}")
    if problems:
        raise typer.Exit(1)
    typer.echo(f"{path}: no problems found for PolyScope {editor.version}")


@program_app.command("convert")
def convert_command(
    path: _Program,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Also write the URScript that runs there, a .script file.")
    ] = None,
    polyscope: Annotated[str, typer.Option(help="The version of PolyScope X.")] = _POLYSCOPE_X,
    as_json: AsJson = False,
) -> None:
    """Report what of a program goes to PolyScope X: which nodes as nodes, which only as URScript, and which do not.

    Exit status 1 if a node does not. TCPs, features, inputs and outputs have to be created in its application.
    """
    editor = open_program(path, None, polyscope)
    if not editor.version.is_polyscope_x:
        raise ClientError(f"PolyScope {editor.version} is not PolyScope X: name a version from 10.7 on")
    found = conversions(editor)
    lost = [each for each in found if each.how == "nothing" and not each.row.suppressed]
    if as_json:
        print_json([{"number": e.row.number, "title": e.row.title, "how": e.how, "note": e.note} for e in found])
    else:
        for each in found:
            typer.echo(f"{each.how:<7} {INDENT * each.row.depth}{each.row.title}{f'  ({each.note})' * bool(each.note)}")
    if output is not None:
        _export(editor, output)
    if lost:
        raise typer.Exit(1)


@program_app.command("export")
def export_command(
    path: _Program,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="The .script or .txt file to write (default: both, next to the program)."),
    ] = None,
    model: Model = None,
    polyscope: Polyscope = None,
) -> None:
    """Write a program's URScript, and its tree as text, as PolyScope saves them next to it.

    External Control nodes stay empty in the script: their code comes from a driver at run time.
    """
    editor = open_program(path, model, polyscope)
    wanted = [output] if output else [path.with_suffix(".script"), path.with_suffix(".txt")]
    for target in wanted:
        _export(editor, target)
        typer.echo(str(target))


def _export(editor: ProgramEditor, target: Path) -> None:
    try:
        export(editor, target)
    except (TreeError, DocumentError, OSError, ValueError) as error:
        raise FileError(target, str(error)) from None


def _save(editor: ProgramEditor, path: Path) -> None:
    try:
        save_program(editor, path)
    except (DocumentError, OSError) as error:
        raise FileError(path, str(error)) from None
