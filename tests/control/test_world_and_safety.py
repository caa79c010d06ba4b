"""The verbs of the world around the arm, and of the safety system."""

from collections.abc import Callable

import pytest

from emulator.machine import ControllerConfig
from emulator.virtual import VirtualRobot
from tests.rows import each_row
from urproto.controlapi import BadArguments, NotPossible
from urproto.robots import load_model

BENT = (0.1, -1.2, 1.3, -1.7, -1.5, 0.2)


@pytest.fixture
def make() -> Callable[..., VirtualRobot]:
    def make_robot(model: str = "ur5e", **options: object) -> VirtualRobot:
        return VirtualRobot(ControllerConfig(model=load_model(model), running=True, initial_q=BENT, **options))

    return make_robot


def force_z(robot: VirtualRobot) -> float:
    robot.step(2)
    return float(robot.state(["actual_TCP_force"])["actual_TCP_force"][2])


def test_pushing_and_releasing_the_tool(make) -> None:
    robot = make()
    robot.push_tool((0.0, 0.0, 12.0, 0.0, 0.0, 0.0))
    assert force_z(robot) == pytest.approx(12.0)
    robot.release_tool()
    assert force_z(robot) == 0.0
    robot.push_tool((0.0, 0.0, 12.0, 0.0, 0.0, 0.0), "base", 0.1)
    assert force_z(robot) == pytest.approx(12.0)
    robot.step(50)
    assert force_z(robot) == 0.0


def test_objects_are_added_and_removed(make) -> None:
    robot = make()
    height = robot.state(["actual_TCP_pose"])["actual_TCP_pose"][2]
    robot.add_object("table", {"plane": {}, "pose": [0, 0, height + 0.001], "stiffness": 5000.0})
    assert robot.objects() == ["table"]
    assert force_z(robot) == pytest.approx(5.0, rel=1e-3)
    robot.move_object("table", (0.0, 0.0, height - 0.1, 0.0, 0.0, 0.0))
    assert force_z(robot) == 0.0
    robot.mount_tool({"sphere": 0.102})
    assert force_z(robot) == pytest.approx(10.0, rel=1e-3)
    robot.remove_object("table")
    assert (robot.objects(), force_z(robot)) == ([], 0.0)


@each_row(
    ("call", "complaint"),
    [
        (lambda robot: robot.add_object("x", {"cone": 1}), "cone"),
        (lambda robot: robot.add_object("x", {"sphere": "big"}), "number"),
        (lambda robot: robot.move_object("x", (0.0,) * 6), "x"),
        (lambda robot: robot.remove_object("x"), "x"),
        (lambda robot: robot.release_tool(), "hand"),
        (lambda robot: robot.push_tool((0.0,) * 6, "base", -1.0), "longer"),
        (lambda robot: robot.mount_tool({"sphere": 0.1, "stiffness": 1}), "stiffness"),
        (lambda robot: robot.mount_payload(-1.0), "mass"),
        (lambda robot: robot.trip_safety("rain"), "choose one of"),
        (lambda robot: robot.trip_safety("joint_fault", 6), "joint 6"),
    ],
)
def test_invalid_arguments_are_refused(make, call: Callable[[VirtualRobot], None], complaint: str) -> None:
    with pytest.raises(BadArguments, match=complaint):
        call(make())


def test_an_unannounced_payload_pulls_the_arm_down_until_the_drives_hold_it(make) -> None:
    robot = make(dynamic=True)
    robot.step(500)
    before = robot.state(["actual_q"])["actual_q"][1]
    robot.mount_payload(3.0, (0.0, 0.0, 0.1))
    robot.step(10)
    assert robot.state(["actual_q"])["actual_q"][1] > before + 2e-4
    robot.step(1000)
    assert robot.state(["actual_q"])["actual_q"][1] == pytest.approx(before, abs=2e-4)
    robot.mount_payload()
    robot.step(1000)
    assert robot.state(["actual_q"])["actual_q"][1] == pytest.approx(before, abs=2e-4)


def test_every_listed_cause_can_be_tripped(make) -> None:
    for cause, text in make().safety_causes().items():
        robot = make()
        robot.trip_safety(cause, 2)
        robot.step(3)
        assert robot.state(["safety_mode"])["safety_mode"] != "NORMAL", cause
        assert any(text.split()[0].split("A")[0] in line for line in robot.log(5)), cause
    assert "clamping" not in make("ur3").safety_causes()  # of the e-Series


def test_a_stop_is_analysed(make) -> None:
    robot = make()
    assert robot.last_stop() is None
    robot.jog((0.8, 0.0, 0.0, 0.0, 0.0, 0.0))
    robot.run_until("actual_qd[0] > 0.79")
    robot.press_emergency_stop()
    robot.run_until("robot_mode == POWER_OFF")
    stop = robot.last_stop()
    assert stop is not None
    assert (stop["mode"], stop["category"], stop["over"]) == ("ROBOT_EMERGENCY_STOP", 1, True)
    assert 0.0 < stop["duration_s"] < 0.1
    assert 0.0 < stop["distance_m"] < 0.05


