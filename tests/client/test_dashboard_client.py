"""The dashboard client, in both shells, against a port that answers from a table."""

import socket

import pytest

from client import dashboard, dashboard_commands
from client.connection import POLL
from client.dashboard import BlockingDashboardClient, DashboardClient, DashboardCore, Operation
from client.dashboard_commands import checked_command
from client.errors import ConnectionLostError, NoAnswerError, RobotUnreachableError
from urproto.dashboard import COMMANDS, GREETING, LineDecoder, OperationalMode, ProgramState, UserRole, encode_line
from urproto.errors import LocalProtocolError, RemoteProtocolError, RobotRefused
from urproto.modes import RobotMode, SafetyMode, SafetyStatus
from urproto.versions import PolyscopeVersion

ANSWERS = {
    "power on": "Powering on",
    "power off": "Powering off",
    "brake release": "Brake releasing",
    "play": "Failed to execute: play",
    "stop": "Stopped",
    "robotmode": "Robotmode: IDLE",
    "safetymode": "Safetymode: NORMAL",
    "safetystatus": "Safetystatus: REDUCED",
    "programState": "PAUSED pick.urp",
    "get loaded program": "No program loaded",
    "running": "Program running: true",
    "is in remote control": "false",
    "PolyscopeVersion": "URSoftware 5.13.1.1010327 (Mar 21 2022)",
    "get serial number": "20175599999",
    "get robot model": "UR3",
    "load pick.urp": "Loading program: /programs/pick.urp",
    "load place.urp": "Loading program: /programs/place.urp, /programs/default.installation",  # e-Series
    "popup look here": "showing popup",
    "addToLog ": "No log message to add",
    "in local": "Command is not allowed due to safety reasons, please switch robot to Remote Control mode and "
    "reconnect to port 29999",
    "addToLog noted": "Added log message",
    "load installation cell.installation": "Loading installation: /programs/cell.installation",
    "isProgramSaved": "true pick.urp",
    "version": "5.13.1.1010327",
    "get operational mode": "NONE",
    "set operational mode manual": "Operational mode 'manual' is set",
    "clear operational mode": "No longer controlling the operational mode. Current operational mode: 'NONE'.",
    "generate flight report system": "Flight Report generated with id: 7",
    "generate support file reports": "Completed successfully: ur_20175599999.zip",
    "saveLog": "Log saved to disk",
    "close popup": "closing popup",
    "close safety popup": "closing safety popup",
    "unlock protective stop": "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of "
    "protective stop before unlocking",
    "restart safety": "Restarting safety",
    "shutdown": "Shutting down",
}


def answer_from_table(connection: socket.socket) -> None:
    connection.sendall(encode_line(GREETING))
    lines = LineDecoder()
    while data := connection.recv(4096):
        for line in lines.feed(data):
            if line == "hang up":
                return
            if line != "be silent":
                connection.sendall(encode_line(ANSWERS.get(line, f"could not understand: '{line}'")))


ASKED = [
    (dashboard.POWER_ON, None),
    (dashboard.POWER_OFF, None),
    (dashboard.BRAKE_RELEASE, None),
    (dashboard.STOP, None),
    (dashboard.ROBOT_MODE, RobotMode.IDLE),
    (dashboard.SAFETY_MODE, SafetyMode.NORMAL),
    (dashboard.SAFETY_STATUS, SafetyStatus.REDUCED),
    (dashboard.PROGRAM_STATE, (ProgramState.PAUSED, "pick.urp")),
    (dashboard.LOADED_PROGRAM, None),
    (dashboard.IS_RUNNING, True),
    (dashboard.IS_IN_REMOTE_CONTROL, False),
    (dashboard.POLYSCOPE_VERSION, PolyscopeVersion(5, 13, 1, 1010327)),
    (dashboard.SERIAL_NUMBER, "20175599999"),
    (dashboard.ROBOT_MODEL, "UR3"),
    (dashboard.load("pick.urp"), "/programs/pick.urp"),
    (dashboard.load("place.urp"), "/programs/place.urp"),
    (dashboard.popup("look here"), None),
    (dashboard.add_to_log("noted"), None),
    (dashboard.load_installation("cell.installation"), "/programs/cell.installation"),
    (dashboard.IS_PROGRAM_SAVED, (True, "pick.urp")),
    (dashboard.VERSION, PolyscopeVersion(5, 13, 1, 1010327)),
    (dashboard.OPERATIONAL_MODE, OperationalMode.NONE),
    (dashboard.set_operational_mode(OperationalMode.MANUAL), None),
    (dashboard.CLEAR_OPERATIONAL_MODE, None),
    (dashboard.generate_flight_report(), "7"),
    (dashboard.generate_support_file("reports"), "ur_20175599999.zip"),
    (dashboard.SAVE_LOG, None),
    (dashboard.CLOSE_POPUP, None),
    (dashboard.CLOSE_SAFETY_POPUP, None),
    (dashboard.RESTART_SAFETY, None),
    (dashboard.SHUTDOWN, None),
    (dashboard.command("dance"), "could not understand: 'dance'"),
]


