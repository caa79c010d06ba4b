"""Scripts through the primary interface: what is sent, and what becomes of what the robot says."""

import pytest

from client.connection import POLL, TimeLimit
from client.errors import NoAnswerError, ScriptFailedError
from client.primary import BRAKE_RELEASE, POWER_ON, STOP_PROGRAM, UNLOCK_PROTECTIVE_STOP, PrimaryCore
from client.scripts import prepare, with_end_message
from tests.rows import each_row
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.modes import ReportLevel, RobotMode, SafetyMode
from urproto.primary.messages import (
    PROGRAM_STARTED,
    PROGRAM_STOPPED,
    ErrorCodeMessage,
    KeyMessage,
    PopupMessage,
    RuntimeExceptionMessage,
    SafetyModeMessage,
    TextMessage,
    VersionMessage,
)
from urproto.primary.state import RobotStateData, encode_robot_state
from urproto.primary.subpackages import ConfigurationData, KinematicsInfo, MasterboardData, ModeData
from urproto.versions import PolyscopeVersion

VERSION = PolyscopeVersion(5, 22)
ZERO6 = (0.0,) * 6
DH_D = (0.1, 0.0, 0.0, 0.1, 0.1, 0.1)


def state(mode=RobotMode.RUNNING, safety=SafetyMode.NORMAL, *, full=False, running=False, paused=False):
    kinematics = KinematicsInfo(dh_d=DH_D)
    configuration = ConfigurationData(
        q_min=ZERO6, q_max=ZERO6, qd_max=ZERO6, qdd_max=ZERO6, v_joint_default=1.0, a_joint_default=1.4,
        v_tool_default=0.25, a_tool_default=1.2, eq_radius=0.25, dh_a=ZERO6, dh_d=DH_D, dh_alpha=ZERO6,
        dh_theta=ZERO6, masterboard_version=6, controller_box=4, robot_type=1, sub_type=3,
    )  # fmt: skip
    data = RobotStateData(
        mode=ModeData(
            timestamp_us=1, robot_power_on=True, emergency_stopped=False,
            protective_stopped=safety is SafetyMode.PROTECTIVE_STOP, program_running=running, program_paused=paused,
            robot_mode=mode, target_speed_fraction=1.0, speed_scaling=1.0,
        ),
        masterboard=MasterboardData(safety_mode=safety),
        kinematics=kinematics if full else None,
        configuration=configuration if full else None,
    )  # fmt: skip
    return encode_robot_state(data, VERSION, full=full)


def encoded(*messages):
    return b"".join(message if isinstance(message, bytes) else message.encode(VERSION) for message in messages)


def key(title, name):
    return KeyMessage(title=title, text=name)


class Robot:
    """Gives its answers one at a time once it was sent something, states before; then it keeps silent."""

    def __init__(self, *answers, backlog=b"", first=None):
        self.sent = []
        self.limits = []
        self._first = first or state()
        self._backlog = backlog
        self._answers = list(answers)

    def run(self, flow):
        step = next
        argument = ()
        while True:
            try:
                wanted = step(flow, *argument)
            except StopIteration as end:
                return end.value
            step = type(flow).send
            if isinstance(wanted, bytes):
                self.sent.append(wanted.decode())
                argument = (b"",)
            elif isinstance(wanted, TimeLimit):
                self.limits.append(wanted.seconds)
                argument = (b"",)
            elif wanted is POLL:
                argument, self._backlog = (self._backlog,), b""
            elif not self.sent:
                argument = (self._first,)
            elif self._answers:
                argument = (self._answers.pop(0),)
            else:
                step, argument = (
                    type(flow).throw,
                    (NoAnswerError("robot", 30001, (self.limits and self.limits[-1]) or 5.0),),
                )


def started_and_stopped(name="hello"):
    return [encoded(key(PROGRAM_STARTED, name)), encoded(key(PROGRAM_STOPPED, name), state())]


PROGRAM = "def hello():\n  textmsg(1)\nend"


def test_a_program_to_its_end():
    note = ErrorCodeMessage(code=171, argument=4, level=ReportLevel.WARNING)
    robot = Robot(
        encoded(state(), key(PROGRAM_STOPPED, "before")),
        encoded(key(PROGRAM_STARTED, "hello"), TextMessage(text="1"), note),
        encoded(state(running=True), key(PROGRAM_STOPPED, "hello"), state()),
    )
    result = robot.run(PrimaryCore().execute(PROGRAM, start_timeout_s=3, timeout_s=60))
    assert robot.sent == [PROGRAM + "\n"]
    assert robot.limits == [3, None, 60, None]
    assert (result.name, result.texts, [error.label for error in result.errors]) == ("hello", ("1",), ["C171A4"])


