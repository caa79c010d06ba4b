"""Reports to primary clients about a running program: variables, threads and labels."""

from collections.abc import Callable
from typing import Any

import pytest
from server_rig import MemoryClient

from emulator.app import make_servers
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from emulator.servers.primary import PrimaryServer
from urproto.primary.framing import PrimaryDecoder
from urproto.primary.messages import KeyMessage, ProgramThread, ProgramThreadsMessage, UnknownMessage
from urproto.primary.program_state import GlobalVariableNames, GlobalVariableValues, MatrixValue, PoseValue
from urproto.primary.state import RobotStateData
from urproto.robots import load_model
from urproto.versions import PolyscopeVersion

LEGAL_SIZE = 2048  # bytes: the buffer of a public client


class Robot:
    """A running controller with its servers, and clients that record received data."""

    def __init__(self, model: str = "ur5e", version: str | None = None) -> None:
        parsed = PolyscopeVersion.parse(version) if version else None
        self.controller = Controller(ControllerConfig(model=load_model(model), version=parsed, running=True))
        self.servers = {server.name: server for server in make_servers(self.controller)}

    def client(self, port: str = "primary") -> MemoryClient:
        return MemoryClient(self.servers[port])

    def start(self, *lines: str) -> None:
        self.controller.programs.submit("def prog():\n" + "".join(f"  {line}\n" for line in lines) + "end\n")

    def cycles(self, count: int = 1) -> None:
        """Advance by this number of states of the primary port."""
        for _ in range(round(0.1 * count / self.controller.period_s)):
            self.controller.tick()

    def received(self, client: MemoryClient) -> list[Any]:
        """Messages since the last call, none of which is too long or unreadable."""
        data = client.take()
        decoder = PrimaryDecoder(self.controller.version)
        messages: list[Any] = []
        while data:
            size = int.from_bytes(data[:4], "big")
            assert size <= LEGAL_SIZE
            messages += (
                m for m in decoder.feed(data[:size]) if not isinstance(m, UnknownMessage)
            )  # behind the version
            data = data[size:]
        assert not [message for message in messages if getattr(message, "error", None)]
        return messages


def of_kind(messages: list[Any], kind: type) -> list[Any]:
    return [message for message in messages if isinstance(message, kind)]


@pytest.fixture
def robot() -> Robot:
    return Robot()


@pytest.fixture
def make_robot() -> Callable[..., Robot]:
    return Robot


def test_names_are_sent_once_and_values_with_every_state(robot: Robot) -> None:
    client = robot.client()
    robot.start("global n = 0", "while True:", "  n = n + 1", "  sleep(0.1)", "end")
    robot.cycles(5)
    received = robot.received(client)
    (names,) = of_kind(received, GlobalVariableNames)
    assert names.names == ("n",)
    values = of_kind(received, GlobalVariableValues)
    assert [update.values[0] for update in values] == sorted({update.values[0] for update in values})
    assert len(values) == len(of_kind(received, RobotStateData))
    assert received.index(names) < received.index(values[0])
    first = received.index(values[0])
    assert isinstance(received[first + 1], RobotStateData)


def test_an_idle_robot_sends_no_program_reports(robot: Robot) -> None:
    client = robot.client()
    robot.cycles(3)
    assert {type(message) for message in robot.received(client)[1:]} == {RobotStateData}


def test_a_short_program_is_reported_once_after_its_end(robot: Robot) -> None:
    """As in a capture of a 5.4 simulator: started, stopped, then the values, of which there are none here, then the
    state."""
    client = robot.client()
    robot.cycles()
    robot.received(client)
    robot.start("textmsg(1)")
    robot.cycles(4)
    received = [message for message in robot.received(client) if not isinstance(message, RobotStateData)]
    assert [type(message) for message in received[-2:]] == [KeyMessage, GlobalVariableValues]
    assert received[-2].title == "PROGRAM_XXX_STOPPED"
    assert received[-1].values == ()
    assert not of_kind(received, GlobalVariableNames)


def test_the_last_values_are_those_at_the_end(robot: Robot) -> None:
    client = robot.client()
    robot.start("global n = 1", "sleep(0.25)", "n = 7")
    robot.cycles(6)
    values = of_kind(robot.received(client), GlobalVariableValues)
    assert [update.values for update in values] == [(1,), (1,), (7,)]


VALUES = [
    ("True", True),
    ("-5", -5),
    ("0.5", 0.5),
    ("1e300", float("inf")),
    ('"words"', "words"),
    ("p[1, 2, 3, 0, 0, 0.5]", PoseValue((1.0, 2.0, 3.0, 0.0, 0.0, 0.5))),
    ("[1, 2.5]", (1, 2.5)),
    ("[p[0,0,0,0,0,0]]", (PoseValue((0.0,) * 6),)),
    ("[[1, 2], [3, 4]]", MatrixValue(((1, 2), (3, 4)))),
    ('struct(a = 1, b = "x")', 'struct(a=1,b="x")'),
]


@pytest.mark.parametrize(("text", "value"), VALUES, ids=[text for text, _ in VALUES])
def test_every_type_of_value_is_reported(robot: Robot, text: str, value: Any) -> None:
    client = robot.client()
    robot.start(f"global x = {text}", "sleep(0.3)")
    robot.cycles(2)
    assert of_kind(robot.received(client), GlobalVariableValues)[0].values == (value,)


