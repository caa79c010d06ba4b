"""Options of the commands that record or show camera images, and the function that fetches the images."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Annotated, Final, TypeAlias

import typer

from client.cameras import CameraClient, CameraFollower, Shot
from client.recording.pictures import DEPTH, JPEG

_MAX_HZ: Final = 30.0  # the highest rate at which an emulator renders
_MAX_PENDING: Final = 100  # images: more pile up only while the connection to the robot is lost; they are dropped

CameraNames: TypeAlias = Annotated[
    list[str] | None,
    typer.Option("--camera", help="Also include images of this camera; all for every camera. Repeatable."),
]
CameraRate: TypeAlias = Annotated[float, typer.Option("--camera-rate", help="Images per second from each camera.")]
CameraPort: TypeAlias = Annotated[
    int | None, typer.Option("--camera-port", help="Port of an emulator's cameras, if not the usual one.")
]
DEFAULT_HZ: Final = 5.0


@dataclass(frozen=True)
class CameraOptions:
    """The camera options of a command line. names: empty for no images. Raises BadParameter."""

    robot_ip: str
    port: int
    names: Sequence[str]
    rate_hz: float
    depth: bool = False

    def __post_init__(self) -> None:
        if not 0.0 < self.rate_hz <= _MAX_HZ:
            raise typer.BadParameter(f"--camera-rate must be above 0 and at most {_MAX_HZ:g}, not {self.rate_hz:g}")
        if self.depth and not self.names:
            raise typer.BadParameter("--depth needs a camera: add --camera all or --camera NAME")


def follow_cameras(opened: ExitStack, options: CameraOptions) -> Callable[[], list[Shot]]:
    """Start fetching images. The returned function gives those that have arrived since its last call.

    Raises CameraError for cameras that do not exist.
    """
    if not options.names:
        return list
    client = CameraClient(options.robot_ip, options.port)
    opened.callback(client.close)
    cameras = client.chosen(options.names)
    forms = [JPEG, DEPTH] if options.depth else [JPEG]
    subscriptions = [(camera, form) for camera in cameras for form in forms]
    for camera, form in subscriptions:
        client.shot(camera, form)  # raises now if the emulator cannot render it
    shots: SimpleQueue[Shot] = SimpleQueue()

    def enqueue(shot: Shot) -> None:
        if shots.qsize() < _MAX_PENDING:
            shots.put(shot)

    def report(message: str) -> None:
        typer.echo(f"note: {message}", err=True)

    opened.enter_context(CameraFollower(client, lambda: subscriptions, options.rate_hz, enqueue, report))
    return lambda: [shots.get() for _ in range(shots.qsize())]
