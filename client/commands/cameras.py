"""Options of commands that take pictures of cameras, and what they take them with."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Annotated, Final, TypeAlias

import typer

from client.cameras import CameraClient, CameraFollower, Shot
from client.recording.pictures import DEPTH, JPEG
from urproto.ports import CAMERA_PORT

_MOST_HZ: Final = 30.0  # what an emulator draws at most
_MOST_WAITING: Final = 100  # pictures: more come only while a robot is lost, and then they are of no use

CameraNames: TypeAlias = Annotated[
    list[str] | None,
    typer.Option("--camera", help="Pictures of this camera too, or all. Repeat it for several."),
]
CameraRate: TypeAlias = Annotated[float, typer.Option("--camera-rate", help="Pictures per second of each camera.")]
CameraDepth: TypeAlias = Annotated[bool, typer.Option("--depth", help="Depth of those cameras too.")]
CameraPort: TypeAlias = Annotated[
    int | None, typer.Option("--camera-port", help="Port of an emulator's cameras, if not the usual one.")
]
USUAL_HZ: Final = 5.0


@dataclass(frozen=True)
class CameraOptions:
    """What was given. names: none for no pictures."""

    robot_ip: str
    port: int
    names: Sequence[str]
    rate_hz: float
    depth: bool

    @classmethod
    def of(
        cls,
        robot_ip: str,
        port_offset: int,
        port: int | None,
        names: Sequence[str] | None,
        rate_hz: float,
        depth: bool = False,
    ) -> "CameraOptions":
        """Of a command line. Raises BadParameter."""
        if not 0.0 < rate_hz <= _MOST_HZ:
            raise typer.BadParameter(f"--camera-rate is above 0 and at most {_MOST_HZ:g}, not {rate_hz:g}")
        if depth and not names:
            raise typer.BadParameter("--depth is of cameras: say of which, --camera all or --camera NAME")
        usual = CAMERA_PORT + port_offset
        return cls(robot_ip, usual if port is None else port, tuple(names or ()), rate_hz, depth)


def follow_cameras(opened: ExitStack, options: CameraOptions) -> Callable[[], list[Shot]]:
    """Begin to take pictures; what is returned gives those that came since it was last called.

    Raises CameraError for cameras that are not there.
    """
    if not options.names:
        return list
    client = CameraClient(options.robot_ip, options.port)
    opened.callback(client.close)
    cameras = client.chosen(options.names)
    forms = [JPEG, DEPTH] if options.depth else [JPEG]
    wanted = [(camera, form) for camera in cameras for form in forms]
    for camera, form in wanted:
        client.shot(camera, form)  # what draws none says so now
    shots: SimpleQueue[Shot] = SimpleQueue()

    def take(shot: Shot) -> None:
        if shots.qsize() < _MOST_WAITING:
            shots.put(shot)

    def tell(what: str) -> None:
        typer.echo(f"note: {what}", err=True)

    opened.enter_context(CameraFollower(client, lambda: wanted, options.rate_hz, take, tell))
    return lambda: [shots.get() for _ in range(shots.qsize())]
