"""``ur-emulator-check HOST``: check which ports of a controller answer, and say what it means if one does not.

It changes nothing, so it can be used with a real robot too; only ``--run-script`` makes the robot execute something.
Exit status: 0 all is well, 1 something is wrong, 2 usage error, 3 no port of a robot is reachable.
"""

import asyncio
import json
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from importlib.machinery import PathFinder
from importlib.metadata import packages_distributions, version
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from emulator.ports import PORTS
from emulator.readiness import Finding, probe, run_script, watch_rtde
from urproto.commandline import AsJson, application, print_json, version_of
from urproto.controlapi import ControlClient
from urproto.errors import URError

_ROOT: Final = Path(__file__).absolute().parents[1]
_PACKAGES: Final = ("client", "emulator", "urproto", "urscript", "urproto.testing")
_FAILED: Final = 1
_UNREACHABLE: Final = 3
_PAUSE_S: Final = 0.25  # between two attempts while waiting
_CONTROL_TIMEOUT_S: Final = 2.0  # guess: for the control API, which real robots lack
_WATCH_S: Final = 4.0  # guess: a robot that falls silent now and then does so within this time
_SCRIPT: Final = "script"
# servers that every robot has; the others depend on series, version, model and options
_ALWAYS: Final = ("dashboard", "primary", "secondary", "realtime", "rtde")
_OPTIONAL: Final = (
    "modbus",
    "robot api",
    "interpreter",
    "primary read-only",
    "secondary read-only",
    "realtime read-only",
    "control",
)
_MEANING: Final[Mapping[str, str]] = {
    "dashboard": "the arm cannot be switched on, nor programs loaded or started, remotely (PolyScope X: see robot api)",
    "robot api": "the arm cannot be switched on, nor programs loaded or started, remotely (PolyScope X)",
    "primary": "clients receive no state and no messages from this port, and cannot send scripts to it",
    "secondary": "clients receive no state from this port, and cannot send scripts to it",
    "realtime": "clients receive no state at 125 or 500 Hz, and cannot send scripts to this port",
    "rtde": "drivers cannot exchange data; ur_rtde and the ROS driver do not start",
    "rtde stream": "drivers that need regular states stop the arm, or lose their connection",
    "modbus": "Modbus clients cannot read or write",
    "interpreter": "programs in interpreter_mode() receive no statements",
    "control": "the emulator's own API does not answer; its verbs cannot be used",
    "cameras": "clients receive no images of the emulator's scene (--physics)",
    _SCRIPT: "the robot accepts connections but runs nothing: is it in RUNNING, and in remote control (e-Series)?",
}
_REFUSED: Final = (
    "connection refused",
    "not started yet, wrong port, or the service is disabled in the robot's settings",
)
_SILENT: Final = ("no answer in time", "wrong address, a firewall, or a controller that hangs")

_DISTRIBUTION: Final = "ur-emulator"
_RENAME: Final = (
    "rename it, or work in another folder. The commands (ur-emulator, ur-client, ...) and the pytest plugin do not "
    "search the current folder; neither does python -P (Python 3.11 or newer)"
)
_OFF_THE_PATH: Final = "remove that folder from PYTHONPATH, or rename the package in it"
_ENVIRONMENT: Final = "remove it, or install ur-emulator into a separate virtual environment (python -m venv)"

app = application()


def main() -> None:
    app(prog_name="ur-emulator-check")


