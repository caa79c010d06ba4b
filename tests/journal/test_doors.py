"""Whatever enters a controller is in its journal: a replay of the run is the run."""

import ast
import inspect
import json
import math
from pathlib import Path
from typing import Any

import pytest
from journal_rig import Recorded

from emulator.commands.requests import (
    DashboardLine,
    GripperCall,
    InterpreterLine,
    ModbusCall,
    RefusedScript,
    RTDEInputs,
    ScriptUnit,
    ServingFailed,
    ToolBytes,
)
from emulator.control.control import LiveControl
from emulator.devices.gripper_requests import GripperSession
from emulator.devices.tool_line import EchoDevice
from emulator.journal import values
from emulator.journal.doors import DOORS
from emulator.journal.file import read_journal
from emulator.journal.values import commands
from emulator.robotapi.endpoints import OPERATIONS
from emulator.robotapi.server import RobotApiCall
from emulator.servers import rtde
from emulator.servers.port import ServedController
from emulator.services.modbus import ModbusUnit
from tests.networks import MemoryModbus, MemorySockets, MemoryUnit
from tests.rows import each_row
from urproto.robotiq import RequestDecoder

MOVE = """def go():
  movej([0.2, -1.4, 1.5, -1.7, -1.5, 0.3])
  movel(pose_add(get_target_tcp_pose(), p[0, 0, 0.05, 0, 0, 0]))
end
"""


ROOT = Path(__file__).parents[2]
EMULATOR = ROOT / "emulator"
PHYSICS = ROOT / "examples" / "physics"
COMMANDS = (
    DashboardLine("load a\xfc\udcff.urp", restricted=True),
    ScriptUnit("a = 1\n", "line"),
    RefusedScript("b", "c"),
    RTDEInputs({"input_bit_registers0_to_31": 3, "external_force_torque": (1.0, math.inf, -0.0, 1e-300, 0.1, 2.0)}),
    ModbusCall(b"\x00\xff"),
    ToolBytes(b"\n"),
    rtde._Note("hello"),
    RobotApiCall(OPERATIONS[0], ()),
)
ELSEWHERE = {InterpreterLine, ServingFailed, GripperCall}  # with functions, exceptions, sessions: never equal


def kinds(run):
    return {record[1] for record in read_journal(run.journal)}


def test_commands_of_ports():
    run = Recorded()
    run.post(ScriptUnit(MOVE, "block"))
    run.robot.step(300)
    run.post(DashboardLine("pause"))
    run.robot.step(200)
    run.post(RTDEInputs({"speed_slider_mask": 1, "speed_slider_fraction": 0.4, "input_double_register_24": 1.5}))
    run.post(DashboardLine("play"))
    run.robot.step(900)
    run.post(ModbusCall(b"\x03\x00\x10\x00\x04"))
    run.post(ScriptUnit('sec ask():\n  popup("a", blocking=False)\nend\n', "block"))
    run.robot.step(20)
    run.robot.answer_popup(1, True)
    run.robot.step(1500)
    run.is_repeated()


def test_sockets_of_programs():
    sockets = MemorySockets(("10.0.0.1", 80))

    def prepare(robot):
        robot.controller.programs.socket_backend = sockets

    run = Recorded(prepare=prepare)
    run.robot.send_script(
        'def ask():\n  global ok = socket_open("10.0.0.1", 80)\n  global no = socket_open("10.0.0.2", 80, "other")\n'
        "  while True:\n    global line = socket_read_line(timeout=0.5)\n    socket_send_line(line)\n"
        "    movej(get_target_joint_positions() + [0, 0, 0, 0, 0, 0.01 * str_len(line)])\n  end\nend\n"
    )
    run.robot.step(50)
    for text in (b"a\n", b"bcd\nef", b"gh\n"):
        sockets.opened[0].feed(text)
        run.robot.step(150)
    sockets.opened[0].close()
    run.robot.step(400)
    assert b"efgh" in sockets.opened[0].sent
    assert {"socket"} <= kinds(run)
    run.is_repeated()


