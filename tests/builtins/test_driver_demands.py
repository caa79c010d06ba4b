"""Requirements of unmodified drivers on a controller's timing and order that no other test covers.

Times and orders are those of the official C++ library and its integration tests.
"""

import struct

import pytest

from emulator.commands.requests import DashboardLine, ScriptUnit
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from tests.rows import each_row
from tests.ticking import ticked
from urproto.modes import ReportLevel, RobotMode, RuntimeState, SafetyMode
from urproto.primary.messages import ErrorCodeMessage, KeyMessage, RobotMessage, SafetyModeMessage
from urproto.robots import load_model
from urproto.rtde.fields import OUTPUT_FIELDS, available_fields
from urproto.rtde.recipes import Recipe

SERIES = pytest.mark.parametrize("model", ["ur5e", "ur5"])
LOOP = 'socket_open("10.0.0.1", 50001, "a")\nwhile True:\n  sync()\nend'


def request(controller: Controller, line: str, within_s: float = 10.0) -> str:
    answers: list[str] = []
    controller.post(DashboardLine(line), answers.append)
    for _ in range(round(within_s / controller.period_s)):
        controller.tick()
        if answers:
            return answers[0]
    raise AssertionError(f"{line}: no answer within {within_s} s")


def of_kind(messages: list[RobotMessage], kind: type) -> list[RobotMessage]:
    return [message for message in messages if isinstance(message, kind)]


# connections


@SERIES
def test_a_script_the_size_of_the_official_one_connects_within_half_a_second(make_rig, model):
    rig = make_rig(model, None)
    functions = "".join(
        f"  def step_{n}(q, qd, time=0.5):\n"
        f"    local scaled = q * {n} + qd / 1000000\n"
        "    if norm(scaled) > 3.0:\n"
        f'      textmsg(str_cat("step {n} ", to_str(scaled)), time)\n'
        "    end\n    return scaled\n  end\n"
        for n in range(160)
    )
    script = f'def externalControl():\n{functions}  socket_open("10.0.0.1", 50001, "reverse")\n  sleep(1)\nend\n'
    script += "#" * (48_000 - len(script)) + "\n" if len(script) < 48_000 else ""
    assert script.count("\n") > 1100
    rig.submit(script)
    assert rig.until(lambda: rig.sockets.opened, 1.0) < 0.35  # the rest is for the network and load


@pytest.mark.parametrize(
    "end",
    [
        DashboardLine("stop"),
        ScriptUnit("stop program\n", "line"),
        ScriptUnit("halt\n", "line"),
        DashboardLine("power off"),
        ScriptUnit("def other():\n  sleep(1)\nend\n", "block"),
    ],
    ids=["stop", "stop program", "halt", "power off", "another program"],
)
def test_connections_close_immediately_when_their_program_ends(rig, end):
    rig.start(LOOP)
    rig.tick(5)
    assert [socket.state for socket in rig.sockets.opened] == ["open"]
    rig.controller.post(end)
    rig.tick(2)
    assert [socket.state for socket in rig.sockets.opened] == ["closed"]


DRAIN = """
global left = 500
thread path():
  movej([1.0, -1.5, 1.5, -1.6, -1.57, 0], a=6, v=0.8)
end
def drain():
  while left > 0:
    local count = 0
    while count < 10 and left > 0:
      socket_read_binary_integer(21, "points", 0.5)
      left = left - 1
      count = count + 1
    end
    sync()
  end
end
socket_open("10.0.0.1", 50001, "points")
h = run path()
sleep(0.6)
textmsg("cancel")
kill h
stopj(4)
drain()
socket_send_int(1, "points")
"""


def test_a_path_of_500_points_is_cancelled_and_drained_within_half_a_second(rig):
    rig.start(DRAIN)
    rig.until(lambda: bool(rig.sockets.opened), 0.5)
    (driver,) = rig.sockets.opened
    driver.feed(struct.pack(">21i", *range(21)) * 500)
    rig.until(lambda: rig.texts == ["cancel"])
    assert rig.controller.snapshot.target_qd[0] > 0.5
    took = rig.until(lambda: bool(driver.sent), 1.0)
    assert took < 0.5  # the ramp of stopj(4), then 50 periods
    assert not driver.inbox
    assert bytes(driver.sent) == struct.pack(">i", 1)
    assert rig.controller.snapshot.target_qd == (0.0,) * 6


# messages and their number


def test_an_undisturbed_program_sends_only_its_start_and_stop_messages(rig):
    rig.run('popup("note", "Title", blocking=False)\nmovej([0.1, -1.5, 1.5, -1.6, -1.57, 0])\nsync()')
    rig.seconds(0.5)
    assert [title for title, _ in rig.keys] == ["PROGRAM_XXX_STARTED", "PROGRAM_XXX_STOPPED"]
    assert of_kind(rig.messages, ErrorCodeMessage) == []
    assert of_kind(rig.messages, SafetyModeMessage) == []


