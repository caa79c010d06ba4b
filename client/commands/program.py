"""``ur-client program``: PolyScope programs made, shown, checked and exported in the shell."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from client.errors import ClientError, FileError
from client.programs import all_problems, controller, find_installation, open_program, set_driver
from urproto.commandline import AsJson, application, print_json
from urscript.polyscope.document import DocumentError
from urscript.polyscope.editing import ProgramEditor, Row
from urscript.polyscope.files import PROGRAM_SUFFIX, export, new_program, save_program
from urscript.polyscope.folder import ProgramsFolder
from urscript.polyscope.tree import TreeError

DRIVER_PORT = 50002  # what the URCap asks without being told

program_app = application("PolyScope programs, without PolyScope.", completion=False, no_args_is_help=True)

_Program = Annotated[Path, typer.Argument(help="The program, a .urp file.", metavar="NAME.urp")]
Model = Annotated[str | None, typer.Option(help="The arm, for example ur3 or ur5e.")]
Polyscope = Annotated[str | None, typer.Option(help="The PolyScope version it is for, for example 3.15.")]
DriverHost = Annotated[str | None, typer.Option(help="Address of the driver's machine, as the robot sees it.")]
DriverPort = Annotated[int, typer.Option(help="Port of the driver's program.", min=1, max=65535)]


def check_new(path: Path, kind: str, suffix: str, force: bool) -> None:
    """Raises FileError where a file of this kind cannot be made. force: one that is there may be written over."""
    if path.suffix != suffix:
        raise FileError(path, f"{kind}'s name ends in {suffix}")
    if path.exists() and not force:
        raise FileError(path, "is there already; --force writes over it")


@program_app.command("new")
def new_command(
    path: _Program,
    host: DriverHost = None,
    port: DriverPort = DRIVER_PORT,
    model: Model = None,
    polyscope: Polyscope = None,
    installation: Annotated[
        str, typer.Option(help="The installation it belongs to: a path relative to it, without .installation.")
    ] = "default",
    empty: Annotated[bool, typer.Option("--empty", help="Without a node in it.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Write over a program that is there.")] = False,
) -> None:
    """Make a program with an External Control node.

    The address of the driver belongs to the installation, where the URCap keeps it: with --host it is set in the
    installation beside the program, and nothing else of that. Where none is, a small one is made, enough for the
    emulator; on a robot, set the address on the URCap's page of the installation.
    """
    check_new(path, "a program", PROGRAM_SUFFIX, force)
    if empty and host is not None:
        raise ClientError("--host is of an External Control node, which --empty leaves out")
    arm, version = controller(model, polyscope)
    root = new_program(path.stem, version, arm, installation=installation, external_control=not empty)
    folder, notes = ProgramsFolder(path.absolute().parent), []
    if host is not None:
        settings = path.parent / f"{installation}.installation"
        made = set_driver(settings, host, port, version)
        notes.append(f"{settings}: {'made; ' if made else ''}the driver is at {host}:{port}")
    _save(ProgramEditor(root, path.stem, find_installation(root, folder), version, arm, folder=folder), path)
    typer.echo(f"{path}: for {arm.title}, PolyScope {version}")
    for note in notes:
        typer.echo(note)


@program_app.command("show")
def show_command(
    path: _Program,
    forms: Annotated[bool, typer.Option("--forms", help="With what is set at each node.")] = False,
    as_json: AsJson = False,
) -> None:
    """Print the tree of a program, with PolyScope's line numbers."""
    editor = open_program(path)
    rows = editor.rows()
    if as_json:
        print_json([{**_plain(row), "form": editor.form(row.id)["fields"]} for row in rows])
        return
    width = len(str(len(rows)))
    for row in rows:
        typer.echo(f"{row.number:>{width}} {'  ' * row.depth}{row.title}{_remark(row)}")
        if forms:
            for field in editor.form(row.id)["fields"]:
                indent = " " * (width + 3 + 2 * row.depth)
                typer.echo(f"{indent}{field['title']}: {_shown(field['value'])}{_unit(field)}")


@program_app.command("check")
def check_command(path: _Program, model: Model = None, polyscope: Polyscope = None) -> None:
    """Show what keeps a program from running: at its nodes, then in its script. Exit status 1 for anything found."""
    editor = open_program(path, model, polyscope)
    problems = all_problems(editor)
    lines = {row.id: row for row in editor.rows()}
    for problem in problems:
        row = lines.get(problem.node)
        typer.echo(f"{path}{f':{row.number}: {row.title}' if row else ''}: {problem.message}")
    if problems:
        raise typer.Exit(1)
    typer.echo(f"{path}: no problems found for PolyScope {editor.version}")


@program_app.command("export")
def export_command(
    path: _Program,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The .script or .txt to write; without it both, beside it.")
    ] = None,
    model: Model = None,
    polyscope: Polyscope = None,
) -> None:
    """Write the URScript of a program, and its tree as text, as PolyScope puts them beside it.

    Where a driver's code would be, at External Control nodes, the script has none.
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


def _plain(row: Row) -> dict[str, Any]:
    return {name: getattr(row, name) for name in row.__slots__}


def _remark(row: Row) -> str:
    if row.suppressed_itself:
        return "  (suppressed)"
    return f"  <- {row.problem}" if row.problem else ""


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return json.dumps(value)
    return "-" if value is None or value == "" else {True: "yes", False: "no"}.get(value, str(value))


def _unit(field: dict[str, Any]) -> str:
    return f" {field['unit']}" if field["unit"] and field["value"] is not None else ""
