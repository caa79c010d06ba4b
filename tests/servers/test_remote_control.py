"""Remote control as seen by clients of the ports, with the real controller."""

from typing import Any

from server_rig import MemoryClient

from emulator.app import make_servers
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from urproto.dashboard import NOT_IN_REMOTE_CONTROL
from urproto.modes import RobotMode
from urproto.primary.framing import PrimaryDecoder
from urproto.primary.messages import ErrorCodeMessage
from urproto.robots import load_model


def local_arm() -> tuple[Controller, dict[str, Any]]:
    controller = Controller(ControllerConfig(model=load_model("ur5e"), enforce_remote_control=True))
    return controller, {server.name: server for server in make_servers(controller)}


def ticks(controller: Controller, count: int = 10) -> None:
    for _ in range(count):
        controller.tick()


def test_the_dashboard_refuses_until_the_client_reconnects() -> None:
    controller, servers = local_arm()
    early = MemoryClient(servers["dashboard"])
    early.feed(b"power on\n")
    ticks(controller)
    controller.remote_control = True
    ticks(controller)
    early.feed(b"power on\n")
    ticks(controller)
    refusal = NOT_IN_REMOTE_CONTROL.encode() + b"\n"
    assert early.take().endswith(2 * refusal)
    assert controller.power.robot_mode is RobotMode.POWER_OFF
    late = MemoryClient(servers["dashboard"])
    late.feed(b"power on\n")
    ticks(controller)
    assert late.take().endswith(b"Powering on\n")
    assert controller.power.robot_mode is RobotMode.BOOTING


def test_scripts_on_every_port_are_refused_with_c210_to_primary_clients() -> None:
    controller, servers = local_arm()
    watcher, decoder = MemoryClient(servers["primary"]), PrimaryDecoder()
    for name in ("primary", "secondary", "realtime", "primary read-only", "secondary read-only", "realtime read-only"):
        client = MemoryClient(servers[name])
        decoder.feed(watcher.take())
        client.feed(b"power on\n")
        ticks(controller, 60)
        codes = [m.code for m in decoder.feed(watcher.take()) if isinstance(m, ErrorCodeMessage)]
        assert codes == [210], name
    assert controller.power.robot_mode is RobotMode.POWER_OFF
