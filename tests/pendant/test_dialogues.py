"""Popups and questions."""

import pytest

from client.pendant.dialogues import Dialogues, parse_answer
from tests.rows import each_row
from urproto.modes import RequestedType
from urproto.primary.messages import PROGRAM_STOPPED, KeyMessage, PopupMessage, RequestValueMessage

ASK = RequestValueMessage(request_id=3, requested_type=RequestedType.INTEGER, text="how many?")
POPUP = PopupMessage(request_id=2, title="Attention", text="<b>no</b>", warning=True)


def listed(number: int, kind: str = "NONE") -> dict[str, object]:
    return {"id": number, "title": "", "text": "t", "type": kind}


def test_dialogues_stay_open_until_closed():
    dialogues = Dialogues()
    dialogues.handle_message(POPUP)
    dialogues.handle_message(ASK)
    assert dialogues.oldest is not None
    assert (dialogues.oldest.title, dialogues.oldest.severity) == ("Attention", "warning")
    dialogues.close_popups()
    assert [dialogue.number for dialogue in dialogues.open.values()] == [3]
    dialogues.close(3)
    assert dialogues.oldest is None


def test_program_end_closes_questions():
    dialogues = Dialogues()
    dialogues.handle_message(POPUP)
    dialogues.handle_message(ASK)
    dialogues.handle_message(KeyMessage(title=PROGRAM_STOPPED, text="go"))
    assert list(dialogues.open) == [2]


def test_outdated_list_does_not_reopen_closed_dialogue():
    dialogues = Dialogues()
    dialogues.synchronise([listed(7, "INTEGER")])
    assert dialogues.oldest is not None
    assert (dialogues.oldest.title, dialogues.oldest.type) == ("Question", RequestedType.INTEGER)
    dialogues.close(7)
    dialogues.synchronise([listed(7, "INTEGER")])
    assert dialogues.oldest is None
    dialogues.synchronise([])
    dialogues.synchronise([listed(7, "STRING")])  # of a restarted emulator
    assert list(dialogues.open) == [7]


@each_row(
    ("kind", "text", "value"),
    [
        (RequestedType.INTEGER, " -12 ", -12),
        (RequestedType.FLOAT, "0.25", 0.25),
        (RequestedType.FLOAT, "3", 3.0),
        (RequestedType.STRING, " 3 ", " 3 "),
    ],
)
def test_typed_answers_are_converted_to_requested_type(kind: RequestedType, text: str, value: object):
    assert parse_answer(kind, text) == value


@each_row(
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
def test_invalid_answer_reports_expected_format(kind: RequestedType, text: str, wanted: str):
    with pytest.raises(ValueError, match=wanted):
        parse_answer(kind, text)