def test_blocking_operations(serve):
    with BlockingDashboardClient("127.0.0.1", serve(answer_from_table)) as robot:
        assert [robot.request(operation) for operation, _ in ASKED] == [expected for _, expected in ASKED]


async def test_async_operations(serve):
    async with DashboardClient("127.0.0.1", serve(answer_from_table)) as robot:
        assert [await robot.request(operation) for operation, _ in ASKED] == [expected for _, expected in ASKED]


def test_a_refusal_names_request_and_answer(serve):
    with BlockingDashboardClient("127.0.0.1", serve(answer_from_table)) as robot:
        with pytest.raises(RobotRefused, match="Failed to execute: play") as refused:
            robot.request(dashboard.PLAY)
        assert refused.value.request == "play"
        with pytest.raises(RobotRefused):
            robot.request(dashboard.PAUSE)
        assert robot.request(dashboard.ROBOT_MODE) is RobotMode.IDLE


REFUSED = [
    (dashboard.UNLOCK_PROTECTIVE_STOP, "wait until 5 s after the stop"),
    (dashboard.load("gone.urp"), "exists on CB3 since 1.4"),  # the table does not know the line
    (dashboard.USER_ROLE, "CB3 since 3.1 only"),
    (dashboard.set_user_role(UserRole.OPERATOR), "only: update the controller"),
    (dashboard.add_to_log(""), "must not be empty"),
    (Operation("in local", dashboard.POWER_ON.read), "then connect again"),
]


@pytest.mark.parametrize(("operation", "advice"), REFUSED)
def test_a_refusal_says_what_to_do(serve, operation, advice):
    with BlockingDashboardClient("127.0.0.1", serve(answer_from_table)) as robot:
        with pytest.raises(RobotRefused, match=advice) as refused:
            robot.request(operation)
        assert advice in refused.value.advice
        assert robot.request(dashboard.ROBOT_MODE) is RobotMode.IDLE


def sent(asking, waiting=b""):
    """What a flow says first, while this is there to be read."""
    assert next(asking) is POLL
    if waiting:
        assert asking.send(waiting) is POLL
    return asking.send(b"")


def test_what_the_version_lacks_is_not_sent():
    core = DashboardCore()
    asking = core.request(dashboard.SERIAL_NUMBER)
    assert sent(asking) == b"PolyscopeVersion\n"
    assert asking.send(b"") is None
    with pytest.raises(RobotRefused, match=r"3\.11\.0 does not know it - it exists on CB3 since 3\.12"):
        asking.send(b"URSoftware 3.11.0.0 (Feb 1 2020)\n")
    again = core.request(dashboard.SERIAL_NUMBER)  # the version is known now
    with pytest.raises(RobotRefused):
        next(again)


def test_the_mode_that_cannot_be_set():
    with pytest.raises(LocalProtocolError, match="CLEAR_OPERATIONAL_MODE"):
        dashboard.set_operational_mode(OperationalMode.NONE)


def test_spellings_of_the_manual_are_confirmations_too():
    """The e-Series manual of 2022 has other words than simulators answer."""
    manual = OperationalMode.MANUAL
    assert dashboard.set_operational_mode(manual).answer("Setting operational mode: manual") is None
    answer = "operational mode is no longer controlled by Dashboard Server"
    assert dashboard.CLEAR_OPERATIONAL_MODE.answer(answer) is None


def test_any_line_is_judged_by_the_table():
    refused = checked_command("setUserRole boss")
    with pytest.raises(RobotRefused, match="roles that are set up on the pendant"):
        refused.answer("Failed setting user role: boss")
    assert (
        checked_command("SETUSERROLE operator").answer("Setting user role: operator") == "Setting user role: operator"
    )


BUILDERS = [
    dashboard.load("x"),
    dashboard.load_installation("x"),
    dashboard.popup("x"),
    dashboard.add_to_log("x"),
    dashboard.set_user_role(UserRole.NONE),
    dashboard.set_operational_mode(OperationalMode.MANUAL),
    dashboard.generate_flight_report(),
    dashboard.generate_support_file("x"),
]


