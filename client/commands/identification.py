"""``ur-client fidelity``, ``identify`` and ``excite``: a real arm compared with the emulator's model of it."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Final, TypeAlias

import typer
from rich.table import Table

from client.commands.control import MakeReady
from client.commands.following import PortOffset, RobotIP
from client.commands.record import (
    Overwrite,
    check_and_confirm,
    check_free,
    exclusive_motion,
    move_along,
    read_with_remarks,
)
from client.commands.scene_drawing import model_named, model_of_robot
from client.driver import points
from client.driver.config import robot_ports
from client.identification.excitation import ExcitationBounds, excitation
from client.identification.fidelity import Fidelity, Payload, draw, fidelity
from client.identification.identify import Identified, identify, write_arm
from client.recording.files import Recorder
from client.recording.recording import DEFAULT_FIELDS, Recording
from client.robot import Robot
from urproto.commandline import AsJson, console, print_json
from urproto.joints import JOINT_LABELS

Model: TypeAlias = Annotated[str, typer.Option("--model", help="The arm that was recorded, for example ur10e.")]
Columns: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--columns",
        help="RTDE variables of a .csv file without a header line, such as timestamp,actual_q,actual_current.",
    ),
]
SetPayload: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--payload", metavar="KG,X,Y,Z", help="Payload set on the controller (default: as recorded, else none)."
    ),
]
Mounted: TypeAlias = Annotated[
    str | None,
    typer.Option("--mounted", metavar="KG,X,Y,Z", help="Payload actually mounted on the arm (default: as set)."),
]

_FIELDS: Final = (*DEFAULT_FIELDS, "target_moment", "target_current", "payload", "payload_cog")
_REST_S: Final = 1.0  # before and after the motion: states at rest show the torque constants and the noise


def fidelity_command(
    file: Annotated[Path, typer.Argument(help="A recording: .mcap, .csv or .npz.", exists=True, dir_okay=False)],
    model: Model,
    payload: SetPayload = None,
    mounted: Mounted = None,
    columns: Columns = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Plot to write: .png, .svg or .pdf.")] = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Compare a recording of a real arm with the emulator's model of it, field by field and joint by joint."""
    arm = model_named(model)
    if output is not None:
        check_free(output, overwrite)
    result = fidelity(_read(file, columns), arm, _payload("--payload", payload), _payload("--mounted", mounted))
    if output is not None:
        draw(result, output, f"{file.name}: {arm.title}")
    if as_json:
        print_json({"model": result.model, "notes": result.samples.notes, "errors": [asdict(e) for e in result.errors]})
        return
    for note in result.samples.notes:
        typer.echo(f"note: {file}: {note}", err=True)
    console().print(_table(result))


def identify_command(
    file: Annotated[Path, typer.Argument(help="A recording: .mcap, .csv or .npz.", exists=True, dir_okay=False)],
    model: Model,
    output: Annotated[Path, typer.Option("-o", "--output", help="Arm file to write (YAML).")] = Path("arm.yaml"),
    plot: Annotated[
        Path | None, typer.Option(help="Plot of measured and predicted values to write: .png, .svg or .pdf.")
    ] = None,
    payload: SetPayload = None,
    columns: Columns = None,
    overwrite: Overwrite = False,
) -> None:
    """Identify an arm's torque constants, rotors, friction and noise from a recording of it, for ur-emulator --arm."""
    arm = model_named(model)
    check_free(output, overwrite)
    if plot is not None:
        check_free(plot, overwrite)
    recording, set_payload = _read(file, columns), _payload("--payload", payload)
    found = identify(recording, arm, set_payload)
    write_arm(output, found)
    if plot is not None:
        result = fidelity(recording, found.arm, set_payload, found.mounted)
        draw(result, plot, f"{file.name}: {arm.title}, {output.name}")
    for note in (*found.samples.notes, *found.kept):
        typer.echo(f"note: {note}", err=True)
    console().print(_identified_table(found))
    if found.payload is not None:
        cog = ", ".join(f"{part:.3f}" for part in found.payload.cog_m)
        typer.echo(f"the arm carried {found.payload.mass_kg:.2f} kg at [{cog}] m that was not set on its controller")
    typer.echo(f"{output}: to emulate this arm, run ur-emulator --arm {output}")


