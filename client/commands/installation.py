"""``ur-client installation``: create, show, change and check PolyScope installations in the shell."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from client.commands.program import DRIVER_PORT, DriverHost, DriverPort, Model, Polyscope, check_new
from client.errors import ClientError, FileError
from client.programs import controller, open_installation, save_installation
from urproto.commandline import AsJson, application, print_json
from urproto.text import unknown
from urscript.polyscope.document import DocumentError
from urscript.polyscope.installation_check import problems_of
from urscript.polyscope.installation_sections import SettingError
from urscript.polyscope.installation_settings import (
    SECTIONS,
    change_setting,
    new_installation,
    read_settings,
    set_driver_address,
)
from urscript.polyscope.lines import nonempty_rows, setting_text
from urscript.polyscope.safety_configuration import factory_configuration
from urscript.polyscope.safety_settings import add_safety

_SUFFIX = ".installation"

installation_app = application(
    "Create, show, change and check PolyScope installations, without PolyScope.", completion=False, no_args_is_help=True
)

_Installation = Annotated[Path, typer.Argument(help="The installation file.", metavar="NAME.installation")]
_Section = Annotated[str, typer.Argument(help=f"One of {', '.join(SECTIONS)}.")]


@installation_app.command("new")
def new_command(
    path: _Installation,
    host: DriverHost = None,
    port: DriverPort = DRIVER_PORT,
    model: Model = None,
    polyscope: Polyscope = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the installation if it exists.")] = False,
) -> None:
    """Create the installation of an arm as delivered: TCP at the flange, no payload, factory safety limits.

    It is for the emulator. A robot comes with its own installation, with a checksum that only a controller computes.
    """
    check_new(path, "an installation", _SUFFIX, force)
    arm, version = controller(model, polyscope)
    root = new_installation(version, path.stem)
    add_safety(root, factory_configuration(arm), arm)
    if host is not None:
        try:
            set_driver_address(root, host, port)
        except SettingError as error:
            raise ClientError(str(error)) from None
    save_installation(root, path)
    typer.echo(f"{path}: for {arm.title}, PolyScope {version}")


@installation_app.command("show")
def show_command(
    path: _Installation,
    section: Annotated[str | None, typer.Option(help="Print only this section.")] = None,
    as_json: AsJson = False,
) -> None:
    """Print the settings of an installation, section by section; with --json, in SI units."""
    if section is not None and section not in SECTIONS:
        raise ClientError(unknown("section", section, SECTIONS))
    rows = read_settings(open_installation(path))
    chosen = {name: rows[name] for name in SECTIONS if section in (None, name)}
    if as_json:
        print_json(chosen)
        return
    for name, found in chosen.items():
        typer.echo(f"{SECTIONS[name].title} ({name}){'' if found else ': none'}")
        for row in nonempty_rows(name, found):
            fields = SECTIONS[name].fields
            typer.echo("  " + ", ".join(f"{field.title}: {setting_text(field, row[field.name])}" for field in fields))


@installation_app.command("set")
def set_command(
    path: _Installation,
    section: _Section,
    values: Annotated[
        list[str], typer.Argument(help="New values as FIELD=VALUE, in SI units; lists as JSON.", metavar="FIELD=VALUE")
    ],
    row: Annotated[str, typer.Option(help="The row to change, by its first field, if the section is a list.")] = "",
) -> None:
    """Change values of one row; everything else in the file stays the same, byte for byte.

    For example: set cell.installation tcps 'pose=[0,0,0.15,0,0,0]' --row TCP
    """
    root = open_installation(path)
    try:
        change_setting(root, section, row, dict(map(_parse_assignment, values)))
    except (SettingError, DocumentError) as error:
        raise FileError(path, str(error)) from None
    save_installation(root, path)


@installation_app.command("check")
def check_command(path: _Installation) -> None:
    """Report invalid settings of an installation: unreadable ones, and references to something that does not exist.

    Exit status 1 if a problem is found.
    """
    problems = list(problems_of(open_installation(path), path.absolute().parent))
    for problem in problems:
        typer.echo(f"{path}: {problem}")
    if problems:
        raise typer.Exit(1)
    typer.echo(f"{path}: no problems found")


def _parse_assignment(text: str) -> tuple[str, Any]:
    name, sign, value = text.partition("=")
    if not sign:
        raise ClientError(f"{text!r} is not FIELD=VALUE")
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value
