"""``ur-client mcp``: the tools of an assistant."""

from importlib.metadata import version
from typing import Annotated

import typer

from client.commands.following import PortOffset, RobotIP


def mcp_command(
    allow_motion: Annotated[
        bool, typer.Option("--allow-motion", help="Also tools that move the arm, switch outputs and send programs.")
    ] = False,
    allow: Annotated[
        list[str] | None,
        typer.Option(metavar="ADDRESS", help="A robot beyond this machine that may be reached. Repeatable."),
    ] = None,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Serve tools for an assistant over standard input and output (MCP), until its end.

    Without --allow-motion, assistants can only read, check programs, and try them in virtual time on an arm of their
    own. Robots on this machine can be reached; any other one needs --allow with its address, --robot-ip included.
    """
    from client.mcp import Consent, Tools, make_server  # imports Pydantic, which no other command needs

    consent = Consent(frozenset(allow or ()), allow_motion)
    consent.check(robot_ip)
    make_server(Tools(consent, robot_ip, port_offset), consent, version("ur-emulator")).run()
