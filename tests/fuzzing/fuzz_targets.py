"""Everything here that reads bytes which somebody else wrote, as functions of those bytes.

A target returns for any input, or raises what its reader promises to raise, which is caught here; anything else is a
finding, and so is an exception that is only logged. What arrives as a stream is read twice, whole and in pieces of a
length that the input's first byte gives: both have to give the same.

`fuzz.py` searches for inputs, `test_corpus.py` replays those that are kept.
"""

import gzip
import json
import logging
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from server_rig import MemoryClient
from tree_rig import assign, expression, line, main, sleep, tag

from client.calibration import read_calibration as read_calibration_of_client
from client.controllers.configuration import read_controllers
from client.controllers.goal_files import read_goals
from client.decoding.capture import head_of_capture, packet_block
from client.decoding.codecs import ConnectionFrames
from client.decoding.packets import Endpoint
from client.decoding.session import Choice, Session
from client.errors import ClientError
from client.recording import Recorder
from client.recording.files import read as read_recording
from client.traffic.recording import Recording as Traffic
from emulator.app import Emulator
from emulator.builtins.remote.httpclient import RemoteError
from emulator.builtins.remote.pstream import PacketReader
from emulator.builtins.remote.xmlrpc import BadReplyError, Reply, to_value
from emulator.clock import StepClock
from emulator.config import (
    ConfigError,
    EmulatorConfig,
    read_calibration,
    read_initial_positions,
    read_safety,
    read_surroundings,
)
from emulator.control.control import LiveControl
from emulator.control.verbs import verbs_of
from emulator.machine import ControllerConfig
from emulator.polyscope.document import DocumentError
from emulator.polyscope.installation_file import InstallationFile, read_installation, read_variables
from emulator.programs.compiling import LIBRARY_SET
from emulator.programs.loading import ProgramLoadError, load_steps
from urproto import dashboard, external_control, interpreter, modbus, robotiq
from urproto.errors import ProtocolError, RemoteProtocolError
from urproto.primary.framing import PrimaryDecoder
from urproto.realtime import RealtimeDecoder
from urproto.robots import load_model
from urproto.rtde import codec as rtde_codec
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series
from urscript.compiler import compile_script, find_problems
from urscript.errors import CompileError
from urscript.files import ScriptFile
from urscript.splitter import ScriptSplitter
from urscript.work import run_to_end

__all__ = ["TARGETS", "Finding", "Target"]

GOLDEN: Final = Path(__file__).parents[1] / "golden"
CONTROLLERS: Final = Path(__file__).parents[2] / "client" / "controllers"
EXAMPLES: Final = Path(__file__).parents[2] / "examples"
VERSIONS: Final = (PolyscopeVersion(3, 15, 8, 106339), DEFAULT_VERSION[Series.E], PolyscopeVersion(5, 4, 0, 0))


class Finding(AssertionError):  # noqa: N818 - what a fuzzer calls it
    """A reader did what it promises not to do."""


@dataclass(frozen=True)
class Target:
    """One reader. seeds: inputs to begin with, which it understands."""

    name: str
    read: Callable[[bytes], object]
    seeds: Callable[[], Iterable[bytes]]

    def __call__(self, data: bytes) -> None:
        """Read. Raises whatever the reader should not have raised, and Finding for what it only logged."""
        with _nothing_logged():
            self.read(data)


TARGETS: dict[str, Target] = {}


def target(*seeds: bytes | Callable[[], Iterable[bytes]]) -> Callable[[Callable[[bytes], object]], None]:
    """Register a reader under the name of its function."""

    def all_seeds() -> Iterator[bytes]:
        for seed in seeds:
            yield from seed() if callable(seed) else (seed,)

    def register(read: Callable[[bytes], object]) -> None:
        TARGETS[read.__name__] = Target(read.__name__, read, all_seeds)

    return register