def test_modbus_units():
    network = MemoryModbus()
    unit = ModbusUnit("10.0.0.9", 255)
    network.units[unit] = MemoryUnit(registers={16: 7})

    def prepare(robot):
        robot.controller.programs.modbus.backend = network

    run = Recorded(prepare=prepare)
    run.robot.send_script('def add():\n  modbus_add_signal("10.0.0.9", 255, 16, 3, "level")\n  sleep(2)\nend\n')
    run.robot.step(300)
    network.units[unit].registers[16] = 9
    run.robot.step(300)
    network.silent.add(unit)
    run.robot.step(300)
    assert "modbus" in kinds(run)
    run.is_repeated()


def test_the_tools_serial_line():
    def prepare(robot):
        robot.controller.tool_line.connect(EchoDevice())

    run = Recorded(prepare=prepare)
    line = "set_tool_communication(True, 9600, 0, 1, 1.5, 3.5)"
    run.robot.send_script(f"def tool():\n  set_tool_voltage(24)\n  {line}\nend\n")
    run.robot.step(50)
    for number in range(20):
        run.post(ToolBytes(bytes([number] * 40)))
        run.robot.step(11)
    assert "tool" in kinds(run)
    run.is_repeated()


def test_gripper_and_its_clients():
    run = Recorded("ur3", gripper="robotiq-2f-85", gripper_object=20.0)
    one, other, decoder = GripperSession(), GripperSession(), RequestDecoder()
    run.post(ScriptUnit("def on():\n  set_tool_voltage(24)\nend\n", "block"))
    run.robot.step(30)
    for session, text in ((one, b"SET ACT 1\n"), (other, b"SET SID 3\n"), (one, b"SET GTO 1 POS 255 SPE 200\n")):
        run.post(GripperCall(tuple(decoder.feed(text)), session))
        run.robot.step(200)
    run.post(GripperCall(tuple(decoder.feed(b"SET GTO 1 POS 0\n")), other))  # of another gripper
    run.robot.step(200)
    run.is_repeated()


def test_interpreter_mode():
    run = Recorded()
    run.robot.send_script("def listen():\n  interpreter_mode()\nend\n")
    run.robot.step(30)
    for line in ("movej([0.2, -1.4, 1.5, -1.7, -1.5, 0.3])", "skipbuffer", "global a = random()", "end_interpreter()"):
        run.post(InterpreterLine(line, lambda text: None))
        run.robot.step(400)
    run.is_repeated()


@each_row(
    "fault",
    [
        {"kind": "encoder_jump", "joint": 2, "by_rad": 0.01},
        {"kind": "lagging_joint", "joint": 3},
        {"kind": "runtime_exception", "line": 2},
        {"kind": "program_stuck"},
    ],
)
def test_verbs_and_faults(fault: dict[str, Any]):
    run = Recorded(arm="dynamic", seed=5)
    run.robot.set_digital_input(2, True)
    run.robot.send_script(MOVE)
    run.robot.step(200)
    run.robot.inject_fault(**fault, lasting=0.5)
    run.robot.step(300)
    run.robot.dashboard("stop")
    run.robot.power_off()
    run.robot.release_brakes()
    run.robot.step(50)
    run.is_repeated()


@pytest.mark.parametrize("world", ["wall.yaml", pytest.param("conveyor.yaml", marks=pytest.mark.long)])
def test_a_world_with_physics(world):
    run = Recorded("ur5e", world=PHYSICS / world, physics=True, gripper="robotiq-2f-85")
    run.robot.send_script("def down():\n  while True:\n    speedl([0.02, 0, -0.1, 0, 0, 0], 0.5, 0.5)\n  end\nend\n")
    run.robot.step(300)
    run.robot.set_digital_output(0, True)
    run.robot.step(1200)
    run.is_repeated()


def test_values_of_options_that_are_names_of_files_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("ideal", "ursim", "ur5e", "factory"):
        (tmp_path / name).mkdir()
    run = Recorded("ur5e", safety="factory")
    run.robot.step(10)
    run.is_repeated()


