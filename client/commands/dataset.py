"""``ur-client dataset``: recordings as a dataset for training policies."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from client.lerobot import DEFAULT_ACTION, DEFAULT_STATE, write_dataset


def dataset_command(
    folder: Annotated[Path, typer.Argument(help="Folder to create.")],
    recordings: Annotated[
        list[Path],
        typer.Argument(help="Recordings (.mcap, .csv or .npz); each becomes one episode.", exists=True, dir_okay=False),
    ],
    task: Annotated[list[str], typer.Option(help="Description of the task: one for all recordings, or one for each.")],
    fps: Annotated[
        int | None,
        typer.Option(min=1, help="Frames per second (default: the rate of the images, else 10)."),
    ] = None,
    state: Annotated[
        list[str] | None,
        typer.Option(help="RTDE outputs of an observation, or elements of them: actual_q, actual_TCP_pose[2], ..."),
    ] = None,
    action: Annotated[
        list[str] | None,
        typer.Option(help="RTDE outputs of an action, likewise: target_q, actual_digital_output_bits[0], ..."),
    ] = None,
    robot_type: Annotated[str, typer.Option(help="Name of the robot in the dataset.")] = "ur",
) -> None:
    """Create a LeRobot dataset (v3.0) from recordings, with the camera images in them."""
    made = write_dataset(
        folder,
        recordings,
        task,
        fps=fps,
        state=_names(state) or DEFAULT_STATE,
        action=_names(action) or DEFAULT_ACTION,
        robot_type=robot_type,
    )
    cameras = f", cameras: {', '.join(made.cameras)}" if made.cameras else ""
    typer.echo(f"{folder}: {made.episodes} episodes, {made.frames} frames at {made.fps} fps{cameras}")
    if made.cameras:
        typer.echo(f"largest time between an image and its frame: {made.late_s:.3f} s")
    for note in made.notes:
        typer.echo(f"note: {note}", err=True)


def _names(given: Sequence[str] | None) -> list[str]:
    return [name.strip() for part in given or () for name in part.split(",") if name.strip()]
