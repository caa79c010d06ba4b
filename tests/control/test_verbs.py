"""The verbs on a robot in virtual time."""

import ast
import inspect
import json
import math
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

from emulator.control import control
from emulator.control.control import Control, LiveControl, PortVerbs
from emulator.control.verbs import verbs_of
from emulator.machine import ControllerConfig
from emulator.servers.admission import Reason, RejectedClients
from emulator.virtual import VirtualRobot
from tests.rows import each_row
from urproto.controlapi import BadArguments, NotPossible
from urproto.robots import load_model
from urproto.versions import PolyscopeVersion

UP = (0.0, -1.57, 0.0, -1.57, 0.0, 0.0)
BENT = (0.1, -1.2, 1.0, -1.4, -1.5, 0.2)
VERBS = verbs_of(Control.SUBJECTS)


@pytest.fixture(params=["ur3", "ur5e"])
def robot(request: pytest.FixtureRequest) -> VirtualRobot:
    return VirtualRobot(ControllerConfig(model=load_model(request.param), running=True))


def field(robot: VirtualRobot, name: str) -> object:
    robot.step()
    return robot.state([name])[name]


def test_power_on_to_the_end_of_a_move() -> None:
    robot = VirtualRobot(ControllerConfig(model=load_model("ur3")))
    robot.release_brakes()
    robot.run_until("robot_mode == RUNNING")
    assert robot.send_script("def go():\n  movej([0, -1, 1, 0, 0, 0], t=2)\nend\n")
    began = robot.run_until("runtime_state == PLAYING")
    assert robot.run_until("runtime_state == STOPPED") - began == pytest.approx(2.0, abs=0.1)
    assert robot.state(["actual_q"]) == {"actual_q": pytest.approx([0, -1, 1, 0, 0, 0])}


def test_steps_are_control_periods(robot: VirtualRobot) -> None:
    before = robot.time()["time_s"]
    assert robot.step(500) == pytest.approx(before + 500 * robot.time()["period_s"])


@each_row(
    ("condition", "complaint"),
    [
        ("robot_mode", "is not a condition"),
        ("arm == 1", "there is no field arm"),
        ("values == 1", "there is no field values"),
        ("robotmode == RUNNING", "no field robotmode"),
        ("actual_q[6] > 0", r"no field actual_q\[6\]"),
        ("timestamp[0] > 0", r"no field timestamp\[0\]"),
        ("robot_mode == WALKING", "one of .*RUNNING"),
        ("timestamp > soon", "give a number"),
    ],
)
def test_an_invalid_condition_is_explained(robot: VirtualRobot, condition: str, complaint: str) -> None:
    with pytest.raises(BadArguments, match=complaint):
        robot.run_until(condition)


def test_waiting_for_an_unmet_condition_times_out(robot: VirtualRobot) -> None:
    before = robot.time()["time_s"]
    with pytest.raises(NotPossible, match="within 2 s"):
        robot.run_until("robot_mode == POWER_OFF and timestamp > 0", timeout_s=2.0)
    assert robot.time()["time_s"] == pytest.approx(before + 2.0)


def test_virtual_time_has_no_speed(robot: VirtualRobot) -> None:
    with pytest.raises(NotPossible):
        robot.set_speed(2.0)


def test_emergency_stop_and_recovery(robot: VirtualRobot) -> None:
    robot.press_emergency_stop("system")
    assert field(robot, "safety_mode") == "SYSTEM_EMERGENCY_STOP"
    with pytest.raises(NotPossible, match="SYSTEM_EMERGENCY_STOP"):
        robot.release_brakes()
    robot.release_emergency_stop()
    robot.release_brakes()
    robot.run_until("robot_mode == RUNNING and safety_mode == NORMAL")


def test_a_safeguard_stop_pauses_the_program_and_resumes_it(robot: VirtualRobot) -> None:
    robot.set_joints(UP)
    robot.send_script("def go():\n  movej([0, -1, 1, 0, 0, 0], t=2)\nend\n")
    robot.run_until("runtime_state == PLAYING")
    robot.open_safeguard()
    robot.run_until("safety_mode == SAFEGUARD_STOP and runtime_state == PAUSED")
    robot.close_safeguard()
    robot.step(10)
    assert robot.state(["safety_mode"])["safety_mode"] == "SAFEGUARD_STOP", "an input of a new robot is for its reset"
    robot.reset_safeguard()
    robot.run_until("runtime_state == STOPPED")
    assert robot.state(["actual_q"])["actual_q"] == pytest.approx([0, -1, 1, 0, 0, 0])


