"""The bookkeeping of interpreter mode, without a program."""

import pytest

from emulator.programs.interpreter import MAX_STATEMENTS, StatementQueue
from urproto.interpreter import LAST_ID, Reason

Queue = StatementQueue[str]


@pytest.fixture
def queue() -> Queue:
    return StatementQueue()


@pytest.fixture
def answers() -> list[str]:
    return []


def interpret(queue: Queue, answers: list[str], *lines: str, holds: bool = False) -> None:
    for line in lines:
        queue.receive(line, answers.append)
        queue.accept(line.upper(), holds=holds)


def run(queue: Queue) -> str:
    statement = queue.start()
    assert statement is not None
    queue.finish()
    return statement.code


def test_the_life_of_a_line(queue: Queue, answers: list[str]) -> None:
    queue.receive("a", answers.append)
    assert (answers, queue.unexecuted, queue.last_interpreted) == ([], 1, 0)
    queue.accept("A", holds=False)
    assert (answers, queue.unexecuted, queue.last_interpreted, queue.last_executed) == (["ack: 1: a"], 1, 1, 0)
    assert run(queue) == "A"
    assert (queue.unexecuted, queue.last_executed, queue.last_cleared) == (0, 1, 0)
    assert queue.start() is None
    assert [statement.id for statement in queue.clear()] == [1]
    assert queue.last_cleared == 1


def test_refused_lines_have_no_id(queue: Queue, answers: list[str]) -> None:
    queue.receive("(", answers.append)
    queue.refuse(Reason.SYNTAX)
    interpret(queue, answers, "b")
    assert answers == ["discard: Syntax error: (", "ack: 1: b"]


def test_ids_wrap_around(queue: Queue, answers: list[str]) -> None:
    queue.last_interpreted = LAST_ID
    interpret(queue, answers, "a")
    assert answers == ["ack: 1: a"]


def test_lines_after_a_clear_wait_until_it_was_executed(queue: Queue, answers: list[str]) -> None:
    interpret(queue, answers, "a")
    interpret(queue, answers, "clear", holds=True)
    queue.receive("b", answers.append)
    assert queue.next_received is None
    run(queue)
    assert queue.next_received is None
    queue.start()
    assert [statement.id for statement in queue.clear()] == [2, 1]
    queue.finish()
    received = queue.next_received
    assert received is not None
    assert received.line == "b"


def test_skip_keeps_running_statements_and_definitions(queue: Queue, answers: list[str]) -> None:
    interpret(queue, answers, "a", "b")
    queue.start()
    interpret(queue, answers, "clear", holds=True)
    queue.receive("c", answers.append)
    assert queue.unexecuted == 3
    queue.skip()
    assert queue.unexecuted == 0
    assert answers[-1] == "discard: Cleaned up before interpretation: c"
    queue.receive("d", answers.append)
    assert queue.next_received is not None, "the clear was skipped: nothing is waited for"
    assert len(queue.kept) == 3


def test_skip_during_a_clear_still_waits_for_it(queue: Queue, answers: list[str]) -> None:
    interpret(queue, answers, "clear", holds=True)
    queue.start()
    queue.skip()
    queue.receive("a", answers.append)
    assert queue.next_received is None
    queue.finish()
    assert queue.next_received is not None


def test_limits(queue: Queue, answers: list[str]) -> None:
    interpret(queue, answers, *["x"] * MAX_STATEMENTS)
    assert queue.full
    answers.clear()
    for _ in range(MAX_STATEMENTS):
        queue.receive("y", answers.append)
    assert answers == []
    queue.receive("z", answers.append)
    assert answers == ["discard: Too many interpreted messages: z"]
    queue.end()
    assert len(queue.clear()) == MAX_STATEMENTS
    assert not queue.full
