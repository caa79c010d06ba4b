"""Text of any bytes on every port: ports return it unchanged, and every verb and command still answers."""

import gzip
import json
import os
import zipfile
from pathlib import Path
from typing import Any, Final, Literal, get_args, get_origin, get_type_hints

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from server_rig import MemoryClient

from emulator.app import make_servers
from emulator.commands.dashboard import available_commands
from emulator.control.control import LiveControl
from emulator.control.http import ControlServer
from emulator.control.timing import ManualPace
from emulator.control.verbs import verbs_of
from emulator.controller import Controller
from emulator.faults.injector import FaultInjector
from emulator.machine import ControllerConfig
from emulator.reports import write_crash
from tests.budget import examples
from tests.rows import each_row
from urproto.modes import RobotMode, RuntimeState
from urproto.primary.framing import PrimaryDecoder
from urproto.primary.messages import PopupMessage, TextMessage
from urproto.robotiq import MODELS
from urproto.robots import load_model
from urproto.text import from_bytes, readable, to_bytes
from urproto.versions import PolyscopeVersion

VERBS: Final = verbs_of(LiveControl.SUBJECTS)
ENDS_IT: Final = ("quit", "shutdown")
STEPS: Final = ("step", "run_until")  # time of this robot is driven by the test
MAX_PERIODS: Final = 400
LATIN: Final = "Grüße an Zoë".encode("latin-1")
INSTALLATION: Final = (
    b'<Installation><TCPSettings activePose="TCP" toolPayload="0.5"><availablePoses>'
    b'<tcp name="TCP" offset="0, 0, 0.2, 0, 0, 0"/></availablePoses></TCPSettings></Installation>'
)
ODD: Final = (LATIN, b"\x00", b"\xff\xfe", b"\xed\xb3\xa9", b"\xc3", b"a\x1cb\x85c\xe2\x80\xa8d", b"\xc2\xb2\xd9\xa3")

# all characters that can be between quotation marks in a line
inside = st.binary(min_size=1, max_size=60).map(lambda data: data.translate(None, b'"\r\n')) | st.sampled_from(ODD)


class Robot:
    """A robot with all its ports in memory, and a folder of programs."""

    def __init__(self, folder: Path, version: PolyscopeVersion | None = None) -> None:
        config = ControllerConfig(
            model=load_model("ur3"),
            running=True,
            gripper=MODELS["robotiq-2f-85"],
            programs_dir=folder,
            **({} if version is None else {"version": version}),
        )
        self.controller = Controller(config)
        self.servers = {server.name: server for server in make_servers(self.controller)}
        control = LiveControl(self.controller, ManualPace(), {}, FaultInjector(self.controller))
        self.servers["control"] = ControlServer(self.controller, control)
        self.primary = MemoryClient(self.servers["primary"])
        self.tick(5)

    def tick(self, periods: int = 1) -> None:
        for _ in range(periods):
            self.controller.tick()

    def client(self, port: str) -> MemoryClient:
        client = MemoryClient(self.servers[port])
        self.tick()
        client.take()  # a greeting
        return client

    def request(self, port: str, data: bytes) -> bytes:
        """The answer to a new client that sends these bytes, once it is a complete line."""
        client = self.client(port)
        client.feed(data)
        for _ in range(MAX_PERIODS):
            self.tick()
            if client.transport.delivered.endswith(b"\n"):
                break
        client.vanish()
        return client.take()

    def command(self, line: bytes) -> bytes:
        return self.request("dashboard", line + b"\n").removesuffix(b"\n")

    def call(self, verb: str, body: bytes = b"{}") -> tuple[int, Any]:
        """Status of the answer and its decoded JSON."""
        client = self.client("control")
        head = f"POST /verbs/{verb} HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
        client.feed(head.encode() + b"Content-Length: %d\r\n\r\n" % len(body) + body)
        for _ in range(MAX_PERIODS):
            if client.transport.delivered:
                break
            self.tick()
        answer = client.take()
        client.vanish()
        head, _, content = answer.decode("utf-8").partition("\r\n\r\n")
        return int(head.split(" ", 2)[1]), json.loads(content)

    def play(self, statements: bytes) -> None:
        """Run a program that continues after these statements."""
        self.command(b"brake release")
        for _ in range(4 * MAX_PERIODS):
            if self.controller.snapshot.robot_mode is RobotMode.RUNNING:
                break
            self.tick()
        self.messages()
        self.client("secondary").feed(b"def p():\n" + statements + b"\n  while True:\n    sync()\n  end\nend\n")
        self.tick(60)

    def messages(self) -> list[Any]:
        """Messages of the primary port since the last call."""
        return PrimaryDecoder(self.controller.version).feed(self.primary.take())

    def check(self) -> None:
        """Every query verb, and every dashboard command that ends nothing, answers."""
        for name in ("log", "program", "variables", "popups", "programs", "state", "describe", "faults", "world"):
            status, answer = self.call(name)
            assert status == 200, (name, answer)
        for command in available_commands(self.controller.version):
            if command.form.words not in ENDS_IT and not command.form.takes_argument:
                answer = self.command(command.form.words.encode())
                assert answer, command.form.words
                assert b"rror" not in answer, answer
        self.controller.tick()
        assert self.controller.guard.problem is None


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return Robot(tmp_path_factory.mktemp("programs"))


