"""The RTDE client: the conversation without sockets, then both shells against a small server."""

import socket

import pytest

from client.errors import ConnectionLostError
from client.rtde import BlockingRTDEClient, RTDEClient, RTDECore
from urproto.errors import LocalProtocolError, RemoteProtocolError, RobotRefused
from urproto.rtde import codec
from urproto.rtde.fields import INPUT_FIELDS, OUTPUT_FIELDS
from urproto.rtde.recipes import Recipe, type_names
from urproto.versions import PolyscopeVersion

OUTPUTS = ["timestamp", "actual_q", "robot_mode"]
SLIDER = ["speed_slider_mask", "speed_slider_fraction"]
REGISTER = ["input_int_register_24"]
E_5_22 = PolyscopeVersion(5, 22)
Q = (0.0, -1.57, 0.0, -1.57, 0.0, 0.0)


class Controller:
    """A controller's side of one connection; it notes what was asked of it."""

    def __init__(self, version=E_5_22, protocols=(1, 2), busy=()):
        self.version = version
        self.protocols = protocols
        self.busy = busy
        self.protocol = 1
        self.requests = []
        self.decoder = codec.RTDEDecoder()
        self.recipe = None
        self.input_recipes = []
        self.timestamp = 41.0

    def feed(self, data):
        """The bytes that answer these."""
        return b"".join(self.answer(package) for package in self.decoder.feed(data))

    def answer(self, package):
        protocol = self.protocol
        request = codec.decode_request(package, protocol)
        self.requests.append(request)
        reply = getattr(self, f"on_{type(request).__name__}")(request)
        note = codec.TextMessage("careful", "controller").encode(protocol)
        return note + reply.encode(protocol) + self.data() if reply else b""

    def data(self):
        """A state after every reply once started: clients must tell it from replies."""
        if self.recipe is None or codec.Start() not in self.requests:
            return b""
        self.timestamp += 0.002
        return codec.OutputData(self.recipe.pack((self.timestamp, Q, 7))).encode(self.protocol)

    def on_RequestProtocol(self, request):
        accepted = request.version in self.protocols
        self.protocol = request.version if accepted else self.protocol
        return codec.ProtocolReply(accepted)

    def on_GetVersion(self, request):
        return codec.VersionReply(self.version)

    def on_SetupOutputs(self, request):
        types = type_names(request.names, OUTPUT_FIELDS)
        self.recipe = None if "NOT_FOUND" in types else Recipe.of(request.names, OUTPUT_FIELDS)
        return codec.SetupOutputsReply(types)

    def on_SetupInputs(self, request):
        types = type_names(request.names, INPUT_FIELDS)
        types = tuple("IN_USE" if name in self.busy else kind for name, kind in zip(request.names, types, strict=True))
        self.input_recipes.append(Recipe.of(request.names, INPUT_FIELDS))
        return codec.SetupInputsReply(types, len(self.input_recipes))

    def on_Start(self, request):
        return codec.StartReply(self.recipe is not None)

    def on_InputData(self, request):
        return None


def drive(flow, controller):
    """Run a flow against a controller in memory, one byte of each answer at a time."""
    waiting = b""
    try:
        wanted = next(flow)
        while True:
            if wanted is not None:
                waiting += controller.feed(wanted)
                wanted = flow.send(b"")
            else:
                assert waiting, "the client waits, the controller has nothing to say"
                byte, waiting = waiting[:1], waiting[1:]
                wanted = flow.send(byte)
    except StopIteration as end:
        return end.value


def test_handshake():
    controller = Controller()
    core = RTDECore(OUTPUTS, [SLIDER, REGISTER], 125.0)
    drive(core.start(), controller)
    assert controller.requests == [
        codec.RequestProtocol(2),
        codec.GetVersion(),
        codec.SetupOutputs(tuple(OUTPUTS), 125.0),
        codec.SetupInputs(tuple(SLIDER)),
        codec.SetupInputs(tuple(REGISTER)),
        codec.Start(),
    ]
    assert core.version == PolyscopeVersion(5, 22)
    assert {message.text for message in core.messages} == {"careful"}


