"""``ur-client plot``: a picture of a recording."""

from pathlib import Path
from typing import Annotated

import typer

from client.commands.record import Overwrite, check_free, read_telling
from client.recording.plots import deviations, draw

__all__ = ["plot_command"]


def plot_command(
    file: Annotated[Path, typer.Argument(help="A recording: .mcap, .csv or .npz.", exists=True, dir_okay=False)],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Picture to write: .png, .svg, .pdf or .html.")
    ] = None,
    title: Annotated[str | None, typer.Option("--title", help="Above the picture; the file's name without it.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Draw desired and actual positions and speeds, their differences and the speed scaling of a recording."""
    output = file.with_suffix(".png") if output is None else output
    check_free(output, overwrite)
    recording = read_telling(file)
    draw(recording, output, file.name if title is None else title)
    typer.echo(f"{output}: {len(recording)} states, {recording.time_s[-1]:.2f} s")
    if "target_q" in recording and "actual_q" in recording:
        worst = max(deviations(recording), key=lambda deviation: deviation.largest)
        typer.echo(f"largest position error: {worst.largest:.5f} rad ({worst.joint}, rms {worst.rms:.5f} rad)")
