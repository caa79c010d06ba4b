"""Begin, effect and end of faults; refused faults; complete removal."""

from collections.abc import Iterator
from typing import Any

import pytest
from fault_rig import Robot

from emulator.clock import RealClock
from emulator.config import ConfigError, read_faults
from emulator.faults.catalogue import kinds, make_fault, parse_fault
from emulator.faults.fault import KINDS, FaultError
from emulator.faults.network import DropConnection
from emulator.machine import ControllerConfig
from emulator.virtual import VirtualRobot
from tests.rows import each_row
from urproto.controlapi import BadArguments, NotPossible
from urproto.robots import START_Q, load_model

NEEDED: dict[str, dict[str, Any]] = {
    "delay": {"delay_s": 0.05},
    "limit_bandwidth": {"bytes_per_s": 5000.0},
    "rtde_field_not_found": {"field": "timestamp"},
    "rtde_input_in_use": {"field": "speed_slider_mask"},
    "lagging_joint": {"joint": 1},
    "frozen_feedback": {"joint": 1},
    "encoder_jump": {"joint": 1, "by_rad": 0.1},
    "joint_fault": {"joint": 1},
    "lost_brake": {"joint": 1},
    "runtime_exception": {"line": 2},
}
# for an ideal arm, and without a scene: see test_scene_faults.py
IMPOSSIBLE = {"lost_brake", "missing_part", "slippery_part", "jammed_conveyor", "covered_camera"}


@pytest.fixture
def virtual() -> VirtualRobot:
    return VirtualRobot(ControllerConfig(model=load_model("ur3"), running=True))


def in_force(robot: VirtualRobot) -> list[float]:
    """The times [s of uptime] within the next second at which joint 5 shows a fault."""
    seen = []
    for _ in range(125):
        time_s = robot.step()
        if robot.state(["actual_q"])["actual_q"][5] != START_Q[5]:
            seen.append(round(time_s, 3))
    return seen


@pytest.mark.parametrize(
    ("schedule", "first", "last"),
    [
        ({}, 41.008, 42.0),
        ({"at": 41.4}, 41.408, 42.0),
        ({"after": 0.4}, 41.408, 42.0),
        ({"until": 41.4}, 41.008, 41.4),
        ({"lasting": 0.4}, 41.008, 41.4),
        ({"after": 0.4, "lasting": 0.2}, 41.408, 41.6),
        ({"at": 41.4, "until": 41.6}, 41.408, 41.6),
    ],
)
def test_the_times_at_which_a_fault_is_active(
    virtual: VirtualRobot, schedule: dict[str, float], first: float, last: float
) -> None:
    virtual.inject_fault("encoder_jump", joint=5, by_rad=0.1, **schedule)
    seen = in_force(virtual)
    assert (seen[0], seen[-1]) == (pytest.approx(first, abs=0.0081), pytest.approx(last, abs=0.0081))
    assert len(seen) == round((seen[-1] - seen[0]) / 0.008) + 1


@each_row(
    ("kind", "arguments", "complaint"),
    [
        ("explosion", {}, "unknown fault 'explosion': choose one of drop_connection"),
        ("stall", {"colour": "red"}, "stall has no argument colour: choose from"),
        ("stall", {"direction": "up"}, "direction"),
        ("stall", {"port": 5}, "port"),
        ("delay", {}, "delay_s"),
        ("delay", {"delay_s": -1.0}, ">= 0"),
        ("delay", {"delay_s": "1"}, "float"),
        ("encoder_jump", {"joint": 6, "by_rad": 0.1}, "<= 5"),
        ("encoder_jump", {"joint": 1, "by_rad": float("nan")}, "finite"),
        ("garble", {"probability": 0.0}, "> 0"),
        ("garble", {"probability": 1.5}, "<= 1"),
        ("drop_connection", {"at": 50.0, "after": 1.0}, "at and after contradict each other"),
        ("drop_connection", {"until": 50.0, "lasting": 1.0}, "until and lasting contradict each other"),
        ("drop_connection", {"at": 50.0, "until": 49.0}, "before it begins"),
        ("drop_connection", {"after": 10.0, "until": 42.0}, "before it begins"),
        ("drop_connection", {"at": 3.0}, "an uptime of 3 s has passed, it is now 41"),
        ("drop_connection", {"until": 3.0}, "has passed"),
        ("drop_connection", {"after": -3.0}, "negative"),
        ("stall", {"once": True}, "leave out once and probability"),
        ("encoder_jump", {"joint": 1, "by_rad": 0.1, "probability": 0.5}, "leave out once and probability"),
    ],
)
async def test_invalid_faults_are_refused(ur3: Robot, kind: str, arguments: dict[str, object], complaint: str) -> None:
    with pytest.raises(BadArguments, match=complaint):
        ur3.control.inject_fault(kind, **arguments)
    assert ur3.control.faults() == []


async def test_two_faults_of_the_same_subject_conflict(ur3: Robot) -> None:
    first = ur3.control.inject_fault("refuse_connections", port="rtde")
    with pytest.raises(BadArguments, match=rf"fault {first} \(refuse_connections\) occupies the listener of rtde"):
        ur3.control.inject_fault("restart_port")
    ur3.control.inject_fault("restart_port", port="dashboard")
    ur3.control.clear_fault(first)
    await ur3.until(lambda: ur3.emulator.servers["rtde"].listening)
    ur3.control.inject_fault("restart_port", port="rtde")


