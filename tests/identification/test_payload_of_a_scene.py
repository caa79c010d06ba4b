"""`ur-client identify` finds the payload of a scene in the currents of the arm."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the extra physics")  # not packaged for Python 3.10

from client.identification.identify import identify
from client.recording import Recording
from emulator.virtual import virtual_robot
from tests.identification.conftest import MODEL, MOVES, NAMES
from urproto.robots import kinematics_of
from urproto.robots.pose import pose_trans
from urproto.rtde.fields import OUTPUT_FIELDS

START = (0.2, -1.4, 1.0, 0.0, 0.3, 0.1)
KG = 3.0
COG = (0.03, 0.0, 0.081)  # in the flange's frame [m]
CUP = "mounted: {cup: {suction: {output: 0, vacuum: 3, force: 2000}, pose: [0, 0, 0.05]}}\n"


def carried() -> str:
    """A box held off-centre by a suction cup, in the initial position of the arm."""
    pose = pose_trans(kinematics_of(MODEL).forward(START), (*COG, 0.0, 0.0, 0.0))
    return f"objects: {{part: {{box: [0.12, 0.12, 0.06], pose: {list(pose)}, mass: {KG}}}}}\n{CUP}"


def bolted() -> str:
    return f"mounted: {{part: {{box: [0.12, 0.12, 0.06], pose: {list(COG)}, mass: {KG}}}}}\n"


@pytest.mark.long
@pytest.mark.parametrize("scene", [carried, pytest.param(bolted, marks=pytest.mark.long)])
def test_mass_and_centre_of_a_carried_body_are_identified(tmp_path, scene):
    (file := tmp_path / "cell.yaml").write_text(scene())
    robot = virtual_robot("ur10", world=file, physics=True, running=True, arm="dynamic", initial_q=START)
    robot.controller.signals.digital_outputs |= 1
    robot.send_script(MOVES)
    states = []
    while len(states) < 10 or robot.controller.snapshot.program_running:
        robot.step()
        states.append({name: OUTPUT_FIELDS[name].read(robot.controller.snapshot) for name in NAMES})
    assert robot.controller.safety.mode.name == "NORMAL"
    recording = Recording({name: np.array([state[name] for state in states]) for name in NAMES})
    found = identify(recording, MODEL)
    assert found.controller_payload.mass_kg == 0.0
    assert found.payload is not None
    assert found.payload.mass_kg == pytest.approx(KG, rel=0.05)
    assert found.payload.cog_m == pytest.approx(COG, abs=0.05 * COG[2])
