"""XML-RPC of scripts, in virtual time: the tests write the server's bytes."""

import math
import xmlrpc.client
from contextlib import nullcontext, suppress

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from emulator.builtins.remote import connections
from emulator.builtins.remote.connections import PacketReader
from emulator.builtins.remote.xmlrpc import BadReplyError, Reply, encode_call, to_value
from tests.rows import each_row
from urscript.values import INT_MAX, INT_MIN, MAX_ELEMENTS, Matrix, Pose, Struct

URL = "http://10.0.0.1:50001/RPC2"
FACTORY = f'server = rpc_factory("xmlrpc", "{URL}")\n'


def to_end(frames):
    """The result of a generator that waits for nothing."""
    while True:
        try:
            next(frames)
        except StopIteration as end:
            return end.value


def xml(value) -> bytes:
    """A reply, by the standard library's codec."""
    return xmlrpc.client.dumps((value,), methodresponse=True, allow_none=True).encode()


def http(body: bytes, *headers: str, status: str = "200 OK") -> bytes:
    lines = [f"HTTP/1.1 {status}", f"Content-Length: {len(body)}", *headers]
    return "\r\n".join([*lines, "", ""]).encode() + body


def requested(sent: bytes) -> tuple[str, dict[str, str], tuple, str]:
    """Request line, headers, arguments and method of the last call that was sent."""
    head, body = sent.rsplit(b"POST ", 1)[1].split(b"\r\n\r\n", 1)
    line, *headers = head.decode().split("\r\n")
    arguments, method = xmlrpc.client.loads(body)
    return f"POST {line}", dict(header.split(": ", 1) for header in headers), arguments, method


def start_call(rig, call: str):
    """Run a program until it has sent a call; returns the socket."""
    rig.start(f"{FACTORY}global result = {call}\nsync()\nsync()")
    rig.until(lambda: bool(rig.sockets.opened and rig.sockets.opened[-1].sent), 1.0)
    return rig.sockets.opened[-1]


def call(rig, expression: str, *reply: bytes):
    """The result of a call when the server sends these bytes, some frames apart."""
    socket = start_call(rig, expression)
    for data in reply:
        socket.feed(data)
        rig.tick(2)
    rig.until(lambda: is_set(rig) or bool(rig.exceptions), 5.0)
    assert rig.exceptions == []
    return rig.controller.programs.variables["result"]


def is_set(rig) -> bool:
    return "result" in rig.controller.programs.variables


def fails(rig, *reply: bytes, close: bool = False) -> str:
    socket = start_call(rig, "server.get()")
    for data in reply:
        socket.feed(data)
    if close:
        socket.close()
    rig.until(lambda: bool(rig.exceptions), 5.0)
    text = rig.exceptions[-1].text
    assert text.startswith(f"RPC get at {URL}: ")
    rig.until(lambda: rig.state.name == "STOPPED", 1.0)
    assert socket.state == "closed"
    return text.removeprefix(f"RPC get at {URL}: ")


# requests


def test_the_request(rig):
    socket = start_call(rig, 'server.get_next_pose(p[1, 2, 3, 0.1, 0, 0], [1, 2.5, True], "a<&>", -7)')
    line, headers, arguments, method = requested(bytes(socket.sent))
    assert line == "POST /RPC2 HTTP/1.1"
    assert headers["Host"] == "10.0.0.1:50001"
    assert headers["Content-Type"] == "text/xml"
    assert method == "get_next_pose"
    pose = {"x": 1.0, "y": 2.0, "z": 3.0, "rx": 0.1, "ry": 0.0, "rz": 0.0}
    assert arguments == (pose, [1, 2.5, True], "a<&>", -7)


def test_requests_are_formatted_as_by_xmlrpc_c():
    assert to_end(encode_call("set", (7, True, 1e-7, "a\rb"))) == (
        b'<?xml version="1.0" encoding="UTF-8"?>\r\n<methodCall>\r\n<methodName>set</methodName>\r\n<params>\r\n'
        b"<param><value><i4>7</i4></value></param>\r\n"
        b"<param><value><boolean>1</boolean></value></param>\r\n"
        b"<param><value><double>0.0000001</double></value></param>\r\n"
        b"<param><value><string>a&#x0d;b</string></value></param>\r\n"
        b"</params>\r\n</methodCall>\r\n"
    )


