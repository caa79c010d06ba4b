"""The RTDE client: the conversation without sockets, then both shells against a small server."""

import socket
import threading

import pytest

from client.connection import POLL
from client.errors import ConnectionLostError, RobotUnreachableError
from client.rtde import BlockingRTDEClient, RTDEClient, RTDECore, read_recipe
from tests.rows import each_row
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

    def on_Pause(self, request):
        return codec.PauseReply(True)

    def on_InputData(self, request):
        return None

    def on_ClientMessage(self, request):
        return None


def drive(flow, controller, waiting=b""):
    """Run a flow against a controller in memory, one byte of each answer at a time."""
    try:
        wanted = next(flow)
        while True:
            if wanted is POLL:
                arrived, waiting = waiting, b""
                wanted = flow.send(arrived)
            elif wanted is not None:
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


class Old(Controller):
    """A controller whose software lacks the joint angles."""

    def on_SetupOutputs(self, request):
        types = type_names(request.names, OUTPUT_FIELDS)
        found = [name != "actual_q" for name in request.names]
        self.recipe = Recipe.of(request.names, OUTPUT_FIELDS) if all(found) else None
        types = tuple(kind if good else "NOT_FOUND" for kind, good in zip(types, found, strict=True))
        return codec.SetupOutputsReply(types)

    def data(self):
        if self.recipe is None or codec.Start() not in self.requests:
            return b""
        return codec.OutputData(self.recipe.pack((41.5, 7))).encode(self.protocol)


def test_unavailable_outputs_are_left_out_on_request():
    core = RTDECore(OUTPUTS, ignore_unavailable=True)
    controller = Old()
    drive(core.start(), controller)
    assert core.unavailable == {"actual_q"}
    assert drive(core.receive(), controller, controller.data()) == {"timestamp": 41.5, "robot_mode": 7}


def test_nothing_is_left_to_receive():
    with pytest.raises(RobotRefused, match="none of actual_q"):
        drive(RTDECore(["actual_q"], ignore_unavailable=True).start(), Old())


@each_row(
    ("version", "frequency_hz", "rate_hz"),
    [("3.15", None, 125), ("3.15", 50, 62.5), ("3.15", 100, 125), ("5.22", 125, 125), ("5.22", 300, 500)],
)
def test_the_rate_is_whole_periods(version, frequency_hz, rate_hz):
    core = RTDECore(OUTPUTS, frequency_hz=frequency_hz)
    drive(core.start(), Controller(PolyscopeVersion.parse(version)))
    assert core.rate_hz == rate_hz


def test_frequencies_no_robot_has():
    with pytest.raises(LocalProtocolError, match="at most 125 states/s, not 500"):
        drive(RTDECore(OUTPUTS, frequency_hz=500).start(), Controller(PolyscopeVersion(3, 15)))
    for frequency_hz in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(LocalProtocolError):
            RTDECore(OUTPUTS, frequency_hz=frequency_hz)


def test_recipes_from_files(tmp_path):
    path = tmp_path / "outputs.txt"
    path.write_text("# what the robot does\ntimestamp\n\n  actual_q  # rad\r\nrobot_mode")
    assert read_recipe(path) == tuple(OUTPUTS)
    controller = Controller()
    drive(RTDECore(path).start(), controller)
    assert codec.SetupOutputs(tuple(OUTPUTS), 500.0) in controller.requests
    path.write_text("timestamp,actual_q")
    with pytest.raises(LocalProtocolError, match="one name per line"):
        RTDECore(path)
    path.write_text("# nothing")
    with pytest.raises(LocalProtocolError, match="names no variable"):
        RTDECore(path)
    with pytest.raises(LocalProtocolError, match="not 'timestamp'"):
        RTDECore("timestamp")


def test_pause_and_resume():
    controller = Controller()
    core = RTDECore(OUTPUTS)
    drive(core.start(), controller)
    drive(core.pause(), controller)
    assert controller.requests[-1] == codec.Pause()
    assert not core.running
    with pytest.raises(LocalProtocolError, match="resume"):
        next(core.receive())
    drive(core.resume(), controller)
    assert core.running
    assert drive(core.receive(), controller, controller.data())["robot_mode"] == 7


def test_a_client_that_only_writes():
    controller = Controller()
    core = RTDECore([], [REGISTER])
    drive(core.start(), controller)
    assert controller.requests[2:] == [codec.SetupInputs(tuple(REGISTER))]
    with pytest.raises(LocalProtocolError, match="no outputs"):
        next(core.latest())
    drive(core.send_message("careful", "me"), controller)
    assert controller.requests[-1] == codec.ClientMessage("careful", "me")


def written(controller):
    """Input values the controller got, package by package."""
    packages = [request for request in controller.requests if isinstance(request, codec.InputData)]
    recipes = [controller.input_recipes[package.recipe_id - 1] for package in packages]
    return [
        dict(zip(recipe.names, recipe.unpack(package.data), strict=True))
        for recipe, package in zip(recipes, packages, strict=True)
    ]


