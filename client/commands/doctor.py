"""``ur-client doctor``: find what prevents a good connection, and suggest the command that fixes it."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from client.commands.following import ROBOT_IP_VARIABLE, PortOffset
from client.doctor import (
    Finding,
    Grade,
    examine_calibration,
    examine_machine,
    examine_own_ports,
    examine_ports,
    examine_replies,
    examine_stream,
    examine_versions,
    exit_status,
)
from urproto.commandline import AsJson, console, print_json
from urproto.text import readable_in

_STYLES = {Grade.GOOD: "green", Grade.UNKNOWN: "dim", Grade.WEAK: "yellow", Grade.BROKEN: "bold red"}


def doctor_command(
    host: Annotated[
        str | None,
        typer.Argument(metavar="ROBOT_IP", help="Address of the robot (default: examine this machine only)."),
    ] = None,
    robot_ip: Annotated[
        str | None,
        typer.Option(envvar=ROBOT_IP_VARIABLE, help="The same, as an option like in other commands."),
    ] = None,
    port_offset: PortOffset = 0,
    calibration: Annotated[Path | None, typer.Option(help="Calibration file to compare with the robot's.")] = None,
    as_json: AsJson = False,
) -> None:
    """Examine this machine, the network and the robot within seconds. Exit status 1 if something cannot work."""
    screen = console()
    findings = []
    for finding in map(readable_in, _examine(host or robot_ip, port_offset, calibration)):  # a robot may say anything
        if not as_json:
            screen.print(_line(finding), soft_wrap=True)
        findings.append(finding)
    if as_json:
        print_json([{**asdict(finding), "grade": finding.grade.value} for finding in findings])
    raise typer.Exit(exit_status(findings))


def _examine(host: str | None, port_offset: int, calibration: Path | None) -> Iterator[Finding]:
    yield from examine_machine()
    yield from examine_versions()
    yield from examine_own_ports()
    if host is None:
        return
    ports = list(examine_ports(host, port_offset))
    yield from ports
    if exit_status(ports):  # the other checks would only report the same
        return
    yield from examine_replies(host, port_offset)
    yield from examine_stream(host, port_offset)
    yield from examine_calibration(host, calibration, port_offset)


def _line(finding: Finding) -> Text:
    line = Text(f"{finding.grade:>14}  ", style=_STYLES[finding.grade])
    line.append(f"{finding.subject}: {finding.text}", style="default")
    if finding.mend:
        line.append(f"\n{'':>16}-> {finding.mend}", style="default")
    return line
