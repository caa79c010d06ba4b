"""The tables of docs/reference/fidelity.md: ``python docs/fidelity_table.py FOLDER`` rewrites them.

FOLDER holds clones of the public repositories named below. Nothing is downloaded, and what is not there, or cannot be
compared, is listed with the reason.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from fidelity_following import following, pushed
from fidelity_moves import (
    Compared,
    movej_by_angles,
    movej_by_targets,
    movej_without_rests,
    movel_with_its_program,
    tool_spread,
)
from fidelity_rest import at_rest

from client.errors import RecordingError
from client.identification.fidelity import Fidelity, fidelity
from client.recording.files import read
from client.recording.recording import Recording
from urproto.robots import kinematics_of, load_model
from urproto.vectors import as_six

PAGE: Final = Path(__file__).parent / "reference" / "fidelity.md"
BEGIN: Final = "<!-- table: made by docs/fidelity_table.py -->\n"
END: Final = "<!-- end of table -->\n"
FIELDS: Final = ("target_moment", "target_current", "actual_current")
_UR10E: Final = ("timestamp", "actual_q", "actual_qd", "actual_current", "target_current", "target_moment")
_UR5: Final = "ur5_modeling_force_estimate/JointSpaceControl_Model_C_ForceEstim/RecordedUR5Data"
_UR5_FITTED: Final = (
    "Movement_No4_Acc",
    "Movement_No5_Acc_slow_no_disturbance",
    "Movement_No6_Acc_slow_Verify_Model",
)
# the files of a folder of the UR5's, each a time and a vector a line
_UR5_FILES: Final = {
    "target_q": "q_target",
    "target_qd": "qd_target",
    "target_qdd": "qdd_target",
    "target_moment": "m_target",
    "target_current": "i_target",
    "actual_current": "i_actual",
    "actual_q": "q_actual",
    "actual_qd": "qd_actual",
    "actual_TCP_pose": "tool_vector",
}
_PTP: Final = "dynamic_calibration/dataset_ur10e/validation_data/ur-20_01_17-ptp_10_points.csv"
_UR3_MOVEL: Final = "Robotik/Modularbeit/Aufgabe4/Aufnahme_Lennard_Messung.csv"  # a=0.1, v=0.05
_UR5_MOVEL: Final = "Robotik/*/Modularbeit Code/A2_movel.csv"  # a=0.8, v=0.1, 50 mm back along x
_UR5_MOVEL_FROM: Final = 5  # the period of its first line, by its place on the way
_UR5E_POSES: Final = "bachelorproject/Testdaten/*/robot*.csv"  # a UR5e by its lengths
_UR5E_MOVEJ: Final = "Universal-Robots-Notts/UR5e_motion_full.csv"  # three movej at 60 degrees/s and 80 degrees/s2
_UR5E_PERIOD_S: Final = 0.008  # of its computer, which took 8.0 s for 1001 states
_LARGE: Final = ("dynamic_calibration", "ur5_modeling_force_estimate")
_AT_REST: Final = ("RTDE_PYTHON_CLIENT_LIB_EXPANDED/", "TSSP-2024/", "RTDE_Python_Client_Library_Zhizhuo/")


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
    *(
        Source(f"{_UR5}/{name}", "ur5", "fitted" if name in _UR5_FITTED else "judged")
        for name in (
            *_UR5_FITTED,
            "Movement_No[123]",
            "Movement_No3_Acc",
            "Movement_No[789]_*",
            "Movement_No10*",
            "TEST",
        )
    ),
    Source("RTDE_PYTHON_CLIENT_LIB_EXPANDED/examples/robot_data.csv", "ur10", "judged"),
    Source("TSSP-2024/examples/robot_data.csv", "ur5e", "judged"),
    Source("RTDE_Python_Client_Library_Zhizhuo/examples/robot_data.csv", "ur5e", "judged"),
)
# what hung on the arm, or pushed it, while its controller was told of nothing: actual currents are not the bare arm's
LOADED: Final = ("load", "Load", "w_dist", "with_dist", "WDist", "ForceSensor")


def main(folder: Path) -> None:
    """Rewrite the tables in the page."""
    left_out: list[tuple[str, str]] = []
    heads = " | ".join(f"`{name}`" for name in FIELDS)
    lines = [
        f"| recording | arm | data | {heads} | `target_moment` at rest |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        *_torques(folder, left_out),
        "",
        "Movements, compared by what each recording shows of them:",
        "",
        "| movement | recording | arm | moves | largest error in duration | largest error in position on the path |",
        "| --- | --- | --- | --- | --- | --- |",
        *_movements(folder, left_out),
        "",
        "Distance of recorded TCP poses from those of the model's nominal lengths at the recorded angles:",
        "",
        "| recording | arm | rms |",
        "| --- | --- | --- |",
        *_poses(folder, left_out),
        "",
        "How closely arms follow their targets: recording / emulator, for base to elbow; wrists. "
        "Deviations are 99th percentiles:",
        "",
        "| recording | arm | data | lag | deviation beyond 0.5 ms | noise of angles | noise of speeds |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        *_following(folder, left_out),
        "",
        "Arms pushed manually at rest; the emulated arm is pushed by the torques that the recorded currents held:",
        "",
        "| recording | joint: push: largest deviation |",
        "| --- | --- |",
        *_pushes(folder, left_out),
        "",
        "At rest, recording / emulator; vectors: mean absolute value of their elements; accelerations: length:",
        "",
        *_rests(folder, left_out),
        "",
        "Left out:",
        "",
        "| recording | why |",
        "| --- | --- |",
        *(f"| {name} | {why} |" for name, why in dict.fromkeys(left_out)),
    ]
    text = PAGE.read_text("utf-8")
    head, rest = text.split(BEGIN)
    PAGE.write_text(head + BEGIN + "\n" + "\n".join(lines) + "\n\n" + END + rest.split(END)[1], "utf-8")


def _found(folder: Path, pattern: str, left_out: list[tuple[str, str]]) -> list[Path]:
    files = sorted(folder.glob(pattern))
    if not files:
        left_out.append((pattern, "not in the folder"))
    return files


def _torques(folder: Path, left_out: list[tuple[str, str]]) -> Iterator[str]:
    """A row for each recording; those of a kind that have equal cells except for the last share one."""
    rows = dict[str, list[tuple[str, str]]]()
    for source in SOURCES:
        for file in _found(folder, source.pattern, left_out):
            try:
                cells, rest = _row(file, source)
            except RecordingError as error:
                left_out.append((_name(folder, file), str(error).replace(f"{file}: ", "").replace(f"{file} ", "")))
            else:
                rows.setdefault(cells, []).append((_name(folder, file), rest))
    for cells, found in rows.items():
        names, rests = zip(*found, strict=True)
        rest = rests[0] if len(rests) == 1 else f"{min(rests)} to {max(rests)}"
        yield f"| {', '.join(names)} | {cells} | {rest} |"


def _movements(folder: Path, left_out: list[tuple[str, str]]) -> Iterator[str]:
    folders = [file for source in SOURCES if source.model == "ur5" for file in sorted(folder.glob(source.pattern))]
    if folders:
        found = movej_by_targets(map(_recording, folders), load_model("ur5"))
        yield _movement("`movej`, targets", "ur5_modeling_force_estimate", "UR5", found)
    for file in _found(folder, _PTP, left_out):
        found = movej_by_angles(read(file, _UR10E), load_model("ur10e"))
        yield _movement("`movej`, angles", _name(folder, file), "UR10e", found)
    for file in _found(folder, _UR5E_MOVEJ, left_out):
        found = movej_without_rests(
            _by_a_computer(file), load_model("ur5e"), float(np.radians(60.0)), float(np.radians(80.0))
        )
        yield _movement("`movej`, targets", _name(folder, file), "UR5e", found)
    for file in _found(folder, _UR3_MOVEL, left_out):
        recording, model = read(file), load_model("ur3")
        first = int(np.argmax((np.abs(recording["target_qd"]) > 1e-9).any(axis=1))) - 1
        start, places = recording["target_q"][first], recording["target_TCP_pose"][first:, :3]
        goal = np.array(kinematics_of(model).forward(as_six(recording["target_q"][-1])))
        ways = np.linalg.norm(places - places[0], axis=1)
        yield _movement(
            "`movel` that begins a program",
            _name(folder, file),
            "UR3",
            movel_with_its_program(ways, start, goal, model, 0.05, 0.1),
        )
    for file in _found(folder, _UR5_MOVEL, left_out)[:1]:
        table, model = np.genfromtxt(file, delimiter=",", skip_header=1), load_model("ur5")
        start = np.radians([30.0, -60.0, 90.0, 0.0, 90.0, 0.0])
        goal = np.array(kinematics_of(model).forward(as_six(start)))
        goal[0] += np.sign(table[-1, 0] - table[0, 0]) * 0.05
        ways = np.linalg.norm(table[:, :3] - table[0, :3], axis=1)
        ways += 0.05 - ways[-1]
        yield _movement(
            "`movel` that begins a program",
            _name(folder, file),
            "UR5",
            movel_with_its_program(ways, start, goal, model, 0.1, 0.8, _UR5_MOVEL_FROM),
        )


def _movement(what: str, name: str, arm: str, found: Compared | None) -> str:
    if found is None:
        return f"| {what} | {name} | {arm} | 0 | | |"
    place = "" if np.isnan(found.place) else f"{found.place:.3f} {found.unit}"
    return f"| {what} | {name} | {arm} | {found.moves} | {100.0 * found.duration:.2f} % | {place} |"


def _poses(folder: Path, left_out: list[tuple[str, str]]) -> Iterator[str]:
    for pattern, model in ((_UR3_MOVEL, "ur3"), (f"{_UR5}/Movement_No6*", "ur5"), (_UR5E_POSES, "ur5e")):
        for file in _found(folder, pattern, left_out):
            recording = _posed(file) if pattern == _UR5E_POSES else _recording(file)
            spread = tool_spread(recording["actual_q"][::10], recording["actual_TCP_pose"][::10], load_model(model))
            yield f"| {_name(folder, file)} | {load_model(model).title} | {spread:.2f} mm |"


def _posed(file: Path) -> Recording:
    """A recording of angles and poses alone, without times."""
    numbers = np.genfromtxt(file, skip_header=1)
    numbers = numbers[np.isfinite(numbers[:, :12]).all(axis=1)]
    values = {"actual_q": numbers[:, :6], "actual_TCP_pose": numbers[:, 6:12]}
    return Recording({"timestamp": np.arange(len(numbers)), **values})


def _following(folder: Path, left_out: list[tuple[str, str]]) -> Iterator[str]:
    for source in SOURCES:
        for file in _found(folder, source.pattern, left_out) if source.model == "ur5" else ():
            recording = _recording(file)
            if not _even(recording):
                left_out.append((_name(folder, file), "for angles: has gaps"))
            elif (np.abs(recording["target_qd"]) > 0.0).any() and not _loaded(file):
                cells = [cell for _, cell in following(recording, load_model("ur5"))]
                yield f"| {_name(folder, file)} | UR5 | {source.role} | {' | '.join(cells)} |"
    for file in _found(folder, _UR5E_MOVEJ, left_out):
        cells = [cell for _, cell in following(_by_a_computer(file), load_model("ur5e"))]
        yield f"| {_name(folder, file)} | UR5e | noise fitted | {' | '.join(cells)} |"


def _pushes(folder: Path, left_out: list[tuple[str, str]]) -> Iterator[str]:
    for file in _found(folder, f"{_UR5}/Movement_No10*", left_out):
        found = pushed(_recording(file), load_model("ur5"))
        cells = (f"{joint}: {push:.0f} Nm: {theirs:.2f} / {ours:.2f}" for joint, push, theirs, ours in found)
        yield f"| {_name(folder, file)} | {'; '.join(cells)} mrad |"


def _even(recording: Recording) -> bool:
    return float(np.ptp(np.diff(recording["timestamp"]))) < 1e-3


def _by_a_computer(file: Path) -> Recording:
    """Of one that a computer took state by state, without the controller's time; what it took twice counts once."""
    table = np.genfromtxt(file, delimiter=",", names=True)
    vectors = {
        name: np.stack([table[f"{short}_{joint}"] for joint in range(6)], axis=-1)
        for name, short in (("actual_q", "q"), ("actual_qd", "qd"), ("target_q", "tq"), ("target_qd", "tqd"))
    }
    new = np.append(True, np.diff(vectors["target_q"], axis=0).any(axis=1))
    vectors = {name: values[new] for name, values in vectors.items()}
    vectors["target_qdd"] = np.gradient(vectors["target_qd"], _UR5E_PERIOD_S, axis=0)
    return Recording({"timestamp": _UR5E_PERIOD_S * np.arange(np.count_nonzero(new)), **vectors})