PLAIN = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(INT_MIN, INT_MAX),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(
        st.characters(min_codepoint=32, exclude_categories=("Cs",), exclude_characters="\ufffe\uffff"), max_size=50
    ),
    st.sampled_from(["\t", "\n", "\r", "\r\n", "<&>\"'", "é", ""]),
)
VALUES = st.recursive(PLAIN, lambda inner: st.one_of(st.lists(inner), st.dictionaries(st.text("abc"), inner)))


def as_struct(value):
    if isinstance(value, dict):
        return Struct({name: as_struct(item) for name, item in value.items()})
    return [as_struct(item) for item in value] if isinstance(value, list) else value


@given(VALUES)
def test_the_standard_library_reads_our_requests(value):
    arguments, _ = xmlrpc.client.loads(to_end(encode_call("m", (as_struct(value),))))
    assert arguments == (value,)


def read(reply: bytes, piece: int = 1024, structs: bool = True):
    reader = Reply()
    for at in range(0, len(reply), piece):
        reader.feed(reply[at : at + piece])
    return to_end(to_value(reader.close(), structs=structs))


@given(VALUES, st.integers(1, 50))
def test_replies_of_the_standard_library_are_read_in_any_split(value, piece):
    value = value.replace("\r", "") if isinstance(value, str) else value  # which that library does not escape
    encoded = to_end(encode_call("m", (as_struct(value),)))
    reply = encoded.replace(b"methodCall>", b"methodResponse>").replace(b"<methodName>m</methodName>\r\n", b"")
    assert read(reply, piece) == as_struct(value)
    assert read(xml(7), piece) == 7


def test_matrices_and_poses_are_sent_as_arrays_and_structs():
    sent = to_end(encode_call("m", (Matrix(((1, 2), (3, 4))), Struct({"at": Pose([0.0] * 6)}))))
    arguments, _ = xmlrpc.client.loads(sent)
    assert arguments == ([[1, 2], [3, 4]], {"at": dict.fromkeys(("x", "y", "z", "rx", "ry", "rz"), 0.0)})


@pytest.mark.parametrize(
    ("argument", "named"),
    [("1 / 0.0", "inf"), ("server", "RPC handle"), ('socket_read_string("s")', "'\\x00', at 1")],
)
def test_values_that_xml_cannot_carry_are_errors(rig, argument, named):
    rig.start(f'socket_open("10.0.0.1", 50001, "s")\n{FACTORY}server.set({argument})')
    rig.until(lambda: bool(rig.sockets.opened), 1.0)
    rig.sockets.opened[0].feed(b"a\0b")
    rig.until(lambda: bool(rig.exceptions), 1.0)
    assert named in rig.exceptions[0].text


# replies


@each_row(
    ("sent", "value"),
    [
        (True, True),
        (-5, -5),
        (2.5, 2.5),
        ("text", "text"),
        ("", ""),
        (None, None),
        ([1, [2.5, "x"]], [1, [2.5, "x"]]),
        ({"x": 1, "y": 2.5, "z": 3, "rx": 0, "ry": 0, "rz": 0}, Pose([1.0, 2.5, 3.0, 0.0, 0.0, 0.0])),
        ([{"x": 1, "y": 2, "z": 3, "rx": 0, "ry": 0, "rz": 0}], [Pose([1.0, 2.0, 3.0, 0.0, 0.0, 0.0])]),
        ({"found": True, "n": 2}, Struct({"found": True, "n": 2})),
    ],
)
def test_results(make_rig, sent, value):
    result = call(make_rig("ur5e", "5.22"), "server.get()", http(xml(sent)))
    assert result == value
    assert type(result) is type(value)


def test_the_arm_moves_to_a_returned_pose(rig):
    target = [round(part, 4) for part in rig.controller.snapshot.actual_TCP_pose]
    target[2] += 0.05
    rig.start(FACTORY + "movej(server.get_next_pose(get_actual_tcp_pose()))")
    rig.until(lambda: bool(rig.sockets.opened and rig.sockets.opened[0].sent), 1.0)
    rig.sockets.opened[0].feed(http(xml(dict(zip(("x", "y", "z", "rx", "ry", "rz"), target, strict=True)))))
    rig.until(lambda: rig.state.name == "STOPPED", 10.0)
    assert rig.exceptions == []
    assert rig.controller.snapshot.actual_TCP_pose[2] == pytest.approx(target[2], abs=1e-4)


