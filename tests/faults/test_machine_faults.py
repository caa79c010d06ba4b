"""The unconfirmed safety setup: what RTDE, dashboard and robot mode show, and every way to confirm it."""

import pytest
from fault_rig import HOST, Robot, RTDEClient

from emulator.app import Emulator
from emulator.config import EmulatorConfig, controller_config
from emulator.faults.catalogue import parse_fault
from emulator.readiness import check_ready
from tests.ticking import StepClock, ticked
from urproto.modes import RobotMode
from urproto.rtde.codec import Package, PackageType, RequestProtocol, SetupOutputs, Start

TEXT = b"SafetySetup has not been confirmed yet, therefore no data will be send yet"


async def sent(robot: Robot, *requests: bytes) -> list[tuple[PackageType, bytes]]:
    """Type and payload of what a new RTDE client gets, before and after these requests."""
    client = await robot.connect("rtde", RTDEClient)
    for request in requests:
        client.send(request)
    packages = list[Package]()

    def answered() -> bool:
        packages.extend(client.packages())
        return any(package.type == PackageType.START for package in packages)

    await robot.until_ticking(answered)
    return [(PackageType(package.type), package.payload) for package in packages]


HANDSHAKE = (
    RequestProtocol(2).encode(1),
    SetupOutputs(("timestamp",), 125.0).encode(2),
    Start().encode(2),
)


async def test_rtde_tells_each_client_and_sends_no_data(robot: Robot) -> None:
    robot.control.inject_fault("unconfirmed_safety_setup")
    await robot.step(1)
    packages = await sent(robot, *HANDSHAKE)
    assert packages[0] == (PackageType.TEXT_MESSAGE, b"\2" + TEXT)  # in the form of protocol 1, before any answer
    assert packages[1] == (PackageType.REQUEST_PROTOCOL_VERSION, b"\1")
    assert [kind for kind, _ in packages[2:]] == [
        PackageType.SETUP_OUTPUTS,
        PackageType.TEXT_MESSAGE,
        PackageType.START,
    ]
    assert packages[-1] == (PackageType.START, b"\0")


async def test_robot_mode_and_switching_on(ur3: Robot) -> None:
    """A public report of URSim 5.26: the dashboard switches the arm on, and RTDE still tells that nothing is sent."""
    controller = ur3.emulator.controller
    ur3.control.power_off()
    ur3.control.inject_fault("unconfirmed_safety_setup")
    await ur3.step(2)
    assert controller.snapshot.robot_mode is RobotMode.CONFIRM_SAFETY
    ur3.control.release_brakes()
    await ur3.until_ticking(lambda: controller.snapshot.robot_mode is RobotMode.RUNNING)
    assert not controller.snapshot.safety_confirmed
    ur3.control.power_off()
    await ur3.step(2)
    assert controller.snapshot.robot_mode is RobotMode.CONFIRM_SAFETY


@pytest.mark.parametrize("how", ["verb", "text command", "clear"])
async def test_ways_to_confirm_it(ur3: Robot, how: str) -> None:
    controller = ur3.emulator.controller
    ur3.control.power_off()
    fault = ur3.control.inject_fault("unconfirmed_safety_setup")
    await ur3.step(2)
    if how == "verb":
        ur3.control.confirm_safety_setup()
    elif how == "clear":
        ur3.control.clear_fault(fault)
    else:
        client = await ur3.connect("primary")
        client.send(b"confirm user safety parameters\n")
    await ur3.step(5)
    assert controller.snapshot.robot_mode is RobotMode.POWER_OFF
    assert controller.snapshot.safety_confirmed
    assert ur3.states() == ["over"]
    assert [kind for kind, _ in await sent(ur3, *HANDSHAKE)][:3] == [
        PackageType.REQUEST_PROTOCOL_VERSION,
        PackageType.SETUP_OUTPUTS,
        PackageType.START,
    ]


async def test_such_a_controller_counts_as_ready() -> None:
    config = EmulatorConfig(
        controller=controller_config("ur5e"),
        ephemeral_ports=True,
        faults=(parse_fault("unconfirmed_safety_setup"),),
    )
    async with Emulator(config) as emulator:
        await check_ready(HOST, emulator.ports)
        assert not emulator.controller.snapshot.safety_confirmed


def test_an_arm_boots_through_its_modes_and_polyscope_confirms_its_safety_setup() -> None:
    emulator = Emulator(EmulatorConfig(controller=controller_config("ur5e", personality="arm")), StepClock())
    controller, modes = emulator.controller, list[str]()
    for _ in range(4000):
        mode = ticked(controller).robot_mode.name
        if mode not in modes[-1:]:
            modes.append(mode)
    assert modes == ["DISCONNECTED", "BOOTING", "CONFIRM_SAFETY", "POWER_OFF"]
    assert controller.snapshot.safety_confirmed
