"""A robot, its ROS 2 driver, and a plain rclpy program in another process that talks to it."""

import asyncio
import json
import os
import socket
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import ExitStack, aclosing, asynccontextmanager, contextmanager
from itertools import count
from pathlib import Path
from typing import Any
from unittest import mock

from driver_rig import PatientClock

from client.controllers.control import RobotControl
from client.ros2 import message_packages
from client.ros2.control_side import ControlSide
from client.ros2.driver import DriverOptions, Ros2Driver
from emulator.app import Emulator
from urproto.compat_asyncio import timeout

HOST = "127.0.0.1"
SCALED = "scaled_joint_trajectory_controller"
PATIENCE_S = 90.0
_LAST = 99  # UDP ports of those beyond are taken for outgoing connections too
_turns = count(os.getpid())


@contextmanager
def free_domain() -> Iterator[int]:
    """The number of a domain that no other test of this machine uses meanwhile."""
    for _ in range(_LAST):
        number = 1 + next(_turns) % _LAST
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as claim:
            try:
                claim.bind((HOST, 7400 + 250 * number + 249))  # the last port of the domain, which nobody gets
            except OSError:
                continue
            yield number
            return
    raise AssertionError(f"all domains from 1 to {_LAST} are in use")


class Peer:
    """The program peer.py."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process

    async def request(self, **order: Any) -> dict[str, Any]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{json.dumps(order)}\n".encode())
        async with timeout(PATIENCE_S):
            line = await self._process.stdout.readline()
        assert line, f"it ended at {order}"
        answer: dict[str, Any] = json.loads(line)
        assert "error" not in answer or set(answer) != {"error"}, answer
        return answer

    async def call(self, service: str, kind: str, **request: Any) -> dict[str, Any]:
        return await self.request(call=service, type=kind, request=request)

    async def echo(self, topic: str, kind: str, *, latched: bool = False, new: bool = False) -> dict[str, Any]:
        return await self.request(echo=topic, type=kind, latched=latched, new=new)

    async def graph(self, complete: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """What the peer knows of all nodes, once it is complete, or when patience is at its end.

        Nodes, topics and services are made known one after another, and on a busy machine seconds after they exist.
        """
        end_s = time.monotonic() + PATIENCE_S
        while not complete(known := await self.request(graph=True)) and time.monotonic() < end_s:
            await asyncio.sleep(0.1)
        return known

    async def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        async with timeout(PATIENCE_S):
            await self._process.wait()


@asynccontextmanager
async def peer(domain: int) -> AsyncIterator[Peer]:
    message_packages.ensure()  # `make test` has made them
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        str(Path(__file__).with_name("peer.py")),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        limit=2**22,
        env=environment,
    )
    started = Peer(process)
    try:
        yield started
    finally:
        try:
            await started.close()
        except TimeoutError:
            process.kill()
            await process.wait()
            raise


class Lab:
    """What a test has: the emulator, the driver's nodes, its control loop, and the peer."""

    def __init__(self, robot: Emulator, driver: Ros2Driver, side: ControlSide, peer: Peer) -> None:
        self.robot = robot
        self.driver = driver
        self.side = side
        self.peer = peer

    @property
    def control(self) -> RobotControl:
        return self.side.running.control


@asynccontextmanager
async def in_this_process(side: ControlSide) -> AsyncIterator[socket.socket]:
    """Execute the calls of nodes here, as the process of the control loop does, so that a test sees its objects."""
    link, its_link = socket.socketpair()
    async with aclosing(side):
        serving = asyncio.ensure_future(side.calls.serve(its_link))
        try:
            with link:
                yield link
        finally:
            await serving


@asynccontextmanager
async def laboratory(
    robot: Emulator, options: dict[str, Any], host: str = HOST, **of_driver: Any
) -> AsyncIterator[Lab]:
    """A driver for a robot that has been entered, and a peer in its domain. options: of the robot's driver.

    With a patient clock the driver is late by that only: who is late since the machine is busy is not the subject.
    """
    with ExitStack() as stack:
        domain = stack.enter_context(free_domain())
        if isinstance(robot.clock, PatientClock):
            stack.enter_context(mock.patch("client.driver.reverse.time", robot.clock))
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        side = ControlSide()
        async with (
            peer(domain) as other,
            in_this_process(side) as link,
            Ros2Driver(DriverOptions(host, options, domain=domain, **of_driver), link) as driver,
        ):
            yield Lab(robot, driver, side, other)
