import pytest
from server_rig import FakeController, MemoryClient

from emulator.commands.requests import DashboardLine
from emulator.mailbox import Command
from emulator.servers.hooks import Direction
from emulator.servers.requests import DashboardServer

GREETING = b"Connected: Universal Robots Dashboard Server\n"


def answer(command: Command) -> str | None:
    assert isinstance(command, DashboardLine)
    if not command.text:
        return None
    return "Disconnected" if command.text == "quit" else f"<{command.text}>"


@pytest.fixture
def controller() -> FakeController:
    return FakeController(answer=answer)


@pytest.fixture
def server(controller: FakeController) -> DashboardServer:
    return DashboardServer(controller)


@pytest.mark.parametrize("chunk", [1, 1000])
def test_greeting_and_answers_in_order(server: DashboardServer, controller: FakeController, chunk: int) -> None:
    client = MemoryClient(server)
    assert client.take() == GREETING
    client.feed(b"one\r\ntwo\n\nthree\nhalf", chunk)
    controller.tick(6)
    assert client.take() == b"<one>\n<two>\n<three>\n"
    client.feed(b" line\n", chunk)
    controller.tick()
    assert client.take() == b"<half line>\n"


def test_each_line_waits_for_the_previous_answer(server: DashboardServer, controller: FakeController) -> None:
    first, second = MemoryClient(server), MemoryClient(server)
    first.feed(b"a\nb\n")
    second.feed(b"c\n")
    controller.tick()
    assert [command.text for command in controller.commands] == ["a", "c"]


def test_quit_closes_after_its_answer(server: DashboardServer, controller: FakeController) -> None:
    client = MemoryClient(server)
    client.feed(b"quit\nnever\n")
    controller.tick(3)
    assert client.take() == GREETING + b"Disconnected\n"
    assert not client.connected
    assert [command.text for command in controller.commands] == ["quit"]


def test_a_half_closed_client_still_gets_its_answers(server: DashboardServer, controller: FakeController) -> None:
    client = MemoryClient(server)
    client.feed(b"a\nb\n")
    client.end()
    controller.tick(2)
    assert client.take() == GREETING + b"<a>\n<b>\n"
    assert not client.connected


def test_lines_of_a_vanished_client_are_carried_out(server: DashboardServer, controller: FakeController) -> None:
    client = MemoryClient(server)
    client.feed(b"a\nb\n")
    client.vanish()
    controller.tick(3)
    assert [command.text for command in controller.commands] == ["a", "b"]


def test_an_endless_line_ends_the_connection(server: DashboardServer, controller: FakeController) -> None:
    client, other = MemoryClient(server), MemoryClient(server)
    client.feed(b"x" * 200_000)
    assert not client.connected
    assert other.connected


def test_hooks_see_lines(server: DashboardServer, controller: FakeController) -> None:
    server.hooks.on_message.append(
        lambda connection, direction, line: None if "secret" in line else f"{direction.value} {line}"
    )
    client = MemoryClient(server)
    client.feed(b"a\nsecret\n")
    controller.tick(3)
    assert client.take().splitlines()[1:] == [f"{Direction.SENT.value} <received a>".encode()]
