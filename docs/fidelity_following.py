"""The tables of docs/reference/fidelity.md on angles: how real arms and the emulator's follow targets.

The dynamic arm is given the recorded targets, and is pushed as the recorded one was while it stood: by what its
currents had beyond the target currents.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from client.recording.recording import Recording
from emulator.robot.arm import Arm
from emulator.robot.installation import Installation
from urproto.joints import JOINT_LABELS
from urproto.robots import RobotModel
from urproto.robots.measured import drivetrain_of
from urproto.vectors import ZERO6, as_six

Array = NDArray[np.float64]

_MOVING_RAD_S: Final = 0.05
_FEWEST: Final = 100  # states of a joint in motion
_EVEN_RAD_S2: Final = 0.01  # an acceleration: less is a constant speed
_BEGUN_S: Final = 0.5  # a recording may begin in motion, or pushed: the emulator's arm begins at rest
_SMOOTHED: Final = 5  # states: what is left of noise does not hide a deviation
_SECOND_DIFFERENCE: Final = 6.0**0.5  # of white noise, in its standard deviations
_PUSHED_NM: Final = 3.0  # a push that shows


def following(recording: Recording, model: RobotModel) -> Iterator[tuple[str, str]]:
    """What is compared, and its numbers in recording and emulator: base, shoulder, elbow; wrists.

    Lag: the part of the deviation that is in proportion to the target's speed. Deviation: the 99th percentile of what
    is beyond half a millisecond of lag. Noise: of second differences at constant speed.
    """
    targets, ours = recording["target_q"], _emulated(recording, model)
    speeds = recording["target_qd"]
    theirs = recording["actual_q"], recording["actual_qd"]
    tables = [[table[_begun(recording) :] for table in (targets, speeds, q, qd)] for q, qd in (theirs, ours)]
    both = [[_joint(*(table[:, joint] for table in arm)) for joint in range(6)] for arm in tables]
    for column, (what, unit, scale) in enumerate(
        (("lag", "ms", 1e3), ("deviation", "mrad", 1e3), ("noise of angles", "urad", 1e6), ("of speeds", "mrad/s", 1e3))
    ):
        cells = []
        for joints in (range(3), range(3, 6)):
            values = [[arm[j][column] for j in joints] for arm in both]
            if not np.isfinite(values).any():
                continue
            cells.append(" / ".join(_short(scale * float(np.nanmean(value))) for value in values) + f" {unit}")
        yield what, "; ".join(cells)


def pushed(recording: Recording, model: RobotModel) -> Iterator[tuple[str, float, float, float]]:
    """Of joints that were pushed while the arm stood: name, push [Nm], largest deviations of both, smoothed [mrad]."""
    constants = np.array(drivetrain_of(model).torque_constants_Nm_A)
    push = (recording["actual_current"] - recording["target_current"]) * constants
    push = -(push - np.median(push, axis=0))
    q, _ = _emulated(recording, model, push)
    begun = _begun(recording)
    for joint in range(6):
        if np.ptp(push[:, joint]) < _PUSHED_NM:
            continue
        found = [
            1e3 * float(np.percentile(np.abs(_smooth((recording["target_q"] - angles)[begun:, joint])), 99.9))
            for angles in (recording["actual_q"], q)
        ]
        yield JOINT_LABELS[joint], float(np.ptp(push[:, joint])), found[0], found[1]


def _short(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"


def _joint(target: Array, speed: Array, q: Array, qd: Array) -> tuple[float, float, float, float]:
    moving = np.abs(speed) > _MOVING_RAD_S
    if moving.sum() < _FEWEST:
        return (np.nan,) * 4
    off = target - q
    lag = float(off[moving] @ speed[moving] / (speed[moving] @ speed[moving]))
    deviation = float(np.percentile(np.abs(_smooth(off - 0.0005 * speed)[moving]), 99.0))
    period_s = float(np.median(np.abs(np.diff(target))[moving[1:]] / np.abs(speed[1:])[moving[1:]]))
    even = np.abs(np.gradient(speed)) < _EVEN_RAD_S2 * period_s
    even &= moving
    steady = even[2:] & even[1:-1] & even[:-2]
    noises = [float(np.std(np.diff(values, 2)[steady]) / _SECOND_DIFFERENCE) for values in (off, qd - speed)]
    return lag, deviation, noises[0], noises[1]


def _begun(recording: Recording) -> int:
    return round(_BEGUN_S / float(np.median(np.diff(recording["timestamp"]))))


def _smooth(values: Array) -> Array:
    return np.convolve(values, np.ones(_SMOOTHED) / _SMOOTHED, "same")


def _emulated(recording: Recording, model: RobotModel, push: Array | None = None) -> tuple[Array, Array]:
    """Angles and speeds that the dynamic arm tells."""
    arm, installation = Arm(model, seed=0), Installation()
    period_s = float(np.median(np.diff(recording["timestamp"])))
    targets = recording["target_q"], recording["target_qd"], recording["target_qdd"]
    q, qd = [], []
    for k, (angles, speeds, rates) in enumerate(zip(*(table.tolist() for table in targets), strict=True)):
        arm.link_torque = ZERO6 if push is None else as_six(push[k].tolist())
        motion = (as_six(angles), as_six(speeds), as_six(rates))
        arm.update(motion, installation, ZERO6, period_s, driven=True)
        q.append(arm.measured_q)
        qd.append(arm.measured_qd)
    return np.array(q), np.array(qd)
