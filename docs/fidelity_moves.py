"""The second table of docs/reference/fidelity.md: movements of real arms beside the emulator's. See fidelity_table.py.

Moves are found between rests, and the emulator is given what the recording shows of each: where it begins and ends, its
highest speed and its acceleration. What it does with them is then compared period by period.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from client.recording.recording import Recording
from emulator.lifecycle.runstate import START_S
from emulator.motion import Motion
from urproto.robots import RobotModel, kinematics_of
from urproto.robots.pose import rotvec_to_matrix
from urproto.vectors import as_six, rotate_back, sub3

Array = NDArray[np.float64]

_SYNCHRONOUS_RAD_S: Final = 1e-3  # joints of a movej keep step
_SHORTEST_PERIODS: Final = 20
_LONGEST_PERIODS: Final = 5000
_PHASES: Final = 81


@dataclass(frozen=True, slots=True)
class Compared:
    """Of one kind of move: how many, the largest error of a duration [share], of a place on the way, and its unit."""

    moves: int
    duration: float
    place: float
    unit: str


def movej_by_targets(recordings: Iterator[Recording], model: RobotModel) -> Compared | None:
    """movej where targets were recorded; None without one. What is not one movej between two rests is left out."""
    durations, places = [], []
    for recording in recordings:
        period_s = float(np.median(np.diff(recording["timestamp"])))
        for begin, end in _moves(recording["target_qd"]):
            q, qd, qdd = (recording[name][begin : end + 1] for name in ("target_q", "target_qd", "target_qdd"))
            way = q[-1] - q[0]
            lead = int(np.argmax(np.abs(way)))
            keep_step = np.abs(qd - qd[:, [lead]] * (way / way[lead])).max() < _SYNCHRONOUS_RAD_S
            if len(q) < _SHORTEST_PERIODS or not keep_step or np.ptp(np.diff(recording["timestamp"])[begin:end]) > 1e-3:
                continue
            speed, rate = float(np.abs(qd[:, lead]).max()), float(np.abs(qdd[:, lead]).max())
            if speed > model.qd_max[lead]:
                continue  # a controller that lets its joints go faster than the manual says
            ours = _movej(model, period_s, q[0], q[-1], speed, rate)
            durations.append(abs(len(ours) / len(q) - 1.0))
            shared = min(len(ours), len(q))
            places.append(float(np.abs(ours[:shared] - q[:shared]).max()))
    return Compared(len(places), max(durations), 1e3 * max(places), "mrad") if places else None


def movej_by_angles(recording: Recording, model: RobotModel) -> Compared | None:
    """Durations of movej where only angles were recorded: from and to where the straight ramps of speed reach zero."""
    time_s, q, qd = recording["timestamp"], recording["actual_q"], recording["actual_qd"]
    durations = []
    for begin, end in _moves(np.where(np.abs(qd) < 0.01, 0.0, qd)):
        lead = int(np.argmax(np.abs(qd[begin:end]).max(axis=0)))
        speed = np.abs(qd[begin:end, lead])
        top = float(np.median(speed[speed > 0.9 * speed.max()]))
        ramp = np.flatnonzero((speed > 0.25 * top) & (speed < 0.9 * top))
        middle = int(np.argmax(speed > 0.95 * top))
        up, down = ramp[ramp < middle], ramp[ramp > middle]
        if min(len(up), len(down)) < 5 or (speed > 0.97 * top).sum() < 10:
            continue
        (rate, up_at), (_, down_at) = (np.polyfit(time_s[begin + i], speed[i], 1) for i in (up, down))
        first, last = -up_at / rate, -down_at / float(np.polyfit(time_s[begin + down], speed[down], 1)[0])
        way = abs(float(np.interp(last, time_s, q[:, lead]) - np.interp(first, time_s, q[:, lead])))
        start = q[begin]
        goal = start.copy()
        goal[lead] += way if abs(start[lead] + way) < 6.2 else -way
        ours = (len(_movej(model, model.series.period_s, start, goal, top, float(rate))) - 1) * model.series.period_s
        durations.append(abs(ours / (last - first) - 1.0))
    return Compared(len(durations), max(durations), float("nan"), "") if durations else None


def movej_without_rests(recording: Recording, model: RobotModel, speed: float, rate: float) -> Compared | None:
    """movej that follow each other at once: what lies between two periods in which the arm all but stands.

    When in its control period the arm was seen is not known: of all times, the best counts.
    """
    period_s = float(np.median(np.diff(recording["timestamp"])))
    q, qd = recording["target_q"], recording["target_qd"]
    pace = np.abs(qd).max(axis=1)
    lows = [k for k in range(1, len(pace) - 1) if pace[k - 1] >= pace[k] < pace[k + 1] and pace[k] < rate * period_s]
    durations, places = [], []
    for begin, end in pairwise(lows):
        start, goal = _rest_by(q, qd, begin, rate), _rest_by(q, qd, end, rate)
        path = _movej(model, model.series.period_s, start, goal, speed, rate)
        theirs, times = q[begin + 1 : end], model.series.period_s * np.arange(len(path))
        errors = []
        for late in np.linspace(0.0, 2.0 * period_s, _PHASES):
            seen = late + period_s * np.arange(len(theirs))
            errors.append(max(float(np.abs(np.interp(seen, times, path[:, j]) - theirs[:, j]).max()) for j in range(6)))
        places.append(min(errors))
        durations.append(abs(len(path) * model.series.period_s / ((end - begin) * period_s) - 1.0))
    return Compared(len(places), max(durations), 1e3 * max(places), "mrad") if places else None


def _rest_by(q: Array, qd: Array, k: int, rate: float) -> Array:
    """Where the arm stands beside state k, in which it hardly moves: by its deceleration, or acceleration."""
    fastest = float(np.abs(qd[k]).max())
    way = 0.5 * qd[k] * fastest / rate
    return q[k] + way if np.abs(qd[k - 1]).max() > np.abs(qd[k + 1]).max() else q[k] - way


def movel_with_its_program(
    distances: Array, start: Array, goal: Array, model: RobotModel, speed: float, rate: float, first: int = 0
) -> Compared:
    """A movel that begins with its program. distances: along the way [m], one a period, from period ``first`` on."""
    period_s = model.series.period_s
    gain = round(START_S / period_s)
    motion = Motion(model, period_s, as_six(start))
    origin = motion.target.reach.pose(motion.q)
    motion.commands.movel(as_six(goal), a=rate, v=speed)
    ours = [0.0]
    while not motion.idle or len(ours) == 1:
        motion.advance(min(1.0, len(ours) / gain))
        here = motion.target.reach.pose(motion.q)
        ours.append(float(np.linalg.norm(np.subtract(here[:3], origin[:3]))))
        if len(ours) > _LONGEST_PERIODS:
            break
    theirs = distances[: int(np.argmax(distances > distances[-1] - 1e-9)) + 1]
    shared = min(len(ours) - first, len(theirs))
    off = float(np.abs(np.array(ours[first : first + shared]) - theirs[:shared]).max())
    return Compared(1, abs((len(ours) - first) / len(theirs) - 1.0), 1e3 * off, "mm")


def tool_spread(q: Array, poses: Array, model: RobotModel) -> float:
    """How far the tool that the recorded poses show at nominal angles wanders in the flange [mm, rms].

    0 for an arm without calibration; a real one's lengths are not nominal.
    """
    kinematics = kinematics_of(model)
    tools = []
    for angles, pose in zip(q.tolist(), poses.tolist(), strict=True):
        flange = kinematics.forward(as_six(angles))
        tools.append(rotate_back(rotvec_to_matrix(*flange[3:]), sub3(as_six(pose), flange)))
    array = np.array(tools)
    return 1e3 * float(np.sqrt(((array - array.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _moves(speeds: Array) -> Iterator[tuple[int, int]]:
    """The rest before each movement and the one after it."""
    moving = np.concatenate(([False], (np.abs(speeds) > 1e-9).any(axis=1), [False]))
    edges = np.flatnonzero(np.diff(moving.astype(int)))
    for begin, end in edges.reshape(-1, 2).tolist():
        if begin > 0 and end < len(speeds):
            yield begin - 1, end


def _movej(model: RobotModel, period_s: float, start: Array, goal: Array, speed: float, rate: float) -> Array:
    motion = Motion(model, period_s, as_six(start))
    motion.commands.movej(as_six(goal), a=rate, v=speed)
    path = [motion.q]
    while len(path) < _LONGEST_PERIODS:
        motion.advance(1.0)
        path.append(motion.q)
        if motion.idle:
            break
    return np.array(path)
