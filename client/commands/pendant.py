"""``ur-client pendant``: the teach pendant in a browser."""

import os
import signal
import threading
from pathlib import Path
from typing import Annotated

import typer

from client.commands.following import PortOffset, RobotIP
from client.errors import extra
from urproto.ports import LAST_PORT, PENDANT_PORT
from urproto.robots import MODELS


def pendant_command(
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    host: Annotated[
        str, typer.Option(help="Address to listen on; 0.0.0.0 lets other machines move the robot.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=LAST_PORT, help="Port to listen on, for browsers.")] = PENDANT_PORT,
    control_port: Annotated[
        int | None, typer.Option(help="Port of an emulator's control API, if not the usual one.")
    ] = None,
    camera_port: Annotated[
        int | None, typer.Option(help="Port of an emulator's cameras, if not the usual one.")
    ] = None,
    modbus_port: Annotated[int | None, typer.Option(help="Modbus port of the robot, if not the usual one.")] = None,
    robot_api_port: Annotated[
        int | None, typer.Option(help="Port of the Robot API (PolyScope X), if not the usual one.")
    ] = None,
    meshes: Annotated[
        Path | None,
        typer.Option(help="Folder of the arm's meshes (STL, GLB), laid out as for describe (default: simple shapes)."),
    ] = None,
    poses: Annotated[
        Path | None, typer.Option(help="File of the saved poses (default: poses.json in your configuration folder).")
    ] = None,
    tools: Annotated[
        Path | None, typer.Option(help="File of the saved TCPs (default: tools.json in your configuration folder).")
    ] = None,
    drafts: Annotated[
        Path | None,
        typer.Option(help="Folder of unsaved programs (default: drafts in your configuration folder)."),
    ] = None,
    scene: Annotated[
        Path | None,
        typer.Option(help="World file of the objects around the arm, for planning (default: an emulator's world)."),
    ] = None,
    with_parent: Annotated[
        bool, typer.Option("--with-parent", hidden=True, help="Exit when standard input closes.")
    ] = False,
    control_token: Annotated[
        str, typer.Option(envvar="UR_EMULATOR_TOKEN", help="Token of an emulator's control API.")
    ] = "",
    key: Annotated[
        str, typer.Option(envvar="UR_PENDANT_KEY", help="Serve only browsers that were opened with /?key=KEY.")
    ] = "",
) -> None:
    """Serve a teach pendant for a robot or an emulator, until Ctrl-C."""
    with extra("pendant", "the teach pendant"):
        from client.pendant.server import serve
        from client.pendant.station import Station
    if scene is not None:
        _check_scene(scene)
    if with_parent:
        threading.Thread(target=_exit_with_standard_input, name="parent watch", daemon=True).start()
    station = Station(
        robot_ip,
        port_offset,
        control_port,
        modbus_port,
        control_token,
        meshes,
        poses or _own_file("poses"),
        tools or _own_file("tools"),
        drafts or Path(typer.get_app_dir("ur-client")) / "drafts",
        scene,
        robot_api_port,
        camera_port,
    )
    serve(station, host, port, lambda: typer.echo(f"Teach pendant of {robot_ip}: http://{host}:{port}"), key)


def _check_scene(path: Path) -> None:
    """Report errors in the scene file now, rather than when the Move screen is opened."""
    from client.planning import CollisionChecker, PlanningScene

    try:
        CollisionChecker(PlanningScene.read(MODELS[0], path))  # any arm does: the objects are the same
    except OSError as error:
        raise typer.BadParameter(f"cannot read {path}: {error.strerror}", param_hint="--scene") from error


def _own_file(name: str) -> Path:
    return Path(typer.get_app_dir("ur-client")) / f"{name}.json"


def _exit_with_standard_input() -> None:
    """Exit at the end of standard input: a pipe that closes when the process that started this one is gone."""
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
