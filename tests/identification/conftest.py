"""Recordings in virtual time of an arm with drives that exist only in these tests."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from client.recording import Recording
from emulator.machine import ControllerConfig
from emulator.virtual import VirtualRobot
from urproto.robots import load_model
from urproto.robots.measured import drivetrain_of
from urproto.rtde.fields import OUTPUT_FIELDS

MODEL = load_model("ur10")
DRIVES = replace(
    drivetrain_of(MODEL),
    torque_constants_Nm_A=(13.0, 13.5, 12.0, 10.0, 11.0, 9.0),
    rotor_kg_m2=(5.0, 4.5, 1.5, 0.4, 0.5, 0.6),
    coulomb_Nm=(11.0, 14.0, 6.0, 3.0, 2.5, 2.0),
    viscous_Nm_s=(18.0, 22.0, 9.0, 4.0, 3.0, 2.0),
    known_coulomb_Nm=(10.0, 15.0, 5.0, 3.0, 2.0, 2.5),
    known_viscous_Nm_s=(25.0, 20.0, 12.0, 4.0, 3.0, 5.0),
    known_fast_viscous_Nm_s=(10.0, 9.0, 6.0, 2.0, 1.5, 3.0),
)
ARM = replace(MODEL, drivetrain=DRIVES)
NAMES = (
    *("timestamp", "target_q", "target_qd", "target_qdd", "actual_q", "actual_qd"),
    *("target_moment", "target_current", "actual_current", "payload", "payload_cog"),
)
MOVES = """def moves():
  sleep(1)
  movej([-0.8, -1.0, 0.4, 0.5, 0.9, 1.0], a=3, v=1.2)
  movej([0.7, -1.9, 1.7, -1.5, -0.9, -0.8], a=2, v=1.0)
  movej([-0.3, -0.6, 0.8, -0.5, 0.1, 0.1], a=4, v=1.4)
  movej([0.9, -1.7, 1.9, -1.0, 0.2, -1.0], a=3, v=0.4)
  movej([-0.9, -0.3, 0.5, 0.0, -1.1, 0.5], a=1.5, v=1.1)
  movej([0.2, -1.5, 1.2, -0.6, 1.0, -0.5], a=4, v=1.3)
  movej([-0.6, -1.0, 1.9, 0.8, -0.6, 0.9], a=2, v=0.3)
  sleep(1)
end
"""


def recorded(script: str, payload: str = "") -> dict[str, np.ndarray]:
    """Published states of the arm until the program ends, one per control period."""
    robot = VirtualRobot(
        ControllerConfig(model=ARM, initial_q=(0.2, -1.4, 1.0, 0.0, 0.3, 0.1), running=True, dynamic=True)
    )
    robot.send_script(script.replace("():\n", f"():\n  {payload}\n", 1))
    states = []
    while len(states) < 10 or robot.controller.snapshot.program_running:
        robot.step()
        states.append({name: OUTPUT_FIELDS[name].read(robot.controller.snapshot) for name in NAMES})
    return {name: np.array([state[name] for state in states]) for name in NAMES}


@pytest.fixture(scope="session")
def motion() -> dict[str, np.ndarray]:
    return recorded(MOVES)


def without(values: dict[str, np.ndarray], *names: str) -> Recording:
    return Recording({name: array for name, array in values.items() if not name.startswith(names)} if names else values)


def saved(path: Path, values: dict[str, np.ndarray], names: tuple[str, ...], head: str = "") -> Path:
    """A .csv file with these values; head: its first line, if any."""
    table = np.column_stack([values[name] for name in names])
    np.savetxt(path, table, delimiter=",", header=head, comments="", fmt="%.9g")
    path.write_text(path.read_text().removeprefix("\n"))
    return path
