"""``ur-emulator-check HOST``: is a controller there, and if not, which part of it and what that means.

It only looks, so that it may be used on a real robot too; ``--run-script`` alone lets the robot do something.
Exit status: 0 all is well, 1 something is wrong, 2 it was called wrongly, 3 nothing of a robot is reachable.
"""

import asyncio
import json
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.machinery import PathFinder
from importlib.metadata import packages_distributions, version
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from emulator.control.remote import ControlClient
from emulator.control.verbs import BadArguments, NotPossible
from emulator.ports import PORTS
from emulator.readiness import Finding, find_out, run_script
from urproto.commandline import AsJson, application, print_json, version_of
from urproto.testing.launch import PACKAGES, ROOT, is_ours

_FAILED: Final = 1
_UNREACHABLE: Final = 3
_PAUSE_S: Final = 0.25  # between two tries while waiting
_ASK_S: Final = 2.0  # guess: how long the control API, which real robots lack, may take to answer
_SCRIPT: Final = "script"
# what every robot has; the others depend on series, version, model and options
_ALWAYS: Final = ("dashboard", "primary", "secondary", "realtime", "rtde")
_LOOKED_FOR: Final = (
    "modbus",
    "robot api",
    "interpreter",
    "primary read-only",
    "secondary read-only",
    "realtime read-only",
    "control",
)
_MEANING: Final[Mapping[str, str]] = {
    "dashboard": "nobody can switch the arm on, load or start programs from afar (PolyScope X: see robot api)",
    "robot api": "nobody can switch the arm on, load or start programs from afar (PolyScope X)",
    "primary": "clients get no state and no messages here, and can send no scripts",
    "secondary": "clients get no state here, and can send no scripts",
    "realtime": "clients of the 125 or 500 Hz stream get nothing, and can send no scripts",
    "rtde": "drivers cannot exchange data; ur_rtde and the ROS driver do not start",
    "modbus": "Modbus clients cannot read or write",
    "interpreter": "statements for interpreter_mode() do not arrive",
    "control": "an emulator's own API does not answer: its verbs cannot be used",
    "cameras": "nobody gets pictures of an emulator's scene (--physics)",
    _SCRIPT: "the robot takes connections but runs nothing: is it in RUNNING, and in remote control (e-Series)?",
}
_REFUSED: Final = (
    "connection refused",
    "not started yet, another port, or the service is switched off in the robot's settings",
)
_SILENT: Final = ("no answer in time", "wrong address, a firewall, or a controller that hangs")

_DISTRIBUTION: Final = "ur-emulator"
_RENAME: Final = (
    "rename it, or work elsewhere. The commands (ur-emulator, ur-client, ...) and the pytest plugin do not look "
    "there; python -P, which is new in Python 3.11, does not either"
)
_OFF_THE_PATH: Final = "take that folder off PYTHONPATH, or rename the package in it"
_ENVIRONMENT: Final = "remove it, or install ur-emulator into a virtual environment of its own (python -m venv)"

app = application()


def main() -> None:
    """Run the command line."""
    app(prog_name="ur-emulator-check")


@app.command()
def _check(
    host: Annotated[str, typer.Argument(help="Address of the robot.")] = "127.0.0.1",
    wait: Annotated[float, typer.Option(help="Keep trying for up to this many seconds.")] = 0.0,
    timeout: Annotated[float, typer.Option(help="Time limit for each port's answer, in seconds.")] = 5.0,
    port_offset: Annotated[int, typer.Option(help="Added to each port, as given to the emulator.")] = 0,
    ports_file: Annotated[Path | None, typer.Option(help="File to which the emulator wrote its ports.")] = None,
    require: Annotated[
        list[str] | None, typer.Option(help="A server that must answer, for example modbus. Repeatable.")
    ] = None,
    script: Annotated[
        bool, typer.Option("--run-script", help="Also run a script on the robot that only writes to its log.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print only what is wrong.")] = False,
    as_json: AsJson = False,
    install: Annotated[
        bool,
        typer.Option("--install", help="Check this installation instead: which other packages have the same names."),
    ] = False,
    version: Annotated[bool, version_of("ur-emulator-check")] = False,
) -> None:
    """Connect to every port of a robot, emulated or real, as clients do, and report what does not answer."""
    if install:
        _show_installation()
        return
    unknown = sorted(set(require or []) - PORTS.keys())
    if unknown:
        raise typer.BadParameter(f"no server is called {', '.join(unknown)}: there are {', '.join(PORTS)}")
    deadline = time.monotonic() + wait
    while True:
        plan = _plan(host, port_offset, ports_file, require or [])
        findings = asyncio.run(_look(plan, timeout, script=script))
        if any(finding.name == "robot api" and finding.error is None for finding in findings):
            plan = replace(plan, required=plan.required - {"dashboard"} | set(require or []))
        if not any(map(plan.is_wrong, findings)) or time.monotonic() >= deadline:
            break
        time.sleep(_PAUSE_S)
    raise typer.Exit(_report(findings, plan, quiet=quiet, as_json=as_json))


@dataclass(frozen=True)
class _Plan:
    """Where to ask. required: servers that have to be there."""

    host: str
    ports: Mapping[str, int]
    required: frozenset[str]

    def is_absent(self, finding: Finding) -> bool:
        """Whether it is nothing but not there, and need not be."""
        refused = isinstance(finding.error, ConnectionRefusedError | TimeoutError)
        return refused and finding.name not in self.required

    def is_wrong(self, finding: Finding) -> bool:
        return finding.error is not None and not self.is_absent(finding)


