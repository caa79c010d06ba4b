"""Helpers for the tests of recordings."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from client.recording import DEFAULT_FIELDS, Recorder, Recording
from emulator.machine import ControllerConfig
from emulator.virtual import VirtualRobot
from urproto.joints import JOINT_NAMES
from urproto.robots import load_model
from urproto.rtde.fields import OUTPUT_FIELDS

BEGAN_NS = 1_700_000_000_123_456_789
HOME = (0.2, -1.4, 1.5, -1.7, -1.5, 0.1)
GOAL = (0.5, -1.3, 1.3, -1.7, -1.4, 0.4)
INFO = {"robot": "127.0.0.1", "polyscope": "5.25"}


def moving_states(names: Iterable[str] = DEFAULT_FIELDS, seconds: float = 2.0) -> list[dict[str, Any]]:
    """RTDE states of a UR5e that moves from HOME to GOAL and back, as published by its controller."""
    names = tuple(names)
    robot = VirtualRobot(ControllerConfig(model=load_model("ur5e"), initial_q=HOME, running=True))
    robot.send_script(f"def m():\n  movej({list(GOAL)}, a=3.0, v=1.5)\n  movej({list(HOME)}, a=3.0, v=1.5)\nend\n")
    states = []
    for _ in range(round(seconds / robot.controller.period_s)):
        robot.step()
        states.append({name: OUTPUT_FIELDS[name].read(robot.controller.snapshot) for name in names})
    return states


def record(path: Path, states: Sequence[Mapping[str, Any]]) -> Path:
    """Write a file with these states."""
    with Recorder(path, states[0], INFO, now_ns=lambda: BEGAN_NS) as recorder:
        for state in states:
            recorder.write(state)
    return path


def array(states: Sequence[Mapping[str, Any]], name: str) -> Any:
    return np.array([state[name] for state in states])


def recording(time_s: Any, q: Any, **more: Any) -> Recording:
    return Recording({"timestamp": np.asarray(time_s), "target_q": np.asarray(q), **more})


def controller_state(time_s: float, actual: float, desired: float) -> SimpleNamespace:
    """A controller state with all joints at one angle and their targets at another."""
    points = {
        name: SimpleNamespace(positions=(q,) * 6, velocities=(9.0,) * 6, accelerations=(), effort=())
        for name, q in (("reference", desired), ("feedback", actual), ("error", desired - actual), ("output", desired))
    }
    return SimpleNamespace(time_s=time_s, joint_names=JOINT_NAMES, **points)
