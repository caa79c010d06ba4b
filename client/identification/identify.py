"""Identify the drives of an arm from a recording: torque constants, rotors, friction, noise, and its payload.

All parameters enter the recorded values linearly (Pinocchio's inverse dynamics and regressor), so each group is a
least-squares fit per joint. The standard errors come from a jackknife over ten pieces of the recording. Unlike the
usual formula, it does not assume that neighbouring states are independent. Parameters that the motion does not
determine keep the model's values.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from client.errors import FileError, RecordingError
from client.identification.fidelity import Payload, check_model, moments, recorded_payload
from client.identification.samples import Array, Samples, friction_features, known_features, samples_of
from client.recording.recording import Recording
from urproto.durable import write_file
from urproto.joints import JOINT_LABELS
from urproto.robots import RobotModel
from urproto.robots.drivetrain import Drivetrain
from urproto.robots.measured import drivetrain_of
from urproto.robots.pinocchio_dynamics import Dynamics

_PIECES: Final = 10
_UNCERTAIN: Final = 0.2  # of a value: a larger standard error means that the motion does not determine it
_MIN_LOAD_NM: Final = 1.0  # a joint at rest that holds less does not show its torque constant
_SIGMA_PER_MEDIAN: Final = 1.4826  # standard deviation over median absolute value of a normal distribution
_MIN_STATES: Final = 50  # states at rest
_PAYLOAD_KG: Final = 0.1  # the arm's own data may be wrong by this much


@dataclass(frozen=True, slots=True)
class Identified:
    """The identified arm.

    drives: parameters of the recorded arm where the recording determines them, otherwise the model's. errors: their
    standard errors, by the names of `Drivetrain`; None in joints that keep the model's value. kept: one line for each
    value kept from the model, with the reason. payload: the mounted payload, from the currents, beyond the one set on
    the controller; None if there is none. controller_payload: the payload set on the controller.
    """

    model: RobotModel
    drives: Drivetrain
    errors: Mapping[str, tuple[float | None, ...]]
    kept: tuple[str, ...]
    payload: Payload | None
    controller_payload: Payload
    samples: Samples

    @property
    def arm(self) -> RobotModel:
        """The model with these drives."""
        return replace(self.model, drivetrain=self.drives)

    @property
    def mounted(self) -> Payload:
        """The whole mounted payload."""
        return self.controller_payload if self.payload is None else _combined(self.payload, self.controller_payload)

    def to_mapping(self) -> dict[str, Any]:
        """The entries of an arm file, as ``ur-emulator --arm FILE`` reads it."""
        entries: dict[str, Any] = {"model": self.model.name, **_rounded(self.drives.to_mapping())}
        entries["standard_errors"] = _rounded({name: list(values) for name, values in self.errors.items()})
        entries["kept_from_the_model"] = list(self.kept)
        if self.payload is not None:
            entries["payload"] = _rounded({"mass_kg": self.payload.mass_kg, "cog_m": list(self.payload.cog_m)})
        return entries


def identify(recording: Recording, model: RobotModel, payload: Payload | None = None) -> Identified:
    """Identify an arm's drives from a recording. payload: set on the controller (default: as recorded, or none).

    Raises RecordingError if nothing can be identified: too little motion, no currents, another arm.
    """
    samples = samples_of(recording)
    controller_payload = payload or recorded_payload(recording)
    if not any(map(samples.moves, range(6))):
        raise RecordingError(
            "no joint moves at 0.1 rad/s or more for two seconds, so nothing can be identified: record a motion of "
            "ur-client excite"
        )
    check_model(samples, model, controller_payload)
    return _Fit(samples, model, controller_payload).result()


class _Fit:
    """The fits, one after the other: each builds on the results of the earlier ones."""

    def __init__(self, samples: Samples, model: RobotModel, controller_payload: Payload) -> None:
        self._samples, self._model, self._controller_payload = samples, model, controller_payload
        self._before = drivetrain_of(model)
        self._values = {name: list(values) for name, values in self._before.to_mapping().items()}
        self._errors: dict[str, list[float | None]] = {name: [None] * 6 for name in self._values}
        self._kept: list[str] = []
        self._payload: Payload | None = None

    def result(self) -> Identified:
        rigid = moments(self._model, self._controller_payload, self._samples, slice(None))
        if "target_moment" in self._samples.fields:
            self._rotors(rigid)
            if "target_current" in self._samples.fields:
                self._constants()
                self._known_friction()
            else:
                self._kept.append("target_current was not recorded: torque constants and known friction are kept")
        else:
            self._kept.append("target_moment was not recorded: rotors, torque constants and known friction are kept")
        if "actual_current" in self._samples.fields:
            self._true_friction(rigid)
            self._noise()
        else:
            self._kept.append("actual_current was not recorded: friction and noise are kept")
        if not any(error is not None for errors in self._errors.values() for error in errors):
            raise RecordingError(f"nothing can be identified: {'; '.join(self._kept)}")
        drives = Drivetrain.from_mapping(self._values)
        errors = {name: tuple(values) for name, values in self._errors.items()}
        return Identified(
            self._model, drives, errors, tuple(self._kept), self._payload, self._controller_payload, self._samples
        )

    def _rotors(self, rigid: Array) -> None:
        rest = self._samples.fields["target_moment"] - rigid
        for joint in self._moving_joints("its rotor"):
            rows = self._samples.moving[:, joint]
            self._fit(joint, ("rotor_kg_m2",), self._samples.qdd[rows, joint, None], rest[rows, joint])

    def _constants(self) -> None:
        """Torque constants from the joints' load at rest; for unloaded joints from motion, together with friction."""
        moment, current = self._samples.fields["target_moment"], self._samples.fields["target_current"]
        resting = self._samples.resting
        for joint, label in enumerate(JOINT_LABELS):
            rows = resting & (np.abs(moment[:, joint]) > _MIN_LOAD_NM)
            if rows.sum() >= _MIN_STATES:
                self._fit(joint, ("torque_constants_Nm_A",), current[rows, joint, None], moment[rows, joint])
            elif self._samples.moves(joint):
                rows = self._samples.moving[:, joint]
                friction = self._samples.smooth(known_features(self._samples.qd))[rows, joint]
                columns = np.column_stack([current[rows, joint], -friction])
                self._fit(joint, ("torque_constants_Nm_A",), columns, moment[rows, joint])
            else:
                self._kept.append(f"{label}: is not loaded and hardly moves; its torque constant is kept")

    def _known_friction(self) -> None:
        names = ("known_coulomb_Nm", "known_viscous_Nm_s", "known_fast_viscous_Nm_s")
        constants = np.array(self._values["torque_constants_Nm_A"])
        loss = self._samples.fields["target_current"] * constants - self._samples.fields["target_moment"]
        features = self._samples.smooth(known_features(self._samples.qd))
        for joint in self._moving_joints("the friction that the controller knows"):
            rows = self._samples.moving[:, joint]
            self._fit(joint, names, features[rows, joint], loss[rows, joint])

    def _true_friction(self, rigid: Array) -> None:
        """Friction, fitted with a payload unknown to the controller: a body on the last link (see Pinocchio)."""
        samples = self._samples
        rotors, constants = (np.array(self._values[name]) for name in ("rotor_kg_m2", "torque_constants_Nm_A"))
        loss = samples.fields["actual_current"] * constants - rigid - rotors * samples.qdd
        features = samples.smooth(friction_features(samples.qd))
        loss = loss - self._unknown_load(loss, features)
        for joint in self._moving_joints("its friction"):
            rows = samples.moving[:, joint]
            self._fit(joint, ("coulomb_Nm", "viscous_Nm_s"), features[rows, joint], loss[rows, joint])

    def _unknown_load(self, loss: Array, features: Array) -> Array:
        """Torques of payload unknown to the controller (n, 6); zeros if there is none."""
        samples, none = self._samples, np.zeros_like(loss)
        dynamics = Dynamics(self._model)
        rows = np.flatnonzero(samples.moving.any(axis=1))
        regressor = dynamics.last_link_regressor(samples.q[rows], samples.smooth_qd[rows], samples.qdd[rows])
        friction = np.zeros((len(rows), 6, 12))
        for joint in range(6):
            friction[:, joint, 2 * joint : 2 * joint + 2] = features[rows, joint]
        weights = 1.0 / np.maximum(loss[rows].std(axis=0), 1e-6)
        columns = np.concatenate([regressor, friction], axis=2) * weights[None, :, None]
        found, error = _least_squares(columns, loss[rows] * weights)
        mass, mass_error = float(found[0]), float(error[0])
        if mass < _PAYLOAD_KG or mass_error > _UNCERTAIN * mass:
            return none
        kg, cog = dynamics.payload_of(found[:10].tolist())
        self._payload = Payload(kg, cog)
        controller_payload = moments(self._model, self._controller_payload, samples, slice(None))
        together = moments(self._model, _combined(self._payload, self._controller_payload), samples, slice(None))
        return together - controller_payload

    def _noise(self) -> None:
        """White noise, from second differences of the recorded currents, to which motion hardly contributes."""
        raw, step = self._samples.raw["actual_current"], np.zeros(len(self._samples.time_s), bool)
        for begin, end in self._samples.parts:
            step[begin + 2 : end] = True
        second = np.zeros_like(raw)
        second[2:] = np.diff(raw, 2, axis=0) / np.sqrt(6.0)
        for name, rows_of in (
            ("rest_noise_A", self._samples.resting[:, None]),
            ("motion_noise_A", self._samples.moving),
        ):
            for joint in range(6):
                rows = np.broadcast_to(rows_of, raw.shape)[:, joint] & step
                if (count := int(rows.sum())) < _MIN_STATES:
                    self._kept.append(f"{JOINT_LABELS[joint]}: too few states for {name}, which is kept")
                    continue
                size = _SIGMA_PER_MEDIAN * float(np.median(np.abs(second[rows, joint])))  # motion has outliers
                self._values[name][joint] = size
                self._errors[name][joint] = size / np.sqrt(count / 3.0)

    def _moving_joints(self, quantity: str) -> Iterator[int]:
        for joint, label in enumerate(JOINT_LABELS):
            if self._samples.moves(joint):
                yield joint
            else:
                self._kept.append(f"{label}: hardly moves; {quantity} is kept")

    def _fit(self, joint: int, names: tuple[str, ...], columns: Array, target: Array) -> None:
        """Fit, and accept values that are certain enough. columns: (n, k); the first of them belong to ``names``."""
        found, errors = _least_squares(columns[:, None, :], target[:, None])
        for name, value, error in zip(names, found.tolist(), errors.tolist(), strict=False):
            if not np.isfinite(error) or value <= 0.0 or error > _UNCERTAIN * value:
                quantity = f"{name} ({value:.3g} +- {error:.2g})"
                self._kept.append(f"{JOINT_LABELS[joint]}: the motion does not determine {quantity}, which is kept")
            else:
                self._values[name][joint] = value
                self._errors[name][joint] = error


