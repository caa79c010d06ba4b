"""The third table of docs/reference/fidelity.md: what real arms report at rest beside the emulator's dynamic arm."""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from client.recording.recording import Recording
from emulator.config import controller_config
from emulator.controller import Controller

_STATES: Final = 500
# field, its unit, and what is compared of its numbers
_FIELDS: Final = (
    ("actual_main_voltage", "V"),
    ("actual_robot_voltage", "V"),
    ("actual_joint_voltage", "V"),
    ("actual_robot_current", "A"),
    ("actual_current", "A"),
    ("joint_control_output", "A"),
    ("actual_tool_accelerometer", "m/s2"),
    ("actual_momentum", "kg m/s"),
    ("actual_TCP_force", "N, Nm"),
    ("actual_qd", "rad/s"),
    ("actual_TCP_speed", "m/s, rad/s"),
    ("speed_scaling", ""),
)


def at_rest(recording: Recording, model: str) -> Iterator[tuple[str, str, str, str]]:
    """field, its means in the recording and in the emulator, noise in both (standard deviations; of vectors: means).

    Vectors are shown as their length where they are one, else as the mean of their numbers' sizes.
    """
    ours = _emulated(recording, model)
    for name, unit in _FIELDS:
        if name not in recording:
            continue
        theirs = np.asarray(recording[name], float)
        theirs = theirs[np.isfinite(theirs.reshape(len(theirs), -1)).all(axis=1)]
        both = [_figures(name, array) for array in (theirs, ours[name])]
        means = " / ".join(f"{mean:.4g}" for mean, _ in both)
        noises = " / ".join(f"{noise:.2g}" for _, noise in both)
        yield name, unit, means, noises


def _figures(name: str, values: "np.ndarray[tuple[int, ...], np.dtype[np.float64]]") -> tuple[float, float]:
    mean, noise = values.mean(axis=0), float(np.mean(values.std(axis=0)))
    if name == "actual_tool_accelerometer":
        return math.hypot(*mean), noise
    return float(np.mean(np.abs(mean))), noise


def _emulated(recording: Recording, model: str) -> "dict[str, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]":
    joints = tuple(np.asarray(recording["actual_q"], float)[0].tolist())
    controller = Controller(controller_config(model, arm="dynamic", running=True, initial_q=joints))
    values: dict[str, list[object]] = {name: [] for name, _ in _FIELDS}
    for _ in range(2 * _STATES):
        controller.tick()
        for name in values:
            values[name].append(getattr(controller.snapshot, name))
    return {name: np.array(column[_STATES:], float) for name, column in values.items()}
