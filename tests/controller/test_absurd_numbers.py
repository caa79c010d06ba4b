"""Numbers that are impossible for an arm are refused at every interface."""

import math
from functools import partial

import pytest

from emulator.control.verbs import verbs_of
from emulator.machine import ControllerConfig
from emulator.safety.files import load_safety_file
from emulator.virtual import VirtualRobot
from emulator.world.file import read_world
from tests.rows import each_row
from urproto.controlapi import BadArguments, NotPossible
from urproto.primary.messages import TextMessage
from urproto.robots import load_model
from urproto.worldfile import WorldFileError
from urscript.polyscope.safety_section import SafetySettingsError

BAD = [math.nan, math.inf, -math.inf, 1e155, -1e200]
SIX = (0.0,) * 5
CALLS = {
    "set_payload": lambda bad: {"mass_kg": abs(bad)},
    "set_payload, cog": lambda bad: {"mass_kg": 1.0, "cog_m": (bad, 0.0, 0.0)},
    "set_tcp": lambda bad: {"pose": (bad, *SIX)},
    "set_gravity": lambda bad: {"acceleration_m_s2": (0.0, 0.0, bad)},
    "set_joints": lambda bad: {"q_rad": (bad, *SIX)},
    "push_tool": lambda bad: {"wrench": (bad, *SIX)},
    "mount_payload": lambda bad: {"mass_kg": abs(bad)},
    "jog": lambda bad: {"qd_rad_s": (bad, *SIX)},
    "set_speed_slider": lambda bad: {"fraction": bad},
    "set_analog_input": lambda bad: {"index": 0, "value": bad},
    "set_analog_output": lambda bad: {"index": 0, "ratio": bad},
    "set_encoder_speed": lambda bad: {"index": 0, "ticks_per_s": bad},
    "move_object": lambda bad: {"name": "wall", "pose": (bad, *SIX)},
}


@each_row("bad", BAD)
@each_row("call", CALLS)
@each_row("by_name", [False, True])
def test_verbs_refuse_absurd_numbers(call, bad, by_name):
    robot = VirtualRobot(ControllerConfig(model=load_model("ur3"), running=True))
    robot.step()
    before = robot.controller.snapshot.values()
    name, arguments = call.split(",")[0], CALLS[call](bad)
    call_verb = partial(verbs_of(VirtualRobot.SUBJECTS)[name].call, robot, arguments)
    with pytest.raises((BadArguments, NotPossible)):
        call_verb() if by_name else getattr(robot, name)(**arguments)
    robot.step(20)
    after = robot.controller.snapshot.values()
    changed = {key for key in after if after[key] != before[key]}
    assert changed <= {"step", "timestamp", "actual_robot_energy_consumed"}


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "1e999", "fast"])
def test_the_slider_accepts_only_finite_numbers(rig, text):
    rig.script("set speed 0.5")
    rig.tick()
    rig.script(f"set speed {text}")
    assert rig.tick().target_speed_fraction == 0.5
    assert rig.messages_of(TextMessage) == []
    assert "ignored: give a number" in rig.controller.messages.history[-1]


@each_row("bad", [".nan", ".inf", "1.0e+155"])
def test_a_world_file_with_absurd_numbers_is_refused(tmp_path, bad):
    path = tmp_path / "world.yaml"
    for shape in (f"box: [1, 1, {bad}]", f"sphere: {bad}", f"box: [1, 1, 1]\n    pose: [0, {bad}, 0]"):
        path.write_text(f"objects:\n  wall:\n    {shape}\n")
        with pytest.raises(WorldFileError):
            read_world(path)


@pytest.mark.parametrize("bad", [".nan", ".inf"])
def test_a_safety_file_with_absurd_numbers_is_refused(tmp_path, bad):
    path = tmp_path / "safety.yaml"
    path.write_text(f"normal:\n  tool_speed: {bad}\n")
    with pytest.raises(SafetySettingsError):
        load_safety_file(path, load_model("ur3"))
