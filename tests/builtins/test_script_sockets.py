"""Sockets of scripts, on a simulated network."""

import math

import pytest

from tests.rows import each_row

OPEN = 'socket_open("10.0.0.1", 50001, "s")\n'


def run_with_peer(rig, body: str, *sent: bytes, limit_s: float = 10.0):
    """Run a body with an open socket; the peer sends its bytes one after the other, some frames apart."""
    rig.start(OPEN + body)
    rig.until(lambda: bool(rig.sockets.opened), 1.0)
    for data in sent:
        rig.tick(3)
        rig.sockets.opened[0].feed(data)
    rig.until(lambda: rig.state.name == "STOPPED", limit_s)
    assert rig.exceptions == []
    return rig.sockets.opened[0]


def test_open_reports_success_refusal_and_timeout(rig):
    rig.sockets.silent.add(("10.0.0.9", 1))
    took = rig.run(
        """
        textmsg(socket_open("10.0.0.1", 50001))
        textmsg(socket_open("10.0.0.2", 50001, "refused"))
        textmsg(socket_open("10.0.0.9", 1, "silent"))
        textmsg(socket_send_string("x", "silent"))
        """
    )
    assert rig.texts == ["True", "False", "False", "False"]
    assert took == pytest.approx(2.0, abs=0.02)


def test_reopening_a_name_closes_the_first_connection(rig):
    rig.run(OPEN * 2 + "sleep(0.01)")
    assert len(rig.sockets.opened) == 2


@pytest.mark.parametrize(
    ("call", "wire"),
    [
        ('socket_send_string("abc", "s")', b"abc"),
        ('socket_send_string(12.5, "s")', b"12.5"),
        ('socket_send_line("abc", "s")', b"abc\n"),
        ('socket_send_line(p[1,2,3,0,0,0], "s")', b"p[1, 2, 3, 0, 0, 0]\n"),
        ('socket_send_byte(255, "s")', b"\xff"),
        ('socket_send_byte("A", "s")', b"A"),
        ('socket_send_int(-2, "s")', b"\xff\xff\xff\xfe"),
        ('socket_send_int(True, "s")', b"\x00\x00\x00\x01"),
        ('socket_set_var(7, 1, "s")', b"SET 7 1\n"),
        ('socket_set_var("SPE", 100, "s")', b"SET SPE 100\n"),
        ('socket_set_var("POS", -1.5, "s")', b"SET POS -1.5\n"),
        ('socket_get_var("POS", "s")', b"GET POS\n"),
        ('socket_send_string("", "s")', b""),
        ('socket_send_string([1, 2.5, True], "s")', b"[1, 2.5, True]"),
        ('socket_send_string(True, "s")', b"True"),
        ('socket_send_line("", "s")', b"\n"),
        ('socket_send_byte(0, "s")', b"\0"),
        ('socket_send_byte(2.0, "s")', b"\2"),
        ('socket_send_int(2147483647, socket_name="s")', b"\x7f\xff\xff\xff"),
    ],
)
def test_bytes_sent_by_each_function(rig, call, wire):
    assert bytes(run_with_peer(rig, call).sent) == wire


