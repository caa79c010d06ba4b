"""All functions of ur_rtde's interfaces are in docs/reference/ur_rtde_calls.md, and all names there exist."""

import importlib
import re
from pathlib import Path

import dashboard_client
import numpy as np
import pytest
import rtde_control
import rtde_io
import rtde_receive
import script_client
from rig import START_Q, Rig
from rtde_control import RTDEControlInterface

from client import Robot, RobotState
from client.robot.state import MORE_OUTPUTS, OUTPUTS
from tests.rows import each_row

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "ur_rtde_calls.md"
INTERFACES = {
    kind.__name__: kind
    for kind in (
        rtde_control.RTDEControlInterface,
        rtde_receive.RTDEReceiveInterface,
        rtde_io.RTDEIOInterface,
        dashboard_client.DashboardClient,
        script_client.ScriptClient,
    )
}
ROW = re.compile(r"^\| `(?P<name>\w+)` \| (?:—|`(?P<here>[^`]+)`) \| (?P<note>.*) \|$", re.M)
NEWEST = pytest.mark.parametrize("rig", ["ur5e"], indirect=True)
OTHER_Q = [-0.7, -1.1, 1.2, -0.6, 1.3, 0.4]
TOOL = [0.01, -0.02, 0.12, 0.1, 0.2, -0.3]


def table(interface: str) -> dict[str, tuple[str | None, str]]:
    section = PAGE.read_text("utf-8").split(f"## {interface}\n")[1].split("\n## ")[0]
    return {row["name"]: (row["here"], row["note"].strip()) for row in ROW.finditer(section)}


def exists(path: str) -> bool:
    """A path on a robot that is not connected, or of the package."""
    if match := re.fullmatch(r'robot\.state\.values\["(\w+)"\]', path):
        return match[1] in (*OUTPUTS, *MORE_OUTPUTS)
    if path.startswith("robot.state."):
        return hasattr(RobotState, path.removeprefix("robot.state."))
    if path.startswith("robot."):
        whole: object = Robot("127.0.0.1")
        for part in path.split(".")[1:]:
            if not hasattr(type(whole), part) and part not in vars(whole):
                return False
            found_in_class = getattr(type(whole), part, None)
            whole = found_in_class if isinstance(found_in_class, property) else getattr(whole, part)
        return True
    module, *names = path.split(".")
    found: object = importlib.import_module(module)
    for name in names:
        found = getattr(found, name, None) or importlib.import_module(f"{getattr(found, '__name__', module)}.{name}")
    return found is not None


@each_row("interface", INTERFACES)
def test_every_ur_rtde_function_has_an_equivalent(interface: str) -> None:
    offered = {name for name in dir(INTERFACES[interface]) if not name.startswith("_")}
    listed = table(interface)
    assert listed.keys() == offered
    for name, (here, note) in listed.items():
        assert here is not None or len(note) > 20, f"{name}: why not?"
        assert here is None or exists(here), f"{name}: there is no {here}"


@NEWEST
def test_both_libraries_report_the_same_values(rig: Rig, control: RTDEControlInterface) -> None:
    """ur_rtde's values first: its script and ours are programs of the same robot, which runs one at a time."""
    pose = control.getForwardKinematics(OTHER_Q, TOOL)
    theirs = {
        "forward": pose,
        "inverse": control.getInverseKinematics(control.getForwardKinematics(OTHER_Q, [1e-12, 0, 0, 0, 0, 0]), OTHER_Q),
        "jacobian": np.reshape(control.getJacobian(), (6, 6)).T,  # column by column; at the position of the arm
        "mass": control.getMassMatrix(),
        "offset": control.getTCPOffset(),
        "pose_trans": control.poseTrans(pose, TOOL),
    }
    control.stopScript()
    control.disconnect()
    with Robot(rig.host) as robot:
        robot.make_ready()
        kinematics = robot.kinematics
        ours = {
            "forward": kinematics.forward(OTHER_Q, TOOL),
            "inverse": kinematics.inverse(kinematics.forward(OTHER_Q), OTHER_Q),
            "jacobian": kinematics.jacobian(),
            "mass": robot.dynamics.mass_matrix(),
            "offset": robot.tcp_offset(),
            "pose_trans": kinematics.pose_trans(pose, TOOL),
        }
        for name, value in theirs.items():
            np.testing.assert_allclose(np.ravel(ours[name]), np.ravel(value), atol=1e-6, err_msg=name)
        robot.move_j([START_Q[0] + 0.1, *START_Q[1:]])
        assert robot.q == pytest.approx([START_Q[0] + 0.1, *START_Q[1:]], abs=1e-6)