@pytest.mark.parametrize("ended", [True, False])
def test_a_program_that_is_stopped_has_not_come_to_its_end(ended):
    end_message = [TextMessage(text="hello has come to its end")] if ended else []
    robot = Robot(encoded(key(PROGRAM_STARTED, "hello"), *end_message), encoded(key(PROGRAM_STOPPED, "hello"), state()))
    core = PrimaryCore()
    run = robot.run(core.start(PROGRAM, require_end=True))
    assert robot.sent == ['def hello():\n  textmsg(1)\n  textmsg("hello has come to its end")\nend\n']
    if ended:
        assert robot.run(core.finish(run)).texts == ()
    else:
        with pytest.raises(ScriptFailedError, match="program hello: it was stopped before its end"):
            robot.run(core.finish(run))


@each_row(
    ("text", "can_report_end"),
    [
        ("def f():\n  def g():\n    a = 1\n  end\n  g()\nend # f\n\n# that is all\n", True),
        ("  def f():\n  end", True),
        ("def f():\n  # never halt\nend", True),
        ("def f():\n  if x:\n    halt\n  end\nend", False),
        ("def f():\n  return 1\nend", False),
        ("def f():\nend\ndef g():\nend", False),
        ("def f():\nend\nf()", False),
        ("def f():\ndef g():\nend\nend", False),
        ("def f():\n  if x:\n    y = 1\n  end", False),
    ],
)
def test_programs_that_can_report_their_end(text, can_report_end):
    script = with_end_message(prepare(text))
    assert bool(script.end_message) is can_report_end
    assert (script.text != text) is can_report_end
    if can_report_end:
        extra = f'  textmsg("{script.end_message}")'
        lines = script.text.splitlines()
        (place,) = [number for number, line in enumerate(lines) if line.endswith(extra)]
        assert lines[place + 1].split("#")[0].strip() == "end"
        assert lines[:place] + lines[place + 1 :] == text.splitlines()


def test_a_program_that_was_replaced_by_one_of_the_same_name():
    """The end of the old one is not taken for the end of the new one."""
    core = PrimaryCore()
    robot = Robot(
        encoded(key(PROGRAM_STOPPED, "hello"), key(PROGRAM_STARTED, "hello")),
        encoded(TextMessage(text="new"), key(PROGRAM_STOPPED, "hello"), state()),
    )
    assert robot.run(core.execute(PROGRAM)).texts == ("new",)


def test_bare_statements_get_a_name():
    robot = Robot(*started_and_stopped("mine"))
    robot.run(PrimaryCore().execute("a = 1\ntextmsg(a)", "mine"))
    assert robot.sent == ["def mine():\na = 1\ntextmsg(a)\nend\n"]
    first, second = prepare("x = 1"), prepare("x = 1")
    assert first.name != second.name


@each_row(
    ("text", "name", "shift"),
    [
        ("def f():\nend", "f", 0),
        ("# comment\n\n  def f (x):\nend", "f", 0),
        ("definition = 1", "given", 1),
        ("\n\nmovej(q)", "given", 1),
    ],
)
def test_what_is_a_program(text, name, shift):
    script = prepare(text, "given")
    assert (script.name, script.shift) == (name, shift)
    assert text in script.text


def test_what_cannot_be_waited_for():
    with pytest.raises(LocalProtocolError, match="send_script"):
        prepare("# beside\nsec f():\nend")
    with pytest.raises(LocalProtocolError, match="not a program name"):
        prepare("x = 1", "1st")


@each_row(
    ("text", "reported", "line", "message"),
    [
        (PROGRAM, (2, 3, "compile_error_name_not_found:f:"), 2, "compile_error_name_not_found:f:"),
        ("a = 1\nb = ", (3, 1, "syntax_error_on_line:3:end:"), 2, "syntax_error_on_line:2:end:"),
        ("a = f()", (2, 5, "compile_error_name_not_found:f:"), 1, "compile_error_name_not_found:f:"),
    ],
)
def test_an_error_names_the_callers_line(text, reported, line, message):
    error = RuntimeExceptionMessage(line=reported[0], column=reported[1], text=reported[2])
    with pytest.raises(ScriptFailedError, match=f"line {line}, column {reported[1]}") as failed:
        Robot(encoded(error)).run(PrimaryCore().execute(text))
    assert (failed.value.line, failed.value.column, failed.value.text) == (line, reported[1], message)


def test_an_error_while_running():
    error = RuntimeExceptionMessage(line=2, column=3, text="division by zero")
    robot = Robot(encoded(key(PROGRAM_STARTED, "hello")), encoded(error, key(PROGRAM_STOPPED, "hello")))
    with pytest.raises(ScriptFailedError, match="hello line 2, column 3: division by zero"):
        robot.run(PrimaryCore().execute(PROGRAM))


def test_old_messages_are_not_about_this_program():
    old = encoded(RuntimeExceptionMessage(line=1, column=1, text="old"), ErrorCodeMessage(code=153, argument=2))
    core = PrimaryCore()
    result = Robot(*started_and_stopped(), backlog=old).run(core.execute(PROGRAM))
    assert result.errors == ()
    assert [error.label for error in core.errors] == ["C153A2"]


