"""Every kind of message of every port has a golden case: bytes or texts from external sources, with their origin.

Our extensions of External Control exist nowhere else: their cases are written manually after the URScript of our
control program, and are marked as such.

``tests/golden/wire.tsv`` is the list. Each case is decoded by the port's codec, which determines its kinds, and must be
encoded to the same bytes. A kind without a case fails; the table of all is ``tests/golden/README.md``, which

    PYTHONPATH=. python tests/codecs/test_golden.py

writes.
"""

import json
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.rows import each_row
from urproto import external_control as ec
from urproto import modbus
from urproto.dashboard import COMMANDS
from urproto.interpreter import (
    InterpreterCommand,
    Reason,
    StatementDecoder,
    ack,
    discard,
    encode_answer,
    parse_answer,
)
from urproto.interpreter import state as state_answer
from urproto.primary import messages, program_state, state
from urproto.primary.framing import OtherMessage, PrimaryDecoder
from urproto.realtime import COLUMNS, packet_size
from urproto.robotiq import Get, RequestDecoder, Set, encode_value
from urproto.rtde import codec as rtde
from urproto.versions import PolyscopeVersion

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / "tests" / "golden"
LINES = (GOLDEN / "wire.tsv").read_text().splitlines()
ROWS = [tuple(line.split("\t")) for line in LINES if not line.startswith("#")]
EXECUTED = [row for row in ROWS if not row[2].startswith("test:")]

# messages that do not depend on the protocol have only the form of protocol 2
BOTH_PROTOCOLS = {"SetupOutputs", "SetupOutputsReply", "OutputData", "TextMessage"}
CODES = {"3.2": program_state._OLDEST_TYPES, "3.13": program_state._OLD_TYPES, "5.9": program_state._NEW_TYPES}
REALTIME = dict.fromkeys(str(column.since.cb3 or column.since.e).removesuffix(".0") for column in COLUMNS)


def data_of(case: str) -> bytes:
    """The bytes of a case."""
    if case.startswith("@"):
        lines = (GOLDEN / case[1:]).read_text().splitlines()
        assert lines[0].startswith("#"), f"{case} does not state its origin"
        return bytes.fromhex("".join(line for line in lines if not line.startswith("#")))
    if case.startswith('"'):
        return json.loads(case).encode()
    if case.startswith("w "):
        counted = (word.partition("*") for word in case.split()[1:])
        words = [int(word) for word, _, count in counted for _ in range(int(count or 1))]
        return struct.pack(f">{len(words)}i", *words)
    return bytes.fromhex(case)


# one function per port: the kinds in the bytes; the codec must encode the same bytes again


def primary(version: str, case: str) -> set[str]:
    parsed, data = PolyscopeVersion.parse(version), data_of(case)
    received = PrimaryDecoder(parsed).feed(data)
    kinds, again = set(), b""
    for message in received:
        if isinstance(message, state.RobotStateData):
            assert not message.unknown
            kinds |= {part_kind(type(part)) for part in message.parts}
            again += state.encode_robot_state(message, parsed, full=message.configuration is not None)
        elif isinstance(message, OtherMessage):
            assert message.error is None
            again += struct.pack(">iB", 5 + len(message.payload), message.type) + message.payload
        else:
            kinds.add(type(message).__name__)
            again += message.encode(parsed)
    read_only = False
    if len(received) == 1 and isinstance(received[0], program_state.GlobalVariableValues) and version in CODES:
        name = CODES[version][data[16]]
        kinds.add(value_kind(version, name))
        read_only = name in ("var string", "num")
    if isinstance(received[0], messages.PopupMessage):
        kinds.add("PopupMessage as " + ("request" if data[14] == 9 else "popup" if version != "3.2" else "short popup"))
    assert again == data or (read_only and PrimaryDecoder(parsed).feed(again) == received)
    return kinds


def part_kind(part: type) -> str:
    return f"state part {part.type} {part.__name__}"


def value_kind(version: str, name: str) -> str:
    first = {"3.2": "the beginning", "3.13": "3.3 and 5.0", "5.9": "3.14 and 5.9"}[version]
    return f"variable: {name}, from {first} on"


def rtde_request(protocol: str, case: str) -> set[str]:
    return _rtde(rtde.decode_request, int(protocol), data_of(case))


def rtde_reply(protocol: str, case: str) -> set[str]:
    return _rtde(rtde.decode_reply, int(protocol), data_of(case))


