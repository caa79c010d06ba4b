"""The trace of a recording, which may be of a real arm."""

from math import inf
from typing import Final

import numpy as np
import numpy.typing as npt

from client.recording.recording import Recording
from urproto.robots import MODELS, RobotModel, kinematics_of, load_model
from urproto.robots.pose import pose_inv, pose_trans
from urproto.trace.model import Trace

_SAMPLES: Final = 50  # of a recording, by which its arm is recognised
_ALIKE_M: Final = 0.02  # guess: calibrated arms differ by millimetres from nominal ones, models by centimetres


def trace_of(
    recording: Recording,
    title: str,
    model: RobotModel | None = None,
    first_s: float = 0.0,
    last_s: float = inf,
) -> Trace:
    """The trace of a recording between two uptimes of the robot [s]. model: the arm; None to recognise it."""
    model = model or recognised(recording)
    version = recording.info.get("polyscope", "")
    about = ", ".join(filter(None, (model.title if model else "unknown arm", version and f"PolyScope {version}")))
    trace = Trace(title, about, model)
    begin_s = float(recording["timestamp"][0])
    for time_s, state in zip((begin_s + recording.time_s).tolist(), recording.states(), strict=True):
        if not first_s <= time_s <= last_s:
            continue
        trace.add(time_s, state)
        if "script_control_line" in state:
            trace.state("Program line", time_s, str(state["script_control_line"] or ""))
    trace.finish()
    return trace


def recognised(recording: Recording) -> RobotModel | None:
    """The arm that was recorded; None if the recording lacks joint angles or poses, or if no arm fits them."""
    if not {"actual_q", "actual_TCP_pose"} <= recording.values.keys():
        return None
    both = np.hstack((recording["actual_q"], recording["actual_TCP_pose"]))
    both = both[np.isfinite(both).all(axis=1)]
    return arm_of(both[:, :6], both[:, 6:])


def arm_of(q_rad: npt.ArrayLike, tcp_poses: npt.ArrayLike) -> RobotModel | None:
    """The arm whose flange, by its kinematics, keeps its distance from the TCP; None if none does.

    q_rad, tcp_poses: arrays (n, 6), at the same times.
    """
    q, pose = np.asarray(q_rad), np.asarray(tcp_poses)
    if not len(q):
        return None
    rows = np.linspace(0, len(q) - 1, _SAMPLES).astype(int)
    q, pose = q[rows], pose[rows]

    def distance_m(model: RobotModel) -> tuple[float, float]:
        """From flange to TCP: by how much it changes, and what it is."""
        forward = kinematics_of(model).forward
        offsets = np.array([pose_trans(pose_inv(forward(a)), b)[:3] for a, b in zip(q, pose, strict=True)])
        middle = offsets.mean(axis=0)
        return round(float(np.linalg.norm(offsets - middle, axis=1).max()), 3), float(np.linalg.norm(middle))

    best = min(MODELS, key=lambda name: distance_m(load_model(name)))
    return load_model(best) if distance_m(load_model(best))[0] < _ALIKE_M else None