@settings(max_examples=examples(15), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=inside)
@example(LATIN)
def test_any_text_in_any_field(robot: Robot, text: bytes) -> None:
    robot.play(b'  global v = "%s"\n  textmsg("<", v)\n  popup(v, v)\n  varmsg("n", v)\n' % text)
    assert robot.controller.programs.state is RuntimeState.PLAYING
    for line in (b"popup " + text, b"addToLog x" + text, b"load " + text, b"load installation " + text):
        assert robot.command(line), line
    for line in (b"setUserRole " + text, b"set operational mode " + text, b"generate support file " + text, text):
        robot.command(line + b" x")
    robot.client("gripper").feed(b"SET POS " + text + b"\nGET " + text + b"\n" + text + b"\n")
    robot.client("primary").feed(text + b"\nanswer question " + text + b"\nset speed " + text + b"\n")
    robot.tick(60)
    robot.check()
    robot.play(b"  interpreter_mode()\n")
    robot.client("interpreter").feed(b'global w = "%s"\n%s\nstatelastexecuted\n' % (text, text))
    robot.tick(60)
    robot.check()


@pytest.mark.parametrize("text", ODD)
def test_ports_return_text_byte_for_byte(robot: Robot, text: bytes) -> None:
    robot.play(b'  global v = "%s"\n  textmsg(v, str_len(v))\n  popup(v, v)\n' % text)
    received = robot.messages()
    assert [to_bytes(m.text) for m in received if isinstance(m, TextMessage)] == [text + b"%d" % len(text)]
    popups = [(to_bytes(m.title), to_bytes(m.text)) for m in received if isinstance(m, PopupMessage)]
    assert popups == [(text, text)]
    assert robot.call("variables")[1]["result"]["v"] == readable(from_bytes(text))
    assert robot.command(b"popup " + text) == b"showing popup"
    robot.tick(60)
    (shown,) = [to_bytes(m.text) for m in robot.messages() if isinstance(m, PopupMessage)]
    assert shown == text.strip()
    assert text.strip() in robot.command(b"nonsense " + text)
    robot.play(b"  interpreter_mode()\n")
    assert text in robot.request("interpreter", b'w = "%s"\n' % text)


