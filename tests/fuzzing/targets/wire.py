"""Data received on connections: the robot's ports, the driver's messages, replies of remote procedures."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Final

from emulator.builtins.remote.connections import PacketReader, RemoteError
from emulator.builtins.remote.xmlrpc import BadReplyError, Reply, to_value
from targets.registry import REPOSITORY, VERSIONS, Finding, in_any_split, target
from urproto import dashboard, external_control, interpreter, modbus, robotiq
from urproto.errors import RemoteProtocolError
from urproto.primary.framing import PrimaryDecoder
from urproto.realtime import RealtimeDecoder
from urproto.rtde import codec as rtde_codec

_GOLDEN: Final = REPOSITORY / "tests" / "golden"


def _golden(*names: str) -> Callable[[], Iterator[bytes]]:
    """Captures, each to be read in small pieces."""

    def seeds() -> Iterator[bytes]:
        for name in names:
            text = (line.partition("#")[0] for line in (_GOLDEN / name).read_text().splitlines())
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
    for package in in_any_split(rtde_codec.RTDEDecoder, data):
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
        in_any_split(lambda version=version: PrimaryDecoder(version), data)


@target(lambda: (b"\xff" + size.to_bytes(4, "big") + bytes(size - 4) for size in (1044, 1060, 1108, 1220)))
def realtime(data: bytes) -> None:
    in_any_split(RealtimeDecoder, data)


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
    for text in in_any_split(dashboard.LineDecoder, data):
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
    frames = in_any_split(modbus.FrameDecoder, data)
    requested = [modbus.ModbusRequest(3, 0, 2), modbus.ModbusRequest(1, 0, 9), modbus.ModbusRequest(16, 1, 2, (5, 6))]
    for frame in frames:
        with suppress(modbus.ModbusException):
            request = modbus.decode_request(frame.pdu)
            requested.append(request)
            if modbus.decode_request(modbus.encode_request(request)) != request:
                raise Finding(f"{request} is another one after encoding")
    for frame in frames:
        for request in requested:
            with suppress(modbus.ModbusException, RemoteProtocolError):
                modbus.decode_response(request, frame.pdu)


@target(b"\2SET ACT 1 GTO 1\nGET POS\nGET SID\nSET POS 1e300\n", b"\2GET STA", b"\2ackPOS 3\nnack\n")
def gripper_requests(data: bytes) -> None:
    in_any_split(robotiq.RequestDecoder, data)
    in_any_split(robotiq.ReplyDecoder, data)
    decoder = robotiq.RequestDecoder()
    with suppress(RemoteProtocolError):
        decoder.feed(data)
        decoder.flush()


@target(
    b"\7ack: 1: x = 1\ndiscard: syntax error: y\nstate: 3: z\n", b"\7clear_interpreter()\nskipbuffer\nabort\n\xff\n"
)
def interpreter_lines(data: bytes) -> None:
    for found in in_any_split(lambda: interpreter.StatementDecoder(64), data):
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
            kind.decode(data[: kind.SIZE].ljust(kind.SIZE, b"\0"))
    with suppress(RemoteProtocolError):
        external_control.ReplyDecoder().feed(data)


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
