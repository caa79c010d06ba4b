"""``ur-client git``: PolyScope's files under git, with readable differences and merges by node."""

import shlex
import subprocess
from pathlib import Path
from typing import Annotated, Final

import typer

from client.errors import ClientError
from client.programs import merge_into, open_lines
from urproto.commandline import application
from urproto.compat import module_command
from urproto.durable import write_file
from urproto.text import from_bytes, readable, to_bytes
from urscript.polyscope.files import INDENT

_SUFFIXES: Final = (".urp", ".installation", ".variables", ".urpx")
_DRIVER: Final = "polyscope"
_ATTRIBUTES: Final = [f"*{suffix} -text diff={_DRIVER} merge={_DRIVER}" for suffix in _SUFFIXES]

git_app = application(
    "Read, compare and merge PolyScope's files in a git repository.", completion=False, no_args_is_help=True
)

_Global = Annotated[
    bool, typer.Option("--global", help="Use git's configuration of this user instead of the repository's.")
]


@git_app.command("install")
def install_command(everywhere: _Global = False) -> None:
    """Make git show and merge PolyScope's files by their nodes, in the repository of the current folder.

    It adds four lines to .gitattributes, to be committed, and two commands to the repository's configuration, which
    git does not copy: everyone who works in a clone runs this once.
    """
    attributes = _attributes_file()
    python, *rest = module_command("client")
    command = shlex.join([Path(python).as_posix(), *rest])  # git runs it with a POSIX shell, on Windows as well
    for key, value in {
        f"diff.{_DRIVER}.textconv": f"{command} git show",
        f"merge.{_DRIVER}.name": "PolyScope's files by node",
        f"merge.{_DRIVER}.driver": f"{command} git merge %O %A %B %P",
    }.items():
        _git("config", _scope(everywhere), key, value)
    lines = _lines(attributes)
    if missing := [line for line in _ATTRIBUTES if line not in lines]:
        _write(attributes, [*lines, *missing])
    typer.echo(f"{attributes}: {len(missing)} lines added; commit it, and run this once in every clone")


@git_app.command("uninstall")
def uninstall_command(everywhere: _Global = False) -> None:
    """Undo `install`."""
    attributes = _attributes_file()
    for section in ("diff", "merge"):
        _git("config", _scope(everywhere), "--remove-section", f"{section}.{_DRIVER}", check=False)
    lines = _lines(attributes)
    kept = [line for line in lines if line not in _ATTRIBUTES]
    if kept:
        _write(attributes, kept)
    else:
        attributes.unlink(missing_ok=True)
    typer.echo(f"{attributes}: {len(lines) - len(kept)} lines removed")


@git_app.command("show")
def show_command(path: Annotated[Path, typer.Argument(help="The file that git provides.")]) -> None:
    """Print a file for git diff. An unreadable one is a line as well, because git would stop at an error."""
    try:
        for depth, line in open_lines(path).walk():
            typer.echo(f"{INDENT * depth}{line.text}")
    except ClientError as error:
        typer.echo(f"(not readable: {str(error).removeprefix(f'{path}: ')})")


@git_app.command("merge")
def merge_command(
    base: Annotated[Path, typer.Argument(help="The common earlier version.")],
    ours: Annotated[Path, typer.Argument(help="Our version, which the result replaces.")],
    theirs: Annotated[Path, typer.Argument(help="Their version.")],
    name: Annotated[str, typer.Argument(help="The path of the file, for messages and its installation.")] = "",
) -> None:
    """Merge two versions of a file by node, as git's merge driver. Exit status 1 for conflicts.

    The result can always be opened: where both versions changed the same, it has ours, and a program also theirs, as a
    suppressed node or in a comment that begins with MERGE CONFLICT. A merged program that cannot be run although both
    versions can is a conflict as well.
    """
    conflicts = merge_into(base, ours, theirs, Path(name or ours))
    for conflict in conflicts:
        typer.echo(f"{name or ours}: {conflict}", err=True)
    if conflicts:
        raise typer.Exit(1)


def _scope(everywhere: bool) -> str:
    return "--global" if everywhere else "--local"


def _attributes_file() -> Path:
    return Path(_git("rev-parse", "--show-toplevel")) / ".gitattributes"


def _lines(path: Path) -> list[str]:
    return from_bytes(path.read_bytes()).splitlines() if path.exists() else []


def _write(path: Path, lines: list[str]) -> None:
    write_file(path, to_bytes("".join(f"{line}\n" for line in lines)))


def _git(*arguments: str, check: bool = True) -> str:
    try:
        done = subprocess.run(["git", *arguments], capture_output=True)
    except OSError as error:
        raise ClientError(f"git: {error.strerror or error}: install it, or add it to PATH") from None
    if check and done.returncode:
        raise ClientError(f"git {arguments[0]}: {readable(from_bytes(done.stderr)).strip() or done.returncode}")
    return from_bytes(done.stdout).strip()
