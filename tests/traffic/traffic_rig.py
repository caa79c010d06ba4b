"""Recordings in virtual time of a controller that is stepped manually."""

from pathlib import Path
from typing import Any

from client.decoding.packets import SocketAddress
from client.traffic.recording import Recorded, TrafficRecorder, TrafficRecording
from emulator.commands.requests import ScriptUnit
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from tests.ticking import ticked
from urproto.robots import load_model
from urproto.rtde import codec
from urproto.rtde.fields import INPUT_FIELDS, OUTPUT_FIELDS
from urproto.rtde.recipes import Recipe
from urproto.versions import DEFAULT_VERSION, Series

BEGIN_NS = 1_700_000_000 * 10**9
CLIENT, ROBOT = "10.0.0.2", "10.0.0.1"
NAMES = ("timestamp", "target_q", "actual_q", "runtime_state", "actual_digital_output_bits")
PROGRAM = "def prog():\n  movej([-1.6, -1.4, -1.7, -0.8, 1.6, 0], a={acceleration}, v=1)\n{then}end\n"


class VirtualTime:
    """A clock that is advanced by the test."""

    def __init__(self) -> None:
        self.ns = BEGIN_NS

    def __call__(self) -> int:
        return self.ns


def ends(port: int, client_port: int = 45678) -> tuple[SocketAddress, SocketAddress]:
    return SocketAddress(CLIENT, client_port), SocketAddress(ROBOT, port)


def recorded_robot(
    path: Path,
    *,
    acceleration: float = 1.4,
    then: str = "",
    idle_s: float = 0.2,
    names: Any = NAMES,
    model: str = "ur3",
) -> TrafficRecording:
    """An RTDE client observes a robot executing a program, and sends a dashboard query."""
    clock = VirtualTime()
    recorder = TrafficRecorder(path, ["robot: UR3", "PolyScope: 3.15.8.1"], now_ns=clock)
    controller = Controller(ControllerConfig(model=load_model(model), running=True))
    period_ns = round(controller.period_s * 1e9)
    client = recorder.connection(*ends(30004))
    agree(client, names)
    dashboard = recorder.connection(*ends(29999, 45679))
    dashboard.data(False, b"Connected: Universal Robots Dashboard Server\n")
    pack = codec.output_packer(Recipe.of(names, OUTPUT_FIELDS), 2)
    start = round(idle_s / controller.period_s)
    for step in range(start + round(2.5 / controller.period_s)):
        if step == start:
            controller.post(ScriptUnit(PROGRAM.format(acceleration=acceleration, then=then), "block"))
            dashboard.data(True, b"running\n")
            dashboard.data(False, b"Program running: false\n")
        clock.ns += period_ns
        client.data(False, pack(ticked(controller)))
    recorder.close()
    return TrafficRecording.read(path)


def agree(client: Recorded, outputs: tuple[str, ...], inputs: tuple[str, ...] = ()) -> None:
    """Record how an RTDE client sets up its recipes, both of which have the id 1."""
    for request, reply, protocol in (
        (codec.RequestProtocol(2), codec.ProtocolReply(True), 1),
        (codec.GetVersion(), codec.VersionReply(DEFAULT_VERSION[Series.CB3]), 2),
        (codec.SetupOutputs(outputs, 125.0), codec.SetupOutputsReply(Recipe.of(outputs, OUTPUT_FIELDS).types, 1), 2),
        (codec.SetupInputs(inputs), codec.SetupInputsReply(Recipe.of(inputs, INPUT_FIELDS).types, 1), 2),
        (codec.Start(), codec.StartReply(True), 2),
    ):
        if isinstance(request, codec.SetupInputs) and not inputs:
            continue
        client.data(True, request.encode(protocol))
        client.data(False, reply.encode(protocol))