@pytest.mark.parametrize(
    ("value", "problem"),
    [
        (xmlrpc.client.Binary(b"x"), "base64 data"),
        (xmlrpc.client.DateTime("20260101T00:00:00"), "a date"),
        ("x" * 1024, "exceeds maximum length"),
        ([[[[[[[[[[[[[[[[[1]]]]]]]]]]]]]]]]], "levels"),
    ],
)
def test_results_without_a_urscript_type(rig, value, problem):
    assert problem in fails(rig, http(xml(value)))


def test_integers_of_more_than_32_bits(rig):
    assert "does not fit 32 bits" in fails(
        rig, http(xml(1).replace(b"<int>1<", b"<i8>4294967296<").replace(b"/int", b"/i8"))
    )


def test_other_structs_are_errors_in_versions_without_structs(make_rig):
    assert "needs 5.15" in fails(make_rig("ur5", "3.15.8"), http(xml({"a": 1})))


def test_replies_in_chunks_and_in_single_bytes(rig):
    body = xml([1, 2, 3])
    chunked = b"".join(b"%x\r\n%c\r\n" % (1, byte) for byte in body) + b"0\r\n\r\n"
    reply = b"HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n" + chunked
    assert call(rig, "server.get()", *(reply[at : at + 1] for at in range(120)), reply[120:]) == [1, 2, 3]


def test_a_reply_delimited_by_the_end_of_the_connection(rig):
    socket = start_call(rig, "server.get()")
    socket.feed(b"HTTP/1.0 200 OK\r\n\r\n" + xml(5))
    rig.tick(3)
    socket.close()
    rig.until(lambda: is_set(rig), 1.0)
    assert rig.controller.programs.variables["result"] == 5


def test_a_call_blocks_only_its_own_thread(rig):
    rig.start(
        f"{FACTORY}global n = 0\nthread count():\nwhile True:\nn = n + 1\nsync()\nend\nend\nrun count()\nserver.get()"
    )
    rig.until(lambda: bool(rig.sockets.opened and rig.sockets.opened[0].sent), 1.0)
    rig.seconds(60.0)  # a server may take as long as it likes
    assert rig.state.name == "PLAYING"
    assert rig.controller.programs.variables["n"] > 1000
    rig.sockets.opened[0].feed(http(xml(1)))
    rig.until(lambda: rig.state.name == "STOPPED", 1.0)
    assert rig.exceptions == []


def test_a_long_reply_is_read_over_several_periods(rig):
    socket = start_call(rig, "server.get()")
    socket.feed(http(xml([1.5] * (MAX_ELEMENTS - 1))))
    took = rig.until(lambda: is_set(rig), 5.0)
    assert took > 100 * rig.period
    assert rig.controller.programs.variables["result"] == [1.5] * (MAX_ELEMENTS - 1)


# connections


def test_one_connection_serves_all_calls(rig):
    rig.start(FACTORY + "a = server.first()\nb = server.second()\ntextmsg(a + b)")
    rig.until(lambda: bool(rig.sockets.opened and rig.sockets.opened[0].sent), 1.0)
    (socket,) = rig.sockets.opened
    socket.feed(http(xml(1)))
    rig.until(lambda: socket.sent.count(b"POST") == 2, 1.0)
    assert requested(bytes(socket.sent))[3] == "second"
    socket.feed(http(xml(2)))
    rig.until(lambda: rig.state.name == "STOPPED", 1.0)
    assert rig.texts == ["3"]
    assert len(rig.sockets.opened) == 1
    assert socket.state == "closed"  # with the program


@pytest.mark.parametrize("between", ["server.closeXMLRPCClientConnection()", "sleep(0.1)"])
def test_a_connection_closed_by_either_side_is_reopened(rig, between):
    rig.start(f"{FACTORY}a = server.first()\n{between}\ntextmsg(server.second())")
    rig.until(lambda: bool(rig.sockets.opened and rig.sockets.opened[0].sent), 1.0)
    rig.sockets.opened[0].feed(http(xml(1)))
    rig.tick(3)
    rig.sockets.opened[0].close()
    rig.until(lambda: len(rig.sockets.opened) == 2 and bool(rig.sockets.opened[1].sent), 1.0)
    rig.sockets.opened[1].feed(http(xml(2)))
    rig.until(lambda: rig.state.name == "STOPPED", 1.0)
    assert rig.texts == ["2"]