def test_files_for_which_there_is_no_room(tmp_path):
    for number in range(3):
        (tmp_path / f"{number}.script").write_text(f"# {'x' * 2_000_000}\n")
    run = Recorded(programs=tmp_path)
    run.robot.step(10)
    run.is_repeated()
    with run.replay() as again:
        assert len(again.header["left_out"]) == 1
        assert "1 files did not fit into the journal" in again.advice


def test_programs_that_change_while_it_runs(tmp_path):
    program = tmp_path / "move.script"
    program.write_text(MOVE)
    run = Recorded(programs=tmp_path)
    for text in (MOVE, MOVE.replace("0.05", "-0.03")):
        program.write_text(text)
        run.post(DashboardLine("load move.script"))
        run.robot.step(20)
        run.post(DashboardLine("play"))
        run.robot.step(1800)
    assert "file" in kinds(run)
    program.unlink()
    run.is_repeated()


def test_servers_have_no_other_door_than_post():
    """mypy sees to it that they use nothing else of a controller."""
    own = {name for name in vars(ServedController) if not name.startswith("_")}
    assert own == {"version", "situation", "snapshot", "post", "subscribe"}


READ = {
    "gripper",
    "messages.note",
    "model",
    "model.title",
    "period_s",
    "remote_control",
    "shutdown_requested",
    "version",
}
READ |= {
    "commands_waiting",
    "execution_time_ms",
    "guard.problem",
    "power.running",
    "programs.texts_waiting",
    "safety.mode",
}
READ |= {"situation", "snapshot", "time_s", "work", "world"}
PARTS = {
    "servers": {"post", "subscribe", "local_control", "version.series.frequency_hz"},
    "app.py": {"tick", "recorder", "programs", "programs.modbus.backend", "programs.socket_backend", "programs.stop"}
    | {"tool_line.connect"},  # connect, end; how long the last period took, only its clients see
    "whatever": set[str](),
}
OUTSIDE = [
    *((file, "servers") for file in (*(EMULATOR / "servers").glob("*.py"), EMULATOR / "robotapi" / "server.py")),
    (EMULATOR / "app.py", "app.py"),
    *((EMULATOR / name, "whatever") for name in ("first_screen.py", "serve.py", "pendant_process.py")),
    *((EMULATOR / name, "whatever") for name in ("control/http.py", "control/metrics.py", "journal/stops.py")),
]


@each_row(("file", "part"), OUTSIDE, ids=lambda value: getattr(value, "name", None))
def test_what_is_outside_of_the_controller_has_no_other_doors(file, part):
    used = {".".join(chain[:3]) for chain in chains(file.read_text())}
    assert {name for name in used if not name.startswith("snapshot.")} <= READ | PARTS[part]


def chains(source):
    """The attributes of attributes of anything named controller, such as programs.modbus.backend."""
    tree = ast.parse(source)
    parents = {child: node for node in ast.walk(tree) for child in ast.iter_child_nodes(node)}
    for node in ast.walk(tree):
        name = node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""
        if name in ("controller", "_controller", "before"):
            chain = []
            while isinstance(node := parents.get(node), ast.Attribute):
                chain.append(node.attr)
            if chain:
                yield chain


def test_verbs_that_are_not_recorded_change_nothing():
    unrecorded = [subject for subject in LiveControl.SUBJECTS if not subject.changes]
    used = {".".join(chain) for subject in unrecorded for chain in chains(inspect.getsource(subject))}
    assert used <= READ


def test_every_command_is_encoded_and_comes_back():
    kinds = {kind for kind in commands() if kind.__module__.startswith("emulator.")}  # others are of tests
    assert {kind.__name__ for kind in kinds} <= values._classes().keys()
    numbers = values.Numbers()
    for command in COMMANDS:
        assert values.decode(json.loads(json.dumps(values.encode(command, numbers))), numbers) == command
    assert {type(command) for command in COMMANDS} >= kinds - ELSEWHERE


def test_all_doors_are_described():
    replay = (EMULATOR / "journal/replay.py").read_text()
    assert {name for name in DOORS if f"_apply_{name}(" in replay} == set(DOORS)
