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
    controller: Annotated[
        str | None, typer.Option("--controller", help='Whose desired motion; "robot" is the robot\'s own controller.')
    ] = None,
    limit: Annotated[
        float | None, typer.Option("--limit", min=0.0, help="Draw a line here, for the deviation from the path [rad].")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Draw desired and actual positions and speeds, their differences and the speed scaling of a recording."""
    output = file.with_suffix(".png") if output is None else output
    check_free(output, overwrite)
    recording = read_telling(file)
    draw(recording, output, file.name if title is None else title, controller=controller, limit_rad=limit)
    typer.echo(f"{output}: {len(recording)} states, {recording.time_s[-1]:.2f} s")
    tracking = recording.tracking(controller)
    if tracking.compared:
        worst = max(deviations(recording, controller=controller), key=lambda deviation: deviation.largest)
        typer.echo(f"desired by: {tracking.source}")
        typer.echo(f"largest position error: {worst.largest:.5f} rad ({worst.joint}, rms {worst.rms:.5f} rad)")
        typer.echo(f"largest deviation from the path: {tracking.largest_path_deviation:.5f} rad")
