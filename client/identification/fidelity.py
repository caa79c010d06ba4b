"""Deviation of the emulator's model of an arm from a recording of a real one, by field and by joint."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from client.errors import RecordingError
from client.identification.samples import Array, Samples, friction_features, known_features, samples_of
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
