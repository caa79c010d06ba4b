"""Popups and questions as a pendant keeps them."""

import pytest

from client.pendant.dialogues import Dialogues, parse_answer
from urproto.modes import RequestedType
from urproto.primary.messages import PROGRAM_STOPPED, KeyMessage, PopupMessage, RequestValueMessage

ASK = RequestValueMessage(request_id=3, requested_type=RequestedType.INTEGER, text="how many?")
POPUP = PopupMessage(request_id=2, title="Attention", text="<b>no</b>", warning=True)


def listed(number: int, kind: str = "NONE") -> dict[str, object]:
    return {"id": number, "title": "", "text": "t", "type": kind}


def test_popups_and_questions_are_open_until_somebody_closes_them():
    dialogues = Dialogues()
    dialogues.handle_message(POPUP)
    dialogues.handle_message(ASK)
    assert dialogues.oldest is not None
    assert (dialogues.oldest.title, dialogues.oldest.severity) == ("Attention", "warning")
    dialogues.close_popups()
    assert [dialogue.number for dialogue in dialogues.open.values()] == [3]
    dialogues.close(3)
    assert dialogues.oldest is None


def test_the_end_of_a_program_takes_its_questions_back():
    dialogues = Dialogues()
    dialogues.handle_message(POPUP)
    dialogues.handle_message(ASK)
    dialogues.handle_message(KeyMessage(title=PROGRAM_STOPPED, text="go"))
    assert list(dialogues.open) == [2]


def test_an_older_list_does_not_open_what_was_answered_here():
    dialogues = Dialogues()
    dialogues.synchronise([listed(7, "INTEGER")])
    assert dialogues.oldest is not None
    assert (dialogues.oldest.title, dialogues.oldest.type) == ("Question", RequestedType.INTEGER)
    dialogues.close(7)
    dialogues.synchronise([listed(7, "INTEGER")])
    assert dialogues.oldest is None
    dialogues.synchronise([])
    dialogues.synchronise([listed(7, "STRING")])  # of an emulator that began anew
    assert list(dialogues.open) == [7]


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        (RequestedType.INTEGER, " -12 ", -12),
        (RequestedType.FLOAT, "0.25", 0.25),
        (RequestedType.FLOAT, "3", 3.0),
        (RequestedType.STRING, " 3 ", " 3 "),
    ],
)
def test_typed_answers_have_the_type_that_is_asked_for(kind: RequestedType, text: str, value: object):
    assert parse_answer(kind, text) == value


@pytest.mark.parametrize(
    ("kind", "text", "wanted"),
    [
        (RequestedType.INTEGER, "1.5", "an integer"),
        (RequestedType.INTEGER, "", "an integer"),
        (RequestedType.INTEGER, "3000000000", "at most 2147483647"),
        (RequestedType.FLOAT, "a lot", "a number"),
        (RequestedType.FLOAT, "nan", "a number"),
        (RequestedType.FLOAT, "1e999", "a number"),
    ],
)
def test_a_wrong_answer_says_what_is_wanted(kind: RequestedType, text: str, wanted: str):
    with pytest.raises(ValueError, match=wanted):
        parse_answer(kind, text)