def test_a_call_is_retried_once_if_a_kept_connection_breaks(rig):
    rig.start(FACTORY + "a = server.first()\ntextmsg(server.second())")
    rig.until(lambda: bool(rig.sockets.opened and rig.sockets.opened[0].sent), 1.0)
    rig.sockets.opened[0].feed(http(xml(1)))
    rig.until(lambda: rig.sockets.opened[0].sent.count(b"POST") == 2, 1.0)
    rig.sockets.opened[0].close()
    rig.until(lambda: len(rig.sockets.opened) == 2 and bool(rig.sockets.opened[1].sent), 1.0)
    rig.sockets.opened[1].close()
    rig.until(lambda: bool(rig.exceptions), 1.0)
    assert rig.exceptions[0].text.endswith("the connection was closed without an answer")
    assert len(rig.sockets.opened) == 2


def test_a_server_that_closes_after_each_answer(rig):
    socket = start_call(rig, "server.get() + server.get()")
    socket.feed(http(xml(1), "Connection: close"))
    rig.until(lambda: len(rig.sockets.opened) == 2 and bool(rig.sockets.opened[1].sent), 1.0)
    assert socket.state == "closed"


def test_threads_take_turns_on_a_handle(rig):
    other = "thread other():\ntextmsg(server.slow())\nend\n"
    rig.start(f"{FACTORY}{other}t = run other()\nsync()\ntextmsg(server.fast())\njoin t")
    rig.until(lambda: bool(rig.sockets.opened and rig.sockets.opened[0].sent), 1.0)
    rig.tick(5)
    (socket,) = rig.sockets.opened
    assert socket.sent.count(b"POST") == 1
    socket.feed(http(xml("slow")))
    rig.until(lambda: socket.sent.count(b"POST") == 2, 1.0)
    socket.feed(http(xml("fast")))
    rig.until(lambda: rig.state.name == "STOPPED", 1.0)
    assert rig.texts == ["slow", "fast"]


def test_a_killed_call_leaves_no_partial_answer_for_the_next(rig):
    body = f"{FACTORY}thread other():\nserver.slow()\nend\nt = run other()\nsleep(0.1)\nkill t\ntextmsg(server.fast())"
    rig.start(body)
    rig.until(lambda: len(rig.sockets.opened) == 2 and bool(rig.sockets.opened[1].sent), 1.0)
    assert rig.sockets.opened[0].state == "closed"
    rig.sockets.opened[1].feed(http(xml("fast")))
    rig.until(lambda: rig.state.name == "STOPPED", 1.0)
    assert rig.texts == ["fast"]


def test_dotted_names(rig):
    socket = start_call(rig, 'server.system.methodHelp("get")')
    assert requested(bytes(socket.sent))[2:] == (("get",), "system.methodHelp")


def test_a_handle_has_methods_and_nothing_else(rig):
    assert "'RPC handle'" in rig.fault(FACTORY + "a = server.size + 1")


def test_other_values_have_no_members(rig):
    assert rig.fault("a = 1\nb = a.name") == "Type error: 'Int' has no member 'name'"


@each_row("name", ["append", "pop", "clear", "to_string", "length"])
def test_list_method_names_are_methods_of_the_server(make_rig, name):
    rig = make_rig("ur5e", "5.22")
    assert call(rig, f"server.{name}()", http(xml(3))) == 3
    assert requested(bytes(rig.sockets.opened[0].sent))[3] == name


# errors


def test_only_the_first_call_needs_the_server_not_the_factory(rig):
    rig.run('server = rpc_factory("xmlrpc", "http://10.0.0.2:80")\ntextmsg(server)')
    assert rig.texts == ["rpc_factory(http://10.0.0.2:80/)"]
    text = rig.fault('server = rpc_factory("xmlrpc", "http://10.0.0.2:80")\nserver.get()')
    assert text == "RPC get at http://10.0.0.2:80/: cannot connect to 10.0.0.2:80: is the server running?"


def test_a_server_that_never_accepts(rig, monkeypatch):
    monkeypatch.setattr(connections, "_CONNECT_S", 1.0)
    rig.sockets.silent.add(("10.0.0.9", 80))
    assert "did not answer within 1 s" in rig.fault('rpc_factory("xmlrpc", "http://10.0.0.9").get()')
    assert rig.sockets.opened[0].state == "closed"


