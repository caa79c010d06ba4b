"""``ur-client proxy``: all connections of a robot, seen and recorded on their way."""

import asyncio
import signal
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from client.commands.options import PortOffset, RobotIP
from client.traffic.identity import ask_identity
from client.traffic.ports import choose_ports
from client.traffic.proxy import Proxy, Route, driver_routes, robot_routes
from client.traffic.recorder import Recorder

__all__ = ["proxy_command", "until_interrupted"]

_UNRECORDED = 1  # exit status when the recording ended before the proxy


def proxy_command(
    robot_ip: RobotIP = "127.0.0.1",
    listen: Annotated[str, typer.Option("--listen", help="Address of this machine for the clients.")] = "127.0.0.1",
    file: Annotated[
        Path | None, typer.Option("--record", help="Write everything to this pcapng file; Wireshark opens it.")
    ] = None,
    ports: Annotated[
        list[str] | None, typer.Option("--ports", help="Names or numbers, all of a robot's by default. Repeatable.")
    ] = None,
    driver: Annotated[
        str | None,
        typer.Option("--driver", help="A driver's address: carry what programs connect to on 50001-50004 there too."),
    ] = None,
    port_offset: PortOffset = 0,
    listen_offset: Annotated[
        int, typer.Option("--listen-offset", help="Added to each port of this machine, as of an emulator.")
    ] = 0,
) -> None:
    """Carry every connection to a robot unchanged, and record it, until Ctrl-C."""
    chosen = choose_ports(ports or ()).items()
    routes = robot_routes(robot_ip, listen, chosen, port_offset=port_offset, listen_offset=listen_offset)
    if driver is not None:
        routes += driver_routes(driver, listen)
    _refuse_loop(routes)
    recorder = _recorder(file, robot_ip, port_offset) if file is not None else None
    try:
        asyncio.run(_carry(routes, recorder))
    except OSError as error:
        raise typer.BadParameter(str(error)) from error
    finally:
        if recorder is not None:
            recorder.close()
    if recorder is not None and recorder.failed:
        raise typer.Exit(_UNRECORDED)


def _refuse_loop(routes: list[Route]) -> None:
    for route in routes:
        if (route.listen, route.listen_port) == (route.host, route.target):
            raise typer.BadParameter(
                f"the proxy cannot listen where {route.name} is, on {route.host}:{route.target}: "
                "give another --listen (127.0.0.2, say) or a --listen-offset"
            )


def _recorder(file: Path, robot_ip: str, port_offset: int) -> Recorder:
    comments = asyncio.run(ask_identity(robot_ip, port_offset))
    return Recorder(file, comments, trouble=_warn)


async def _carry(routes: list[Route], recorder: Recorder | None) -> None:
    async with Proxy(routes, recorder, typer.echo) as proxy:
        for name, port in proxy.ports.items():
            route = proxy.routes[name]
            typer.echo(f"{name}: {route.listen}:{port} leads to {route.host}:{route.target}")
        typer.echo(f"{f'Recording to {recorder.path}. ' if recorder else ''}Ctrl-C ends it.")
        await until_interrupted()


async def until_interrupted() -> None:
    """Return at Ctrl-C, or when the process is asked to end."""
    ended = asyncio.Event()
    stop: Callable[[], None] = ended.set
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        with suppress(NotImplementedError):  # Windows: there Ctrl-C cancels this task
            loop.add_signal_handler(number, stop)
    await ended.wait()


def _warn(text: str) -> None:
    typer.echo(f"! {text}; the connections go on", err=True)