def test_inputs_outputs_and_registers(robot: VirtualRobot) -> None:
    robot.set_digital_input(3, True)
    robot.set_digital_input(1, True, "tool")
    robot.set_digital_output(2, True, "configurable")
    robot.set_analog_input(1, 0.012, "current")
    robot.set_input_register("double", 7, 2.5)
    robot.set_input_register("int", 8, -3)
    robot.set_input_register("bit", 70, True)
    assert field(robot, "actual_digital_input_bits") == 1 << 3 | 1 << 17
    assert field(robot, "actual_digital_output_bits") == 1 << 10
    assert field(robot, "standard_analog_input1") == 0.012
    assert field(robot, "analog_io_types") == 0b01
    assert robot.state(["input_double_registers"])["input_double_registers"][7] == 2.5
    assert robot.state(["input_int_registers"])["input_int_registers"][8] == -3
    assert robot.state(["input_bit_registers"])["input_bit_registers"] == 1 << 70


@each_row(
    ("verb", "arguments", "complaint"),
    [
        ("set_digital_input", {"index": 8, "level": True}, "standard digital signal 8"),
        ("set_digital_input", {"index": 1, "level": True, "group": "tools"}, "group"),
        ("set_digital_input", {"index": 1}, "level"),
        ("set_digital_input", {"index": 1, "level": True, "colour": 1}, "colour"),
        ("set_analog_input", {"index": 2, "value": 1.0}, "analog input 2"),
        ("set_input_register", {"kind": "int", "index": 1, "value": 2**40}, "32 bits"),
        ("set_input_register", {"kind": "int", "index": 1, "value": 1.5}, "1.5"),
        ("set_input_register", {"kind": "double", "index": 48, "value": 1}, "register 48"),
        ("set_input_register", {"kind": "double", "index": 1, "value": math.inf}, "finite"),
        ("set_joints", {"q_rad": [0.0] * 5}, "q_rad"),
        ("set_joints", {"q_rad": [0.0, 0.0, math.nan, 0.0, 0.0, 0.0]}, "finite"),
        ("set_payload", {"mass_kg": -1.0}, "negative"),
        ("set_speed_slider", {"fraction": 1.5}, "0 to 1"),
        ("set_encoder_speed", {"index": 2, "ticks_per_s": 1.0}, "encoder 2"),
        ("set_speed", {"speed": -1.0}, "-1"),
        ("step", {"periods": 0}, "at least 1"),
        ("state", {"names": ["actual_Q"]}, "actual_q"),
    ],
)
def test_invalid_arguments_change_nothing(
    robot: VirtualRobot, verb: str, arguments: dict[str, object], complaint: str
) -> None:
    before = robot.state()
    with pytest.raises(BadArguments, match=complaint):
        VERBS[verb].call(robot, arguments)
    assert robot.state() == before


def test_a_moving_arm_cannot_be_repositioned(robot: VirtualRobot) -> None:
    robot.send_script("def go():\n  movej([0, -1, 1, 0, 0, 0], t=2)\nend\n")
    robot.run_until("actual_qd[2] > 0.1")
    with pytest.raises(NotPossible, match="moving"):
        robot.set_joints(UP)


def test_the_dashboard_and_the_log(robot: VirtualRobot) -> None:
    assert robot.dashboard("robotmode") == "Robotmode: RUNNING"
    assert robot.dashboard("stop") == "Stopped"
    assert not robot.send_script("def broken(:\nend\n")
    assert "syntax error" in robot.log(1)[0]
    assert robot.log(0) == []


def test_questions_are_answered(robot: VirtualRobot) -> None:
    robot.send_script(
        'def ask():\n  global n = request_integer_from_primary_client("how many?")\n'
        "  while True:\n    sync()\n  end\nend\n"
    )
    robot.step(5)
    (question,) = robot.popups()
    assert (question["text"], question["type"]) == ("how many?", "INTEGER")
    with pytest.raises(NotPossible):
        robot.answer_popup(question["id"], "many")
    robot.answer_popup(question["id"], 3)
    robot.step(5)
    assert robot.variables()["n"] == "3"
    with pytest.raises(NotPossible, match="no popup"):
        robot.answer_popup(question["id"], 3)