def test_a_jog_ends_with_zeros_and_cannot_run_alongside_a_program(make) -> None:
    robot = make()
    robot.jog((0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
    robot.run_until("actual_qd[0] > 0.49")
    robot.jog((0.0,) * 6)
    robot.run_until("actual_qd[0] == 0")
    robot.send_script("def loop():\n  while True:\n    sync()\n  end\nend\n")
    robot.run_until("runtime_state == PLAYING")
    with pytest.raises(NotPossible, match="runtime_state"):
        robot.jog((0.5, 0.0, 0.0, 0.0, 0.0, 0.0))


def test_both_emergency_stops_have_to_be_released(make) -> None:
    robot = make()
    robot.press_emergency_stop("robot")
    robot.press_emergency_stop("system")
    robot.release_emergency_stop("robot")
    robot.run_until("safety_mode == SYSTEM_EMERGENCY_STOP")
    robot.release_emergency_stop()
    robot.release_brakes()
    robot.run_until("robot_mode == RUNNING and safety_mode == NORMAL")


def test_reduced_mode_and_the_arms_supply(make) -> None:
    robot = make()
    robot.set_safety_device("reduced_mode", True)
    robot.run_until("safety_mode == REDUCED")
    robot.set_safety_device("reduced_mode", False)
    robot.run_until("safety_mode == NORMAL")
    robot.set_arm_supply(False)
    robot.run_until("robot_mode == POWER_OFF and safety_mode == FAULT")
    robot.set_arm_supply(True)
    robot.restart_safety()
    robot.release_brakes()
    robot.run_until("robot_mode == RUNNING")


def test_an_arm_without_brakes_sags(make) -> None:
    robot = make(dynamic=True)
    robot.step(200)
    before = robot.state(["actual_q"])["actual_q"]
    number = robot.inject_fault("lost_brake", joint=1)
    robot.power_off()
    robot.run_until("robot_mode == POWER_OFF")
    robot.step(1000)
    after = robot.state(["actual_q"])["actual_q"]
    assert after[1] > before[1] + 0.1  # the stretched arm falls forward
    assert after[2:] == pytest.approx(before[2:], abs=0.05)
    robot.clear_fault(number)
    robot.step(1000)
    still = robot.state(["actual_q"])["actual_q"]
    robot.step(1000)
    assert robot.state(["actual_q"])["actual_q"] == pytest.approx(still, abs=1e-4)
    robot.release_brakes()
    robot.run_until("robot_mode == RUNNING")
    robot.step(500)
    assert robot.state(["actual_q"])["actual_q"] == pytest.approx(still, abs=1e-3)


def test_an_ideal_arm_cannot_lose_its_brakes(make) -> None:
    with pytest.raises(NotPossible, match="--arm dynamic"):
        make().inject_fault("lost_brake", joint=1)


def test_the_world_is_reported_as_described(make) -> None:
    robot = make()
    block = {"box": [0.1, 0.2, 0.3], "pose": [0.5, 0.1, 0.2, 0.0, 0.0, 1.0], "stiffness": 1e4, "damping": 5.0}
    robot.add_object("block", block)
    robot.add_object("ball", {"sphere": 0.05, "friction": 0.4})
    robot.add_object("table", {"plane": {}, "pose": [0, 0, -1]})
    described = robot.world()
    assert described["objects"]["block"] == {**block, "friction": 0.0}
    other = make()
    for name, description in described["objects"].items():
        other.add_object(name, description)
    assert other.world() == described


def test_the_world_reports_pushes_and_the_mounted_payload(make) -> None:
    robot = make()
    assert (robot.world()["push"], robot.world()["payload"]) == (None, None)
    robot.push_tool((1.0, 2.0, 3.0, 0.0, 0.0, 0.0), "tool")
    robot.mount_payload(0.5, (0.0, 0.0, 0.1))
    robot.mount_tool({"sphere": 0.01})
    described = robot.world()
    assert described["push"] == {"wrench": [1.0, 2.0, 3.0, 0.0, 0.0, 0.0], "frame": "tool"}
    assert described["payload"] == {"mass_kg": 0.5, "cog_m": [0.0, 0.0, 0.1]}
    assert described["tool"] == {"sphere": 0.01, "pose": [0.0] * 6}


def test_safety_devices_are_reported(make) -> None:
    robot = make()
    assert not any(robot.safety_devices().values())
    robot.open_safeguard()
    robot.press_emergency_stop("system")
    assert {name for name, active in robot.safety_devices().items() if active} == {
        "safeguard",
        "system_emergency_stop",
    }
