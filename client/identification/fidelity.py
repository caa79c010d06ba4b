"""Deviation of the emulator's model of an arm from a recording of a real one, by field and by joint."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from client.errors import RecordingError, extra
from client.identification.samples import Array, Samples, friction_features, known_features, samples_of
from client.recording.plots import save_figure
from client.recording.recording import Recording
from urproto.joints import JOINT_LABELS
from urproto.robots import MODELS, RobotModel, load_model
from urproto.robots.measured import drivetrain_of
from urproto.robots.pinocchio_dynamics import Dynamics
from urproto.vectors import ZERO6, Vector6

UNITS: Final = {"target_moment": "Nm", "target_current": "A", "actual_current": "A"}
_WRONG_SHARE: Final = 0.05  # of the range of the target moments: a larger error means another model or payload
_WRONG_NM: Final = 1.0
_CHECKED_STATES: Final = 400  # enough to recognise the model

_FORMATS: Final = (".png", ".svg", ".pdf")
_SIZE_IN: Final = (10.0, 12.0)
_DPI: Final = 110
_MAX_POINTS: Final = 4000  # of a line; more would not be visible
_RECORDED: Final[Any] = {"linewidth": 0.7, "color": "#56b4e9", "label": "recorded"}
_PREDICTED: Final[Any] = {"linewidth": 0.9, "color": "#d55e00", "label": "predicted"}


@dataclass(frozen=True, slots=True)
class Payload:
    """A payload: mass [kg], centre of gravity (3,) in the flange frame [m]."""

    mass_kg: float = 0.0
    cog_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Error:
    """Error of one field in one joint while the joint moves, in the field's unit.

    range: range of the recorded values in motion. rms, p99: root mean square and 99th percentile of the error. share:
    rms divided by range. These four are None for a joint that hardly moved. rest: rms while the whole arm is at rest;
    None if it never is.
    """

    field: str
    joint: str
    unit: str
    range: float | None
    rms: float | None
    p99: float | None
    share: float | None
    rest: float | None


@dataclass(frozen=True, slots=True)
class Fidelity:
    """Result of a comparison. errors: a row for each field and joint. predicted, samples: values over time."""

    model: str
    payload: Payload
    errors: tuple[Error, ...]
    predicted: dict[str, Array]
    samples: Samples

    def worst(self, field: str) -> tuple[float, str] | None:
        """The largest `Error.share` of a field, and its joint; None if no joint moved or the field is missing."""
        shares = [(row.share, row.joint) for row in self.errors if row.field == field and row.share is not None]
        return max(shares, default=None)


def fidelity(
    recording: Recording, model: RobotModel, payload: Payload | None = None, mounted: Payload | None = None
) -> Fidelity:
    """Compare a recording of an arm with the model of that arm.

    payload: the payload set on the controller (default: as recorded, else none). mounted: the payload actually mounted,
    which affects the actual currents (default: the same). Raises RecordingError for a recording that cannot be
    compared, such as one of another arm.
    """
    samples = samples_of(recording)
    payload = payload or recorded_payload(recording)
    check_model(samples, model, payload)
    predicted = predictions(samples, model, payload, mounted or payload)
    return Fidelity(model.name, payload, tuple(_errors(samples, predicted)), predicted, samples)


def recorded_payload(recording: Recording) -> Payload:
    """The payload that was set according to the recording. Raises RecordingError if it changed."""
    if "payload" not in recording or "payload_cog" not in recording:
        return Payload()
    masses, cogs = np.asarray(recording["payload"], float), np.asarray(recording["payload_cog"], float)
    if float(np.ptp(masses)) > 1e-3:
        raise RecordingError(
            f"the payload changes from {masses.min():g} to {masses.max():g} kg: record each separately"
        )
    x, y, z = cogs[0].tolist()
    return Payload(float(masses[0]), (x, y, z))


def check_model(samples: Samples, model: RobotModel, payload: Payload) -> None:
    """Raise RecordingError if the target moments belong to another arm; the error names the arm that they fit."""
    if "target_moment" not in samples.fields:
        return
    if (deviation := _model_error(samples, model, payload)) is None:
        return
    fitting = [
        name for name in MODELS if name != model.name and _model_error(samples, load_model(name), payload) is None
    ]
    hint = f"; it fits a {' or a '.join(load_model(name).title for name in fitting)}" if fitting else ""
    raise RecordingError(
        f"target_moment differs by {deviation:.1f} Nm (rms) from that of a {model.title} with {payload.mass_kg:g} "
        f"kg{hint}: give the right --model and --payload"
    )


def _model_error(samples: Samples, model: RobotModel, payload: Payload) -> float | None:
    """Error (rms) of the target moments for this arm [Nm]; None if it is small enough."""
    rows = samples.rows(_CHECKED_STATES)
    moment = samples.fields["target_moment"][rows]
    error = moment - moments(model, payload, samples, rows, drivetrain_of(model).rotor_kg_m2)
    rms = np.sqrt((error**2).mean(axis=0))
    allowed = np.maximum(_WRONG_NM, _WRONG_SHARE * np.ptp(moment, axis=0))
    worst = int(np.argmax(rms / allowed))
    return float(rms[worst]) if rms[worst] > allowed[worst] else None


def predictions(samples: Samples, model: RobotModel, payload: Payload, mounted: Payload) -> dict[str, Array]:
    """The model's prediction for the motion: an array (n, 6) for each recorded field."""
    drives = drivetrain_of(model)
    constants = np.array(drives.torque_constants_Nm_A)
    moment = moments(model, payload, samples, slice(None), drives.rotor_kg_m2)
    needed = moment if mounted == payload else moments(model, mounted, samples, slice(None), drives.rotor_kg_m2)
    known = np.stack([drives.known_coulomb_Nm, drives.known_viscous_Nm_s, drives.known_fast_viscous_Nm_s], axis=-1)
    true = np.stack([drives.coulomb_Nm, drives.viscous_Nm_s], axis=-1)
    found = {
        "target_moment": moment,
        "target_current": (moment + samples.smooth((known_features(samples.qd) * known).sum(axis=-1))) / constants,
        "actual_current": (needed + samples.smooth((friction_features(samples.qd) * true).sum(axis=-1))) / constants,
    }
    return {name: found[name] for name in samples.fields}