def test_partial_writes_keep_the_last_values_but_no_masks():
    controller = Controller()
    core = RTDECore(OUTPUTS, [[*SLIDER, "input_double_register_24"], REGISTER, ["external_force_torque"]])
    drive(core.start(), controller)
    drive(core.write({"input_double_register_24": 2.5}), controller)
    drive(core.write({"speed_slider_mask": 1, "speed_slider_fraction": 0.5}), controller)
    drive(core.write({"input_double_register_24": 3.5, "input_int_register_24": 4}), controller)
    drive(core.write({"external_force_torque": [1, 2, 3, 4, 5, 6]}), controller)
    assert written(controller) == [
        {"speed_slider_mask": 0, "speed_slider_fraction": 0.0, "input_double_register_24": 2.5},
        {"speed_slider_mask": 1, "speed_slider_fraction": 0.5, "input_double_register_24": 2.5},
        {"input_int_register_24": 4},
        {"speed_slider_mask": 0, "speed_slider_fraction": 0.5, "input_double_register_24": 3.5},
        {"external_force_torque": (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)},
    ]


def test_the_smallest_recipe_that_has_all_is_written():
    controller = Controller()
    core = RTDECore([], [[*REGISTER, "input_int_register_25"], REGISTER])
    drive(core.start(), controller)
    drive(core.write({"input_int_register_24": 1}), controller)
    assert written(controller) == [{"input_int_register_24": 1}]


def test_a_value_that_does_not_fit_changes_nothing():
    controller = Controller()
    core = RTDECore([], [["input_int_register_24", "input_int_register_25"]])
    drive(core.start(), controller)
    with pytest.raises(LocalProtocolError):
        drive(core.write({"input_int_register_24": 1, "input_int_register_25": 2**40}), controller)
    with pytest.raises(LocalProtocolError, match="no input recipe has input_int_register_26"):
        drive(core.write({"input_int_register_26": 1}), controller)
    drive(core.write({"input_int_register_25": 2}), controller)
    assert written(controller) == [{"input_int_register_24": 0, "input_int_register_25": 2}]


def test_the_latest_state_skips_the_others():
    controller = Controller()
    core = RTDECore(OUTPUTS)
    drive(core.start(), controller)
    drive(core.receive(), controller, controller.data())
    many = controller.data() + controller.data() + controller.data()
    assert drive(core.latest(), controller, many)["timestamp"] == pytest.approx(41.010)
    assert core.skipped == 2
    assert core.state["timestamp"] == pytest.approx(41.010)


def lossy(requests):
    """A controller that hangs up after its first state, and later serves as it should."""

    def serve_lossily(connection):
        controller = Controller()
        while data := connection.recv(4096):
            answer = controller.feed(data)
            started = codec.Start() in controller.requests
            if started:
                requests.append(controller.requests)
            connection.sendall(answer)
            if started:
                if len(requests) > 1:
                    connection.recv(4096)
                return

    return serve_lossily


RECIPES = [codec.SetupOutputs(tuple(OUTPUTS), 125.0), codec.SetupInputs(tuple(SLIDER)), codec.Start()]


def test_coming_back_blocking(serve):
    requests = []
    port = serve(lossy(requests))
    with BlockingRTDEClient("127.0.0.1", OUTPUTS, [SLIDER], frequency_hz=125, reconnect_s=5, port=port) as robot:
        assert [robot.receive() for _ in range(2)] == [STATE, STATE]
        assert robot.core.reconnects == 1
    assert [made[2:] for made in requests] == [RECIPES, RECIPES]


async def test_coming_back_async(serve):
    requests = []
    port = serve(lossy(requests))
    async with RTDEClient("127.0.0.1", OUTPUTS, [SLIDER], frequency_hz=125, reconnect_s=5, port=port) as robot:
        assert [await robot.latest() for _ in range(2)] == [STATE, STATE]
        assert robot.core.reconnects == 1
    assert [made[2:] for made in requests] == [RECIPES, RECIPES]


def test_without_patience_a_loss_is_an_error_and_may_be_mended(serve):
    with BlockingRTDEClient("127.0.0.1", OUTPUTS, port=serve(lossy([]))) as robot:
        robot.receive()
        with pytest.raises(ConnectionLostError):
            robot.receive()
        robot.reconnect()
        assert robot.receive() == STATE


def test_a_robot_that_stays_away(serve):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        serving = threading.Thread(target=serve_once, args=(listener,))
        serving.start()
        with BlockingRTDEClient("127.0.0.1", OUTPUTS, reconnect_s=0.1, port=port) as robot:
            robot.receive()
            serving.join()
            listener.close()
            with pytest.raises(RobotUnreachableError):
                robot.receive()


def serve_once(listener):
    connection, _ = listener.accept()
    with connection:
        lossy([])(connection)


def test_paused_before_and_after_a_loss():
    controller = Controller()
    core = RTDECore(OUTPUTS)
    drive(core.start(), controller)
    drive(core.pause(), controller)
    again = Controller()
    coming_back = core.reconnect(1.0)
    assert next(coming_back).within_s == 1.0
    drive(answered(coming_back), again)
    assert codec.Start() not in again.requests
    assert not core.running


def answered(flow):
    """A flow that waits for a connection, with the connection made."""
    wanted = flow.send(b"")
    while True:
        try:
            wanted = flow.send((yield wanted))
        except StopIteration:
            return


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