def write_arm(path: Path, found: Identified) -> None:
    """Write the arm file, for ``ur-emulator --arm``. Raises FileError if it cannot be written."""
    text = yaml.safe_dump(found.to_mapping(), sort_keys=False, default_flow_style=None, width=120)
    with FileError.accessing(path):
        write_file(path, text)


def _least_squares(columns: Array, target: Array) -> tuple[Array, Array]:
    """Least-squares fit (k,) of (n, m, k) to (n, m), and its standard errors; infinite for undetermined columns."""
    count = columns.shape[-1]
    used = np.flatnonzero(np.abs(columns).max(axis=(0, 1), initial=0.0) > 0.0)
    found, errors = np.zeros(count), np.full(count, np.inf)
    if len(target) < _PIECES * count:
        return found, errors
    parts = [(columns[piece][..., used], target[piece]) for piece in np.array_split(np.arange(len(target)), _PIECES)]
    squares = [np.tensordot(part, part, ((0, 1), (0, 1))) for part, _ in parts]
    products = [np.tensordot(part, values, ((0, 1), (0, 1))) for part, values in parts]
    total, product = np.sum(squares, axis=0), np.sum(products, axis=0)
    scale = np.sqrt(np.diag(total))

    def solved(square: Array, right: Array) -> Array:
        return np.asarray(np.linalg.lstsq(square / np.outer(scale, scale), right / scale, rcond=1e-9)[0] / scale)

    jackknife = np.array([solved(total - one, product - other) for one, other in zip(squares, products, strict=True)])
    spread = ((jackknife - jackknife.mean(axis=0)) ** 2).sum(axis=0) * (_PIECES - 1) / _PIECES
    found[used], errors[used] = solved(total, product), np.sqrt(spread)
    return found, errors


def _combined(one: Payload, other: Payload) -> Payload:
    mass = one.mass_kg + other.mass_kg
    x, y, z = ((one.mass_kg * a + other.mass_kg * b) / mass for a, b in zip(one.cog_m, other.cog_m, strict=True))
    return Payload(mass, (x, y, z))


def _rounded(values: Mapping[str, Any]) -> dict[str, Any]:
    """Round to four digits, more than any recording determines."""

    def rounded(value: Any) -> Any:
        if isinstance(value, list):
            return [rounded(one) for one in value]
        return value if value is None else float(f"{value:.4g}")

    return {name: rounded(value) for name, value in values.items()}