@each_row(
    ("kind", "url"),
    [
        ("corba", URL),
        ("xmlrpc", ""),
        ("xmlrpc", "10.0.0.1"),
        ("xmlrpc", "10.0.0.1:0"),
        ("xmlrpc", "10.0.0.1:99999"),
        ("xmlrpc", "https://10.0.0.1"),
        ("xmlrpc", "http://"),
        ("xmlrpc", "http://10.0.0.1:99999"),
        ("xmlrpc", "http://10.0.0.1:0"),
        ("xmlrpc", "http://10.0.0.1:port"),
        ("xmlrpc", "http://me:secret@10.0.0.1"),
        ("xmlrpc", "http://10.0.0.1/a b"),
        ("xmlrpc", "http://10.0.0.1/é"),
        ("xmlrpc", "http://[::1"),
    ],
)
def test_invalid_addresses(rig, kind, url):
    assert rig.fault(f'rpc_factory("{kind}", "{url}")').startswith("rpc_factory: ")


FAULT = xmlrpc.client.dumps(xmlrpc.client.Fault(1, 'method "get" is not supported'), methodresponse=True).encode()


@pytest.mark.parametrize(
    ("reply", "text"),
    [
        (http(FAULT), 'the server answered with fault 1: method "get" is not supported'),
        (http(b"", status="404 Not Found"), "the server answered with HTTP 404 Not Found"),
        (http(b"", "Location: http://10.0.0.3/", status="302 Found"), "the server answered with HTTP 302 Found"),
        (http(b"hello"), "the reply is not XML: "),
        (http(b""), "the reply is not XML: no element found"),
        (http(b"<html></html>"), "the reply is not XML-RPC: it is a html"),
        (http(b"<methodResponse></methodResponse>"), "the reply contains "),
        (http(b"<methodResponse><params></params></methodResponse>"), "the reply contains 0 results"),
        (http(b"<methodResponse><fault><value>1</value></fault></methodResponse>"), "the reply contains no result"),
        (http(xml(1).replace(b">1<", b">one<")), "the reply is not XML-RPC: ValueError"),
        (b"SSH-2.0-OpenSSH\r\n\r\n", "the answer is not HTTP: "),
        (b"HTTP/1.1 200 OK\r\nX: " + b"x" * 100_000, "the answer is not HTTP: "),
    ],
)
def test_answers_that_end_the_program(rig, reply, text):
    assert fails(rig, reply).startswith(text)


@pytest.mark.parametrize("reply", [b"", b"HTTP/1.1 200 OK\r\n", http(xml(1))[:-5]])
def test_a_server_that_closes_the_connection(rig, reply):
    text = fails(rig, reply, close=True)
    assert "closed" in text or "not HTTP" in text


LAUGHS = b"""<?xml version="1.0"?><!DOCTYPE lolz [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>
<methodResponse><params><param><value>&b;</value></param></params></methodResponse>"""


@pytest.mark.parametrize(
    ("body", "text"),
    [
        (LAUGHS, "the reply has a document type"),
        (b"<methodResponse>" + b"<value><array><data>" * 50, "the reply has more than"),
        (b"<methodResponse><params>" + b"<value/>" * 10_001, "the reply has more than"),
        (b"<methodResponse><value>" + b"x" * 600_000, "the reply is longer than 524288 bytes"),
    ],
)
def test_hostile_replies_are_cut_short(rig, body, text):
    assert fails(rig, http(body)).startswith(text)


TAG_NAMES = (
    "methodResponse params param fault value array data struct member name"
    " int i8 boolean double string base64 dateTime.iso8601 nil bigdecimal odd"
)
TAGS = st.sampled_from([f"{mark}{tag}>" for tag in TAG_NAMES.split() for mark in ("<", "</")])
MARKUP = st.lists(st.one_of(TAGS, st.sampled_from(["1", "-1e9999", "x", "é", "&amp;", "&no;", "faultCode"]))).map(
    lambda parts: "".join(["<methodResponse>", *parts]).encode()
)


@given(st.one_of(st.binary(), MARKUP, MARKUP.map(lambda b: b + b"</value></param></params></methodResponse>")))
def test_any_reply_is_a_value_or_an_error(reply):
    with suppress(BadReplyError):
        read(reply)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])  # one robot takes all of them
@given(
    data=st.one_of(st.binary(), st.builds(lambda tail: b"HTTP/1.1 200 OK\r\n" + tail, st.binary())), close=st.booleans()
)
def test_any_bytes_leave_the_controller_running(rig, data, close):
    opened = len(rig.sockets.opened)
    rig.start(FACTORY + "server.get()")
    rig.until(lambda: len(rig.sockets.opened) > opened and bool(rig.sockets.opened[-1].sent), 1.0)
    rig.sockets.opened[-1].feed(data)
    rig.tick(3)
    if close:
        rig.sockets.opened[-1].close()
    else:
        rig.controller.programs.stop()
    rig.until(lambda: rig.state.name == "STOPPED", 5.0)
    assert rig.sockets.opened[-1].state == "closed"


