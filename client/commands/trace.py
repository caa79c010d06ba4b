"""``ur-client trace``: a recording as a page, with the arm in 3D, a timeline and curves."""

from math import inf
from pathlib import Path
from typing import Annotated

import typer

from client.commands.record import read_with_remarks
from client.commands.scene_drawing import model_named
from client.errors import FileError
from client.recording.trace import trace_of
from urproto.trace.page import packed, run_in, write_page


def trace_command(
    file: Annotated[Path, typer.Argument(help="A recording (.mcap, .csv, .npz), or the page of one.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The page to write (default: FILE.html).")
    ] = None,
    compare: Annotated[Path | None, typer.Option(help="A second such file: show its run over the first.")] = None,
    begin: Annotated[float, typer.Option("--from", metavar="SECONDS", help="Begin at this uptime.")] = 0.0,
    end: Annotated[
        float, typer.Option("--to", metavar="SECONDS", help="End at this uptime (default: at the end).")
    ] = inf,
    model: Annotated[
        str | None, typer.Option(help="The arm that was recorded, such as ur10e (default: recognised by its motion).")
    ] = None,
) -> None:
    """Show a recording as a page for browsers, which works without a network and a server.

    The page of a run of an emulator can be compared with it: ur-emulator trace makes one from a journal.
    """
    page = output or file.with_name(f"{file.name}.html")
    try:
        write_page(page, file.name, *(_packed(one, model, begin, end) for one in (file, compare) if one is not None))
    except OSError as error:
        raise FileError(Path(error.filename or page), error.strerror or str(error)) from error
    typer.echo(f"{page}: {page.stat().st_size / 1e6:.1f} MB")


def _packed(file: Path, model: str | None, begin_s: float, end_s: float) -> str:
    if file.suffix == ".html":
        return run_in(file)
    return packed(trace_of(read_with_remarks(file), file.name, model_named(model) if model else None, begin_s, end_s))