def _plan(host: str, offset: int, ports_file: Path | None, require: Sequence[str]) -> _Plan:
    known = _read_ports(ports_file) if ports_file is not None else _reported_ports(host, PORTS["control"] + offset)
    named = [*require, *(known or _ALWAYS)]
    looked_for = [] if known is not None else _LOOKED_FOR
    names = dict.fromkeys((*_ALWAYS, *named, *looked_for))
    ports = {name: PORTS[name] + offset for name in names} | (known or {})
    return _Plan(host, {name: ports[name] for name in names}, frozenset(named))


def _read_ports(path: Path) -> dict[str, int]:
    try:
        ports: dict[str, int] = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise typer.BadParameter(f"{path} is not a file of ports: {error}") from error
    return ports


def _reported_ports(host: str, port: int) -> dict[str, int] | None:
    """What an emulator says itself; None from a real robot, or an emulator that wants a token."""
    client = ControlClient(host, port, timeout_s=_ASK_S)
    try:
        ports: dict[str, int] = client.call("ports", {})
    except (OSError, BadArguments, NotPossible, AttributeError):
        return None
    finally:
        client.close()
    return ports


async def _look(plan: _Plan, timeout_s: float, *, script: bool) -> list[Finding]:
    """All ports at once; then the script, if those it needs answer."""
    tries = (find_out(name, plan.host, port, timeout_s) for name, port in plan.ports.items())
    findings = list(await asyncio.gather(*tries))
    if script and not any(map(plan.is_wrong, findings)):
        findings.append(await run_script(plan.host, plan.ports["primary"], timeout_s))
    return findings


def _report(findings: Sequence[Finding], plan: _Plan, *, quiet: bool, as_json: bool) -> int:
    """Print it; the exit status."""
    wrong = [finding for finding in findings if plan.is_wrong(finding)]
    nothing = all(isinstance(finding.error, OSError) for finding in findings)
    if as_json:
        print_json([_as_object(finding, plan) for finding in (wrong if quiet else findings)])
    elif nothing:
        typer.echo(f"nothing of a robot is reachable on {plan.host}: {_causes(wrong[0])}")
    else:
        for finding in wrong if quiet else findings:
            typer.echo(_line(finding, plan))
    if nothing:
        return _UNREACHABLE
    return _FAILED if wrong else 0


def _as_object(finding: Finding, plan: _Plan) -> dict[str, Any]:
    found = "failed" if plan.is_wrong(finding) else "ok" if finding.error is None else "absent"
    text = finding.text if finding.error is None else _causes(finding)
    return {"server": finding.name, "port": finding.port, "found": found, "text": text}


def _line(finding: Finding, plan: _Plan) -> str:
    head = f"{finding.name:<20}{finding.port:<7}"
    if plan.is_wrong(finding):
        effect = _MEANING.get(finding.name.removesuffix(" read-only"))
        means = f"\n{'':7}that means: {effect}" if effect else ""
        return f"FAILED {head}{_causes(finding)}{means}"
    return f"ok     {head}{finding.text}" if finding.error is None else f"-      {head}not there"


def _causes(finding: Finding) -> str:
    if finding.name != _SCRIPT:
        for kind, cause in ((ConnectionRefusedError, _REFUSED), (TimeoutError, _SILENT)):
            if isinstance(finding.error, kind):
                return f"{cause[0]}: {cause[1]}"
    return finding.text


def _show_installation() -> None:
    typer.echo(f"ur-emulator {version(_DISTRIBUTION)} in {ROOT}, Python {sys.version.split()[0]}")
    namesakes = [*_found_before_ours(), *_overwritten()]
    for package, problem, cure in namesakes:
        typer.echo(f"FAILED {package}: {problem}\n{'':7}cure: {cure}")
    if not namesakes:
        typer.echo("ok     nothing else has the name of one of our packages")
    raise typer.Exit(_FAILED if namesakes else 0)


def _found_before_ours() -> Iterator[tuple[str, str, str]]:
    """Packages with the names of ours that ``import`` finds first: name, what is wrong, and what to do.

    A folder that is no package is found if ours is not on the path at all.
    """
    search = list(dict.fromkeys([os.getcwd(), *(str(Path(place).absolute()) for place in sys.path if place)]))
    for package in PACKAGES:
        specs = [(place, spec) for place in search if (spec := PathFinder.find_spec(package, [place]))]
        ours = next((i for i, (_, spec) in enumerate(specs) if is_ours(spec.origin, package)), None)
        before = specs if ours is None else [(place, spec) for place, spec in specs[:ours] if spec.origin]
        for place, spec in before:
            who = f"started in {place}" if place == os.getcwd() else "everywhere"
            where = spec.origin or Path(place, package)
            yield package, f"{where} is found before ours by python {who}", _cure(place)


def _cure(place: str) -> str:
    if place == os.getcwd():
        return _RENAME
    named = (str(Path(entry).absolute()) for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry)
    return _OFF_THE_PATH if place in named else _ENVIRONMENT


def _overwritten() -> Iterator[tuple[str, str, str]]:
    """Distributions that put files where ours are: whichever was installed last has overwritten the other's."""
    owners = packages_distributions()
    for package in PACKAGES:
        for other in sorted(set(owners.get(package, [])) - {_DISTRIBUTION}):
            yield (
                package,
                f"the distribution {other} installs a package of this name too: one has overwritten the other",
                f"pip uninstall {other} and pip install --force-reinstall {_DISTRIBUTION}, or a virtual environment "
                "for each",
            )