def moments(
    model: RobotModel, payload: Payload, samples: Samples, rows: "slice | NDArray[np.int_]", rotors: Vector6 = ZERO6
) -> Array:
    """Torques for some rows of a motion [Nm], without friction: (k, 6)."""
    dynamics = Dynamics(model)
    dynamics.set_payload(payload.mass_kg, payload.cog_m)
    dynamics.set_rotor_inertia(rotors)
    return dynamics.inverse_dynamics_along(samples.q[rows], samples.smooth_qd[rows], samples.qdd[rows])


def _errors(samples: Samples, predicted: dict[str, Array]) -> Iterator[Error]:
    moving, resting = samples.moving, samples.resting
    for name, values in predicted.items():
        # actual currents are compared unfiltered: noise is part of a measurement
        recorded = samples.raw[name] if name == "actual_current" else samples.fields[name]
        deviation = values - recorded
        for joint, label in enumerate(JOINT_LABELS):
            rest = _rms(deviation[resting, joint]) if resting.any() else None
            if not samples.moves(joint):
                yield Error(name, label, UNITS[name], None, None, None, None, rest)
                continue
            error = deviation[moving[:, joint], joint]
            range_ = float(np.ptp(recorded[moving[:, joint], joint]))
            p99 = float(np.percentile(np.abs(error), 99.0))
            yield Error(name, label, UNITS[name], range_, _rms(error), p99, _rms(error) / max(range_, 1e-9), rest)


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def draw(result: Fidelity, path: Path, title: str) -> None:
    """Plot a column for each field and a row for each joint. path: .png, .svg or .pdf. Raises RecordingError."""
    if path.suffix.lower() not in _FORMATS:
        raise RecordingError(f"{path} is not a format of plots: choose one of {', '.join(_FORMATS)}")
    with extra("plots", "drawing"):
        from matplotlib.figure import Figure
    samples, names = result.samples, tuple(result.predicted)
    rows = samples.rows(_MAX_POINTS)
    time_s = samples.time_s[rows] - samples.time_s[0]
    figure = Figure(figsize=_SIZE_IN)
    every = figure.subplots(len(JOINT_LABELS), len(names), sharex=True, squeeze=False)
    for column, name in enumerate(names):
        recorded, predicted = samples.raw[name][rows], result.predicted[name][rows]
        every[0, column].set_title(f"{name} [{UNITS[name]}]", fontsize=9)
        for joint, axes in enumerate(every[:, column]):
            axes.plot(time_s, recorded[:, joint], **_RECORDED)
            axes.plot(time_s, predicted[:, joint], **_PREDICTED)
            axes.tick_params(labelsize=7)
            axes.margins(x=0.0)
            if not column:
                axes.set_ylabel(JOINT_LABELS[joint], fontsize=8)
    for axes in np.ravel(every[-1]):
        axes.set_xlabel("time [s]", fontsize=8)
    every[0, 0].legend(fontsize=7)
    figure.subplots_adjust(left=0.08, right=0.98, bottom=0.05, top=0.93, wspace=0.2, hspace=0.12)
    figure.suptitle(title.replace("$", r"\$"), fontsize=10)
    save_figure(figure, path, _DPI)