@app.command()
def _check(
    host: Annotated[str, typer.Argument(help="Address of the robot.")] = "127.0.0.1",
    wait: Annotated[float, typer.Option(help="Keep trying for up to this many seconds.")] = 0.0,
    timeout: Annotated[float, typer.Option(help="Time limit for each port's answer, in seconds.")] = 5.0,
    port_offset: Annotated[int, typer.Option(help="Number added to each port, as given to the emulator.")] = 0,
    ports_file: Annotated[Path | None, typer.Option(help="Ports file that the emulator has written.")] = None,
    require: Annotated[
        list[str] | None, typer.Option(help="A server that must answer, for example modbus. Repeatable.")
    ] = None,
    script: Annotated[
        bool, typer.Option("--run-script", help="Also run a script on the robot, which only writes to the log.")
    ] = False,
    watch: Annotated[
        float | None,
        typer.Option(help="Also receive RTDE data for so many seconds (default: 4, or none with --quiet)."),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print problems only.")] = False,
    as_json: AsJson = False,
    install: Annotated[
        bool,
        typer.Option("--install", help="Check this installation instead, for other packages with the same names."),
    ] = False,
    version: Annotated[bool, version_of("ur-emulator-check")] = False,
) -> None:
    """Connect to every port of a robot, emulated or real, as clients do, and report ports that do not answer."""
    if install:
        _show_installation()
        return
    unknown = sorted(set(require or []) - PORTS.keys())
    if unknown:
        raise typer.BadParameter(f"unknown server {', '.join(unknown)}: choose from {', '.join(PORTS)}")
    deadline = time.monotonic() + wait
    while True:
        plan = _plan(host, port_offset, ports_file, require or [])
        findings = asyncio.run(_probe_all(plan, timeout, script=script))
        if any(finding.name == "robot api" and finding.error is None for finding in findings):
            plan = replace(plan, required=plan.required - {"dashboard"} | set(require or []))
        if not any(map(plan.is_wrong, findings)) or time.monotonic() >= deadline:
            break
        time.sleep(_PAUSE_S)
    seconds = watch if watch is not None else 0.0 if quiet else _WATCH_S
    if seconds > 0.0 and not any(map(plan.is_wrong, findings)):
        findings.append(asyncio.run(watch_rtde(host, plan.ports["rtde"], seconds, timeout)))
    raise typer.Exit(_report(findings, plan, quiet=quiet, as_json=as_json))


@dataclass(frozen=True)
class _Plan:
    """The ports to check. required: servers that must answer."""

    host: str
    ports: Mapping[str, int]
    required: frozenset[str]

    def is_absent(self, finding: Finding) -> bool:
        """Whether an optional server does not exist, which is not an error."""
        refused = isinstance(finding.error, ConnectionRefusedError | TimeoutError)
        return refused and finding.name not in self.required

    def is_wrong(self, finding: Finding) -> bool:
        return finding.error is not None and not self.is_absent(finding)


def _plan(host: str, offset: int, ports_file: Path | None, require: Sequence[str]) -> _Plan:
    known = _read_ports(ports_file) if ports_file is not None else _reported_ports(host, PORTS["control"] + offset)
    named = [*require, *(known or _ALWAYS)]
    looked_for = [] if known is not None else _OPTIONAL
    names = dict.fromkeys((*_ALWAYS, *named, *looked_for))
    ports = {name: PORTS[name] + offset for name in names} | (known or {})
    return _Plan(host, {name: ports[name] for name in names}, frozenset(named))


def _read_ports(path: Path) -> dict[str, int]:
    try:
        ports: dict[str, int] = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise typer.BadParameter(f"{path} is not a ports file: {error}") from error
    return ports


def _reported_ports(host: str, port: int) -> dict[str, int] | None:
    """The ports as reported by an emulator; None for a real robot, or an emulator that requires a token."""
    with closing(ControlClient(host, port, timeout_s=_CONTROL_TIMEOUT_S)) as client, suppress(URError):
        ports: dict[str, int] = client.call("ports", {})
        return ports
    return None


async def _probe_all(plan: _Plan, timeout_s: float, *, script: bool) -> list[Finding]:
    """Check all ports at the same time; then run the script, if nothing is wrong."""
    tries = (probe(name, plan.host, port, timeout_s) for name, port in plan.ports.items())
    findings = list(await asyncio.gather(*tries))
    if script and not any(map(plan.is_wrong, findings)):
        findings.append(await run_script(plan.host, plan.ports["primary"], timeout_s))
    return findings


def _report(findings: Sequence[Finding], plan: _Plan, *, quiet: bool, as_json: bool) -> int:
    """Print the findings; return the exit status."""
    wrong = [finding for finding in findings if plan.is_wrong(finding)]
    nothing = all(isinstance(finding.error, OSError) for finding in findings)
    if as_json:
        print_json([_as_object(finding, plan) for finding in (wrong if quiet else findings)])
    elif nothing:
        typer.echo(f"no port of a robot is reachable on {plan.host}: {_causes(wrong[0])}")
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
    return f"ok     {head}{finding.text}" if finding.error is None else f"-      {head}not available"


def _causes(finding: Finding) -> str:
    if finding.name != _SCRIPT:
        for kind, cause in ((ConnectionRefusedError, _REFUSED), (TimeoutError, _SILENT)):
            if isinstance(finding.error, kind):
                return f"{cause[0]}: {cause[1]}"
    return finding.text


def _show_installation() -> None:
    typer.echo(f"ur-emulator {version(_DISTRIBUTION)} in {_ROOT}, Python {sys.version.split()[0]}")
    namesakes = [*_shadowing_packages(), *_overwritten()]
    for package, problem, remedy in namesakes:
        typer.echo(f"FAILED {package}: {problem}\n{'':7}remedy: {remedy}")
    if not namesakes:
        typer.echo("ok     no other package has the name of one of ur-emulator's packages")
    raise typer.Exit(_FAILED if namesakes else 0)


def _shadowing_packages() -> Iterator[tuple[str, str, str]]:
    """Other packages with the names of ours that ``import`` finds first: name, problem, and remedy.

    A folder that is not a package is found only if ours is not on the path at all.
    """
    search = list(dict.fromkeys([os.getcwd(), *(str(Path(place).absolute()) for place in sys.path if place)]))
    for package in _PACKAGES:
        specs = [(place, spec) for place in search if (spec := PathFinder.find_spec(package, [place]))]
        ours = next((i for i, (_, spec) in enumerate(specs) if _is_own_package(spec.origin, package)), None)
        before = specs if ours is None else [(place, spec) for place, spec in specs[:ours] if spec.origin]
        for place, spec in before:
            who = f"started in {place}" if place == os.getcwd() else "everywhere"
            where = spec.origin or Path(place, package)
            yield package, f"python {who} imports {where} instead of ours", _remedy(place)


def _is_own_package(origin: str | None, package: str) -> bool:
    """Whether a package's ``__init__.py`` is that of the project."""
    own_file = _ROOT / package / "__init__.py"
    return origin is not None and Path(origin).exists() and own_file.samefile(origin)


def _remedy(place: str) -> str:
    if place == os.getcwd():
        return _RENAME
    named = (str(Path(entry).absolute()) for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry)
    return _OFF_THE_PATH if place in named else _ENVIRONMENT


def _overwritten() -> Iterator[tuple[str, str, str]]:
    """Distributions with files in the same places as ours: the one installed last has overwritten the other."""
    owners = packages_distributions()
    for package in _PACKAGES:
        for other in sorted(set(owners.get(package, [])) - {_DISTRIBUTION}):
            yield (
                package,
                f"the distribution {other} also installs a package of this name: one has overwritten the other",
                f"pip uninstall {other} and install {_DISTRIBUTION} again with pip's --force-reinstall, or use "
                "a virtual environment for each",
            )