def test_a_secondary_program_cannot_wait_for_a_server(rig):
    rig.submit(f"sec ask():\n{FACTORY}server.get()\nend\n")
    rig.tick(3)
    assert any("takes physical time" in text for _, text in rig.keys)
    assert rig.sockets.opened[0].state == "closed"


def test_inf_is_not_sent_but_can_be_received(rig):
    assert call(rig, "server.get()", http(xml(math.inf))) == math.inf


# packet streams


STREAM = 'server = rpc_factory("xmlrpc", "10.0.0.1:50001")\n'


def packet(body: bytes) -> bytes:
    return b"\x1bPKT" + body + b"\x1bEND"


def start_stream(rig, body: str):
    rig.start(STREAM + body)
    rig.until(lambda: bool(rig.sockets.opened and rig.sockets.opened[0].sent), 1.0)
    return rig.sockets.opened[0]


def test_packet_streams_in_single_byte_chunks(rig):
    socket = start_stream(rig, "a = server.first(7)\ntextmsg(server.second() + a)")
    sent = bytes(socket.sent)
    assert sent[:4] == b"\x1bPKT"
    assert sent[-4:] == b"\x1bEND"
    assert xmlrpc.client.loads(sent[4:-4]) == ((7,), "first")
    for byte in b"\x1bNOP" + packet(xml(1)):
        socket.feed(bytes([byte]))
        rig.tick()
    rig.until(lambda: socket.sent.count(b"\x1bEND") == 2, 1.0)
    socket.feed(packet(xml(2)))
    rig.until(lambda: rig.state.name == "STOPPED", 1.0)
    assert rig.texts == ["3"]
    assert len(rig.sockets.opened) == 1
    assert socket.state == "closed"


def test_a_packet_stream_needs_its_server_immediately(rig):
    text = rig.fault('rpc_factory("xmlrpc", "10.0.0.2:80")')
    assert text == 'rpc_factory: "10.0.0.2:80" cannot be used: cannot connect to 10.0.0.2:80: is the server running?'


def test_a_closed_packet_stream_is_reopened(rig):
    socket = start_stream(rig, "a = server.first()\nserver.closeXMLRPCClientConnection()\ntextmsg(server.second())")
    socket.feed(packet(xml(1)))
    rig.until(lambda: len(rig.sockets.opened) == 2 and bool(rig.sockets.opened[1].sent), 1.0)
    assert socket.state == "closed"
    rig.sockets.opened[1].feed(packet(xml(2)))
    rig.until(lambda: rig.state.name == "STOPPED", 1.0)
    assert rig.texts == ["2"]


@pytest.mark.parametrize(
    "answer",
    [b"HTTP/1.1 200 OK", b"\x1bEND", b"\x1bESC", b"\x1bPKT\x1bPKT", b"\x1bXYZ", packet(b"x") + b"y", packet(b"")],
)
def test_answers_that_are_not_packets(rig, answer):
    socket = start_stream(rig, "server.get()")
    socket.feed(answer)
    rig.until(lambda: bool(rig.exceptions), 1.0)
    assert "RPC get at 10.0.0.1:50001: the " in rig.exceptions[0].text
    rig.until(lambda: rig.state.name == "STOPPED", 1.0)
    assert socket.state == "closed"


def test_a_packet_stream_that_ends_early(rig):
    socket = start_stream(rig, "server.get()")
    socket.feed(packet(xml(1))[:-1])
    rig.tick(3)
    socket.close()
    rig.until(lambda: bool(rig.exceptions), 1.0)
    assert rig.exceptions[0].text.endswith("the connection was closed before the answer was complete")


@given(st.binary(), st.integers(1, 9), st.booleans())
def test_any_packet_is_read_in_any_split(body, piece, framed):
    got = bytearray()
    reader = PacketReader(got.extend)
    wire = packet(body.replace(b"\x1b", b"\x1bESC")) if framed else body
    with nullcontext() if framed else suppress(connections.RemoteError):
        for at in range(0, len(wire), piece):
            reader.feed(wire[at : at + piece])
    assert not framed or (reader.complete and got == body)
