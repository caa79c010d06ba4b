"""Text of any bytes on the client side: scripts go out as they are, what robots say can be shown and kept."""

import json

from client.pendant.dialogues import Dialogues
from client.pendant.events import EventLog
from client.primary import PrimaryCore
from client.recording.cdr import MessageType
from urproto.commandline import plain_json
from urproto.primary.framing import PrimaryDecoder
from urproto.primary.messages import PopupMessage, VersionMessage
from urproto.text import from_bytes, readable_in
from urproto.versions import PolyscopeVersion

LATIN = "Zoë".encode("latin-1")
SHOWN = r"Zo\xeb"
VERSION = PolyscopeVersion(5, 22, 0, 1)


def test_a_script_goes_out_as_it_is_in_its_file() -> None:
    script = b'def p():\n  textmsg("%s")\nend' % LATIN
    assert next(iter(PrimaryCore().send_script(from_bytes(script)))) == script + b"\n"


def test_messages_of_a_robot_are_shown_on_the_pendant() -> None:
    sent = PopupMessage(request_id=1, title=from_bytes(LATIN), text=from_bytes(LATIN))
    greeting = VersionMessage.of(VERSION, "today").encode(VERSION)
    _, received = PrimaryDecoder().feed(greeting + sent.encode(VERSION))
    assert received == sent
    log, dialogues = EventLog(), Dialogues()
    for listener in (log, dialogues):
        listener.handle_message(readable_in(received))
    assert log.events[-1].text == f"{SHOWN}: {SHOWN}"
    assert dialogues.oldest is not None
    assert dialogues.oldest.title == SHOWN


def test_recordings_and_json_hold_unicode() -> None:
    message = MessageType("std_msgs/msg/String", "string data\n")
    assert message.decode(message.encode({"data": from_bytes(LATIN)})) == {"data": SHOWN}
    assert json.dumps(plain_json({"text": [from_bytes(LATIN)]}), ensure_ascii=False).encode("utf-8")