def test_every_command_has_an_operation():
    operations = [*(value for value in vars(dashboard_commands).values() if isinstance(value, Operation)), *BUILDERS]
    rows = {_words(operation.line): operation.available for operation in operations}
    assert rows == {words: row.available for words, row in COMMANDS.items()}


def _words(line: str) -> str:
    """The longest command that begins a line."""
    return max((words for words in COMMANDS if f"{line.lower()} ".startswith(f"{words} ")), key=len, default=line)


def test_commands_of_every_version_are_sent_without_requesting_the_version():
    """Commands that came before 3.0 are in all versions that there are: asking needs no other exchange."""
    everywhere = {row.line for row in vars(dashboard_commands).values() if getattr(row, "in_every_version", False)}
    assert everywhere >= {"play", "quit", "programState", "PolyscopeVersion", "power on"}
    assert everywhere.isdisjoint({"close safety popup", "safetystatus", "getUserRole", "version"})


def test_silence_and_hanging_up(serve):
    with BlockingDashboardClient("127.0.0.1", serve(answer_from_table)) as robot:
        with pytest.raises(NoAnswerError, match=r"0\.05 s"):
            robot.request(dashboard.command("be silent"), timeout_s=0.05)
        with pytest.raises(ConnectionLostError):
            robot.request(dashboard.command("hang up"))


def test_a_connection_that_was_ended_shows_without_asking(serve):
    with BlockingDashboardClient("127.0.0.1", serve(answer_from_table)) as robot:
        robot.check()
        with pytest.raises(NoAnswerError):
            robot.request(dashboard.command("be silent"), timeout_s=0.01)
        robot.check()
        robot.shut_down()
        with pytest.raises(ConnectionLostError):
            robot.check()


def test_a_role_or_mode_in_words_is_sent_as_it_is():
    assert dashboard.set_user_role("KING").line == "setUserRole KING"
    assert dashboard.set_operational_mode("AUTOMATIC").line == "set operational mode AUTOMATIC"


async def test_async_silence_and_hanging_up(serve):
    async with DashboardClient("127.0.0.1", serve(answer_from_table)) as robot:
        with pytest.raises(NoAnswerError):
            await robot.request(dashboard.command("be silent"), timeout_s=0.05)
        with pytest.raises(ConnectionLostError):
            await robot.request(dashboard.command("hang up"))


def test_a_late_answer_is_not_taken_for_the_next_one():
    core = DashboardCore()
    first = core.request(dashboard.STOP)
    assert sent(first) == b"stop\n"
    assert first.send(b"") is None
    first.close()  # timed out
    second = core.request(dashboard.ROBOT_MODE)
    assert sent(second) == b"robotmode\n"
    assert second.send(b"") is None
    assert second.send(b"Stopped\nRobotmode: ") is None
    with pytest.raises(StopIteration) as end:
        second.send(b"IDLE\n")
    assert end.value.value is RobotMode.IDLE


def test_unsolicited_lines_are_not_answers():
    core = DashboardCore()
    first = core.request(dashboard.STOP)
    assert sent(first) == b"stop\n"
    first.send(b"")
    first.close()  # timed out
    second = core.request(dashboard.ROBOT_MODE)
    assert sent(second, b"Stopped\nand more\n") == b"robotmode\n"
    assert second.send(b"") is None
    with pytest.raises(StopIteration) as end:
        second.send(b"Robotmode: IDLE\n")
    assert end.value.value is RobotMode.IDLE


def test_another_greeting(serve):
    def greet(connection):
        connection.sendall(b"SSH-2.0\r\n")
        connection.recv(1)

    with pytest.raises(RemoteProtocolError, match="SSH"), BlockingDashboardClient("127.0.0.1", serve(greet)):
        pytest.fail("entered")


def test_no_server(serve):
    port = serve(answer_from_table) + 0
    with socket.create_server(("127.0.0.1", 0)) as free:
        unused = free.getsockname()[1]
    assert unused != port
    with (
        pytest.raises(RobotUnreachableError, match=f"127.0.0.1:{unused}"),
        BlockingDashboardClient("127.0.0.1", unused),
    ):
        pytest.fail("entered")


async def test_no_server_async():
    with socket.create_server(("127.0.0.1", 0)) as free:
        unused = free.getsockname()[1]
    with pytest.raises(RobotUnreachableError, match="check the address"):
        await DashboardClient("127.0.0.1", unused).__aenter__()


def test_asking_without_a_connection():
    with pytest.raises(ConnectionLostError):
        BlockingDashboardClient("127.0.0.1").request(dashboard.STOP)


def test_a_command_is_one_line():
    with pytest.raises(LocalProtocolError):
        next(DashboardCore().request(Operation("play\nstop", str)))