@pytest.mark.parametrize(("version", "frequency_hz"), [("3.15.8", 125.0), ("5.22", 500.0)])
def test_the_full_rate_is_the_default(version, frequency_hz):
    controller = Controller(PolyscopeVersion.parse(version))
    drive(RTDECore(OUTPUTS).start(), controller)
    assert codec.SetupOutputs(tuple(OUTPUTS), frequency_hz) in controller.requests


def test_a_controller_that_only_speaks_protocol_1():
    controller = Controller(protocols=(1,))
    core = RTDECore(OUTPUTS)
    drive(core.start(), controller)
    assert controller.requests[2] == codec.SetupOutputs(tuple(OUTPUTS), None)


def test_inputs_go_into_the_recipe_with_their_names():
    controller = Controller()
    core = RTDECore(OUTPUTS, [SLIDER, REGISTER])
    drive(core.start(), controller)
    drive(core.send({"speed_slider_fraction": 0.5, "speed_slider_mask": 1}), controller)
    drive(core.send({"input_int_register_24": -7}), controller)
    first, second = controller.requests[-2:]
    assert (first.recipe_id, second.recipe_id) == (1, 2)
    assert controller.input_recipes[0].unpack(first.data) == (1, 0.5)
    assert controller.input_recipes[1].unpack(second.data) == (-7,)


def test_inputs_without_a_recipe_are_refused():
    core = RTDECore(OUTPUTS, [SLIDER])
    drive(core.start(), Controller())
    with pytest.raises(LocalProtocolError, match="speed_slider_mask"):
        drive(core.send({"speed_slider_mask": 1}), Controller())


def test_unknown_names_are_refused_before_connecting():
    with pytest.raises(LocalProtocolError, match="actual_quux"):
        RTDECore(["actual_quux"])


def test_variables_the_robot_lacks_are_named():
    class Old(Controller):
        def on_SetupOutputs(self, request):
            return codec.SetupOutputsReply(("DOUBLE", "NOT_FOUND", "INT32"), 0)

    with pytest.raises(RobotRefused, match="actual_q: NOT_FOUND"):
        drive(RTDECore(OUTPUTS).start(), Old())


def test_inputs_another_client_holds_are_named():
    with pytest.raises(RobotRefused, match="input_int_register_24: IN_USE"):
        drive(RTDECore(OUTPUTS, [REGISTER]).start(), Controller(busy=REGISTER))


@pytest.mark.parametrize("types", [("DOUBLE",), ("DOUBLE", "VECTOR3D", "INT32")])
def test_types_that_are_not_the_documented_ones(types):
    class Strange(Controller):
        def on_SetupOutputs(self, request):
            return codec.SetupOutputsReply(types)

    with pytest.raises(RemoteProtocolError):
        drive(RTDECore(OUTPUTS).start(), Strange())


def serve_controller(connection: socket.socket) -> None:
    controller = Controller()
    while data := connection.recv(4096):
        connection.sendall(controller.feed(data))
        if any(isinstance(request, codec.InputData) for request in controller.requests):
            connection.sendall(controller.data() * 3)


STATE = {"timestamp": pytest.approx(41.002), "actual_q": Q, "robot_mode": 7}


def test_blocking_shell(serve):
    port = serve(serve_controller)
    with BlockingRTDEClient("127.0.0.1", OUTPUTS, [SLIDER], port=port) as robot:
        assert robot.receive() == STATE
        robot.send(speed_slider_mask=1, speed_slider_fraction=0.25)
        assert [robot.receive()["timestamp"] for _ in range(3)] == [pytest.approx(41.004)] * 3


async def test_async_shell(serve):
    port = serve(serve_controller)
    async with RTDEClient("127.0.0.1", OUTPUTS, [SLIDER], port=port) as robot:
        assert await robot.receive() == STATE
        await robot.send(speed_slider_mask=1, speed_slider_fraction=0.25)
        assert [(await robot.receive())["timestamp"] for _ in range(3)] == [pytest.approx(41.004)] * 3


def test_a_robot_that_hangs_up_during_the_handshake(serve):
    port = serve(lambda connection: connection.recv(1))
    with pytest.raises(ConnectionLostError), BlockingRTDEClient("127.0.0.1", OUTPUTS, port=port):
        pytest.fail("entered")