class _Complaints(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.records: list[logging.LogRecord] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.records.append(record)


@contextmanager
def _nothing_logged() -> Iterator[None]:
    """An exception that a port or the guard of the control period has caught and logged is one all the same."""
    complaints = _Complaints()
    logging.getLogger().addHandler(complaints)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(complaints)
    for record in complaints.records:
        if record.exc_info is not None and record.exc_info[1] is not None:
            raise record.exc_info[1]
        raise Finding(record.getMessage())


class _Stream(Protocol):
    def feed(self, data: bytes) -> list[Any]: ...


def _fed(stream: _Stream, pieces: Iterable[bytes]) -> tuple[list[Any], str]:
    """What came out, and the error that ended it."""
    found: list[Any] = []
    try:
        for piece in pieces:
            found += stream.feed(piece)
        found += stream.feed(b"")  # an error behind messages is told by the next call
    except ProtocolError as error:
        return found, str(error)
    return found, ""


def _in_any_split(make: Callable[[], _Stream], data: bytes) -> list[Any]:
    """The messages of a stream. Raises Finding when they depend on how it arrived."""
    size, data = 1 + data[0] if data else 1, data[1:]
    whole = _fed(make(), [data])
    pieces = _fed(make(), (data[start : start + size] for start in range(0, len(data), size)))
    if repr(whole) != repr(pieces):  # repr, since nan is not equal to itself
        raise Finding(f"whole: {whole!r}; in pieces of {size} bytes: {pieces!r}")
    return whole[0]


# the wire


def _golden(*names: str) -> Callable[[], Iterator[bytes]]:
    """Captures, each to be read in small pieces."""

    def seeds() -> Iterator[bytes]:
        for name in names:
            text = (line.partition("#")[0] for line in (GOLDEN / name).read_text().splitlines())
            yield b"\x06" + bytes.fromhex("".join(text))

    return seeds


def _rtde_seeds() -> Iterator[bytes]:
    names = ("timestamp", "actual_q", "robot_mode")
    for messages in (
        (rtde_codec.RequestProtocol(2), rtde_codec.SetupOutputs(names, 125.0), rtde_codec.Start()),
        (rtde_codec.SetupInputs(("speed_slider_mask",)), rtde_codec.Pause(), rtde_codec.GetVersion()),
        (
            rtde_codec.ProtocolReply(True),
            rtde_codec.SetupOutputsReply(("DOUBLE", "VECTOR6D"), 1),
            rtde_codec.StartReply(True),
        ),
        (rtde_codec.VersionReply(VERSIONS[0]), rtde_codec.SetupInputsReply(("UINT32",), 1)),
        (rtde_codec.TextMessage("a", "b", rtde_codec.MessageLevel.INFO),),
    ):
        yield b"\x04" + b"".join(message.encode(2) for message in messages)


@target(_rtde_seeds)
def rtde(data: bytes) -> None:
    for package in _in_any_split(rtde_codec.RTDEDecoder, data):
        for read in (rtde_codec.decode_request, rtde_codec.decode_reply):
            for protocol in rtde_codec.KNOWN_PROTOCOLS:
                with suppress(RemoteProtocolError):
                    read(package, protocol)


@target(
    _golden(
        "connect_3.10.hex",
        "connect_5.4.hex",
        "robot_state_cb2.hex",
        "robot_state_full_5.24.hex",
        "key_message_urcl.hex",
        "compile_error_5.4.hex",
        "version_message_5.24.hex",
    )
)
def primary(data: bytes) -> None:
    for version in VERSIONS:
        _in_any_split(lambda version=version: PrimaryDecoder(version), data)


@target(lambda: (b"\xff" + size.to_bytes(4) + bytes(size - 4) for size in (1044, 1060, 1108, 1220)))
def realtime(data: bytes) -> None:
    _in_any_split(RealtimeDecoder, data)


_REPLIES: Final = (
    dashboard.parse_robot_mode,
    dashboard.parse_safety_mode,
    dashboard.parse_safety_status,
    dashboard.parse_program_state,
    dashboard.parse_loaded_program,
    dashboard.parse_boolean,
    dashboard.parse_polyscope_version,
    dashboard.parse_loading,
    dashboard.parse_program_saved,
    dashboard.parse_user_role,
    dashboard.parse_operational_mode,
    dashboard.parse_flight_report,
    dashboard.parse_support_file,
)


@target(
    b"\3Robotmode: RUNNING\nSafetystatus: NORMAL\nSTOPPED a.urp\ntrue b.urp\n",
    b"\3Loaded program: /programs/a.urp\nNo program loaded\nURSoftware 5.11.0.108249 (Dec 22 2021)\n",
    b"\3Loading program: a.urp\nFile not found: b\nAUTOMATIC\nPROGRAMMER\nCompleted successfully: /a/b.zip\n",
)
def dashboard_lines(data: bytes) -> None:
    for text in _in_any_split(dashboard.LineDecoder, data):
        for parse in _REPLIES:
            with suppress(RemoteProtocolError):
                parse(text)


def _modbus_seeds() -> Iterator[bytes]:
    for request in (
        modbus.ModbusRequest(3, 256, 2),
        modbus.ModbusRequest(1, 0, 9),
        modbus.ModbusRequest(6, 1, values=(5,)),
        modbus.ModbusRequest(16, 1, 2, (5, 6)),
        modbus.ModbusRequest(15, 1, 9, (1,) * 9),
        modbus.ModbusRequest(23, 1, 2, (5, 6), 9),
    ):
        yield b"\x05" + modbus.encode_frame(modbus.Frame(1, 255, modbus.encode_request(request)))


@target(_modbus_seeds)
def modbus_frames(data: bytes) -> None:
    frames = _in_any_split(modbus.FrameDecoder, data)
    asked = [modbus.ModbusRequest(3, 0, 2), modbus.ModbusRequest(1, 0, 9), modbus.ModbusRequest(16, 1, 2, (5, 6))]
    for frame in frames:
        with suppress(modbus.ModbusException):
            request = modbus.decode_request(frame.pdu)
            asked.append(request)
            if modbus.decode_request(modbus.encode_request(request)) != request:
                raise Finding(f"{request} is another one after encoding")
    for frame in frames:
        for request in asked:
            with suppress(modbus.ModbusException, RemoteProtocolError):
                modbus.decode_response(request, frame.pdu)


@target(b"\2SET ACT 1 GTO 1\nGET POS\nGET SID\nSET POS 1e300\n", b"\2GET STA")
def gripper_requests(data: bytes) -> None:
    _in_any_split(robotiq.RequestDecoder, data)
    decoder = robotiq.RequestDecoder()
    with suppress(RemoteProtocolError):
        decoder.feed(data)
        decoder.flush()


@target(
    b"\7ack: 1: x = 1\ndiscard: syntax error: y\nstate: 3: z\n", b"\7clear_interpreter()\nskipbuffer\nabort\n\xff\n"
)
def interpreter_lines(data: bytes) -> None:
    for found in _in_any_split(lambda: interpreter.StatementDecoder(64), data):
        if isinstance(found, str):
            interpreter.InterpreterCommand.of(found)
            with suppress(RemoteProtocolError):
                interpreter.encode_answer(interpreter.parse_answer(found).line)


def _external_seeds() -> Iterator[bytes]:
    yield external_control.ReverseMessage.setpoint(external_control.ControlMode.SERVOJ, (0.1,) * 6, 20).encode()
    yield external_control.ScriptCommand.set_payload(1.0, (0.1, 0.2, 0.3)).encode()
    yield external_control.Answer((1.5, -2.25)).encode()


@target(_external_seeds)
def driver_messages(data: bytes) -> None:
    for kind in (
        external_control.ReverseMessage,
        external_control.TrajectoryPoint,
        external_control.ScriptCommand,
    ):
        with suppress(RemoteProtocolError):
            external_control.MessageDecoder(kind.SIZE, kind.decode).feed(data)
    for decoder in (external_control.ReplyDecoder(), external_control.MessageDecoder.results()):
        with suppress(RemoteProtocolError):
            decoder.feed(data)


@target(b"<?xml version='1.0'?><methodResponse><params><param><value><struct><member><name>x</name><value><double>1"
        b"</double></value></member></struct></value></param></params></methodResponse>",
        b"<methodResponse><fault><value><int>1</int></value></fault></methodResponse>",
        b"<methodResponse><params><param><value><array><data><value><i4>1</i4></value><value>a</value><value><base64>"
        b"AA==</base64></value><value><dateTime.iso8601>x</dateTime.iso8601></value></data></array></value></param>"
        b"</params></methodResponse>")  # fmt: skip
def rpc_replies(data: bytes) -> None:
    with suppress(BadReplyError):
        reply = Reply()
        reply.feed(data[: len(data) // 2])
        reply.feed(data[len(data) // 2 :])
        wire = reply.close()
        for structs in (False, True):
            with suppress(BadReplyError):
                for _ in to_value(wire, structs=structs):
                    pass
    with suppress(RemoteError):
        PacketReader(lambda plain: None).feed(data)


# programs


@target(
    b'\5def f():\n  x = 1 # end\n  if x:\n    y = "end"\n  end\nend\nmovej([0,0,0,0,0,0])\n'
    b"\xef\xbb\xbfset_digital_out(1,True)\n",
    b'\1sec a():\n  textmsg("a\nb")\nend\nthread t():\n while True:\n  sync()\n end\nend',
    b"\1#\n\n \t\r\n# a\nx = 1\r\n",
)
def splitter(data: bytes) -> None:
    size, data = 1 + data[0] if data else 1, data[1:]
    whole, pieces = ScriptSplitter(256), ScriptSplitter(256)
    if len(data) <= 256:  # what is too long is cut where it has arrived by then
        found = whole.feed(data) + whole.flush()
        split = [unit for at in range(0, len(data), size) for unit in pieces.feed(data[at : at + size])]
        split += pieces.flush()
        if found != split:
            raise Finding(f"whole: {found}; in pieces of {size} bytes: {split}")
    for at in range(0, len(data), size):
        pieces.feed(data[at : at + size])
    pieces.flush()


@target(
    b"\0def f():\n  global a = [1, 2.5e3, p[0,0,0,0,0,1]]\n  local b = a[0] + norm(a)\n  while b < 3 and not False:\n"
    b"    b = b + 1 # c\n    if b > 2:\n      break\n    elif b == 2:\n      continue\n    else:\n"
    b"      halt\n    end\n  end\n"
    b"  return b\nend\n",
    b"\1def f(a, b=[1, 0x1f]):\n  thread t():\n    enter_critical\n    sync()\n    exit_critical\n  end\n"
    b"  h = run t()\n"
    b'  join h\n  kill h\n  s = struct(x=1, y="a")\n  s.x = -s.x % 3 ^ 2\n  m = [[1,2],[3,4]] * [1,2]\n  $ 1 "l"\n'
    b"  movej(get_inverse_kin(p[.1,.2,.3,0,0,0]), a=1.4, v=1.05)\n  f(b=[1], a=2)\nend\n",
    b"\2sec s():\n  set_digital_out(0, True)\nend\n",
    b"\1movel(p[0,0,0,0,0,0]",
    b"\1" + b"(" * 300,
    b"\1x = " + b"-" * 300 + b"1",
)
def scripts(data: bytes) -> None:
    """A program compiles if, and only if, no error is found in it."""
    if not data:
        return
    version, data = VERSIONS[data[0] % len(VERSIONS)], data[1:]
    text = ScriptFile("any.script", data)
    text.problems(LIBRARY_SET, version)
    problems = find_problems(text.text, LIBRARY_SET, version)
    errors = [problem for problem in problems if isinstance(problem, CompileError)]
    try:
        compile_script(text.text, LIBRARY_SET, version)
    except CompileError as error:
        if not errors:
            raise Finding(f"it does not compile, but nothing is found wrong: {error}") from error
    else:
        if errors:
            raise Finding(f"it compiles, but this is found wrong: {errors[0]}")


# files of programs


@cache
def _folder() -> Path:
    """Of this process, in memory if there is such a place."""
    shm = Path("/dev/shm")
    _KEPT.append(tempfile.TemporaryDirectory(prefix="fuzz-", dir=shm if shm.is_dir() else None))
    return Path(_KEPT[-1].name)


_KEPT: list[tempfile.TemporaryDirectory[str]] = []  # removed when the process ends


def _file(name: str, data: bytes) -> Path:
    path = _folder() / name
    path.write_bytes(data)
    return path


def _trees() -> Iterator[bytes]:
    waypoint = tag("Waypoint", tag("motionParameters"), tag("position", joints="0,0,0,0,0,0"), name="a", type="Fixed")
    variable = tag("Assignment", tag("variable", name="v"), expression("1+2"), valueSource="Expression")
    for content in (
        main(line('textmsg("a")'), sleep(0.1), assign("x", "1 + 2")),
        main(tag("Move", tag("children", waypoint), motionType="MoveJ", speed="1.0", acceleration="1.4"), variable),
        main(
            tag("Loop", tag("children", sleep(0.1)), type="Count", count="3"),
            tag("SuppressedNode", tag("suppressedNode", tag("Comment", comment="c"))),
            tag("Halt"),
            tag("Reference", reference="../Halt[1]"),
        ),
    ):
        yield tag("URProgram", tag("children", content), name="p", installation="default").encode()
    yield gzip.compress(tag("URProgram", tag("children", main()), name="p").encode(), mtime=0)


@target(_trees)
def program_tree(data: bytes) -> None:
    path = _file("p.urp", data)
    for version in VERSIONS[:2]:
        with suppress(ProgramLoadError):
            run_to_end(load_steps(path, _folder(), InstallationFile("default"), version))


_SAFETY: Final = (
    "[SafetyLimits Normal Values]\nmaxTcpSpeed = 1.5\nminJointPos = [-6.28, -6.28, -6.28, -6.28, -6.28, -6.28]\n"
    "[Inputs]\nemergencyStopInputA = 255\n[Planes 0]\n"
)


@target(
    lambda: [
        tag(
            "Installation",
            tag("SafetySettings", _SAFETY),
            tag("tcpOffset", x="0.1", y="0"),
            tag("analogInputRange", "1,1,1,1"),
            tag("features", tag("GeomFeature", name="f")),
            name="default",
        ).encode()
    ]
)
def installation(data: bytes) -> None:
    with suppress(DocumentError):
        read_installation(data, "default")
    with suppress(ConfigError):
        read_safety(_file("any.installation", data), load_model("ur5e"))


@target(b"a=1\n#c\nb = p[0,0,0,0,0,0]\nc=\\u00e4\\n\n", b'<variables><variable name="a" value="1"/></variables>')
def variables(data: bytes) -> None:
    with suppress(DocumentError):
        read_variables(data)


# settings

_STRANGE_YAML: Final = (
    b"\xff",
    b"2001-99-99",
    b"[" * 2000,
    b"a: !!int x",
    b"a: !!int",
    b"? [a]\n: b",
    b"a: &a [*a]",
    b"1: .nan",
    b"!!timestamp 1",
)


def _examples(*paths: Path) -> Callable[[], Iterator[bytes]]:
    return lambda: iter([path.read_bytes() for path in paths] + list(_STRANGE_YAML))


@target(
    _examples(EXAMPLES / "table.yaml"),
    b"tool:\n  box: [0.1, 0.1, 0.1]\n  pose: [0,0,0,0,0,0]\nlinks: true\nobjects:\n"
    b"  a: {sphere: 0.1, stiffness: 1e4}\n  b: {plane: {}}\n",
)
def world(data: bytes) -> None:
    with suppress(ConfigError):
        read_surroundings(_file("world.yaml", data))


@target(
    _examples(),
    b"preset: default\nnormal: {tool_speed: 1.0, joint_position: {base: [-1, 1]}}\nplanes:\n"
    b"- {normal: [0,0,1], distance: 0.1}\n"
    b"tool_orientation: {direction: [0,0,1], deviation: 0.3}\ninputs: {emergency_stop: [0,1]}\n"
    b"safe_home: [0,0,0,0,0,0]\n",
)
def safety(data: bytes) -> None:
    with suppress(ConfigError):
        read_safety(_file("safety.yaml", data), load_model("ur5e"))


@target(
    _examples(GOLDEN / "calibration_ur5e.yaml", GOLDEN / "calibration_ur5.yaml"),
    b"dh_theta: [0,0,0,0,0,0]\ndh_a: [0,-0.425,-0.3922,0,0,0]\ndh_d: [0.1625,0,0,0.1333,0.0997,0.0996]\n"
    b"dh_alpha: [1.570796327,0,0,1.570796327,-1.570796327,0]\n",
)
def calibration(data: bytes) -> None:
    path = _file("calibration.yaml", data)
    with suppress(ConfigError):
        read_calibration(path, load_model("ur5e"))
    with suppress(ClientError):
        read_calibration_of_client(path)


@target(
    _examples(),
    b"shoulder_pan_joint: 0\nshoulder_lift_joint: -1.57\nelbow_joint: 0\nwrist_1_joint: 0\n"
    b"wrist_2_joint: 1\nwrist_3_joint: 2\n",
)
def initial_positions(data: bytes) -> None:
    with suppress(ConfigError):
        read_initial_positions(_file("positions.yaml", data), load_model("ur5e"))


@target(_examples(EXAMPLES / "goals.yaml", CONTROLLERS / "ur_controllers.yaml"))
def controllers(data: bytes) -> None:
    path = _file("controllers.yaml", data)
    for read in (read_controllers, read_goals):
        with suppress(ClientError):
            read(path)


# recordings


def _recordings(suffix: str) -> Callable[[], Iterator[bytes]]:
    def seeds() -> Iterator[bytes]:
        path = _folder() / f"seed{suffix}"
        names = ("timestamp", "actual_q", "robot_mode")
        with Recorder(path, names, now_ns=lambda: 1_700_000_000_000_000_000) as recorder:
            for step in range(3):
                recorder.write({"timestamp": step * 0.002, "actual_q": (0.1,) * 6, "robot_mode": 7})
        yield path.read_bytes()

    return seeds


def _recording(suffix: str, data: bytes) -> None:
    with suppress(ClientError), np.errstate(all="raise"):
        found = read_recording(_file(f"any{suffix}", data))
        list(found.states())


@target(_recordings(".mcap"))
def mcap(data: bytes) -> None:
    _recording(".mcap", data)


@target(_recordings(".csv"), b"timestamp,robot_mode\n0,1e400\n", b'"timestamp\n')
def csv(data: bytes) -> None:
    _recording(".csv", data)


@target(_recordings(".npz"))
def npz(data: bytes) -> None:
    _recording(".npz", data)


def _captures() -> Iterator[bytes]:
    ends = Endpoint("10.0.0.2", 45678), Endpoint("10.0.0.1", 30004)
    frames = ConnectionFrames(*ends, 1)
    start = rtde_codec.RequestProtocol(2).encode(1)
    parts = [*frames.open(), *frames.data(True, start), *frames.data(False, rtde_codec.ProtocolReply(True).encode(1))]
    yield head_of_capture("fuzz", "lo", ["a comment"]) + b"".join(packet_block(10**18, part) for part in parts)
    for port in (29999, 30001, 30003, 502, 50001, 63352):
        frames = ConnectionFrames(ends[0], Endpoint("10.0.0.1", port), 1)
        parts = [*frames.open(), *frames.data(True, b"load a\n"), *frames.data(False, b"\0\0\0\5\x14")]
        yield head_of_capture("fuzz", "lo") + b"".join(packet_block(10**18, part) for part in parts)


@target(_captures, b"00 05 56 00 02\n", b"\0\5\x56\0\2")
def captures(data: bytes) -> None:
    session = Session(Choice())
    for _ in session.feed(data):
        pass
    for _ in session.end():
        pass
    with suppress(ClientError):
        Traffic.read(_file("any.pcapng", data))


# the control API


def _http(method: str, path: str, body: bytes = b"") -> bytes:
    head = f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
    return head.encode() + f"Content-Length: {len(body)}\r\n\r\n".encode() + body


def _requests() -> Iterator[bytes]:
    yield _http("GET", "/openapi.json") + _http("GET", "/verbs")
    for name, verb in verbs_of(LiveControl.SUBJECTS).items():
        yield _http("POST", f"/verbs/{name}", json.dumps(dict.fromkeys(verb.arguments, 1)).encode())


@cache
def _robot() -> Emulator:
    """Used again until a verb changed something."""
    config = ControllerConfig(model=load_model("ur5e"), running=True)
    return Emulator(EmulatorConfig(controller=config, ephemeral_ports=True), StepClock())


@target(_requests)
def control_api(data: bytes) -> None:
    emulator = _robot()
    client = MemoryClient(emulator.servers["control"])
    client.feed(data)
    for _ in range(3):
        emulator.controller.tick()
    client.end()
    client.vanish()
    answer = client.take()
    if b"HTTP/1.1 500" in answer:
        raise Finding(answer.decode(errors="replace"))
    if b"POST" in data and b"HTTP/1.1 200" in answer:
        _robot.cache_clear()