class TestSnapshots:
    def test_a_state_survives_in_a_file(self, robot: VirtualRobot) -> None:
        robot.set_joints(BENT)
        robot.set_tcp((0.0, 0.0, 0.1, 0.0, 0.0, 0.0))
        robot.set_payload(1.5, (0.0, 0.0, 0.05))
        robot.set_digital_input(4, True)
        robot.set_input_register("double", 3, 1.25)
        robot.set_speed_slider(0.3)
        robot.step()
        kept = json.loads(json.dumps(robot.save()))
        other = VirtualRobot(robot.controller.config)
        other.restore(kept)
        other.step()
        robot.step()
        assert other.state() == robot.state()

    @pytest.mark.parametrize("running", [True, False])
    def test_the_power_state_is_restored(self, running: bool) -> None:
        config = ControllerConfig(model=load_model("ur3"), running=running)
        kept = VirtualRobot(config).save()
        other = VirtualRobot(ControllerConfig(model=load_model("ur3"), running=not running))
        other.restore(kept)
        assert field(other, "robot_mode") == ("RUNNING" if running else "POWER_OFF")

    def test_a_running_program_cannot_be_saved(self, robot: VirtualRobot) -> None:
        robot.send_script("def loop():\n  while True:\n    sync()\n  end\nend\n")
        robot.step(3)
        with pytest.raises(NotPossible, match="program is running"):
            robot.save()

    def test_another_robot_refuses_the_state(self, robot: VirtualRobot) -> None:
        other = VirtualRobot(ControllerConfig(model=load_model("ur10"), version=PolyscopeVersion(3, 15)))
        with pytest.raises(BadArguments, match="model"):
            other.restore(robot.save())

    def test_damaged_states_are_detected_and_change_nothing(self, robot: VirtualRobot) -> None:
        for key in robot.save():
            damaged = robot.save()
            damaged[key] = {"unknown": 1}
            before = robot.state()
            with pytest.raises(BadArguments):
                robot.restore(damaged)
            assert robot.state() == before
            robot.step()


def test_every_verb_is_a_method_of_the_robot_and_no_two_subjects_share_a_name(robot: VirtualRobot) -> None:
    for subject in LiveControl.SUBJECTS:
        for name in verbs_of([subject]):
            assert [other for other in LiveControl.SUBJECTS if hasattr(other, name)] == [subject], name
    assert {name for name in VERBS if callable(getattr(robot, name))} == set(VERBS)
    assert set(verbs_of(LiveControl.SUBJECTS)) - set(VERBS) == {
        "ports",
        "connections",
        "turned_away",
        "journal",
        "pendant",
    }


def test_type_checkers_see_all_subjects() -> None:
    """The classes with the verbs exist only for type checkers, so a missing one would not affect any call."""
    seen = {
        node.name: {base.id for base in node.bases if isinstance(base, ast.Name)}
        for node in ast.walk(ast.parse(inspect.getsource(control)))
        if isinstance(node, ast.ClassDef)
    }
    assert seen["VerbMethods"] == {subject.__name__ for subject in Control.SUBJECTS}
    with_ports = set(LiveControl.SUBJECTS) - set(Control.SUBJECTS)
    assert seen["_MethodsOfPorts"] == {subject.__name__ for subject in with_ports}


def test_every_verb_returns_its_steps() -> None:
    """Steps that are not returned are never executed where many clients are served, and the verb ends immediately."""
    forgotten = list[str]()
    waits = 0
    for path in Path(control.__file__).parent.glob("*.py"):
        tree = ast.parse(path.read_text("utf-8"))
        returned = {node.value for node in ast.walk(tree) if isinstance(node, ast.Return)}
        for call in ast.walk(tree):
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute) and call.func.attr == "_wait":
                waits += 1
                if call not in returned:
                    forgotten.append(f"{path.name}:{call.lineno}")
    assert waits > 10
    assert not forgotten


def test_only_ports_that_turned_clients_away_are_listed(robot: VirtualRobot) -> None:
    ports = {
        name: SimpleNamespace(port=1, peers=[], turned_away=RejectedClients(name)) for name in ("rtde", "dashboard")
    }
    ports["dashboard"].turned_away.count(Reason.PORT_FULL, "127.0.0.1:5", "is turned away")
    verbs = PortVerbs(robot._robot, ports, dict, bytes)
    assert verbs.turned_away() == {"dashboard": {"port full": 1}}
    assert verbs.ports() == {"rtde": 1, "dashboard": 1}


def test_results_are_json_serialisable(robot: VirtualRobot) -> None:
    for name in ("state", "describe", "time", "save", "log", "popups", "variables"):
        msgspec.json.encode(VERBS[name].call(robot, {}))


def test_external_control_settings(robot: VirtualRobot) -> None:
    assert robot.external_control() == {"host": "192.168.56.1", "port": 50002}
    robot.set_external_control("10.0.0.7")
    assert robot.external_control() == {"host": "10.0.0.7", "port": 50002}
    robot.set_external_control(" driver.local ", 6000)
    assert robot.external_control() == {"host": "driver.local", "port": 6000}
    for host, port in (("", None), ("a b", None), ("ok", 0), ("ok", 65536)):
        with pytest.raises(BadArguments):
            robot.set_external_control(host, port)
    assert robot.external_control() == {"host": "driver.local", "port": 6000}
    robot.set_external_control()
    assert robot.external_control() == {"host": "192.168.56.1", "port": 50002}