def test_a_robot_without_ports_has_no_network_faults(virtual: VirtualRobot) -> None:
    with pytest.raises(NotPossible, match="stall: this robot has no ports"):
        virtual.inject_fault("stall")


def test_a_one_shot_fault_strikes_once(virtual: VirtualRobot) -> None:
    fault = virtual.inject_fault("program_stuck")
    virtual.clear_fault(fault)
    for number in (fault, 99):
        with pytest.raises(NotPossible, match=f"no fault {number}"):
            virtual.clear_fault(number)


def test_a_pending_fault_can_be_cleared(virtual: VirtualRobot) -> None:
    virtual.inject_fault("encoder_jump", joint=5, by_rad=0.1, after=0.5)
    virtual.clear_faults()
    assert in_force(virtual) == []
    assert [fault["state"] for fault in virtual.faults()] == ["over"]


def test_the_list_of_faults_is_bounded(virtual: VirtualRobot) -> None:
    for _ in range(300):
        virtual.clear_fault(virtual.inject_fault("program_stuck"))
    assert len(virtual.faults()) == 100


async def test_a_hundred_faults_can_be_active(ur3: Robot) -> None:
    for _ in range(100):
        ur3.control.inject_fault("delay", delay_s=0.1, after=1.0)
    with pytest.raises(BadArguments, match="100 faults"):
        ur3.control.inject_fault("delay", delay_s=0.1)


def robots_hooks(robot: Robot) -> Iterator[object]:
    controller = robot.emulator.controller
    yield from (controller.on_tick, controller.snapshot_hooks, controller.programs.step_hook)
    yield from (controller.programs.start_held, controller.programs.frames_held)
    for server in (*robot.emulator.servers.values(), robot.emulator._scripts):
        yield from (vars(server.hooks), server.listening)
    host = robot.emulator.servers["rtde"].host  # type: ignore[attr-defined]
    yield from (host.outputs, host.inputs, host.protocols, host.reservations._owners)


@pytest.mark.parametrize("kind", sorted(KINDS.keys() - IMPOSSIBLE))
async def test_a_cleared_fault_leaves_nothing_behind(ur3: Robot, kind: str) -> None:
    ur3.emulator.faults.site.rate = RealClock(0.008)  # drives nothing
    clients = [await ur3.stream(), await ur3.dashboard()]
    before = repr([*robots_hooks(ur3)])
    arguments = NEEDED.get(kind, {})
    fault = ur3.control.inject_fault(kind, **arguments)
    assert ur3.emulator.controller.on_tick
    for _ in range(40):
        await ur3.step()
        for client in clients:
            client.read()
    ur3.control.clear_faults()
    ur3.control.restart_safety()
    for _ in range(3):
        await ur3.step()
        await ur3.until(lambda: all(server.listening for server in ur3.emulator.servers.values()))
    assert repr([*robots_hooks(ur3)]) == before
    (listed,) = ur3.control.faults()
    assert (listed["id"], listed["kind"], listed["state"], listed["problem"]) == (fault, kind, "over", "")
    assert await ur3.stream()
    assert b"Robotmode" in await ur3.request(await ur3.dashboard(), b"robotmode\n")


def test_every_kind_has_a_description() -> None:
    listed = kinds()
    assert {kind["kind"] for kind in listed} == KINDS.keys()
    assert all(kind["text"].strip().endswith(".") for kind in listed)
    delay = next(kind for kind in listed if kind["kind"] == "delay")
    assert delay["arguments"][:2] == [
        {"name": "port", "type": "str", "default": ""},
        {"name": "peer", "type": "str", "default": ""},
    ]
    assert {"name": "delay_s", "type": "float"} in delay["arguments"]
    stall = next(kind for kind in listed if kind["kind"] == "stall")
    assert "probability" not in {argument["name"] for argument in stall["arguments"]}


def test_faults_from_the_command_line() -> None:
    fault = parse_fault("drop_connection,port=rtde,once=false,probability=0.01,after=5")
    assert fault == DropConnection(port="rtde", once=False, probability=0.01, after=5.0)
    assert make_fault("delay", {"delay_s": 1}) == parse_fault("delay,delay_s=1")
    for text, complaint in (
        ("explosion", "unknown"),
        ("delay,delay_s", "NAME=VALUE"),
        ("delay,delay_s=soon", "delay_s"),
        ("", "unknown"),
    ):
        with pytest.raises(FaultError, match=complaint):
            parse_fault(text)
        with pytest.raises(ConfigError, match=complaint):
            read_faults([text])


async def test_configured_faults_begin_with_the_emulator() -> None:
    async with Robot("ur3", faults=read_faults(["turn_away,port=rtde", "stall,port=dashboard,after=1"])) as robot:
        assert robot.states() == ["in force", "waiting"]
    with pytest.raises(ConfigError, match="fault stall: this robot has no port 'tool line'"):
        async with Robot("ur3", faults=read_faults(["stall,port=tool line"])):
            pass