CODE = ErrorCodeMessage(code=153, argument=2, level=ReportLevel.WARNING, text="deviates")
STOP = SafetyModeMessage(safety_mode=SafetyMode.PROTECTIVE_STOP)
STOPPED_STATE = state(safety=SafetyMode.PROTECTIVE_STOP, paused=True)


@each_row(
    ("encoded_messages", "text"),
    [
        ((STOP, STOPPED_STATE, CODE), "PROTECTIVE_STOP C153A2 deviates"),
        ((CODE, STOP), "PROTECTIVE_STOP C153A2 deviates"),
        ((STOP, STOPPED_STATE, STOPPED_STATE), "PROTECTIVE_STOP"),
        ((ErrorCodeMessage(code=191, argument=1, level=ReportLevel.VIOLATION, text="limit"),), "C191A1 limit"),
    ],
)
def test_a_safety_stop_fails_the_program(encoded_messages, text):
    robot = Robot(encoded(key(PROGRAM_STARTED, "hello")), encoded(*encoded_messages))
    with pytest.raises(ScriptFailedError) as failed:
        robot.run(PrimaryCore().execute(PROGRAM))
    assert (failed.value.text, failed.value.line, failed.value.name) == (text, 0, "hello")


def test_a_warning_fails_the_program_if_requested():
    robot = Robot(encoded(key(PROGRAM_STARTED, "hello")), encoded(CODE))
    core = PrimaryCore()
    run = robot.run(core.start(PROGRAM, failing=(ReportLevel.WARNING,)))
    with pytest.raises(ScriptFailedError, match="C153A2 deviates"):
        robot.run(core.finish(run))


def test_programs_that_do_not_start_or_end_in_time():
    with pytest.raises(ScriptFailedError, match=r"not started after 5 s; the robot mode is RUNNING, the safety"):
        Robot(state()).run(PrimaryCore().execute(PROGRAM))
    robot = Robot(encoded(key(PROGRAM_STARTED, "hello"), state(running=True)))
    with pytest.raises(ScriptFailedError, match=r"still running after 7 s; .* a program is running"):
        robot.run(PrimaryCore().execute(PROGRAM, timeout_s=7))


@pytest.mark.parametrize(
    ("condition", "advice"),
    [((RobotMode.IDLE, SafetyMode.NORMAL), "brakes"), ((RobotMode.RUNNING, SafetyMode.PROTECTIVE_STOP), "clear")],
)
def test_a_robot_that_cannot_run_programs_is_not_sent_any(condition, advice):
    robot = Robot(first=state(*condition))
    with pytest.raises(RobotRefused, match=advice):
        robot.run(PrimaryCore().execute(PROGRAM))
    assert robot.sent == []


def test_a_read_only_connection():
    read_only = ErrorCodeMessage(code=210, level=ReportLevel.WARNING, text="read-only")
    with pytest.raises(RobotRefused, match="C210A0 read-only - switch the robot to Remote Control"):
        Robot(encoded(read_only)).run(PrimaryCore().execute(PROGRAM))
    with pytest.raises(RobotRefused, match="connect again"):
        Robot(encoded(read_only)).run(PrimaryCore().command(STOP_PROGRAM))


@each_row(
    ("command", "before", "after"),
    [
        (POWER_ON, state(RobotMode.POWER_OFF), state(RobotMode.IDLE)),
        (BRAKE_RELEASE, state(RobotMode.IDLE), state(RobotMode.RUNNING)),
        (UNLOCK_PROTECTIVE_STOP, STOPPED_STATE, state()),
        (STOP_PROGRAM, state(running=True), state()),
    ],
)
def test_commands_are_seen_through(command, before, after):
    robot = Robot(before, after, first=before)
    robot.run(PrimaryCore().command(command))
    assert robot.sent == [command.line + "\n"]
    assert robot.limits == [command.timeout_s]
    with pytest.raises(RobotRefused, match=r"after .* s the robot mode is") as refused:
        Robot(before, first=before).run(PrimaryCore().command(command))
    assert refused.value.advice == command.advice


def test_what_is_kept():
    hello = VersionMessage.of(VERSION, "today")
    popup = PopupMessage(title="t", text="look")
    encoded_messages = encoded(hello, state(full=True), TextMessage(text="a"), popup, CODE, state())
    core = PrimaryCore()
    robot = Robot(first=encoded_messages)
    assert robot.run(core.polyscope_version()) == VERSION
    assert robot.run(core.kinematics_info()).dh_d == DH_D
    assert robot.run(core.configuration_data()).robot_type == 1
    while not core.errors:
        robot.run(core.next_message())
    assert robot.run(core.robot_state()).kinematics is None
    assert core.kinematics.dh_d == DH_D  # later states do not have it
    assert core.configuration.eq_radius == 0.25
    assert list(core.texts) == ["a"]
    assert [dialogue.text for dialogue in core.dialogues] == ["look"]
