"""``ur-client fidelity``, ``identify`` and ``excite``: a real arm against the emulator's model of it."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, TypeAlias

import typer
import yaml
from rich.table import Table

from client.commands.record import Overwrite, check_free, read_telling
from client.errors import FileError
from client.identification.fidelity import Fidelity, Payload, fidelity
from client.identification.identify import Identified, identify
from client.identification.plots import draw
from client.recording.recording import Recording
from urproto.commandline import AsJson, console, print_json
from urproto.joints import JOINT_LABELS
from urproto.robots import RobotModel, UnknownModel, load_model

Model: TypeAlias = Annotated[str, typer.Option("--model", help="The arm that was recorded, for example ur10e.")]
Columns: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--columns",
        help="RTDE variables of a .csv file without a first line, such as timestamp,actual_q,actual_current.",
    ),
]
Told: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--payload", metavar="KG,X,Y,Z", help="Payload that the controller was told (default: as recorded, else none)."
    ),
]
Mounted: TypeAlias = Annotated[
    str | None,
    typer.Option("--mounted", metavar="KG,X,Y,Z", help="Payload that really hung on the arm (default: as told)."),
]


def fidelity_command(
    file: Annotated[Path, typer.Argument(help="A recording: .mcap, .csv or .npz.", exists=True, dir_okay=False)],
    model: Model,
    payload: Told = None,
    mounted: Mounted = None,
    columns: Columns = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Picture to write: .png, .svg or .pdf.")] = None,
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
    output: Annotated[Path, typer.Option("-o", "--output", help="The arm's file to write, YAML.")] = Path("arm.yaml"),
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Picture of measured against predicted: .png, .svg or .pdf.")
    ] = None,
    payload: Told = None,
    columns: Columns = None,
    overwrite: Overwrite = False,
) -> None:
    """Find the torque constants, rotors, friction and noise of an arm in a recording of it, for ur-emulator --arm."""
    arm = model_named(model)
    check_free(output, overwrite)
    if plot is not None:
        check_free(plot, overwrite)
    recording, told = _read(file, columns), _payload("--payload", payload)
    found = identify(recording, arm, told)
    _write(output, found)
    if plot is not None:
        draw(fidelity(recording, found.arm, told, found.mounted), plot, f"{file.name}: {arm.title}, {output.name}")
    for note in (*found.samples.notes, *found.kept):
        typer.echo(f"note: {note}", err=True)
    console().print(_identified_table(found))
    if found.payload is not None:
        cog = ", ".join(f"{part:.3f}" for part in found.payload.cog_m)
        typer.echo(f"the arm carried {found.payload.mass_kg:.2f} kg at [{cog}] m that its controller was not told of")
    typer.echo(f"{output}: ur-emulator --arm {output} is this arm")


def _write(path: Path, found: Identified) -> None:
    try:
        text = yaml.safe_dump(found.to_mapping(), sort_keys=False, default_flow_style=None, width=120)
        path.write_text(text, "utf-8")
    except OSError as error:
        raise FileError(path, error.strerror or str(error)) from error


def _identified_table(found: Identified) -> Table:
    table = Table("number", box=None, pad_edge=False)
    for joint in JOINT_LABELS:
        table.add_column(joint, justify="right")
    for name, values in found.drives.to_mapping().items():
        cells = zip(values, found.errors[name], strict=True)
        table.add_row(name, *(f"{v:.3g}" + (" kept" if error is None else f" +-{error:.1g}") for v, error in cells))
    return table


def model_named(name: str) -> RobotModel:
    """Raises BadParameter, which lists the known ones."""
    try:
        return load_model(name.lower())
    except UnknownModel as error:
        raise typer.BadParameter(str(error)) from error


def _read(file: Path, columns: str | None) -> Recording:
    return read_telling(file, None if columns is None else [name.strip() for name in columns.split(",")])


def _payload(option: str, text: str | None) -> Payload | None:
    if text is None:
        return None
    try:
        mass, x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{option} is mass [kg] and centre of gravity [m], KG,X,Y,Z, not {text!r}") from None
    if not 0.0 <= mass < 100.0:
        raise typer.BadParameter(f"{option} begins with a mass from 0 to 100 kg, not {mass:g}")
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