def test_a_version_without_matrices_reports_lists(make_robot: Callable[..., Robot]) -> None:
    robot = make_robot("ur5e", "5.8.0")
    client = robot.client()
    robot.start("global x = [[1, 2], [3, 4]]", "global y = 1", "sleep(0.3)")
    robot.cycles(2)
    assert of_kind(robot.received(client), GlobalVariableValues)[0].values == (((1, 2), (3, 4)), 1)


def test_a_variable_without_a_value_is_none(robot: Robot) -> None:
    client = robot.client()
    robot.start("sleep(0.3)", "global later = 1")
    robot.cycles(2)
    assert of_kind(robot.received(client), GlobalVariableValues)[0].values == (None,)


def test_many_variables_are_split_into_messages_of_legal_size(robot: Robot) -> None:
    client = robot.client()
    count = 900
    robot.start(*(f"global variable_number_{n} = {n}" for n in range(count)), "sleep(2)")
    robot.cycles(12)
    received = robot.received(client)
    names: dict[int, str] = {}
    for message in of_kind(received, GlobalVariableNames):
        names |= dict(enumerate(message.names, message.start_index))
    assert list(names.values()) == [f"variable_number_{n}" for n in range(count)]
    values: dict[int, Any] = {}
    for message in of_kind(received, GlobalVariableValues):
        values |= dict(enumerate(message.values, message.start_index))
    assert values == dict(enumerate(range(count)))


def test_values_too_large_for_a_message_are_truncated(robot: Robot) -> None:
    client = robot.client()
    robot.start(
        "global numbers = make_list(9000, 1.5)",
        "global small = 3",
        "global nested = [make_list(500, 1), make_list(400, 2)]",
        'global words = "é"',
        "while str_len(words) < 500:",
        "  words = str_cat(words, words)",
        "end",
        "sleep(2)",
    )
    robot.cycles(12)
    values: dict[int, Any] = {}
    for message in of_kind(robot.received(client), GlobalVariableValues):
        values |= dict(enumerate(message.values, message.start_index))
    assert set(values[0]) == {1.5}
    assert 300 < len(values[0]) < 400
    assert values[1] == 3
    assert values[2][0][:2] == (1, 1)
    assert values[3] == "é" * 256


def test_the_size_of_a_cycle_is_limited(robot: Robot) -> None:
    client = robot.client()
    robot.start(*(f"global x{n} = make_list(300, {n})" for n in range(30)), "sleep(2)")
    robot.cycles(3)
    client.take()
    robot.cycles()
    assert len(client.take()) < 8000


def test_a_late_client_receives_the_names(robot: Robot) -> None:
    early = robot.client()
    robot.start("global n = 4", "sleep(2)")
    robot.cycles(2)
    robot.received(early)
    late = robot.client()
    robot.cycles(2)
    assert of_kind(robot.received(late), GlobalVariableNames)[0].names == ("n",)
    assert of_kind(robot.received(early), GlobalVariableNames) == []


def test_a_program_that_ended_without_clients_is_not_reported(robot: Robot) -> None:
    robot.start("global n = 4")
    robot.cycles(2)
    client = robot.client()
    robot.cycles(2)
    assert {type(message) for message in robot.received(client)[1:]} == {RobotStateData}


def test_the_next_program_reports_new_names(robot: Robot) -> None:
    client = robot.client()
    robot.start("global a = 1", "sleep(0.2)")
    robot.cycles(4)
    robot.start("global b = 2", "sleep(0.2)")
    robot.cycles(4)
    assert [message.names for message in of_kind(robot.received(client), GlobalVariableNames)] == [("a",), ("b",)]


def test_only_primary_ports_report_programs(robot: Robot) -> None:
    clients = {name: robot.client(name) for name, server in robot.servers.items() if isinstance(server, PrimaryServer)}
    robot.start("global n = 1", "sleep(1)")
    robot.cycles(3)
    reported = {name for name, client in clients.items() if of_kind(robot.received(client), GlobalVariableValues)}
    assert reported == {"primary", "primary read-only"}


def test_labels_show_the_position_of_each_thread(robot: Robot) -> None:
    client = robot.client()
    robot.start(
        '$ 1 "Robot Program"',
        "thread watch():",
        '  $ 5 "Watching"',
        "  sleep(5)",
        "end",
        "run watch()",
        '$ 2 "MoveJ"',
        "sleep(0.3)",
        '$ 3 "Wait"',
        "sleep(0.3)",
    )
    robot.cycles(8)
    threads = [message.threads for message in of_kind(robot.received(client), ProgramThreadsMessage)]
    watching = ProgramThread(5, "Watching", "watch")
    assert threads[0] == (ProgramThread(2, "MoveJ", "prog"), watching)
    assert threads[-2] == (ProgramThread(3, "Wait", "prog"), watching)
    assert threads[-1] == ()


def test_a_program_without_labels_reports_no_threads(robot: Robot) -> None:
    client = robot.client()
    robot.start("global n = 1", "sleep(0.3)")
    robot.cycles(3)
    assert of_kind(robot.received(client), ProgramThreadsMessage) == []


def test_a_client_that_does_not_read_loses_values_but_not_its_connection(robot: Robot) -> None:
    client = robot.client()
    client.transport.stalled = True
    robot.start("global x = make_list(300, 1)", "while True:", "  sleep(1)", "end")
    robot.cycles(600)
    assert client.connected
