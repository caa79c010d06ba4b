"""``ur-client compare``: where a robot and an emulator part, or any two recordings."""

from pathlib import Path
from typing import Annotated

import typer

from client.commands.options import PortOffset
from urproto.commandline import AsJson, print_json

__all__ = ["compare_command"]

_DIFFERENT = 1


def compare_command(
    first: Annotated[Path, typer.Argument(help="A recording (pcapng, pcap), or a table of `watch --csv`.")],
    second: Annotated[Path, typer.Argument(help="The one to compare it with.")],
    tolerance: Annotated[
        list[str] | None,
        typer.Option("--tolerance", help="For a unit or a field, as rad=0.01 or actual_q=0.01. Repeatable."),
    ] = None,
    offset: Annotated[
        float | None, typer.Option("--offset", help="What to add to the first one's robot time [s]; else found.")
    ] = None,
    port_offset: PortOffset = 0,
    as_json: AsJson = False,
) -> None:
    """Tell whether two recordings show the same, and where they part; exit status 1 when they differ."""
    from client.traffic.compare import compare_sources, read_source  # numpy: the other commands start without it
    from client.traffic.report import as_object, report

    comparison = compare_sources(
        read_source(first, port_offset), read_source(second, port_offset), tolerance or (), offset
    )
    if as_json:
        print_json(as_object(comparison))
    else:
        typer.echo(report(comparison), nl=False)
    if not comparison.same:
        raise typer.Exit(_DIFFERENT)