@pytest.mark.parametrize(
    ("call", "sent", "text"),
    [
        ('socket_read_binary_integer(2, "s", 1)', b"\0\0\0\5\xff\xff\xff\xff", "[2,5,-1]"),
        ('socket_read_byte_list(3, "s", 1)', b"abc", "[3,97,98,99]"),
        ('socket_read_ascii_float(2, "s", 1)', b"noise(1.5, -2)", "[2,1.5,-2]"),
        ('socket_read_ascii_float(2, "s", 1)', b"(1.5)", "[0,nan,nan]"),
        ('socket_read_line("s", 1)', b"one\r\ntwo\n", "one"),
        ('socket_read_string("s", timeout=1)', b"hello", "hello"),
        ('socket_read_string("s", "<", ">", timeout=1)', b"xx<in>out", "in"),
        ('socket_read_string("s", suffix="\\n", interpret_escape=True, timeout=1)', b"ab\ncd", "ab"),
        ('socket_get_var("POS", "s")', b"POS 42\n", "42"),
        ('socket_get_var("POS", "s")', b"OTHER 42\n", "0"),
        ('socket_get_var("POS", "s")', b"POS -7\r\n", "-7"),
        ('socket_get_var("POS", "s")', b"POS 4.2\n", "0"),
        ('socket_get_var("POS", "s")', b"POS 4294967296\n", "0"),
        ('socket_get_var("POS", "s")', b"POS 42", "0"),
        ('socket_read_binary_integer(0, "s", 1)', b"", "[0]"),
        ('socket_read_byte_list(0, "s", 1)', b"", "[0]"),
        ('socket_read_byte_list(2, timeout=1, socket_name="s")', b"\0\xff", "[2,0,255]"),
        ('socket_read_ascii_float(4, "s", 1)', b"( 1.414 , 3.14159, 1.616, 0.0 )", "[4,1.414,3.14159,1.616,0]"),
        ('socket_read_ascii_float(1, "s", 1)', b"(1e-3)\n", "[1,0.001]"),
        ('socket_read_ascii_float(2, "s", 1)', b"(1,2,3)", "[0,nan,nan]"),
        ('socket_read_ascii_float(2, "s", 1)', b"(1,)", "[0,nan,nan]"),
        ('socket_read_ascii_float(1, "s", 1)', b"(1_0)", "[0,nan]"),
        ('socket_read_ascii_float(1, "s", 1)', b"1)", "[0,nan]"),
        ('socket_read_ascii_float(0, "s", 1)', b"()", "[0]"),
        ('socket_read_line("s", 1)', b"\n", ""),
        ('socket_read_line("s", 1)', b"no end", ""),
        ('socket_read_string("s", "", ">", False, 1)', b"a>b>", "a"),
        ('socket_read_string("s", "<", "", False, 1)', b"x<rest", "rest"),
        ('socket_read_string("s", "<<", ">>", False, 1)', b"<a<<b>>", "b"),
        ('socket_read_string("s", "<", ">", False, 1)', b"a>b<c>", "c"),
        ('socket_read_string("s", "  <", " >", False, 1)', b"<c>", "c"),
        ('socket_read_string("s", "\\t", "\\r\\n", True, 1)', b"a\tb\r\nc", "b"),
        ('socket_read_string("s", "", "\\n", False, 1)', b"a\\nb", "a"),
        ('socket_read_string("s", "", "\\n", False, 0.2)', b"a\nb", ""),
    ],
)
def test_values_returned_by_each_read_function(rig, call, sent, text):
    run_with_peer(rig, f"textmsg({call})", sent)
    assert rig.texts == [text]


def test_reads_wait_for_data_that_arrives_in_pieces(rig):
    run_with_peer(rig, 'textmsg(socket_read_binary_integer(1, "s", 1))', b"\0", b"\0\1", b"\2")
    assert rig.texts == ["[1,258]"]


def test_data_after_the_suffix_is_kept(rig):
    body = 'textmsg(socket_read_string("s", "<", ">"))\ntextmsg(socket_read_byte_list(2, "s", 1))'
    run_with_peer(rig, body, b"<a>bc")
    assert rig.texts == ["a", "[2,98,99]"]


@pytest.mark.parametrize("timeout", [0.1, 0.002, 0.5])
def test_timeouts_are_counted_in_control_periods(rig, timeout):
    took = rig.run(OPEN + f'textmsg(socket_read_binary_integer(2, "s", {timeout}))')
    assert rig.texts == ["[0,-1,-1]"]
    assert took == pytest.approx(timeout, abs=3 * rig.period)


@pytest.mark.parametrize("timeout", [0, -1])
def test_a_read_without_timeout_waits_until_the_peer_closes(rig, timeout):
    rig.start(OPEN + f'textmsg(socket_read_binary_integer(1, "s", {timeout}))')
    rig.seconds(5.0)
    assert rig.texts == []
    rig.sockets.opened[0].close()
    rig.tick(3)
    assert rig.texts == ["[0,-1]"]


