"""The table of docs/fidelity.md: ``python docs/fidelity_table.py FOLDER`` rewrites it.

FOLDER holds clones of the public repositories named below. Nothing is downloaded, and what is not there, or cannot be
compared, is listed with the reason.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from client.errors import RecordingError
from client.identification.fidelity import Fidelity, fidelity
from client.recording.files import read
from urproto.robots import load_model

PAGE: Final = Path(__file__).with_name("fidelity.md")
BEGIN: Final = "<!-- table: made by docs/fidelity_table.py -->\n"
END: Final = "<!-- end of table -->\n"
FIELDS: Final = ("target_moment", "target_current", "actual_current")
_UR10E: Final = ("timestamp", "actual_q", "actual_qd", "actual_current", "target_current", "target_moment")


@dataclass(frozen=True)
class Source:
    """Recordings of one kind: files below the folder, the arm, the columns of files without a first line."""

    pattern: str
    model: str
    role: str
    columns: tuple[str, ...] | None = None


SOURCES: Final = (
    Source("dynamic_calibration/dataset_ur10e/identification_data/*.csv", "ur10e", "fitted", _UR10E),
    Source("dynamic_calibration/dataset_ur10e/jointwise_motion/*.csv", "ur10e", "judged", _UR10E),
    Source("dynamic_calibration/dataset_ur10e/validation_data/*.csv", "ur10e", "judged", _UR10E),
    Source("dynamic_calibration/dataset_ur10e/collision/*.csv", "ur10e", "judged", _UR10E),
    Source("RTDE_PYTHON_CLIENT_LIB_EXPANDED/examples/robot_data.csv", "ur10", "judged"),
    Source("TSSP-2024/examples/robot_data.csv", "ur5e", "judged"),
    Source("RTDE_Python_Client_Library_Zhizhuo/examples/robot_data.csv", "ur5e", "judged"),
)
# what hung on the arm while its controller was told of nothing: actual currents are not the bare arm's
LOADED: Final = ("load", "Load")


def main(folder: Path) -> None:
    """Rewrite the table in the page."""
    rows, left_out = [], []
    for source in SOURCES:
        files = sorted(folder.glob(source.pattern))
        if not files:
            left_out.append((source.pattern, "not in the folder"))
        for file in files:
            try:
                rows.append(_row(folder, file, source))
            except RecordingError as error:
                left_out.append((_name(folder, file), str(error).replace(f"{file}: ", "").replace(f"{file} ", "")))
    heads = " | ".join(f"`{name}`" for name in FIELDS)
    lines = [f"| recording | arm | data | {heads} | `target_moment` at rest |"]
    lines += ["| --- | --- | --- | --- | --- | --- | --- |", *rows, "", "Left out:", ""]
    lines += ["| recording | why |", "| --- | --- |", *(f"| {name} | {why} |" for name, why in left_out)]
    text = PAGE.read_text("utf-8")
    head, rest = text.split(BEGIN)
    PAGE.write_text(head + BEGIN + "\n" + "\n".join(lines) + "\n\n" + END + rest.split(END)[1], "utf-8")


def _name(folder: Path, file: Path) -> str:
    """Repository and file."""
    return f"{file.relative_to(folder).parts[0]} {file.stem}"


def _row(folder: Path, file: Path, source: Source) -> str:
    result = fidelity(read(file, source.columns), load_model(source.model))
    loaded = any(word in file.stem and f"un{word}" not in file.stem for word in LOADED)
    cells = [_share(result, name) for name in FIELDS]
    if loaded:
        cells[2] = "loaded"
    rests = [row.rest for row in result.errors if row.field == FIELDS[0] and row.rest is not None]
    rest = f"{max(rests):.3f} Nm" if rests else ""
    title = load_model(source.model).title
    return f"| {_name(folder, file)} | {title} | {source.role} | {' | '.join(cells)} | {rest} |"


def _share(result: Fidelity, name: str) -> str:
    found = result.worst(name)
    return "rest" if found is None else f"{100.0 * found[0]:.2f} % ({found[1]})"


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python docs/fidelity_table.py FOLDER")
    main(Path(sys.argv[1]))
