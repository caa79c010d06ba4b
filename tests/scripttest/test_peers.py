"""Peers of scripts: conversations on sockets, by XML-RPC and by Modbus, in virtual time."""

from collections.abc import Callable
from pathlib import Path

import pytest

from emulator import script_cli as cli

Talk = Callable[..., tuple[int, list[str]]]
CAMERA = """
class Camera:
    def __init__(self):
        self.asked = 0
    def __call__(self, message):
        self.asked += 1
        return f"({self.asked}, {len(message)})" if message else None
calls = []
def add(a, b):
    calls.append(a + b)
    return a + b
class Tool:
    def total(self):
        return sum(calls)
    def broken(self):
        raise OSError("no current")
methods = {"add": add}
class Plc:
    def __init__(self):
        self.coils, self.registers = {16: 0}, {1: 5}
    def written(self, kind, address, value):
        self.registers[1] += 10 * value
"""


@pytest.fixture
def talk(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Talk:
    """talk(peers, statements, model) -> exit status, and the texts of the report up to the final state."""

    def run(peers: str, statements: str, model: str = "ur3") -> tuple[int, list[str]]:
        (tmp_path / "device.py").write_text(CAMERA)
        (tmp_path / "peers.yaml").write_text(peers)
        (tmp_path / "a.script").write_text(f"def f():\n{statements}\nend\n")
        options = ["--peers", str(tmp_path / "peers.yaml"), "--script-network", "none", "--timeout", "60"]
        options += ["--model", model]
        status = cli.main(["run", str(tmp_path / "a.script"), *options])
        lines = capsys.readouterr().out.splitlines()
        return status, [line.partition("] ")[2] or line for line in lines if not line.startswith(("joints", "TCP"))]

    return run


OPEN = 'socket_open("10.0.0.9", 5000)\n'
TIMED = (
    OPEN
    + """t = 0
thread clock():
  while True:
    t = t + get_steptime()
    sync()
  end
end
def say(text):
  textmsg(str_cat(text, " "), t)
end
run clock()
"""
)

# peers on 10.0.0.9:5000; statements after it is open; what they report
DIALOGUES = {
    "an answer for each line, however the lines are sent": (
        r'{answers: {one: "1\n", two: "2\n"}}',
        'socket_send_string("one\ntw")\nsocket_send_line("o")\ntextmsg(socket_read_line(), socket_read_line())',
        ["12"],
    ),
    "pieces sent in one period are one message": (
        r'{answers: {"SET *": ack}}',
        'socket_send_string("SET ")\nsocket_send_string(5)\nsocket_send_byte(13)\ntextmsg(socket_read_string())',
        ["ack"],
    ),
    "only a delimiter ends a message": (
        r'{delimiter: "|", answers: {"a?c": "yes|"}}',
        'socket_send_string("ab")\nsleep(1)\nsocket_send_string("c|")\ntextmsg(socket_read_string(suffix="|"))',
        ["yes"],
    ),
    "state from named groups": (
        r"""{state: {SPE: 255}, answers: {'/SET (?P<name>\w+) (?P<SPE>\d+)/': {reply: "${name}=${SPE}\n"},
        GET SPE: "SPE ${SPE}\n"}}""",
        'textmsg(socket_get_var("SPE"))\nsocket_set_var("SPE", 7)\ntextmsg(socket_read_line())\n'
        'textmsg(socket_get_var("SPE"))',
        ["255", "SPE=7", "7"],
    ),
    "a reply sets variables, and replies follow one another": (
        r'{state: {n: a}, answers: {x: [{reply: "1\n", set: {n: b}}, "${n}\n"]}}',
        'socket_send_line("x")\nsocket_send_line("x")\nsocket_send_line("x")\n'
        "textmsg(socket_read_line(), socket_read_line())\ntextmsg(socket_read_line())",
        ["1b", "b"],
    ),
    "binary messages of a fixed size": (
        '{binary: true, size: 4, answers: {"00000005": 0000000a00000014, "0000*": "ffffffff"}}',
        "socket_send_int(5)\ntextmsg(socket_read_binary_integer(2))\nsocket_send_int(6)\n"
        "textmsg(socket_read_binary_integer(1))",
        ["[2,10,20]", "[1,-1]"],
    ),
    "a Python class": (
        '{answers: "device.py:Camera"}',
        'socket_send_line("abc")\ntextmsg(socket_read_ascii_float(2))\nsocket_send_line("de")\n'
        "textmsg(socket_read_ascii_float(2))",
        ["[2,1,3]", "[2,2,2]"],
    ),
    "a peer that hangs up": (
        r'{answers: {bye: {reply: "later\n", close: true}}}',
        'socket_send_line("bye")\ntextmsg(socket_read_line())\ntextmsg(socket_send_line("x"))',
        ["later", "False"],
    ),
}


@pytest.mark.parametrize("case", DIALOGUES)
def test_dialogues(case: str, talk: Talk) -> None:
    peer, statements, texts = DIALOGUES[case]
    status, found = talk(f"sockets: {{'10.0.0.9:5000': {peer}}}", OPEN + statements)
    assert found[: len(texts)] == texts
    assert status == 0


TIMES = {
    "unasked, once and repeatedly": (
        r'{greeting: "hi\n", sends: [{text: "once\n", after: 0.2}, {text: "again\n", every: 0.5}]}',
        "say(socket_read_line())\nsay(socket_read_line())\nsay(socket_read_line())\nsay(socket_read_line())",
        [("hi", 0.0), ("once", 0.2), ("again", 0.5), ("again", 1.0)],
    ),
    "delays add up, and no answer overtakes another": (
        r'{delay: 0.25, answers: {slow: {reply: "slow\n", delay: 0.5}, fast: "fast\n"}}',
        'socket_send_line("slow")\nsocket_send_line("fast")\nsay(socket_read_line())\nsay(socket_read_line())',
        [("slow", 0.75), ("fast", 1.0)],
    ),
}


@pytest.mark.parametrize("case", TIMES)
def test_times_are_those_of_the_robot(case: str, talk: Talk) -> None:
    peer, statements, expected = TIMES[case]
    _, found = talk(f"sockets: {{'10.0.0.9:5000': {peer}}}", TIMED + statements)
    said = [text.split() for text in found[: len(expected)]]
    assert [text for text, _ in said] == [text for text, _ in expected]
    assert [float(time) for _, time in said] == pytest.approx([time for _, time in expected], abs=0.025)


def test_refused_connections(talk: Talk) -> None:
    statements = 'textmsg(socket_open("10.0.0.9", 5000), socket_open("10.0.0.9", 5000))\ntextmsg(socket_open("b", 1))'
    _, found = talk("sockets: {'10.0.0.9:5000': {refuse: 1}, 'b:1': {refuse: true}}", statements)
    assert found[:2] == ["FalseTrue", "False"]


def test_xmlrpc_methods(talk: Talk) -> None:
    peers = """xmlrpc:
      http://10.0.0.9:41414: {methods: "device.py:methods", expect: ["add(1, 2)", "add(*)"]}
      http://10.0.0.8: {methods: "device.py:Tool"}
      http://10.0.0.7: {where: {each: [{x: 1, y: 0, z: 0, rx: 0, ry: 0, rz: 0}, [1, 2]]}, never: {fault: not today}}"""
    statements = """a = rpc_factory("xmlrpc", "http://10.0.0.9:41414/RPC2")
    textmsg(a.add(1, 2) + a.add(3, 4))
    textmsg(rpc_factory("xmlrpc", "http://10.0.0.8").total())
    c = rpc_factory("xmlrpc", "http://10.0.0.7")
    textmsg(c.where(), c.where())
    """
    status, found = talk(peers, statements)
    assert (status, found[:3]) == (0, ["10", "10", "p[1,0,0,0,0,0][1,2]"])
    for call, reason in (("c.never()", "not today"), ("c.other()", "has no method other")):
        status, found = talk(peers, f'c = rpc_factory("xmlrpc", "http://10.0.0.7")\n{call}')
        assert status == 1
        assert reason in "\n".join(found)
    assert "no current" in "\n".join(talk(peers, 'rpc_factory("xmlrpc", "http://10.0.0.8").broken()')[1])


def test_modbus_units(talk: Talk) -> None:
    peers = """modbus:
      10.0.0.9: {registers: {1: [7, 8]}, coils: {0: 1}, expect: [coil 16 = 1]}
      10.0.0.8: {exception: 4}
      10.0.0.7: {device: "device.py:Plc"}"""
    statements = """modbus_add_signal("10.0.0.9", 255, 1, 2, "word")
    modbus_set_signal_update_frequency("word", 0)
    modbus_add_signal("10.0.0.8", 255, 1, 2, "bad")
    modbus_add_signal("10.0.0.7", 255, 16, 1, "out")
    modbus_add_signal("10.0.0.7", 255, 1, 2, "in")
    sleep(0.5)
    textmsg(modbus_get_signal_status("word"), modbus_get_signal_status("word"))
    modbus_set_output_signal("out", True)
    sleep(1)
    textmsg(modbus_get_signal_status("in"))
    """
    status, found = talk(peers, statements)
    assert found[:2] == ["88", "15"]
    assert (status, found[-1]) == (1, "result  10.0.0.9 was not sent 'coil 16 = 1'; it was sent nothing")


@pytest.mark.parametrize(
    ("kind", "written", "sent"),
    [
        ("register", ("7", "7", "8", "7"), "'register 1 = 7', 'register 1 = 8', 'register 1 = 7'"),
        ("register", ("0", "0", "0", "0"), "'register 1 = 0'"),
        ("coil", ("True", "False", "False", "True"), "'coil 1 = 1', 'coil 1 = 0', 'coil 1 = 1'"),
    ],
)
def test_a_value_is_reported_when_it_changes(kind: str, written: tuple[str, ...], sent: str, talk: Talk) -> None:
    """A signal writes its value all the time."""
    setter = "modbus_set_output_signal" if kind == "coil" else "modbus_set_output_register"
    statements = f'modbus_add_signal("10.0.0.9", 255, 1, {1 if kind == "coil" else 3}, "out")\n'
    statements += "sleep(0.3)\n" + "".join(f'{setter}("out", {value})\nsleep(0.3)\n' for value in written)
    _, found = talk(
        f"modbus: {{10.0.0.9: {{coils: {{1: 0}}, registers: {{1: 5}}, expect: [{kind} 2 = 1]}}}}", statements
    )
    assert found[-1] == f"result  10.0.0.9 was not sent '{kind} 2 = 1'; it was sent {sent}"


POLLED = """modbus_add_signal("10.0.0.9", 255, 1, 2, "word")
    modbus_set_signal_update_frequency("word", 50)
    t = 0
    changes = ""
    last = 9999
    while t < 1:
      error = modbus_get_error("word", 2)
      if error != last:
        changes = str_cat(changes, str_cat(to_str(floor(t * 10 + 0.5)), str_cat(":", str_cat(to_str(error), " "))))
        last = error
      end
      t = t + get_steptime()
      sync()
    end
    textmsg(changes)
    """


@pytest.mark.parametrize(
    ("unit", "errors"),
    [
        ("", "0:-1 0:0 "),
        ("delay: 0.3", "0:-1 3:0 "),
        ("refuse: true", "0:-1 0:111 "),
        ("refuse: 15", "0:-1 0:111 3:0 "),
        ("disconnect: 0.495", "0:-1 0:0 5:-2 5:0 "),
        ("delay: 0.3, disconnect: 0.5", "0:-1 3:0 5:-2 8:0 "),
        ("delay: 0.6, disconnect: 0.5", "0:-1 5:-2 "),
    ],
)
def test_modbus_units_with_slow_and_broken_connections(unit: str, errors: str, talk: Talk) -> None:
    """The errors of a signal that is polled at 50 Hz, each with its time [0.1 s]."""
    status, found = talk(f"modbus: {{10.0.0.9: {{registers: {{1: 7}}, {unit}}}}}", POLLED, "ur5e")
    assert (status, found[0]) == (0, errors)


@pytest.mark.parametrize(
    ("expect", "failure"),
    [
        ("[a, '?', c]", ""),
        ("[c, a]", "10.0.0.9:5000 was not sent 'a'; it was sent 'a', 'b', 'c'"),
        ("['/[d-f]/']", "10.0.0.9:5000 was not sent '/[d-f]/'"),
    ],
)
def test_expected_messages_in_their_order(expect: str, failure: str, talk: Talk) -> None:
    status, found = talk(
        f"sockets: {{'10.0.0.9:5000': {{expect: {expect}}}}}", OPEN + 'socket_send_string("a\nb\nc\n")'
    )
    assert (status, found[-1].startswith(f"result  {failure or 'finished'}")) == (int(bool(failure)), True)