def _rtde(decode: Callable[[rtde.Package, int], rtde.Request | rtde.Reply], protocol: int, data: bytes) -> set[str]:
    (package,) = rtde.RTDEDecoder().feed(data)
    message = decode(package, protocol)
    assert message.encode(protocol) == data
    return {_rtde_kind(type(message), protocol)}


def _rtde_kind(message: type, protocol: int) -> str:
    return message.__name__ + (f", protocol {protocol}" if message.__name__ in BOTH_PROTOCOLS else "")


def gripper(_: str, case: str) -> set[str]:
    request_data, answer = map(data_of, case.split(" -> "))
    decoder = RequestDecoder()
    (request,) = decoder.feed(request_data) or decoder.flush()
    if isinstance(request, Get):
        text = answer.decode().split()[-1]
        assert encode_value(request, text) == answer
        return {"GET" if request.named else "GET without its line end"}
    assert isinstance(request, Set)
    assert answer == b"ack"  # tests/controller/test_gripper.py and tests/servers/test_gripper_server.py
    return {"SET"}


def interpreter(_: str, case: str) -> set[str]:
    request_data, answer = map(data_of, case.split(" -> "))
    (line,) = StatementDecoder().feed(request_data)
    assert isinstance(line, str)
    received = parse_answer(answer.decode().removesuffix("\n"))
    assert received.line == line
    if received.number is None:
        reason = Reason(received.reason)
        assert encode_answer(discard(reason, line)) == answer
        return {f"discard: {reason.name}"}
    command = InterpreterCommand.of(line)
    encode = state_answer if answer.startswith(b"state") else ack
    assert encode_answer(encode(received.number, line)) == answer
    return {command.value if command else "ack"}


def modbus_exchange(_: str, case: str) -> set[str]:
    request_data, answer = map(data_of, case.split(" -> "))
    request = modbus.decode_request(request_data)
    assert modbus.encode_request(request) == request_data
    if answer[0] & 0x80:
        assert modbus.exception_response(request.function, answer[1]) == answer
        with pytest.raises(modbus.ModbusException):
            modbus.decode_response(request, answer)
        return {"exception"}
    values = modbus.decode_response(request, answer)
    assert modbus.encode_response(request, values) == answer
    return {modbus.Function(request.function).name}


def reverse(_: str, case: str) -> set[str]:
    message = ec.ReverseMessage.decode(data_of(case))
    if message.mode is not ec.ControlMode.IDLE:  # its payload has no meaning
        assert message.encode() == data_of(case)
    return {f"reverse: {message.mode.name}"}


def trajectory(_: str, case: str) -> set[str]:
    point = ec.TrajectoryPoint.decode(data_of(case))
    assert point.encode() == data_of(case)
    return {f"point: {point.type.name}"}


def script_command(_: str, case: str) -> set[str]:
    command = ec.ScriptCommand.decode(data_of(case))
    assert command.encode() == data_of(case)
    return {f"command: {command.kind.name}"}


def result(_: str, case: str) -> set[str]:
    (received,) = ec.ReplyDecoder().feed(data_of(case))
    assert isinstance(received, ec.TrajectoryResult)
    return {f"result: {received.name}"}


def answer(_: str, case: str) -> set[str]:
    (received,) = ec.ReplyDecoder().feed(data_of(case))
    assert isinstance(received, ec.Answer)
    assert received.encode() == data_of(case)
    return {"answer: values" if received.values else "answer: no solution"}


def sender(_: str, case: str) -> set[str]:
    assert data_of(case) == ec.REQUEST_PROGRAM
    return {"request for the program"}


READERS: dict[str, Callable[[str, str], set[str]]] = {
    "primary": primary,
    "rtde request": rtde_request,
    "rtde reply": rtde_reply,
    "interpreter": interpreter,
    "gripper": gripper,
    "modbus": modbus_exchange,
    "external control reverse": reverse,
    "external control trajectory": trajectory,
    "external control command": script_command,
    "external control result": result,
    "external control answer": answer,
    "external control sender": sender,
}