def usual(kind: Any) -> Any:
    """A value that a parameter of this type takes, as JSON has it."""
    choices = [
        word for literal in (kind, *get_args(kind)) if get_origin(literal) is Literal for word in get_args(literal)
    ]
    if choices:
        return choices[0]
    if get_origin(kind) is tuple:
        return [0.0] * len(get_args(kind))
    kinds = get_args(kind) or (kind,)
    return next((value for own, value in ((bool, True), (float, 0.5), (int, 1), (str, "x")) if own in kinds), {})


def numbers(kind: Any) -> bool:
    return any(own in (int, float) for own in (kind, *get_args(kind)))


@each_row("number", ["1e308", "-1e308", "1e29", "1e999", f"1{'0' * 400}", "9223372036854775808", "-1"])
def test_no_verb_fails_for_a_number(tmp_path: Path, number: str) -> None:
    robot = Robot(tmp_path)
    for name, verb in VERBS.items():
        kinds = get_type_hints(verb.parameters)
        for odd in (argument for argument, kind in kinds.items() if name not in STEPS and numbers(kind)):
            given = {argument: json.dumps(usual(kind)) for argument, kind in kinds.items()}
            elements = len(get_args(kinds[odd])) if get_origin(kinds[odd]) is tuple else 0
            given[odd] = f"[{', '.join([number] * elements)}]" if elements else number
            body = f"{{{', '.join(f'{json.dumps(argument)}: {value}' for argument, value in given.items())}}}"
            status, answer = robot.call(name, body.encode())
            assert status in (200, 400, 409), (name, body, answer)
            robot.tick(2)
            assert robot.controller.guard.problem is None, (name, body)
            assert robot.call("state")[0] == robot.call("world")[0] == 200, (name, body)


def test_files_of_any_name_and_messages_about_them(tmp_path: Path) -> None:
    name = "Zoë".encode("latin-1")
    script = b'def p():\n  textmsg("%s")\nend\n' % name
    for suffix, content in ((b".script", script), (b".installation", gzip.compress(INSTALLATION))):
        (tmp_path / os.fsdecode(name + suffix)).write_bytes(content)
    robot = Robot(tmp_path)
    assert robot.command(b"load %s.script" % name).startswith(b"Loading program: /programs/%s.script" % name)
    assert robot.command(b"load installation %s.installation" % name).endswith(b"/%s.installation" % name)
    assert robot.command(b"programState") == b"STOPPED %s.script" % name
    assert robot.call("programs")[1]["result"] == [r"Zo\xeb.script"]
    robot.messages()
    assert robot.command(b"play") == b"Starting program"
    robot.tick(20)
    assert name in [to_bytes(m.text) for m in robot.messages() if isinstance(m, TextMessage)]

    saved = robot.call("save")[1]["result"]
    robot.controller.installation.name = "another"
    assert robot.call("restore", json.dumps({"document": saved}).encode())[0] == 200
    assert to_bytes(robot.controller.installation.name) == name + b".installation"

    for command in (b"addToLog " + name, b"saveLog", b"generate flight report", b"generate support file ."):
        assert b"Failed" not in robot.command(command)
    assert r"Zo\xeb" in (tmp_path / "log_history.txt").read_text("utf-8")
    bundle = write_crash(robot.controller, robot.controller.programs.source, "a test", "no traceback")
    with zipfile.ZipFile(bundle) as archive:
        assert archive.read("program.script") == script
        assert r"Zo\xeb" in archive.read("log_history.txt").decode("utf-8")


@pytest.mark.parametrize(
    ("line", "expected_slider"),
    [(b"set speed \xd9\xa3", None), (b"set speed 0_1", None), (b"set speed 0.5", 0.5), (b"set\x1cspeed 0.7", None)],
)
def test_keywords_and_numbers_of_text_commands_are_ascii(
    robot: Robot, line: bytes, expected_slider: float | None
) -> None:
    robot.controller.speed.set_slider(1.0)
    robot.client("secondary").feed(line + b"\n")
    robot.tick(10)
    assert robot.controller.speed.slider == (expected_slider or 1.0)