def _identified_table(found: Identified) -> Table:
    table = Table("parameter", box=None, pad_edge=False)
    for joint in JOINT_LABELS:
        table.add_column(joint, justify="right")
    for name, values in found.drives.to_mapping().items():
        cells = zip(values, found.errors[name], strict=True)
        table.add_row(name, *(f"{v:.3g}" + (" kept" if error is None else f" +-{error:.1g}") for v, error in cells))
    return table


def excite_command(
    output: Annotated[Path, typer.Option("-o", "--output", help="Recording to write: .mcap, .csv or .npz.")] = Path(
        "excitation.csv"
    ),
    angle: Annotated[
        float, typer.Option(help="How far each joint may move from its current position [rad].", min=0.05)
    ] = 0.5,
    speed: Annotated[float, typer.Option(help="Highest speed of a joint [rad/s].", min=0.05)] = 1.0,
    acceleration: Annotated[float, typer.Option(help="Highest acceleration of a joint [rad/s2].", min=0.1)] = 3.0,
    floor: Annotated[float, typer.Option(help="Lowest height of any link in the base frame [m].")] = 0.05,
    duration: Annotated[float, typer.Option(help="Duration of the motion [s].", min=10.0, max=600.0)] = 40.0,
    seed: Annotated[int, typer.Option(help="The same seed gives the same motion.", min=0)] = 0,
    yes: Annotated[bool, typer.Option("--yes", help="Move a real arm without asking for confirmation.")] = False,
    make_ready: MakeReady = False,
    overwrite: Overwrite = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Move and record every joint, within bounds around the current configuration, as data for identify."""
    check_free(output, overwrite)
    bounds = ExcitationBounds(angle, speed, acceleration, floor)
    ports = robot_ports(port_offset)
    with exclusive_motion(robot_ip, ports), Robot(robot_ip, robot_ports=ports, outputs=_FIELDS) as robot:
        path = excitation(model_of_robot(robot_ip, port_offset), robot.q, duration, bounds, seed)
        check_and_confirm(robot_ip, robot, path, yes=yes)
        if make_ready:
            robot.make_ready()
        with Recorder(output, _FIELDS, {"robot": robot_ip}) as recorder:
            robot.inner.driver.link.on_state.append(recorder.write)
            _rest(robot)
            move_along(robot, path, "excitation")
            _rest(robot)
            robot.inner.driver.link.on_state.remove(recorder.write)
    typer.echo(f"{output}: {recorder.count} states. To identify the arm, run ur-client identify {output}")


def _rest(robot: Robot) -> None:
    robot.sequence([points.spline(robot.q, (0.0,) * 6, _REST_S)])


def _read(file: Path, columns: str | None) -> Recording:
    return read_with_remarks(file, None if columns is None else [name.strip() for name in columns.split(",")])


def _payload(option: str, text: str | None) -> Payload | None:
    if text is None:
        return None
    try:
        mass, x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(
            f"{option} takes mass [kg] and centre of gravity [m] as KG,X,Y,Z, not {text!r}"
        ) from None
    if not 0.0 <= mass < 100.0:
        raise typer.BadParameter(f"{option} starts with a mass from 0 to 100 kg, not {mass:g}")
    return Payload(mass, (x, y, z))


def _table(result: Fidelity) -> Table:
    table = Table("field", "joint", box=None, pad_edge=False)
    for head in ("unit", "range", "rms", "p99", "rms / range", "rms at rest"):
        table.add_column(head, justify="right")
    for row in result.errors:
        share = "-" if row.share is None else f"{100.0 * row.share:.2f} %"
        cells = (row.range, row.rms, row.p99)
        table.add_row(row.field, row.joint, row.unit, *map(_number, cells), share, _number(row.rest))
    return table


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
