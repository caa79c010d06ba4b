"""Faults of RTDE and of the state that ports show."""

import struct

import pytest
from fault_rig import Robot, RTDEClient

from urproto.controlapi import NotPossible
from urproto.rtde.codec import PackageType, RequestProtocol, SetupInputs, SetupOutputs, Start


async def reply(robot: Robot, client: RTDEClient, request: object, protocol: int = 2) -> bytes:
    """The payload of the answer to a request."""
    client.send(request.encode(protocol))  # type: ignore[attr-defined]
    answers: list[bytes] = []

    def answered() -> bool:
        answers.extend(package.payload for package in client.packages() if package.type != PackageType.DATA_PACKAGE)
        return bool(answers)

    await robot.until(answered)
    return answers[0]


async def test_data_pauses_while_requests_are_answered(robot: Robot) -> None:
    client = await robot.stream()
    robot.control.inject_fault("pause_rtde", lasting=20 * robot.period_s)
    await robot.step(20)
    assert client.data() == []
    assert await reply(robot, client, RequestProtocol(2)) == b"\x01"
    await robot.step(10)
    assert len(client.data()) == 10
    assert robot.states() == ["over"]


async def test_random_skipping_of_packages_is_reproducible() -> None:
    seen = []
    for _ in range(2):
        async with Robot("ur3") as robot:
            client = await robot.stream()
            robot.control.inject_fault("skip_rtde", probability=0.3, seed=7)
            start = robot.emulator.controller.step_count
            await robot.step(100)
            times = [round(struct.unpack(">xd", data)[0] * 125) - start for data in client.data()]
            assert 50 < len(times) < 90
            assert robot.strikes() == [100 - len(times)]
            seen.append(times)
    assert seen[0] == seen[1]


@pytest.mark.parametrize(("timestamp", "distinct"), [("runs", 20), ("stands", 1)])
async def test_stale_data(robot: Robot, timestamp: str, distinct: int) -> None:
    client = await robot.stream(("timestamp", "actual_digital_input_bits"))
    fault = robot.control.inject_fault("stale_data", timestamp=timestamp)
    robot.control.set_digital_input(0, True)
    await robot.step(20)
    rows = [struct.unpack(">xdQ", data) for data in client.data()]
    assert len(rows) == 20
    assert {bits for _, bits in rows} == {0}
    assert len({time for time, _ in rows}) == distinct
    robot.control.clear_fault(fault)
    await robot.step()
    ((time, bits),) = [struct.unpack(">xdQ", data) for data in client.data()]
    assert (time, bits) == (robot.emulator.controller.time_s, 1)


async def test_other_ports_show_stale_data_too(ur3: Robot) -> None:
    client = await ur3.connect("realtime")
    ur3.control.inject_fault("stale_data", port="realtime", timestamp="stands")
    await ur3.step(2)
    data = client.read()
    assert data[: len(data) // 2] == data[len(data) // 2 :]


async def test_a_variable_is_not_found(robot: Robot) -> None:
    fault = robot.control.inject_fault("rtde_field_not_found", field="actual_q")
    robot.control.inject_fault("rtde_field_not_found", field="input_int_register_24")
    client = await robot.connect("rtde", RTDEClient)
    await reply(robot, client, RequestProtocol(2))
    setup = SetupOutputs(("timestamp", "actual_q"), 125.0)
    assert await reply(robot, client, setup) == b"\x00DOUBLE,NOT_FOUND"
    assert await reply(robot, client, Start()) == b"\x00"
    assert await reply(robot, client, SetupInputs(("input_int_register_24",))) == b"\x00NOT_FOUND"
    robot.control.clear_fault(fault)
    assert await reply(robot, client, setup) == b"\x01DOUBLE,VECTOR6D"
    assert await reply(robot, client, SetupInputs(("input_int_register_24",))) == b"\x00NOT_FOUND"


async def test_an_input_is_in_use(robot: Robot) -> None:
    fault = robot.control.inject_fault("rtde_input_in_use", field="speed_slider_mask")
    client = await robot.connect("rtde", RTDEClient)
    await reply(robot, client, RequestProtocol(2))
    setup = SetupInputs(("speed_slider_mask", "speed_slider_fraction"))
    assert await reply(robot, client, setup) == b"\x00IN_USE,DOUBLE"
    robot.control.clear_fault(fault)
    assert await reply(robot, client, setup) == b"\x01UINT32,DOUBLE"


async def test_the_owner_of_an_input_keeps_it(ur3: Robot) -> None:
    owner, other = await ur3.connect("rtde", RTDEClient), await ur3.connect("rtde", RTDEClient)
    setup = SetupInputs(("speed_slider_mask",))
    await reply(ur3, owner, setup, 1)
    ur3.control.inject_fault("rtde_input_in_use", field="speed_slider_mask")
    owner.close()
    ur3.clients.remove(owner)
    await ur3.step(3)
    assert (await reply(ur3, other, setup, 1)).endswith(b"IN_USE")
    ur3.control.clear_faults()
    assert (await reply(ur3, other, setup, 1)).endswith(b"UINT32")


async def test_only_the_old_protocol_is_accepted(robot: Robot) -> None:
    fault = robot.control.inject_fault("old_rtde_protocol")
    client = await robot.connect("rtde", RTDEClient)
    assert await reply(robot, client, RequestProtocol(2)) == b"\x00"
    assert await reply(robot, client, SetupOutputs(("timestamp",)), 1) == b"DOUBLE"
    robot.control.clear_fault(fault)
    assert await reply(robot, client, RequestProtocol(2)) == b"\x01"


async def test_variables_missing_in_the_version_are_refused(ur3: Robot) -> None:
    for kind in ("rtde_field_not_found", "rtde_input_in_use"):
        with pytest.raises(NotPossible, match="no_such_thing"):
            ur3.control.inject_fault(kind, field="no_such_thing")
