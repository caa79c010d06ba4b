"""``ur-client trace``: a recording as a page, with the arm in 3D, a timeline and curves."""

from math import inf
from pathlib import Path
from typing import Annotated

import typer

from client.commands.record import read_with_remarks
from client.commands.scene_drawing import model_named
from client.errors import FileError
from client.recording.trace import trace_of
from urproto.trace.page import make_page, packed


def trace_command(
    file: Annotated[Path, typer.Argument(help="A recording (.mcap, .csv, .npz), or the page of one.")],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="The page (default: FILE.html).")] = None,
    compare: Annotated[Path | None, typer.Option(help="A second such file: show its run over the first.")] = None,
    begin: Annotated[float, typer.Option("--from", metavar="SECONDS", help="Begin at this uptime.")] = 0.0,
    end: Annotated[float, typer.Option("--to", metavar="SECONDS", help="End at this uptime.")] = inf,
    model: Annotated[
        str | None, typer.Option(help="The arm that was recorded, such as ur10e (default: recognised by its motion).")
    ] = None,
) -> None:
    """Show a recording as a page for browsers, which works without a network and a server.

    The page of a run of an emulator can be compared with it: ur-emulator trace makes one from a journal.
    """
    arm = model_named(model) if model else None

    def pack(recording: Path) -> str:
        return packed(trace_of(read_with_remarks(recording), recording.name, arm, begin, end))

    try:
        typer.echo(make_page(file, output, compare, pack))
    except OSError as error:
        raise FileError(Path(error.filename or file), error.strerror or str(error)) from error