def test_a_stopped_program_is_reported_once(rig):
    rig.start(LOOP, name="loop")
    rig.tick(5)
    rig.controller.post(ScriptUnit("stop program\n", "line"))
    rig.controller.post(DashboardLine("stop"))
    rig.seconds(0.5)
    assert rig.keys == [("PROGRAM_XXX_STARTED", "loop"), ("PROGRAM_XXX_STOPPED", "loop")]


def test_a_protective_stop_sends_one_error_after_its_safety_mode(rig):
    rig.start("protective_stop()\nsleep(1)")
    rig.until(lambda: rig.controller.snapshot.safety_mode is SafetyMode.PROTECTIVE_STOP, 1.0)
    rig.seconds(1.0)
    assert rig.controller.snapshot.robot_mode is RobotMode.RUNNING
    notices = [message for message in rig.messages if isinstance(message, SafetyModeMessage | ErrorCodeMessage)]
    mode, error = notices
    assert isinstance(mode, SafetyModeMessage)
    assert isinstance(error, ErrorCodeMessage)
    assert (error.label, error.level) == ("C209A0", ReportLevel.WARNING)


@SERIES
def test_power_cycles_send_no_messages(make_rig, model):
    rig = make_rig(model, None)
    for line in ("power off", "power on", "brake release", "power off"):
        request(rig.controller, line)
        rig.seconds(1.0)
    assert of_kind(rig.messages, KeyMessage) == []
    assert of_kind(rig.messages, SafetyModeMessage) == []


# impossible moves


def test_a_joint_target_far_outside_ends_the_program(rig):
    rig.start('socket_open("10.0.0.1", 50001, "a")\nmovej([-123, 0, 0, 0, 0, 0])\ntextmsg("arrived")\nsleep(1)')
    rig.seconds(1.0)
    assert rig.texts == []
    assert rig.state is not RuntimeState.PLAYING
    rig.controller.programs.stop()
    assert [socket.state for socket in rig.sockets.opened] == ["closed"]


def test_an_unreachable_line_reports_its_safety_mode_before_its_error(rig):
    rig.start("movel(p[10, 0, 0, 0, 0, 0])")
    rig.until(lambda: rig.state is RuntimeState.PAUSED, 1.0)
    mode, error = (m for m in rig.messages if isinstance(m, SafetyModeMessage | ErrorCodeMessage))
    assert isinstance(mode, SafetyModeMessage)
    assert isinstance(error, ErrorCodeMessage)
    assert error.level >= ReportLevel.WARNING


@pytest.mark.parametrize(
    "move",
    [
        "movej([3.14, -1.5, 1.5, -1.6, -1.57, 0], t=0.1)",
        "movel(pose_add(get_target_tcp_pose(), p[0, 0.23, 0, 0, 0, 0]), t=0.1)",
    ],
)
def test_a_move_time_that_is_too_short_is_stretched(rig, move):
    took = rig.run(f'{move}\ntextmsg("arrived")')
    assert took > 0.1
    assert rig.texts == ["arrived"]
    assert rig.controller.snapshot.safety_mode is SafetyMode.NORMAL


# cold start


@SERIES
@each_row("command", [DashboardLine("brake release"), ScriptUnit("set robotmode run\n", "line")])
def test_one_command_brings_a_cold_arm_to_run(model, command):
    controller = Controller(ControllerConfig(model=load_model(model)))
    assert ticked(controller).robot_mode is RobotMode.POWER_OFF
    controller.post(command)
    assert _first(controller, RobotMode.RUNNING, within_s=30.0)


@SERIES
def test_power_on_takes_at_most_five_seconds(model):
    controller = Controller(ControllerConfig(model=load_model(model)))
    controller.post(DashboardLine("power on"))
    assert _first(controller, RobotMode.IDLE, within_s=5.0)


def _first(controller: Controller, mode: RobotMode, within_s: float) -> bool:
    return any(ticked(controller).robot_mode is mode for _ in range(round(within_s / controller.period_s)))


@SERIES
def test_rtde_clients_need_not_wait_for_the_uptime(model):
    """Clients read for up to 2 s while the timestamp is below 40 s."""
    controller = Controller(ControllerConfig(model=load_model(model)))
    assert ticked(controller).timestamp > 40.0


def test_commands_are_accepted_in_local_control():
    """As in a simulator: not in remote control, and every command is executed."""
    controller = Controller(ControllerConfig(model=load_model("ur5e")))
    assert request(controller, "is in remote control") == "false"
    assert request(controller, "power on") == "Powering on"
    assert request(controller, "brake release") == "Brake releasing"
    assert _first(controller, RobotMode.RUNNING, within_s=30.0)
    controller.post(ScriptUnit("def remote():\n  sleep(0.1)\nend\n", "block"))
    for _ in range(10):
        snapshot = ticked(controller)
    assert snapshot.runtime_state is RuntimeState.PLAYING


@SERIES
def test_a_recipe_of_all_rtde_outputs_fits_a_clients_buffer(model):
    """The official client reads packages into 4096 bytes, their length included."""
    controller = Controller(ControllerConfig(model=load_model(model)))
    fields = available_fields(OUTPUT_FIELDS, controller.version)
    assert len(fields) > 100
    assert 3 + 1 + Recipe(fields.values()).size < 4094