def _rests(folder: Path, left_out: list[tuple[str, str]]) -> Iterator[str]:
    """A row for each field, with mean and noise of each recording."""
    names, cells = list[str](), dict[str, list[str]]()
    for source in (one for one in SOURCES if one.pattern.startswith(_AT_REST)):
        for file in _found(folder, source.pattern, left_out):
            names.append(_name(folder, file))
            for name, unit, means, noises in at_rest(read(file), source.model):
                cells.setdefault(f"`{name}` [{unit}]", []).append(f"{means}; {noises}")
    yield f"| mean; noise | {' | '.join(names)} |"
    yield "| --- " * (len(names) + 1) + "|"
    yield from (f"| {name} | {' | '.join(values)} |" for name, values in cells.items())


def _recording(file: Path, columns: tuple[str, ...] | None = None) -> Recording:
    """Of a file, or of a folder of the UR5's."""
    if not file.is_dir():
        return read(file, columns)
    values = {}
    for name, log in _UR5_FILES.items():
        path = file / "csv_files" / f"log_{log}.csv"
        if not path.exists():
            raise RecordingError(f"{log} was not recorded")
        lines = path.read_text("utf-8").splitlines()
        rows = [line.split(",") for line in lines if line.count(",") == lines[0].count(",")]
        values[name] = np.array([[float(number or "nan") for number in row] for row in rows])
    count = min(len(table) for table in values.values())
    arrays = {name: table[:count, 1:] for name, table in values.items()}
    return Recording({"timestamp": values["target_q"][:count, 0], **arrays})


def _name(folder: Path, file: Path) -> str:
    """Repository and file; of the two large repositories, which the page names, the file alone."""
    repository = file.relative_to(folder).parts[0]
    return file.stem if repository in _LARGE else f"{repository} {file.stem}"


def _row(file: Path, source: Source) -> tuple[str, str]:
    """The cells of a recording, and the last one."""
    result = fidelity(_recording(file, source.columns), load_model(source.model))
    loaded = _loaded(file)
    cells = [_share(result, name) for name in FIELDS]
    if loaded:
        cells[2] = "loaded" if "oad" in file.stem else "pushed"
    rests = [row.rest for row in result.errors if row.field == FIELDS[0] and row.rest is not None]
    rest = f"{max(rests):.3f} Nm" if rests else ""
    return f"{load_model(source.model).title} | {source.role} | {' | '.join(cells)}", rest


def _loaded(file: Path) -> bool:
    return any(word in file.stem and f"un{word}" not in file.stem for word in LOADED)


def _share(result: Fidelity, name: str) -> str:
    found = result.worst(name)
    return "rest" if found is None else f"{100.0 * found[0]:.2f} % ({found[1]})"


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python docs/fidelity_table.py FOLDER")
    main(Path(sys.argv[1]))