def required_kinds() -> Iterator[tuple[str, str]]:
    """Port and kind of every message that exists, from the code."""
    for part in (kind for _, kind in state._PARTS.values()):
        yield "primary", part_kind(part)
    for message in (*messages._KINDS.values(), messages.UnknownMessage):
        yield "primary", message.__name__
    for form in ("request", "popup", "short popup"):
        yield "primary", f"PopupMessage as {form}"
    for kind in (
        program_state.GlobalVariableNames, program_state.GlobalVariableValues, program_state.VariableMessage,
    ):  # fmt: skip
        yield "primary", kind.__name__
    for version, codes in CODES.items():
        for name in codes.values():
            yield "primary", value_kind(version, name)
    for port, kinds in (("rtde request", rtde.Request), ("rtde reply", rtde.Reply)):
        for kind in kinds.__args__:
            for protocol in (1, 2) if kind.__name__ in BOTH_PROTOCOLS else (2,):
                yield port, _rtde_kind(kind, protocol)
    for version in REALTIME:
        yield "realtime", f"packet of {packet_size(PolyscopeVersion.parse(version))} bytes, from {version} on"
    for words in sorted(command.words for command in COMMANDS.values()):
        yield "dashboard", words
    discarded = (f"discard: {reason.name}" for reason in Reason)
    for text in (*(command.value for command in InterpreterCommand), "ack", *discarded):
        yield "interpreter", text
    for text in ("GET", "GET without its line end", "SET"):
        yield "gripper", text
    for function in (*modbus.Function, None):
        yield "modbus", function.name if function else "exception"
    for port, prefix, members in (
        ("external control reverse", "reverse", ec.ControlMode),
        ("external control trajectory", "point", ec.MotionType),
        ("external control command", "command", ec.ScriptCommandKind),
        ("external control result", "result", ec.TrajectoryResult),
    ):
        for member in members:
            yield port, f"{prefix}: {member.name}"
    for text in ("values", "no solution"):
        yield "external control answer", f"answer: {text}"
    yield "external control sender", "request for the program"


def origins() -> dict[tuple[str, str], list[str]]:
    """The origins of the cases of each kind; a referenced test covers all kinds of its port."""
    found: dict[tuple[str, str], list[str]] = {kind: [] for kind in required_kinds()}
    for port, version, case, origin in ROWS:
        kinds = {kind for its_port, kind in found if its_port == port}
        if not case.startswith("test:"):
            kinds = READERS[port](version, case)
        for kind in kinds:
            known = found.setdefault((port, kind), [])
            if origin not in known:
                known.append(origin)
    return found


def table() -> str:
    rows = "".join(
        f"| {port} | {kind} | {'; '.join(known) or '**none**'} |\n" for (port, kind), known in origins().items()
    )
    return (
        "# Golden cases\n\n<!-- Written by tests/codecs/test_golden.py: do not edit. -->\n\n"
        "Reference cases for each kind of message, and their origins. The cases are in `wire.tsv`,\n"
        '`dashboard.tsv` and the `.hex` files; "capture" is bytes of a controller, everything else was written\n'
        "manually after a document or after an external parser that is used with controllers. Only our extensions of\n"
        "External Control have no external origin: they were written manually after the URScript of our control\n"
        "program.\n\n"
        f"| port | kind | origin |\n| --- | --- | --- |\n{rows}"
    )


@each_row(("port", "version", "case", "origin"), EXECUTED)
def test_case(port: str, version: str, case: str, origin: str) -> None:
    assert READERS[port](version, case)
    assert origin


def test_every_kind_has_a_case() -> None:
    assert [kind for kind, known in origins().items() if not known] == []


def test_every_case_is_of_an_existing_kind() -> None:
    assert set(origins()) == set(required_kinds())


def test_referenced_tests_exist() -> None:
    for row in ROWS:
        if row[2].startswith("test:"):
            path, _, name = row[2].removeprefix("test:").partition("::")
            assert f"def {name}(" in (ROOT / path).read_text(), row[2]
    sizes = (ROOT / "tests/codecs/test_realtime.py").read_text()
    assert all(f'("{version}", {packet_size(PolyscopeVersion.parse(version))})' in sizes for version in REALTIME)


def test_every_recording_is_used() -> None:
    named = {row[2][1:] for row in ROWS if row[2].startswith("@")}
    older = {"robot_state_cb2.hex"}  # for a series that is not emulated
    assert {path.name for path in GOLDEN.glob("*.hex")} == named | older


def test_the_table_is_up_to_date() -> None:
    assert (GOLDEN / "README.md").read_text() == table(), "run: PYTHONPATH=. python tests/codecs/test_golden.py"


if __name__ == "__main__":
    (GOLDEN / "README.md").write_text(table())