def test_bytes_received_before_the_peer_closed_are_read(rig):
    rig.start(OPEN + 'sleep(0.1)\ntextmsg(socket_read_byte_list(1, "s", 1))')
    rig.tick(5)
    rig.sockets.opened[0].feed(b"z")
    rig.sockets.opened[0].close()
    rig.seconds(0.2)
    assert rig.texts == ["[1,122]"]


def test_reading_available_data_takes_no_time(rig):
    rig.start(OPEN + 'sleep(0.1)\ni = 0\nwhile i < 10:\n  x = socket_read_byte_list(1, "s")\n  i = i + 1\nend')
    rig.tick(5)
    rig.sockets.opened[0].feed(b"0123456789")
    took = rig.until(lambda: rig.state.name == "STOPPED", 1.0)
    assert took == pytest.approx(0.1, abs=0.02)


def test_a_socket_that_was_never_opened_fails_immediately(rig):
    took = rig.run(
        """
        textmsg(socket_read_string("nobody"))
        textmsg(socket_read_byte_list(1, "nobody"))
        textmsg(socket_send_int(1, "nobody"))
        socket_close("nobody")
        """
    )
    assert rig.texts == ["", "[0,-1]", "False"]
    assert took < 0.02


def test_text_longer_than_a_string_is_an_error(rig):
    rig.start(OPEN + 'x = socket_read_string("s")')
    rig.tick(3)
    rig.sockets.opened[0].feed(b"x" * 1024)
    rig.tick(3)
    assert rig.exceptions[0].text == "Received String exceeds maximum length (1023 Bytes)."


def test_bytes_survive_a_round_trip_through_a_string(rig):
    socket = run_with_peer(rig, 'socket_send_string(socket_read_string("s"), "s")', bytes(range(256)))
    assert bytes(socket.sent) == bytes(range(256))


@pytest.mark.parametrize(
    ("call", "sent"),
    [
        ('socket_read_line("s")', b"x" * 1024 + b"\n"),
        ('socket_read_string("s", "<", ">")', b"<" + b"x" * 1024 + b">"),
        ('socket_read_string("s", "<", ">", timeout=0)', b"<" + b"x" * 1025),
    ],
)
def test_data_longer_than_a_string_is_an_error_in_every_reader(rig, call, sent):
    rig.start(OPEN + f"x = {call}")
    rig.tick(3)
    rig.sockets.opened[0].feed(sent)
    rig.tick(3)
    assert rig.exceptions[0].text == "Received String exceeds maximum length (1023 Bytes)."


def test_every_reader_accepts_the_longest_string(rig):
    longest = "x" * 1023
    read = 'socket_read_string("s", "<", ">")', 'socket_read_line("s")', 'socket_read_string("s")'
    body = "\n".join(f"textmsg(str_len({call}))" for call in read[:2])
    run_with_peer(
        rig, f"{body}\nsleep(0.1)\ntextmsg(str_len({read[2]}))", f"<{longest}>{longest}\n".encode(), longest.encode()
    )
    assert rig.texts == ["1023", "1023", "1023"]


@pytest.mark.parametrize(
    ("first", "second", "texts"),
    [
        ('socket_read_binary_integer(1, "s", 0.1)', 'socket_read_binary_integer(1, "s", 1)', ["[0,-1]", "[1,258]"]),
        ('socket_read_byte_list(4, "s", 0.1)', 'socket_read_string("s")', ["[0,-1,-1,-1,-1]", "\0\0\1\2"]),
        ('socket_read_line("s", 0.1)', 'socket_read_byte_list(4, "s")', ["", "[4,0,0,1,2]"]),
        ('socket_read_string("s", "<", ">", False, 0.1)', 'socket_read_byte_list(4, "s")', ["", "[4,0,0,1,2]"]),
        ('socket_read_ascii_float(1, "s", 0.1)', 'socket_read_byte_list(4, "s")', ["[0,nan]", "[4,0,0,1,2]"]),
    ],
)
def test_a_read_that_timed_out_keeps_the_received_data(rig, first, second, texts):
    rig.start(OPEN + f"textmsg({first})\nsleep(0.1)\ntextmsg({second})")
    rig.until(lambda: bool(rig.sockets.opened), 1.0)
    rig.sockets.opened[0].feed(b"\0\0\1")
    rig.until(lambda: len(rig.texts) == 1, 1.0)
    rig.sockets.opened[0].feed(b"\2")
    rig.until(lambda: rig.state.name == "STOPPED", 3.0)
    assert rig.texts == texts


