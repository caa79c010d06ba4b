"""Interaction of programs with users: questions and answers, variables, the length of texts."""

import pytest

from emulator.commands.requests import ScriptUnit
from tests.commands import PopupAnswer
from urproto.modes import RuntimeState
from urproto.primary.framing import PrimaryDecoder
from urproto.primary.messages import PopupMessage, TextMessage
from urproto.primary.program_state import VariableMessage


def ask_operator(rig, kind):
    rig.start(f'textmsg(request_{kind}_from_primary_client("?"))')
    rig.until(lambda: bool(rig.controller.popups.shown), 1.0)


@pytest.mark.parametrize(
    ("kind", "typed", "seen"),
    [
        ("boolean", "Yes", "True"),
        ("boolean", "false", "False"),
        ("integer", "-7", "-7"),
        ("float", "2", "2"),
        ("float", "0.25", "0.25"),
        ("string", "Left Hand", "Left Hand"),
    ],
)
def test_operator_answers_on_a_script_port(rig, kind, typed, seen):
    ask_operator(rig, kind)
    rig.controller.post(ScriptUnit(f"answer question {typed}\n", "line"))
    rig.until(lambda: rig.state is RuntimeState.STOPPED, 1.0)
    assert rig.texts == [seen]


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        ("boolean", 1),
        ("integer", True),
        ("integer", 0.5),
        ("integer", 2**31),
        ("float", "1"),
        ("float", float("nan")),
        ("float", 10**400),
        ("string", 3),
        ("string", "é" * 512),
    ],
)
def test_an_answer_of_the_wrong_type_leaves_the_question_open(rig, kind, value):
    ask_operator(rig, kind)
    replies = []
    rig.controller.post(PopupAnswer(rig.controller.popups.shown[0].request_id, value), replies.append)
    rig.tick(2)
    assert replies == [False]
    assert len(rig.controller.popups.shown) == 1
    assert rig.state is RuntimeState.PLAYING


@pytest.mark.parametrize("line", ["answer question maybe", "answer question 5 6"])
def test_an_invalid_typed_answer_is_reported(rig, line):
    ask_operator(rig, "integer")
    rig.controller.post(ScriptUnit(f"{line}\n", "line"))
    rig.tick(2)
    assert "is not an answer" in rig.texts[0]
    assert len(rig.controller.popups.shown) == 1


@pytest.mark.parametrize("line", ["answer question 5", "cancel question"])
def test_an_answer_without_a_question_is_ignored(rig, line):
    rig.start("while True:\n  sync()\nend")
    rig.controller.post(ScriptUnit(f"{line}\n", "line"))
    rig.tick(3)
    assert "no question is open" in rig.texts[0]
    assert rig.state is RuntimeState.PLAYING


def test_cancelled_question_ends_the_program(rig):
    ask_operator(rig, "integer")
    rig.controller.post(ScriptUnit("cancel question\n", "line"))
    rig.until(lambda: rig.state is RuntimeState.STOPPED, 1.0)
    assert "cancelled" in rig.exceptions[0].text
    assert rig.controller.popups.shown == []


def test_varmsg_sends_the_variable_as_text(rig):
    rig.run('varmsg("height", [1, 0.5])')
    (message,) = [m for m in rig.messages if isinstance(m, VariableMessage)]
    assert (message.title, message.text) == ("height", "[1,0.5]")
    data = message.encode(rig.controller.version)
    assert PrimaryDecoder(rig.controller.version).feed(data) == [message]


@pytest.mark.parametrize("call", ["textmsg(x, x)", 'varmsg("x", x)', "popup(x)"])
def test_long_messages_are_cut_to_the_size_clients_can_read(rig, call):
    rig.run(f"x = make_list(3000, 1.25)\n{call}")
    (message,) = [m for m in rig.messages if isinstance(m, TextMessage | VariableMessage | PopupMessage)]
    assert 3000 < len(message.encode(rig.controller.version)) <= 4096


def test_messages_are_cut_by_bytes_not_characters(rig):
    rig.run(f'textmsg("{"é" * 3000}")')
    assert len(rig.texts[0].encode("utf-8", "surrogateescape")) == 4000