@pytest.mark.parametrize(
    ("call", "text"),
    [
        ('socket_read_binary_integer(2, "s", 0)', "[0,-1,-1]"),
        ('socket_read_byte_list(5, "s", 0)', "[0,-1,-1,-1,-1,-1]"),
        ('socket_read_ascii_float(2, "s", 0)', "[0,nan,nan]"),
        ('socket_read_line("s", 0)', ""),
        ('socket_read_string("s", "(", ")", timeout=0)', ""),
        ('socket_get_var("POS", "s")', "0"),
    ],
)
def test_a_peer_that_closes_mid_message_wakes_every_reader(rig, call, text):
    rig.start(OPEN + f'textmsg({call})\ntextmsg(socket_send_int(1, "s"))\ntextmsg(socket_read_string("s"))')
    rig.tick(3)
    rig.sockets.opened[0].feed(b"(1,2")
    rig.tick(3)
    rig.sockets.opened[0].close()
    rig.tick(3)
    assert rig.texts == [text, "False", "(1,2"]


def test_each_socket_name_is_a_separate_connection(rig):
    rig.start(
        'socket_open("10.0.0.1", 50001)\n' + OPEN + 'socket_send_string("a")\nsocket_send_string("b", "s")\nsleep(1)'
    )
    rig.tick(5)
    assert [bytes(socket.sent) for socket in rig.sockets.opened] == [b"a", b"b"]
    rig.until(lambda: rig.state.name == "STOPPED", 2.0)
    assert [socket.state for socket in rig.sockets.opened] == ["closed", "closed"]


def test_a_closed_name_can_be_reopened(rig):
    rig.run(OPEN + 'socket_close("s")\ntextmsg(socket_send_int(1, "s"))\n' + OPEN + 'textmsg(socket_send_int(1, "s"))')
    assert rig.texts == ["False", "True"]


@pytest.mark.parametrize("call", ["socket_read_ascii_float", "socket_read_binary_integer", "socket_read_byte_list"])
def test_at_most_thirty_values_are_read(rig, call):
    wire = {"socket_read_ascii_float": b"(" + b",".join([b"1"] * 30) + b")"}.get(call, b"\0\0\0\1" * 30)
    run_with_peer(rig, f'x = {call}(30, "s", 1)\ntextmsg(x[0], length(x))', wire)
    assert rig.texts == ["3031"]


@each_row(
    "call",
    [
        "socket_read_ascii_float(31)",
        "socket_read_binary_integer(31)",
        "socket_read_byte_list(31)",
        "socket_read_byte_list(-1)",
        "socket_send_byte(256)",
        "socket_send_byte(-1)",
        'socket_send_byte("")',
        "socket_send_byte(True)",
        "socket_send_int(3e9)",
        'socket_open("10.0.0.1", 0)',
        'socket_open("10.0.0.1", 65536)',
    ],
)
def test_values_out_of_range_are_errors(rig, call):
    assert rig.fault(call)


def test_failed_floats_are_not_numbers(rig):
    value = rig.value("socket_read_ascii_float(2)")
    assert value[0] == 0
    assert all(map(math.isnan, value[1:]))


@pytest.mark.parametrize(
    "attempt",
    [
        'socket_open("10.0.0.2", 50001)',
        'socket_read_byte_list(1, "closed")[0] > 0',
        'socket_read_string("closed") != ""',
        'socket_get_var("x", "closed") > 0',
    ],
)
def test_retrying_in_a_loop_leaves_time_for_other_threads(rig, attempt):
    """Public programs do it without sync(); it is not an endless loop."""
    rig.start(f"n = 0\nwhile not {attempt}:\nn = n + 1\nend")
    rig.seconds(12.0)
    assert rig.state.name == "PLAYING"
    assert rig.controller.programs.variables["n"] == pytest.approx(12.0 / rig.controller.period_s, rel=0.02)
